"""The CRS that counts: what a file states and a user gives, units, heights, places, and the CRS that files share."""

import json
import re
from dataclasses import dataclass
from pathlib import Path

import geopandas
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from pyproj import CRS
from small_surveys import run, write_survey

from bumpymap.core import BadInputError, Georeference, Place, UsageError, common_georeference, same_crs, stated_crs
from bumpymap.core.crs import CrsStatement, GivenCrs, georeference, parse_crs, place_notes, statement_from_wkt, utm_epsg

pytestmark = pytest.mark.usefixtures("without_views")

US_FOOT = 1200 / 3937
HERE = Place(Path("site.laz"), (500000.0, 4000000.0, 100.0))
SILENT = CrsStatement()


def settle(statement=SILENT, crs=None, z_unit=None, place=HERE, force=None, must_agree=False, xy_unit=None):
    return georeference(place, statement, GivenCrs(crs, force, must_agree, xy_unit, z_unit))


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


FEET = CRS(2276).to_wkt("WKT1_GDAL").replace("0.304800609601219", "0.3048006096")
BOUND = CRS("+proj=utm +zone=33 +ellps=intl +towgs84=-87,-98,-121 +type=crs").to_wkt()
CLAUSE = 'TOWGS84[-87,-98,-121,0,0,0,0],AUTHORITY["EPSG","6230"]]'
CODED = CRS(23033).to_wkt("WKT1_GDAL").replace('AUTHORITY["EPSG","6230"]]', CLAUSE)
NAVD = "EPSG:32614+5703"


@pytest.mark.parametrize(
    ("own", "given", "crs", "units", "said"),
    [
        (NAVD, {}, NAVD, (1.0, 1.0), ""),
        (None, {"crs": NAVD}, NAVD, (1.0, 1.0), ""),
        (CRS(NAVD).to_wkt("WKT1_GDAL"), {}, NAVD, (1.0, 1.0), ""),
        # Heights that are said to be feet are metres in the layers, from the same zero.
        (NAVD, {"z_unit": "us-ft"}, NAVD, (1.0, US_FOOT), ""),
        # Depths, and heights above the ellipsoid, are left out.
        ("EPSG:32614+5715", {}, "EPSG:32614", (1.0, 1.0), ""),
        (CRS(32614).to_3d().to_wkt(), {}, "EPSG:32614", (1.0, 1.0), ""),
        # The file's unit of height stays, unless the forced CRS has one, or contradicts the file's horizontal unit.
        ("EPSG:32614+6360", {"force": NAVD}, NAVD, (1.0, 1.0), ""),
        ("EPSG:32614+6360", {"force": "EPSG:32613"}, "EPSG:32613", (1.0, US_FOOT), ""),
        ("EPSG:2276+6360", {"force": "EPSG:32614"}, "EPSG:32614", (1.0, 1.0), ""),
        (
            "EPSG:2276+6360",
            {},
            "EPSG:2276+6360",
            (US_FOOT, US_FOOT),
            "NAVD88 height (ftUS) (EPSG:6360) is not in metres",
        ),
        # A clause around a CRS with a code is taken off.
        (BOUND, {}, BOUND, (1.0, 1.0), ""),
        (CODED, {}, "EPSG:23033", (1.0, 1.0), ""),
        # A local CRS is no CRS, but has units.
        ('LOCAL_CS["pit grid",UNIT["foot",0.3048]]', {}, None, (0.3048, 0.3048), "pit grid"),
        # A unit is given where no CRS has one; heights follow it.
        (None, {"xy_unit": "us-ft"}, None, (US_FOOT, US_FOOT), ""),
        (None, {"xy_unit": "ft", "z_unit": "m"}, None, (0.3048, 1.0), ""),
        ('LOCAL_CS["pit grid",UNIT["metre",1]]', {"xy_unit": "ft"}, None, (0.3048, 0.3048), ""),
        (FEET, {"xy_unit": "ft"}, FEET, (US_FOOT, US_FOOT), ""),
    ],
)
def test_the_crs_and_the_units_that_count(own, given, crs, units, said):
    place, notes = settle(statement_from_wkt(own) if own else SILENT, **given)
    assert place.crs == (crs and CRS(crs))
    assert crs is None or place.crs.to_epsg() == CRS(crs).to_epsg()
    assert (place.metres_per_unit, place.metres_per_unit_z) == units
    assert said in "".join(notes)


def test_a_unit_that_nothing_states_is_assumed_and_one_that_contradicts_the_crs_is_refused():
    assert settle()[0] == Georeference(None, 1.0, 1.0, assumed=True)
    for known in (settle(xy_unit="m"), settle(crs="EPSG:32614"), settle(CrsStatement(None, 0.3048))):
        assert not known[0].assumed
    with pytest.raises(UsageError, match=r"site\.laz.*metre.*xy_unit='ft'.*force_crs"):
        settle(crs="EPSG:32614", xy_unit="ft")


def test_trouble_is_refused_or_set_aside():
    trouble = CrsStatement(trouble="it is a riddle")
    with pytest.raises(BadInputError, match=r"site\.laz.*riddle.*`crs`"):
        settle(trouble)
    place, notes = settle(trouble, "EPSG:32614")
    assert place.crs.to_epsg() == 32614
    assert any("riddle" in note for note in notes)


def test_earth_centred_coordinates_are_refused_with_their_zone():
    # 99.1 W, 19.4 N at 2240 m, by the closed formula on the WGS 84 ellipsoid.
    place = Place(Path("a.laz"), (-952_258.6, -5_944_768.1, 2_106_146.8))
    with pytest.raises(BadInputError, match=r"Earth-centred.*out_srs=EPSG:32614"):
        settle(CrsStatement(CRS(4978)), place=place)


def test_utm_at_the_ends_of_the_earth():
    assert [utm_epsg(*place) for place in [(10, 85), (10, -81), (180, 1), (-180, -1), (190, 1)]] == [
        5041, 5042, 32601, 32701, 32602,
    ]  # fmt: skip


@pytest.mark.parametrize("unit", [0, 1e-9, 1e12])
def test_units_that_are_none(unit):
    wkt = CRS("EPSG:32614").to_wkt("WKT1_GDAL").replace('UNIT["metre",1', f'UNIT["metre",{unit}')
    with pytest.raises(BadInputError, match=r"CRS of site\.laz is unclear: .* has an invalid unit of .*`force_crs`"):
        settle(statement_from_wkt(wkt))
    with pytest.raises(UsageError, match="has an invalid unit of"):
        settle(crs=wkt)
    assert settle(statement_from_wkt(wkt), force="EPSG:32614")[0].metres_per_unit == 1.0


@pytest.mark.parametrize(
    ("code", "x", "y", "says"),
    [
        (3857, 1e6, 6.2e6, "0.66"),  # 48.6 N: the cosine is what a metre is
        (3832, 4_000_000, -2_000_000, "one metre"),  # its area crosses the antimeridian
        (32614, 500_000, 2_136_000, ""),
        (32614, 830_000, 2_135_914, ""),  # 0.1 degrees beyond the border of the zone, as of a survey that crosses it
        (32614, 2_135_914, 480_717, "Eastings and northings seem to be swapped.*force_crs"),
        (25832, 512_350 / 0.3048, 5_403_300 / 0.3048, "Feet seem to have been read as metres.*force_crs"),
        (2227, 1_900_000, 600_000, "Metres seem to have been read as feet.*force_crs"),
        (2992, 100, 100, "local frame.*force_crs"),
        (31467, 512_350, 5_403_300, "34.8 degrees outside.*force_crs"),  # without the number of the zone
    ],
)
def test_what_is_odd_of_a_place_in_its_crs_is_noted(code, x, y, says):
    notes = place_notes(Place(Path("site.laz"), (x, y, 0.0)), CRS(code))
    assert len(notes) == bool(says)
    assert all(re.search(says, note, re.DOTALL) for note in notes)


def test_coordinates_that_are_no_place_in_their_crs_are_refused():
    with pytest.raises(BadInputError, match="is no place on Earth in WGS 84"):
        place_notes(Place(Path("site.laz"), (1e12, 1e12, 0.0)), CRS(32614))


@dataclass
class Info:
    path: Path
    georeference: Georeference


def infos(*crs):
    return [Info(Path(f"{i}.laz"), Georeference(c and CRS(c), 1.0)) for i, c in enumerate(crs)]


VERTICAL = CRS("EPSG:32614+5703").to_wkt("WKT1_GDAL").replace("Datum 1988", "Datum_1988").replace(",AUTHORITY[", ",X[")


@pytest.mark.parametrize(
    ("crs", "shared", "said"),
    [
        (("EPSG:32614", CRS(32614).to_wkt("WKT1_ESRI"), "EPSG:32614"), "EPSG:32614", ""),
        ((None, None), None, ""),
        (
            ("EPSG:32614+5703", "EPSG:32614"),
            "EPSG:32614",
            "1 of 2 files state a vertical CRS (NAVD88 height (EPSG:5703)), so the layers carry none",
        ),
        # Metres and feet from one zero share it in metres.
        (("EPSG:32614+6360", "EPSG:32614+5703"), "EPSG:32614+5703", ""),
        (("EPSG:32614+5703", VERTICAL), "EPSG:32614+5703", ""),
    ],
)
def test_files_of_one_crs_share_it_however_it_is_spelled(crs, shared, said, caplog):
    found = common_georeference(infos(*crs)).crs
    assert found == (shared and CRS(shared))
    assert found is None or found.to_epsg() == CRS(shared).to_epsg()
    assert said in caplog.text
    assert bool(caplog.text) == bool(said)


@pytest.mark.parametrize(
    ("crs", "says"),
    [
        (("EPSG:32614", "EPSG:32613"), ["0.laz: WGS 84 / UTM zone 14N (EPSG:32614)", "EPSG:32613", "crs`"]),
        (("EPSG:32614", None), ["0.laz: WGS 84 / UTM zone 14N (EPSG:32614)", "no CRS", "crs`"]),
        (
            ("EPSG:32614+5703", "EPSG:32614+5773"),
            [
                "heights",
                "UTM zone 14N + NAVD88 height (EPSG:32614+5703)",
                "1.laz: WGS 84 / UTM zone 14N + EGM96",
                "`force_crs`",
            ],
        ),
    ],
)
def test_files_of_several_crs_are_listed(crs, says):
    with pytest.raises(BadInputError) as caught:
        common_georeference(infos(*crs))
    assert [part for part in says if part not in str(caught.value)] == []


@pytest.mark.parametrize(
    ("crs", "text"),
    [
        ("EPSG:32614+5703", "NAVD88 height (EPSG:5703); heights in metres"),
        ("EPSG:32614", "none given; heights as in the survey, in metres"),
        ("EPSG:2271+6360", "NAVD88 height (ftUS) (EPSG:6360); heights in metres"),
    ],
)
def test_layers_with_heights_carry_it_others_do_not_and_all_name_it(tmp_path, crs, text):
    out, crs = tmp_path / "out", CRS(crs)
    survey = write_survey(tmp_path / "site.las", epsg=crs)
    run("map", survey, "--out", out, code=0)
    in_metres = crs if "ftUS" not in text else crs.sub_crs_list[0]
    for path in out.rglob("*.tif"):
        with rasterio.open(path) as raster:
            assert raster.tags()["vertical_crs"] == text
            assert CRS.from_wkt(raster.crs.to_wkt()) == (
                in_metres if path.stem in {"heightmap", "relief"} else crs.to_2d()
            )
    tiles = geopandas.read_parquet(out / "tiles.parquet")
    assert tiles.crs == in_metres
    assert pq.read_schema(out / "tiles.parquet").metadata[b"vertical_crs"].decode() == text
    assert json.loads((out / "cost.geojson").read_text(encoding="utf-8"))["vertical_crs"] == text
    lines = pyogrio.read_info(out / "cost.fgb")
    assert (lines["crs"], lines["layer_metadata"]["vertical_crs"]) == (crs.to_2d().to_string(), text)
    stated = json.loads((out / "run.json").read_text(encoding="utf-8"))["crs"]
    assert CRS.from_wkt(stated["wkt"]) == CRS.from_user_input(stated["code"]) == in_metres
