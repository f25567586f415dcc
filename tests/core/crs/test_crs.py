from dataclasses import dataclass
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st
from pyproj import CRS
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from bumpymap.core import (
    CrsStatement,
    GivenCrs,
    Place,
    common_georeference,
    georeference,
    parse_crs,
    place_notes,
    same_crs,
    stated_crs,
    statement_from_wkt,
    utm_epsg,
)
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.core.types import Georeference

US_FOOT = 1200 / 3937
HERE = Place(Path("site.laz"), (500000.0, 4000000.0, 100.0))


SILENT = CrsStatement()


def settle(statement=SILENT, crs=None, z_unit=None, place=HERE, force=None, must_agree=False):
    return georeference(place, statement, GivenCrs(crs, force, must_agree), z_unit)


@pytest.mark.parametrize("text", ["EPSG:32614", "epsg:32614", "32614", "+proj=utm +zone=14 +datum=WGS84"])
def test_what_a_user_may_write(text):
    assert same_crs(parse_crs(text), CRS(32614))


@pytest.mark.parametrize("text", ["", "EPSG:1", "utm zone 14", "EPSG:32614x"])
def test_what_a_user_may_not_write(text):
    with pytest.raises(UsageError, match="EPSG:32614"):
        parse_crs(text)


TRANSVERSE = (
    'PROJCS["x",GEOGCS["x",DATUM["x",SPHEROID["x",6378137,298.257]],PRIMEM["Greenwich",0],UNIT["degree",0.0174532925]],'
    'PROJECTION["Transverse_Mercator"],PARAMETER["central_meridian",-99],UNIT["metre",1],EXTENSION["PROJ4","{}"]]'
)
DERIVED = (
    'PROJCRS["x",BASEGEOGCRS["x",DATUM["x",ELLIPSOID["x",6378137,298.257]]],CONVERSION["x",METHOD["{}"]{}],'
    'CS[Cartesian,2],AXIS["E",east],AXIS["N",north],LENGTHUNIT["metre",1]]'
)
SHIFTED = CRS("+proj=utm +zone=14 +ellps=clrk66 +nadgrids=conus +type=crs").to_wkt()


@pytest.mark.parametrize("file", ["{}", "@{}", "conus,@{}", "../{}", "http://127.0.0.1/a.tif", "C:\\a.gsb", "~/a.gsb"])
@pytest.mark.parametrize(
    "form",
    [
        "+proj=utm +zone=14 +ellps=clrk66 +nadgrids={} +type=crs",
        "proj=utm zone=14 ellps=clrk66 nadgrids = {}",
        "+proj=utm +zone=14 +datum=WGS84 +geoidgrids={} +type=crs",
        "+init={}:1",
        "+proj=pipeline +step +proj=utm +zone=14 +step +proj=hgridshift +grids={}",
        TRANSVERSE.format("+init={}:1"),
        TRANSVERSE.format("+proj=utm +zone=14 +ellps=clrk66 +nadgrids={} +title=[").replace("x", "[+"),
        DERIVED.format("PROJ-based operation method: +proj=hgridshift +grids={}", ""),
        DERIVED.format("PROJ hgridshift", ',PARAMETERFILE["grids","{}"]'),
        SHIFTED.replace('"conus"', '"{}"'),
        CRS(SHIFTED).to_json().replace('"conus"', '"{}"'),
    ],
)
def test_a_crs_that_names_a_file_elsewhere_is_refused(tmp_path, form, file):
    """PROJ would open it: a pipe would be waited for."""
    text = form.replace("{}", file.replace("{}", str(tmp_path / "a")))
    with pytest.raises(UsageError, match="names a file by its path"):
        parse_crs(text)
    assert statement_from_wkt(text).trouble


@pytest.mark.parametrize(
    "text",
    [
        SHIFTED,
        CRS(3857).to_wkt("WKT1_GDAL"),
        "+proj=utm +zone=14 +datum=WGS84 +units=us-ft +type=crs",
        "urn:ogc:def:crs:EPSG::32614",
        'LOCAL_CS["a/b",UNIT["metre",1]]',
    ],
)
def test_a_crs_may_name_what_proj_has(text):
    assert stated_crs(text) == CRS(text)


@pytest.mark.parametrize("spelling", ["WKT1_GDAL", "WKT1_ESRI", "WKT2_2019"])
@pytest.mark.parametrize("code", [32614, 3005, 2992, 2276, 2154, 31467])
def test_one_crs_in_every_spelling(code, spelling):
    statement = statement_from_wkt(CRS(code).to_wkt(spelling))
    assert same_crs(statement.crs, CRS(code))
    place, _ = settle(statement)
    assert place.metres_per_unit == {2992: 0.3048, 2276: US_FOOT}.get(code, 1.0)


def test_us_feet_of_few_digits_are_the_same_unit():
    text = CRS(2276).to_wkt("WKT1_GDAL").replace("0.304800609601219", "0.3048006096")
    assert "0.3048006096," in text
    assert settle(statement_from_wkt(text))[0].metres_per_unit == US_FOOT


def test_heights_of_a_three_dimensional_crs():
    place, _ = settle(CrsStatement(CRS(32614).to_3d()))
    assert place.crs.to_epsg() == 32614
    assert len(place.crs.axis_info) == 2


# What a file states, what is given, and the CRS that counts; the units of the forced ones.
@pytest.mark.parametrize(
    ("own", "crs", "used"),
    [
        ("EPSG:32614", "EPSG:32613", "EPSG:32614"),
        ("EPSG:2276", "EPSG:32614", "EPSG:2276"),
        ("EPSG:32614+6360", "EPSG:32614+5703", "EPSG:32614+6360"),
        ("EPSG:32614+5703", "EPSG:32613", "EPSG:32614+5703"),
    ],
)
def test_a_given_crs_is_for_files_that_have_none(own, crs, used):
    file = CrsStatement(CRS(own))
    place, notes = settle(file, crs)
    assert place == settle(file)[0]
    assert place.crs == CRS(used)
    assert f"`force_crs='{crs}'`" in "".join(notes)
    with pytest.raises(UsageError, match=r"site\.laz.*`force_crs='EPSG"):
        settle(file, crs, must_agree=True)
    assert settle(file, force=crs)[0].crs.to_2d().to_epsg() == CRS(crs).to_2d().to_epsg()


@pytest.mark.parametrize(("own", "crs"), [("EPSG:32614", "EPSG:32614+5703"), ("EPSG:32614+5703", "EPSG:32614")])
def test_a_given_crs_that_agrees_supplies_heights_and_makes_no_noise(own, crs):
    place, notes = settle(CrsStatement(CRS(own)), crs, must_agree=True)
    assert (place.crs, notes) == (CRS("EPSG:32614+5703"), ())


@pytest.mark.parametrize(
    ("own", "force", "units"),
    [
        ("EPSG:32614+6360", "EPSG:32614+5703", (1.0, 1.0)),
        ("EPSG:32614+6360", "EPSG:32613", (1.0, US_FOOT)),
        ("EPSG:2276+6360", "EPSG:32614", (1.0, 1.0)),
    ],
)
def test_heights_under_a_forced_crs(own, force, units):
    """The file's unit of height stays, unless the CRS has one, or contradicts the file's horizontal unit."""
    place, _ = settle(CrsStatement(CRS(own)), force=force)
    assert (place.metres_per_unit, place.metres_per_unit_z) == units


def settled(statement=SILENT, crs=None, z_unit=None):
    return settle(statement, crs, z_unit)[0].crs


def test_the_vertical_part_stays():
    compound = CRS("EPSG:32614+5703")
    assert settled(CrsStatement(compound)) == compound
    assert settled(crs="EPSG:32614+5703") == compound
    assert settled(statement_from_wkt(compound.to_wkt("WKT1_GDAL"))) == compound
    # Heights that are said to be feet are metres in the layers, from the same zero.
    assert settled(CrsStatement(compound), z_unit="us-ft") == compound
    # One that has a code of its own keeps it.
    assert settled(CrsStatement(CRS(7405))).to_epsg() == 7405


def test_the_files_vertical_part_goes_with_a_given_crs_that_agrees():
    file = CrsStatement(CRS("EPSG:32614+5703"))
    assert settled(file, "EPSG:32614") == CRS("EPSG:32614+5703")
    assert settle(file, force="EPSG:32613")[0].crs == CRS("EPSG:32613")
    assert settle(file, force="EPSG:32614+5773")[0].crs == CRS("EPSG:32614+5773")


def test_heights_in_feet_are_written_without_their_crs_and_that_is_said():
    place, notes = settle(CrsStatement(CRS("EPSG:2276+6360")))
    assert (place.metres_per_unit_z, place.crs.is_compound) == (US_FOOT, True)
    assert [note for note in notes if "NAVD88 height (ftUS) (EPSG:6360) is not in metres" in note]


def test_depths_are_no_heights():
    assert settled(CrsStatement(CRS("EPSG:32614+5715"))) == CRS("EPSG:32614")


def test_trouble_is_refused_or_set_aside():
    trouble = CrsStatement(trouble="it is a riddle")
    with pytest.raises(BadInputError, match=r"site\.laz.*riddle.*`crs`"):
        settle(trouble)
    place, notes = settle(trouble, "EPSG:32614")
    assert place.crs.to_epsg() == 32614
    assert any("riddle" in note for note in notes)


def test_a_clause_around_a_crs_with_a_code_is_taken_off():
    crs = CRS("+proj=utm +zone=33 +ellps=intl +towgs84=-87,-98,-121 +type=crs")
    assert settle(CrsStatement(crs))[0].crs.is_bound
    coded = statement_from_wkt(
        CRS(23033)
        .to_wkt("WKT1_GDAL")
        .replace('AUTHORITY["EPSG","6230"]]', 'TOWGS84[-87,-98,-121,0,0,0,0],AUTHORITY["EPSG","6230"]]')
    )
    assert coded.crs.is_bound
    assert settle(coded)[0].crs.to_epsg() == 23033


def test_a_local_crs_is_no_crs_but_has_units():
    place, notes = settle(statement_from_wkt('LOCAL_CS["pit grid",UNIT["foot",0.3048]]'))
    assert place == Georeference(None, 0.3048, 0.3048)
    assert any("pit grid" in note for note in notes)


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:4979", "EPSG:4269+5703"])
def test_degrees_are_refused(crs):
    place = Place(Path("my site.laz"), (-99.1, 19.4, 2240.0))
    with pytest.raises(BadInputError) as caught:
        settle(CrsStatement(CRS(crs)), place=place)
    assert "pdal translate 'my site.laz' 'my site_metres.laz'" in str(caught.value)
    assert "out_srs=EPSG:32614" in str(caught.value)
    assert "in_srs" not in str(caught.value)


def test_earth_centred_coordinates_are_refused_with_their_zone():
    # 99.1 W, 19.4 N at 2240 m, by the closed formula on the WGS 84 ellipsoid.
    place = Place(Path("a.laz"), (-952_258.6, -5_944_768.1, 2_106_146.8))
    with pytest.raises(BadInputError, match=r"Earth-centred.*out_srs=EPSG:32614"):
        settle(CrsStatement(CRS(4978)), place=place)


@settings(max_examples=15)
@given(longitude=st.floats(-179.99, 179.99).map(lambda v: round(v, 6)), latitude=st.floats(-79.9, 83.9))
def test_utm_zone_is_one_that_the_registry_gives_for_the_place(longitude, latitude):
    area = AreaOfInterest(longitude, latitude, longitude, latitude)
    codes = {int(info.code) for info in query_utm_crs_info("WGS 84", area)}
    assert utm_epsg(longitude, latitude) in codes


def test_utm_at_the_ends_of_the_earth():
    assert [utm_epsg(*place) for place in [(10, 85), (10, -81), (180, 1), (-180, -1), (190, 1)]] == [
        5041, 5042, 32601, 32701, 32602,
    ]  # fmt: skip


@pytest.mark.parametrize("unit", [0, 1e-9, 1e12])
def test_units_that_are_none(unit):
    wkt = CRS("EPSG:32614").to_wkt("WKT1_GDAL").replace('UNIT["metre",1', f'UNIT["metre",{unit}')
    with pytest.raises(
        BadInputError, match=r"the CRS of site\.laz is unclear: .* has an invalid unit of .*`force_crs`"
    ):
        settle(statement_from_wkt(wkt))
    with pytest.raises(UsageError, match="has an invalid unit of"):
        settle(crs=wkt)
    assert settle(statement_from_wkt(wkt), force="EPSG:32614")[0].metres_per_unit == 1.0


def noted(code, x, y):
    return place_notes(Place(Path("site.laz"), (x, y, 0.0)), CRS(code))


def test_a_metre_that_is_none_is_noted():
    (note,) = noted(3857, 1e6, 6.2e6)  # 48.6 N: cos = 0.66
    assert "0.66" in note
    assert noted(32614, 500_000, 2_136_000) == []
    assert noted(2276, 2.5e6, 7e6) == []


@pytest.mark.parametrize(
    ("code", "x", "y", "says"),
    [
        (32614, 2_135_914, 480_717, "Eastings and northings seem to be swapped"),
        (25832, 512_350 / 0.3048, 5_403_300 / 0.3048, "Feet seem to have been read as metres"),
        (2227, 1_900_000, 600_000, "Metres seem to have been read as feet"),
        (2992, 100, 100, "local frame"),
        (31467, 512_350, 5_403_300, "34.8 degrees outside"),  # without the number of the zone
    ],
)
def test_coordinates_outside_the_area_of_use_are_noted_with_what_they_may_be(code, x, y, says):
    (note,) = noted(code, x, y)
    assert says in note
    assert "force_crs" in note


def test_a_survey_that_crosses_the_border_of_a_zone_is_none_of_them():
    assert not any("area of use" in note for note in noted(32614, 830_000, 2_135_914))  # 0.1 degrees beyond it
    assert noted(3832, 4_000_000, -2_000_000)[0].startswith("one metre")  # its area crosses the antimeridian


def test_coordinates_that_are_no_place_in_their_crs_are_refused():
    with pytest.raises(BadInputError, match="is no place on Earth in WGS 84"):
        noted(32614, 1e12, 1e12)


@dataclass
class Info:
    path: Path
    georeference: Georeference


def infos(*crs):
    return [Info(Path(f"{i}.laz"), Georeference(c and CRS(c), 1.0)) for i, c in enumerate(crs)]


def test_files_of_one_crs_share_it_however_it_is_spelled():
    esri = CRS(32614).to_wkt("WKT1_ESRI")
    given = infos("EPSG:32614", esri, "EPSG:32614")
    assert common_georeference(given) is given[0].georeference
    assert common_georeference(given[::-1]) is given[0].georeference
    assert common_georeference(infos(None, None)).crs is None


@pytest.mark.parametrize(
    ("crs", "says"), [(("EPSG:32614", "EPSG:32613"), "EPSG:32613"), (("EPSG:32614", None), "no CRS")]
)
def test_files_of_several_crs_are_listed(crs, says):
    with pytest.raises(BadInputError) as caught:
        common_georeference(infos(*crs))
    message = str(caught.value)
    assert "0.laz: WGS 84 / UTM zone 14N (EPSG:32614)" in message
    assert says in message
    assert "crs`" in message


def test_files_of_several_vertical_crs_are_listed():
    with pytest.raises(BadInputError) as caught:
        common_georeference(infos("EPSG:32614+5703", "EPSG:32614+5773"))
    message = str(caught.value)
    assert "heights of the files are not in one vertical CRS" in message
    assert "0.laz: WGS 84 / UTM zone 14N + NAVD88 height (EPSG:32614+5703)" in message
    assert "1.laz: WGS 84 / UTM zone 14N + EGM96 height (EPSG:32614+5773)" in message
    assert "`force_crs`" in message


def test_files_with_and_without_a_vertical_crs_share_the_horizontal_one(caplog):
    assert common_georeference(infos("EPSG:32614+5703", "EPSG:32614")).crs == CRS("EPSG:32614")
    assert "1 of 2 files state a vertical CRS (NAVD88 height (EPSG:5703)), so the layers carry none" in caplog.text


def test_files_in_metres_and_in_feet_from_one_zero_share_it_in_metres(caplog):
    assert common_georeference(infos("EPSG:32614+6360", "EPSG:32614+5703")).crs == CRS("EPSG:32614+5703")
    assert common_georeference(infos("EPSG:32614+5703", "EPSG:32614+5703")).crs == CRS("EPSG:32614+5703")
    spelled = (
        CRS("EPSG:32614+5703").to_wkt("WKT1_GDAL").replace("Datum 1988", "Datum_1988").replace(",AUTHORITY[", ",X[")
    )
    assert common_georeference(infos("EPSG:32614+5703", spelled)).crs == CRS("EPSG:32614+5703")
    assert not caplog.text
