import struct
from datetime import date

import laspy
import numpy as np
import pytest
from las_files import las_bytes, wkt
from pyproj import CRS

from bumpymap.core.errors import BadInputError
from bumpymap.readers import ReadOptions, open_survey

US_FOOT = 1200 / 3937
VERSIONS = [("1.1", 0), ("1.2", 3), ("1.3", 5), ("1.4", 6), ("1.4", 10)]
"""Every format is read, and held against laspy, in test_chunks.py."""


@pytest.mark.parametrize("ending", ["las", "laz"])
@pytest.mark.parametrize(("version", "fmt"), VERSIONS)
def test_every_version_format_and_compression_gives_the_hand_counted_points(las, read, version, fmt, ending):
    path = las.write(f"a.{ending}", version=version, fmt=fmt, classes=las.classes, withheld=las.withheld, epsg=32614)
    reader = open_survey(path)
    points, ground = read(reader)
    assert np.array_equal(points, las.points[las.counting])
    assert ground.tolist() == [True, False, True, False]
    assert reader.dropped == {"withheld": 1, "noise": 2, "not_a_number": 0}
    assert reader.info.point_count == 7
    assert reader.info.format == f"{ending.upper()} {version}, point format {fmt}"
    assert reader.info.georeference.crs.to_epsg() == 32614
    assert reader.info.size_bytes == path.stat().st_size
    box = reader.info.bounds
    assert (box.west, box.south, box.east, box.north) == (500000.001, 4000000.002, 500004.999, 4000004.999)


def test_version_1_0_is_read_too(las, read):
    path = las.patch(las.write(version="1.1", fmt=0), 25, "<B", 0)
    points, ground = read(open_survey(path))
    assert np.array_equal(points, las.points)
    assert not ground.any()


@pytest.mark.parametrize("name", ["b.las", "b.laz"])
def test_other_offsets_give_the_same_bits(las, read, name):
    rng = np.random.default_rng(2)
    points = np.round(rng.uniform([637_000, 849_000, 0], [638_000, 850_000, 500], (5000, 3)), 3)
    one, _ = read(open_survey(las.write("one" + name, points, offset=(637_000.0, 849_000.0, 0))))
    two, _ = read(open_survey(las.write("two" + name, points, offset=(123_456.789, 0.001, -77.7))))
    raw = np.rint((points - [123_456.789, 0.001, -77.7]) / 0.001) * 0.001 + [123_456.789, 0.001, -77.7]
    assert not np.array_equal(raw, points)  # without the rounding the offset would show
    assert np.array_equal(one, two)


@pytest.mark.parametrize(
    ("crs", "unit", "unit_z"),
    [
        ("EPSG:32614", 1.0, 1.0),
        ("EPSG:2992", 0.3048, 0.3048),  # Oregon, international foot
        ("EPSG:2276", US_FOOT, US_FOOT),  # Texas, US survey foot
        ("EPSG:32614+5703", 1.0, 1.0),
        ("EPSG:2992+6360", 0.3048, US_FOOT),  # foot, heights in US survey foot
        ("EPSG:2991+6360", 1.0, US_FOOT),  # metre, heights in US survey foot
        ("EPSG:2276+5703", US_FOOT, 1.0),  # US survey foot, heights in metres
    ],
)
def test_units_of_a_wkt_record(las, read, crs, unit, unit_z):
    path = las.write(version="1.4", fmt=6, wkt=CRS(crs).to_wkt("WKT1_GDAL"))
    reader = open_survey(path)
    points, _ = read(reader)
    assert np.allclose(points, las.points * [unit, unit, unit_z], rtol=1e-14)
    place = reader.info.georeference
    assert (place.metres_per_unit, place.metres_per_unit_z) == (unit, unit_z)
    assert place.crs == CRS(crs)
    assert reader.info.bounds.east == pytest.approx(500004.999 * unit, rel=1e-14)


@pytest.mark.parametrize(
    ("geokeys", "unit", "unit_z"),
    [
        ({1024: 1, 3072: 2994, 3076: 9002}, 0.3048, 0.3048),
        ({1024: 1, 3072: 2276}, US_FOOT, US_FOOT),
        ({1024: 1, 3072: 32614, 4099: 9003}, 1.0, US_FOOT),
        ({1024: 1, 3072: 32614, 4096: 6360}, 1.0, US_FOOT),
        ({1024: 1, 3072: 2276, 4099: 9001}, US_FOOT, 1.0),
        ({3076: 9003}, US_FOOT, US_FOOT),
        ({1024: 1, 3072: 32767, 3076: 9002, 4099: 9001}, 0.3048, 1.0),
    ],
)
def test_units_of_geotiff_keys(las, geokeys, unit, unit_z):
    place = open_survey(las.write(geokeys=geokeys)).info.georeference
    assert (place.metres_per_unit, place.metres_per_unit_z) == (unit, unit_z)
    code = geokeys.get(3072, 32767)
    assert (place.crs is None) == (code == 32767)


@pytest.mark.parametrize("z_unit", ["m", "ft", "us-ft"])
def test_z_unit_overrides_the_file(las, read, z_unit):
    path = las.write(geokeys={1024: 1, 3072: 2276, 4099: 9003})
    points, _ = read(open_survey(path, ReadOptions(z_unit=z_unit)))
    assert np.allclose(points[:, 2], las.points[:, 2] * {"m": 1.0, "ft": 0.3048, "us-ft": US_FOOT}[z_unit], rtol=1e-15)
    assert np.allclose(points[:, 0], las.points[:, 0] * US_FOOT, rtol=1e-15)


@pytest.mark.parametrize(("wkt_bit", "code"), [(True, 32614), (False, 32613)])
def test_of_two_records_the_one_that_the_header_names_counts(las, utm_wkt, wkt_bit, code):
    info = open_survey(las.write(version="1.4", fmt=6, wkt=utm_wkt, epsg=32613, wkt_bit=wkt_bit)).info
    assert info.georeference.crs.to_epsg() == code
    assert any("is used" in note for note in info.notes)


def test_a_record_alone_counts_whatever_the_bit(las, utm_wkt):
    assert open_survey(las.write("a.las", wkt=utm_wkt, wkt_bit=False)).info.georeference.crs.to_epsg() == 32614
    assert open_survey(las.write("b.las", epsg=32614, wkt_bit=True)).info.georeference.crs.to_epsg() == 32614


def test_user_defined_keys_leave_it_to_the_wkt(las, utm_wkt):
    info = open_survey(las.write(wkt=utm_wkt, geokeys={1024: 1, 3072: 32767, 3076: 9001}, wkt_bit=False)).info
    assert info.georeference.crs.to_epsg() == 32614
    assert any("taken from its WKT" in note for note in info.notes)


def test_wkt_in_an_extended_record(las, utm_wkt):
    info = open_survey(las.write(version="1.4", fmt=6, evlr_wkt=utm_wkt)).info
    assert info.georeference.crs.to_epsg() == 32614


def test_no_crs_at_all(las):
    info = open_survey(las.write()).info
    assert info.georeference.crs is None
    assert info.georeference.metres_per_unit == info.georeference.metres_per_unit_z == 1.0
    assert info.notes == ()


def test_given_crs_fills_in_and_a_forced_one_wins(las):
    options = ReadOptions(crs="EPSG:2276")
    assert open_survey(las.write("a.las"), options).info.georeference.metres_per_unit == US_FOOT
    loud = las.write("b.las", epsg=32614)
    assert open_survey(loud, options).info.georeference.crs.to_epsg() == 32614
    assert open_survey(loud, ReadOptions(force_crs="EPSG:32613")).info.georeference.crs.to_epsg() == 32613


def test_unreadable_wkt_is_refused_unless_a_crs_is_given(las):
    path = las.write(version="1.4", fmt=6, wkt="PROJCS[oh no", wkt_bit=True)
    with pytest.raises(BadInputError, match=r"WKT.*`crs`"):
        open_survey(path)
    assert open_survey(path, ReadOptions(crs="EPSG:32614")).info.georeference.crs.to_epsg() == 32614


@pytest.mark.parametrize(
    ("geokeys", "says"),
    [
        ({1024: 1, 3072: 32614, 3076: 9002}, "unit"),
        ({1024: 1, 3072: 30001}, "EPSG:30001"),
        ({1024: 1, 3072: 32614, 3076: 32632}, "32632"),
    ],
)
def test_geotiff_keys_that_contradict_themselves_are_refused(las, geokeys, says):
    path = las.write(geokeys=geokeys)
    with pytest.raises(BadInputError, match=f"{says}.*`crs`"):
        open_survey(path)
    assert open_survey(path, ReadOptions(crs="EPSG:32614")).info.georeference.crs.to_epsg() == 32614


@pytest.mark.parametrize("how", ["wkt", "geokeys", "option"])
def test_degrees_are_refused_with_the_command_that_helps(las, how):
    points = np.array([[-99.1 + d, 19.4 + d, 10.0] for d in (-0.001, 0.001)])
    said = {
        "wkt": {"wkt": CRS(4326).to_wkt("WKT1_GDAL")},
        "geokeys": {"geokeys": {1024: 2, 2048: 4326}},
        "option": {},
    }[how]
    path = las.write(points=points, scale=(1e-7, 1e-7, 0.001), offset=(0, 0, 0), **said)
    options = ReadOptions(crs="EPSG:4326") if how == "option" else ReadOptions()
    with pytest.raises(BadInputError) as caught:
        open_survey(path, options)
    command = caught.value.args[-1].strip()
    assert command.startswith(f"pdal translate {path} a_metres.laz reprojection ")
    assert "--filters.reprojection.out_srs=EPSG:32614" in command
    assert ("--filters.reprojection.in_srs=EPSG:4326" in command) == (how == "option")
    assert "--writers.las.scale_z=0.001" in command


def test_metres_that_are_said_to_be_degrees(las):
    with pytest.raises(BadInputError, match=r"not such a place.*`force_crs`"):
        open_survey(las.write(wkt=CRS(4326).to_wkt("WKT1_GDAL")))


def test_degrees_without_a_crs_are_noted(las):
    path = las.write(points=np.array([[-99.1, 19.4, 10.0]]), scale=1e-7, offset=(0, 0, 0))
    assert any("look like degrees" in note for note in open_survey(path).info.notes)


@pytest.mark.parametrize("wkt_bit", [True, False])
def test_a_unit_of_height_that_one_of_two_records_states_is_believed(las, wkt_bit):
    with_height = CRS.from_user_input("EPSG:26914+6360").to_wkt("WKT1_GDAL")  # NAVD88 in US survey feet
    info = open_survey(las.write(version="1.4", fmt=6, wkt=with_height, epsg=26914, wkt_bit=wkt_bit)).info
    assert info.georeference.metres_per_unit == 1.0
    assert info.georeference.metres_per_unit_z == pytest.approx(1200 / 3937, rel=1e-9)
    assert any("unit of height" in note for note in info.notes) is not wkt_bit


@pytest.mark.parametrize(("day", "year", "expected"), [
    (1, 2024, date(2024, 1, 1)),
    (366, 2024, date(2024, 12, 31)),
    (366, 2023, None),
    (0, 2024, None),
    (60, 0, None),
    (60, 124, None),
    (65535, 65535, None),
])  # fmt: skip
@pytest.mark.parametrize("version", ["1.2", "1.4"])
def test_the_date_in_the_header_counts_days_of_a_year_and_is_none_if_there_is_no_such_day(
    las, version, day, year, expected
):
    path = las.write(version=version, fmt=1 if version == "1.2" else 6)
    content = bytearray(path.read_bytes())
    content[90:94] = struct.pack("<HH", day, year)
    path.write_bytes(content)
    assert open_survey(path, ReadOptions(crs="EPSG:32614")).info.header_date == expected
    if expected is not None:
        assert laspy.open(path).header.creation_date == expected


def test_of_two_records_with_the_same_ids_the_first_is_used_even_if_it_is_empty(tmp_path, utm_wkt):
    path = tmp_path / "a.las"
    records = (("LASF_Projection", 2112, b""), wkt(utm_wkt))
    path.write_bytes(las_bytes([(500_001.0, 4_000_001.0, 1.0)], version="1.4", fmt=6, wkt_bit=True, records=records))
    assert open_survey(path).info.georeference.crs is None
