"""LAS and LAZ: hand-counted points, units and CRS, headers that lie and what a decoder may do."""

import struct
from datetime import date

import numpy as np
import pytest
from las_files import wkt
from pyproj import CRS
from survey_kinds import read_points

from bumpymap.core import BadInputError, horizontal_of
from bumpymap.readers import ReadOptions, open_survey, reopen_survey

US_FOOT = 1200 / 3937


@pytest.mark.parametrize("ending", ["las", "laz"])
@pytest.mark.parametrize(("version", "fmt"), [("1.0", 0), ("1.1", 0), ("1.2", 3), ("1.3", 5), ("1.4", 6), ("1.4", 10)])
def test_every_version_format_and_compression_gives_the_hand_counted_points(las, version, fmt, ending):
    written = "1.1" if version == "1.0" else version  # which laspy does not write
    path = las.write(
        f"a.{ending}", version=written, fmt=fmt, classification=las.classes, withheld=las.withheld, epsg=32614
    )
    las.patch(path, 25, "<B", int(version[2:]))
    reader = open_survey(path)
    points, ground = read_points(reader)
    assert np.array_equal(points, las.points[:4])
    assert ground.tolist() == [True, False, True, False]
    assert reader.dropped == {"withheld": 1, "noise": 2, "not_a_number": 0}
    assert reader.info.point_count == 7
    assert reader.info.format == f"{ending.upper()} {version}, point format {fmt}"
    assert reader.info.georeference.crs.to_epsg() == 32614
    assert reader.info.size_bytes == path.stat().st_size
    box = reader.info.bounds
    assert (box.west, box.south, box.east, box.north) == (500000.001, 4000000.002, 500004.999, 4000004.999)


def wkt_of(crs):
    return CRS(crs).to_wkt("WKT1_GDAL")


@pytest.mark.parametrize(
    ("said", "unit", "unit_z"),
    [
        ("EPSG:32614", 1.0, 1.0),
        ("EPSG:2992", 0.3048, 0.3048),  # Oregon, international foot
        ("EPSG:2276", US_FOOT, US_FOOT),  # Texas, US survey foot
        ("EPSG:32614+5703", 1.0, 1.0),
        ("EPSG:2992+6360", 0.3048, US_FOOT),  # foot, heights in US survey foot
        ("EPSG:2276+5703", US_FOOT, 1.0),  # US survey foot, heights in metres
        ({1024: 1, 3072: 2276}, US_FOOT, US_FOOT),
        ({1024: 1, 3072: 32614, 4099: 9003}, 1.0, US_FOOT),
        ({1024: 1, 3072: 32614, 4096: 6360}, 1.0, US_FOOT),
        ({3076: 9003}, US_FOOT, US_FOOT),
        ({1024: 1, 3072: 32767, 3076: 9002, 4099: 9001}, 0.3048, 1.0),
    ],
)
def test_units_of_a_wkt_record_or_of_geotiff_keys(las, said, unit, unit_z):
    is_wkt = isinstance(said, str)
    path = las.write(version="1.4", fmt=6, wkt=wkt_of(said)) if is_wkt else las.write(geokeys=said)
    reader = open_survey(path)
    assert np.allclose(read_points(reader)[0], las.points * [unit, unit, unit_z], rtol=1e-14)
    place = reader.info.georeference
    assert (place.metres_per_unit, place.metres_per_unit_z) == (unit, unit_z)
    code = 32767 if is_wkt else said.get(3072, 32767)
    assert place.crs == CRS(said) if is_wkt else (place.crs is None) == (code == 32767)
    assert reader.info.bounds.east == pytest.approx(500004.999 * unit, rel=1e-14)
    for z_unit, metres in (("m", 1.0), ("ft", 0.3048), ("us-ft", US_FOOT)):
        points, _ = read_points(open_survey(path, ReadOptions(z_unit=z_unit)))
        assert np.allclose(points, las.points * [unit, unit, metres], rtol=1e-14)


UTM = wkt_of("EPSG:32614")
WITH_HEIGHT = wkt_of("EPSG:26914+6360")
"""NAVD88 in US survey feet."""
RECORDS = {
    "both, wkt named": ({"wkt": UTM, "epsg": 32613, "wkt_bit": True}, 32614, "is used"),
    "both, keys named": ({"wkt": UTM, "epsg": 32613, "wkt_bit": False}, 32613, "is used"),
    "wkt alone": ({"wkt": UTM, "wkt_bit": False}, 32614, None),
    "keys alone": ({"epsg": 32614, "wkt_bit": True}, 32614, None),
    "user-defined keys": (
        {"wkt": UTM, "geokeys": {1024: 1, 3072: 32767, 3076: 9001}, "wkt_bit": False},
        32614,
        "taken from its WKT",
    ),
    "extended": ({"evlr_wkt": UTM}, 32614, None),
    "none": ({}, None, None),
    "two wkt, the first empty": ({"records": [("LASF_Projection", 2112, b""), wkt(UTM)]}, None, None),
    "height, named": ({"wkt": WITH_HEIGHT, "epsg": 26914, "wkt_bit": True}, 26914, "in another unit (US survey foot)"),
    "height, not named": ({"wkt": WITH_HEIGHT, "epsg": 26914, "wkt_bit": False}, 26914, "unit of height"),
}


@pytest.mark.parametrize("name", RECORDS)
def test_of_several_records_the_one_that_the_header_names_counts(las, name):
    how, code, note = RECORDS[name]
    info = open_survey(las.write(version="1.4", fmt=6, **how)).info
    place = info.georeference
    assert (place.crs and horizontal_of(place.crs).to_epsg()) == code
    assert any(note in said for said in info.notes) if note else info.notes == ()
    assert any("unit of height" in said for said in info.notes) == (name == "height, not named")
    assert place.metres_per_unit == 1.0
    assert place.metres_per_unit_z == pytest.approx(US_FOOT if "height" in name else 1.0, rel=1e-9)


@pytest.mark.parametrize("ending", ["las", "laz"])
def test_a_scale_that_is_coarse_for_pixels_is_refused_and_one_of_heights_is_noted(las, ending):
    def opened(*scales, **options):
        how = {} if "xy_unit" in options else {"epsg": 32614}
        options = ReadOptions(**{"pixel_m": 0.2} | options)
        return open_survey(las.write(f"a.{ending}", scale=scales, version="1.4", fmt=6, **how), options).info

    for scales in ((0.1, 0.001, 0.001), (0.001, 0.5, 0.001)):
        with pytest.raises(BadInputError, match=rf"{max(scales):g} m.*scale.*0\.2 m.*Export"):
            opened(*scales)
    assert opened(0.05, 0.05, 0.05).notes == ()
    assert opened(0.1, 0.1, 0.001, pixel_m=0.4).notes == ()
    assert "heights" not in str(opened(0.1, 0.1, 0.1, xy_unit="ft").notes)  # 3 cm
    (note,) = opened(0.001, 0.001, 0.1).notes
    assert "heights" in note
    assert "0.1 m" in note


@pytest.mark.parametrize(
    ("how", "says"),
    [
        ({"wkt": "PROJCS[oh no"}, "WKT"),
        ({"geokeys": {1024: 1, 3072: 32614, 3076: 9002}}, "unit"),
        ({"geokeys": {1024: 1, 3072: 30001}}, "EPSG:30001"),
        ({"geokeys": {1024: 1, 3072: 32614, 3076: 32632}}, "32632"),
    ],
)
def test_a_crs_that_cannot_be_told_is_refused_unless_one_is_given(las, how, says):
    path = las.write(version="1.4", fmt=6, **how)
    with pytest.raises(BadInputError, match=f"{says}.*`crs`"):
        open_survey(path)
    for survey, options, code in (
        (path, {"crs": "EPSG:32614"}, 32614),
        (las.write("none.las"), {"crs": "EPSG:32614"}, 32614),
        (las.write("other.las", epsg=32613), {"crs": "EPSG:32614"}, 32613),
        (las.write("other.las", epsg=32613), {"force_crs": "EPSG:32614"}, 32614),
    ):
        assert open_survey(survey, ReadOptions(**options)).info.georeference.crs.to_epsg() == code


@pytest.mark.parametrize(
    ("said", "crs"), [({"wkt": wkt_of(4326)}, None), ({"geokeys": {1024: 2, 2048: 4326}}, None), ({}, "EPSG:4326")]
)
def test_degrees_are_refused_with_the_command_that_helps(las, said, crs):
    points = np.array([[-99.1 + d, 19.4 + d, 10.0] for d in (-0.001, 0.001)])
    path = las.write(points=points, scale=(1e-7, 1e-7, 0.001), offset=(0, 0, 0), **said)
    with pytest.raises(BadInputError) as caught:
        open_survey(path, ReadOptions(crs=crs))
    command = caught.value.args[-1].strip()
    assert command.startswith(f"pdal translate {path} a_metres.laz reprojection ")
    assert "--filters.reprojection.out_srs=EPSG:32614" in command
    assert ("--filters.reprojection.in_srs=EPSG:4326" in command) == (crs is not None)
    assert "--writers.las.scale_z=0.001" in command


def test_metres_that_are_said_to_be_degrees_and_degrees_without_a_crs(las, caplog):
    with pytest.raises(BadInputError, match=r"not such a place.*`force_crs`"):
        open_survey(las.write(wkt=wkt_of(4326)))
    path = las.write(points=np.array([[-99.1, 19.4, 10.0]]), scale=1e-7, offset=(0, 0, 0))
    noted = open_survey(path)
    (note,) = noted.info.notes
    assert "look like degrees" in note
    assert note in caplog.text
    caplog.clear()
    again = reopen_survey(path, ReadOptions())  # as workers do, without saying it again
    assert not caplog.text
    assert (again.info, again.chunks()) == (noted.info, noted.chunks())


@pytest.mark.parametrize("version", ["1.2", "1.4"])
def test_the_date_in_the_header_is_none_if_there_is_no_such_day(las, version):
    path = las.write(version=version, fmt=1 if version == "1.2" else 6)
    days = {(1, 2024): date(2024, 1, 1), (366, 2024): date(2024, 12, 31)}
    days |= dict.fromkeys([(366, 2023), (0, 2024), (60, 0), (60, 124), (65535, 65535)])
    for given, day in days.items():
        assert open_survey(las.patch(path, 90, "<HH", *given)).info.header_date == day


# ---- files that lie or are damaged: one message each, never another exception, never a lost process ----

MAX_X, MIN_X, MAX_Y, MIN_Y = 179, 187, 195, 203


def exhaust(path, **options):
    return sum(cloud.easting.size for cloud in open_survey(path, ReadOptions(**options)).clouds())


def refused(path, *says):
    with pytest.raises(BadInputError) as caught:
        exhaust(path)
    message = str(caught.value)
    for words in (str(path), *says):
        assert words in message, message
    return message


@pytest.mark.parametrize(
    ("place", "layout", "value", "says"),
    [
        (107, "<I", 8, "declares 8 points"),
        (107, "<I", 0, "holds no points"),
        (100, "<I", 0xFFFFFFFF, "variable length records"),
        (96, "<I", 0xFFFFFFFF, "bytes long"),
        (104, "<B", 11, "format 11"),
        (104, "<B", 0x81, "LASzip record"),
        (105, "<H", 19, "19 bytes"),
        (24, "<B", 2, "LAS 2.2"),
        (131, "<d", np.nan, "scale"),
        (139, "<d", 0.0, "scale"),
        (171, "<d", -np.inf, "offset"),
        (131, "<d", 1e300, "coordinates finite"),
        (131, "<d", 1e8, "not a location on Earth"),
        (147, "<d", 1e8, "heights of up to"),
    ],
)
def test_a_header_that_cannot_be(las, place, layout, value, says):
    # A raw coordinate of 1e9 makes a scale of 1e300 overflow.
    points = np.vstack([las.points, [500000.0 + 1_000_000, 4000000.0, 0.0]])[1:]
    refused(las.patch(las.write(points=points), place, layout, value), says)


@pytest.mark.parametrize("name", ["a.las", "a.laz"])
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({MIN_X: np.nan}, "impossible extent"),
        ({MAX_Y: 1e300}, "impossible extent: easting 500,000.00 to 500,005.00 m, northing 4,000,000.00 to 1e+300 m"),
        ({MIN_X: -2e9, MAX_X: 2e9}, "-2,000,000,000.00 to 2,000,000,000.00"),
        ({MIN_X: 0.0, MAX_X: 0.0, MIN_Y: 0.0, MAX_Y: 0.0}, "7 of 7 points are outside"),
        ({MAX_X: 500003.9}, "1 of 7 points are outside"),
        ({MAX_Y: 4000000.0 + 20_000}, "20,000"),
    ],
)
def test_a_header_that_lies_about_its_extent(las, name, changes, says):
    path = las.write(name)
    for place, value in changes.items():
        las.patch(path, place, "<d", value)
    message = refused(path, says, "`trust_points=True`")
    if "impossible extent" not in says:
        assert "500,000.00 to 500,005.00" in message
    assert open_survey(path, ReadOptions(trust_points=True)).info.bounds is None
    assert exhaust(path, trust_points=True) == 7


def test_a_header_that_is_a_little_off_is_no_lie(las):
    for place, value in (
        (MAX_X, 500004.2),  # rounded by less than a metre
        (MIN_X, 499999.5),
        (MAX_X, 500004.999 + 9_000),  # far, but no 10 km
    ):
        assert exhaust(las.patch(las.write(), place, "<d", value)) == 7
    path = las.write(points=np.array([[0.0, 0.0, 0.0], [30_000.0, 40_000.0, 5.0]]), offset=(0, 0, 0))
    assert exhaust(las.patch(path, MAX_X, "<d", 100_000.0)) == 2  # a large box around large data


@pytest.mark.parametrize(("place", "value", "says"), [(211, 30.0, "height"), (187, 499999.5, "easting"), (0, 0, "")])
def test_an_extent_in_the_header_that_is_not_that_of_the_points_is_noted(las, place, value, says):
    path = las.write("a.laz")
    reader = open_survey(las.patch(path, place, "<d", value) if place else path)
    read_points(reader)
    assert [says in note and "header gives" in note for note in reader.info.notes] == [True] * bool(says)


def test_points_behind_those_that_the_header_counts_are_noted(las):
    path = las.patch(las.write("a.las", version="1.2", fmt=1), 107, "<I", 5)
    assert "2 more points than the 5" in "".join(open_survey(path).info.notes)


@pytest.mark.parametrize(
    ("trees", "north", "says"), [(22.0, 0.0, "35 m apart"), (0.0, 5e6, "beyond the pole"), (0.0, 0.0, "")]
)
def test_coordinates_without_a_unit_that_look_like_feet_are_noted(las, trees, north, says):
    rng = np.random.default_rng(2)
    x, y, z = rng.uniform(0, 60, (3, 4000)) * np.array([[1.0], [1.0], [trees / 60]])
    metres = np.round(np.column_stack([x, y + north, z]), 3)
    for name, unit, known in (("m", 1.0, {}), ("ft", 0.3048, {}), ("ft_known", 0.3048, {3076: 9002, 1024: 1})):
        path = las.write(f"{name}.laz", metres / unit, geokeys=known, offset=(0, round(north / unit), 0))
        likely = ["xy_unit='ft'" in note for note in open_survey(path).info.notes]
        assert any(likely) == (bool(says) and name == "ft")
        assert not any(likely) or says in "".join(open_survey(path).info.notes)


def test_a_negative_scale_mirrors_the_points_and_their_extent(las):
    east = 1_000_000 - las.points[:, 0]  # about the offset
    path = las.patch(las.patch(las.write(), 131, "<d", -0.001), MAX_X, "<dd", east.max(), east.min())
    assert np.allclose(read_points(open_survey(path))[0][:, 0], east, rtol=0, atol=1e-8)
    refused(las.patch(path, MAX_X, "<d", east.max() - 1.1), "1 of 7 points are outside")


def test_chunks_of_fewer_points_than_their_table_promises_and_too_large_ones(las, monkeypatch):
    """The decoder does not look at the count that a chunk of layers carries, and makes points up."""
    for held in (3, 0):
        path = las.write("a.laz", version="1.4", fmt=6)
        (points_at,) = struct.unpack_from("<I", path.read_bytes(), 96)
        las.patch(path, points_at + 8 + 30, "<I", held)
        refused(path, f"declares 7 points in a LAZ chunk but holds {held}")
    monkeypatch.setattr("bumpymap.readers.las._LARGEST_CHUNK", 5 * 28 - 1)
    refused(las.pack(las.write(), 5), "holds 5 points", "pdal translate")
