"""Files, folders and what they hold; LAS and LAZ by hand-counted points and laspy: units, headers that lie, chunks."""

import json
import os
import re
import struct
from collections import Counter
from datetime import date
from functools import reduce

import laspy
import numpy as np
import pytest
from hypothesis import given, strategies as st
from point_files import KINDS, batches_of, read_points, table_of, wkt, write_kind
from pyproj import CRS

import bumpymap.readers.las as las_module
from bumpymap.core import THIN_SEEN, BadInputError, FeatureSettings, Reason, UsageError, horizontal_of, loops
from bumpymap.patches import measure, measure_thin
from bumpymap.readers import (
    BLANK,
    GROUND,
    ReadOptions,
    UnclassifiedPart,
    hash_survey,
    open_survey,
    point_stats,
    summary as module,
)
from bumpymap.readers.detect import find_surveys, identity, reopen_survey
from bumpymap.readers.point_stats import LinedPoints, LineSums, PointStats, cell_indices
from bumpymap.readers.point_table import convert_points
from bumpymap.readers.summary import PointSummaryBuilder, thin_rule
from bumpytiles import Grid, TileBuckets


def test_what_is_not_there(tmp_path):
    for where in (tmp_path / "b.laz", tmp_path):
        with pytest.raises(BadInputError, match=rf"cannot read .*(b\.laz|{tmp_path.name})"):
            open_survey(where)
    (tmp_path / "c.laz").touch()
    with pytest.raises(BadInputError, match="is empty"):
        open_survey(tmp_path / "c.laz")
    if hasattr(os, "mkfifo"):
        os.mkfifo(tmp_path / "pipe.laz")
        with pytest.raises(BadInputError, match="a pipe or a device"):  # which is not waited for
            open_survey(tmp_path / "pipe.laz")


def test_identity_tells_files_and_versions_apart(tmp_path):
    path, data = tmp_path / "a", bytearray(200_000)
    path.write_bytes(data)
    first = identity(path)
    assert first == identity(path)
    assert first["size"] == 200_000
    os.utime(path, ns=(5, 5))
    touched = identity(path)
    assert touched != first
    assert touched["digest"] == first["digest"]
    for place in (0, 199_999):
        path.write_bytes(data[:place] + b"\1" + data[place + 1 :])
        os.utime(path, ns=(5, 5))
        assert identity(path)["digest"] != first["digest"]


# ---- finding surveys ----


def test_folders_are_searched_with_their_subfolders_and_each_file_counts_once(tmp_path):
    files = ("b.LAZ", "a.las", "c.copc.laz", "sub/d.Ply", "sub/deep/e.pcd", "notes.txt", ".hidden.las", ".git/f.las")
    for name in (*files, "empty/notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"x")

    def found(*typed):
        return [str(path.relative_to(tmp_path)) for path in find_surveys(typed)]

    assert found(tmp_path) == found(str(tmp_path)) == sorted(files[:5])
    assert found(tmp_path / "sub", tmp_path / "a.las", tmp_path / "sub/d.Ply") == [
        "a.las",
        "sub/d.Ply",
        "sub/deep/e.pcd",
    ]
    (tmp_path / "z.las").symlink_to(tmp_path / "a.las")
    assert len(found(tmp_path / "a.las", tmp_path / "sub/../a.las", tmp_path / "z.las")) == 1
    assert found(tmp_path / "notes.txt") == ["notes.txt"]  # a named file is taken whatever its ending
    for typed, says in (
        ([tmp_path / "a.las", tmp_path / "empty"], "empty holds no point cloud"),
        ([tmp_path / "nowhere"], "does not exist"),
        ([], "no survey was given"),
    ):
        with pytest.raises(BadInputError, match=says):
            find_surveys(typed)


def test_an_ept_is_refused_with_what_makes_one_file_of_it(tmp_path):
    ept = tmp_path / "site" / "ept.json"
    (ept.parent / "ept-data").mkdir(parents=True)
    for path in (ept, ept.parent / "ept-data" / "0-0-0-0.laz"):
        path.write_bytes(b"{}")
    for place in (ept, ept.parent, tmp_path):
        with pytest.raises(BadInputError, match=re.escape(f"pdal translate --reader readers.ept {ept} OUT.copc.laz")):
            [open_survey(path) for path in find_surveys([place])]


# ---- a file that does not stay the same while it is read: no mixture comes of it, and no word of damage ----

POINTS = np.round(np.random.default_rng(1).uniform(0, 50, (3000, 3)), 3) + np.array([500_000.0, 4_000_000.0, 0.0])


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "packed pcd"])
def test_a_survey_that_is_written_again_or_goes_away_between_two_chunks(tmp_path, kind):
    path = write_kind(kind, tmp_path, POINTS)
    chunks, before = open_survey(path).clouds(500), path.stat().st_mtime_ns
    next(chunks)
    assert write_kind(kind, tmp_path, POINTS + np.array([0.0, 0.0, 5.0])) == path
    os.utime(path, ns=(0, before + 1_000_000_000))
    with pytest.raises(BadInputError, match=rf"{path.name} changed while it was read.*Run\s+again"):
        list(chunks)
    chunks = open_survey(path).clouds(500)
    next(chunks)
    path.unlink()
    with pytest.raises(BadInputError, match="changed while it was read: it was removed"):
        list(chunks)


def test_a_change_while_the_header_is_read(tmp_path, monkeypatch):
    path = write_kind("las", tmp_path, POINTS)
    whole = path.read_bytes()

    def read_and_change(*arguments):
        path.write_bytes(whole[:200])
        return original(*arguments)

    original = las_module.read_raw_header
    monkeypatch.setattr(las_module, "read_raw_header", read_and_change)
    with pytest.raises(BadInputError, match="changed while it was read"):
        open_survey(path)


# ---- what a survey holds, and what of it was never classified ----


CLASSES = ReadOptions(keep_classes=True)

THREE = FeatureSettings(min_points=3, min_coverage=0.0, max_hole=10.0)


def stats(path, settings=THREE, grid=None, *, thin=False):
    return PointSummaryBuilder(grid or Grid(), settings, thin=thin).read(open_survey(path, CLASSES))


def test_hand_counted_tiles(las):
    # Tiles of 3 m: three points in one, one each in two others; noise and withheld points are in none.
    points = np.array([[0.5, 0.5, 1], [1, 1, 2], [2.999, 2.999, 3], [3.0, 0.0, 4], [-0.001, 0.0, 5], [90, 90, 6]])
    path = las.write(points=points, offset=(0, 0, 0), classification=np.array([2, 1, 1, 2, 1, 7], np.uint8))
    told = []
    summary = PointSummaryBuilder(Grid(), THREE).read(open_survey(path, CLASSES), told.append).summary()
    assert (summary.points, summary.tiles, summary.points_per_tile) == (5, 3, 1.0)
    assert summary.density == pytest.approx(1 / 9)
    assert summary.unknown == {Reason.TOO_FEW_POINTS: 2.0, Reason.TOO_MANY_HOLES: 0.0}
    assert summary.ground_unknown == {
        Reason.NO_GROUND: 1.0, Reason.TOO_FEW_POINTS: 2.0, Reason.TOO_MANY_HOLES: 0.0
    }  # fmt: skip
    assert summary.ground_share == pytest.approx(2 / 5)
    assert (summary.ground_tiles, summary.ground_points_per_tile) == (2, 1.0)
    assert (summary.z_min, summary.z_max) == (1.0, 5.0)
    assert (summary.bounds.west, summary.bounds.east) == (-0.001, 3.0)
    assert sum(told) == 5
    assert stats(las.write(classification=np.full(7, 18, np.uint8))).summary() is None  # no point counts


def test_a_sample_is_of_whole_tiles_and_close_to_all(las, monkeypatch):
    rng = np.random.default_rng(6)
    path = las.write("a.laz", np.round(rng.uniform(-60, 60, (104_000, 3)), 3), offset=(0, 0, 0))
    settings = FeatureSettings(min_points=10)
    whole = stats(path, settings).summary()
    monkeypatch.setattr(module, "MOST_PIXELS", 5000)
    sampled = stats(path, settings)
    summary = sampled.summary()
    assert sampled.all_points.pixels.step >= 8
    share, exact = (s.unknown[Reason.TOO_MANY_HOLES] / s.tiles for s in (summary, whole))
    assert share != exact
    assert share == pytest.approx(exact, abs=0.1)
    assert summary.unknown[Reason.TOO_FEW_POINTS] == whole.unknown[Reason.TOO_FEW_POINTS]


def test_pixels_tell_what_the_measure_of_points_tells():
    rng = np.random.default_rng(8)
    tile = np.repeat(np.arange(256), rng.integers(4, 25, 256))
    # Points in one to three spots of a tile, so that many of its parts are empty.
    spot = rng.uniform(0, 3, (256, 3, 2))[tile, rng.integers(0, 3, tile.size)]
    x, y = np.clip(spot + rng.normal(0, 0.4, spot.shape), 0.001, 2.999).T
    col, row = tile % 16, tile // 16
    buckets = TileBuckets(Grid())
    buckets.add(x + 3.0 * col, y + 3.0 * row, rng.normal(0, 0.05, tile.size), np.zeros(tile.size, np.bool_))
    (points,) = buckets.blocks()
    settings = FeatureSettings()
    pairs, _ = measure_thin(points, measure(points, settings, ground_only=False), settings, ground_only=False)
    pixels = np.zeros((256, 15, 15), np.bool_)
    pixels[tile, (y / 0.2).astype(int), (x / 0.2).astype(int)] = True
    spanned = thin_rule(pixels, np.bincount(tile))[points.row * 16 + points.col]
    assert 50 < spanned.sum() < 200
    assert (spanned == (pairs[:, 1] >= THIN_SEEN)).all()
    pixels[0], pixels[1] = True, False  # a dense tile is not thin, whatever stands beside it
    pixels[1, 2::5, 2::5] = True
    assert thin_rule(pixels[:2], np.array([225, 9])).tolist() == [False, True]
    pixels[1, :8, :8] = True
    assert thin_rule(pixels[:2], np.array([225, 40])).tolist() == [False, True]
    assert thin_rule(pixels[:2], np.array([225, 300])).tolist() == [False, False]  # holes among many are no chance


# ---- what was never classified, and what only looks like it: roofs, woods, water ----

SIDE = 64
"""Tiles along the survey: 192 m."""
EAST = np.s_[:, 32:]


def found(blank, lowest, *, empty=()):
    """Tiles that count as never classified, of (64, 64), where those of ``blank`` hold only points of class 0 or 1."""
    marks = np.full((SIDE, SIDE), GROUND, np.uint8)
    for place, mark in [*((place, BLANK) for place in blank), *((place, 0) for place in empty)]:
        marks[place] = mark
    blocks = {(r, c): marks[16 * r :, 16 * c :][:16, :16].reshape(-1) for r in range(4) for c in range(4)}
    part = UnclassifiedPart.find({key: own for key, own in blocks.items() if own.any()}, 3.0)
    out = np.zeros(marks.shape, bool)
    if part is not None:
        row, col = (index.reshape(-1) for index in np.indices(marks.shape))
        whole = part.never_classified([(row, col, lowest.reshape(-1), of_ground) for of_ground in (True, False)])
        north, east = np.nonzero(whole)
        out[north + part.south, east + part.west] = True
    return out


def ground(slope=0.0):
    """Lowest points on a plane that rises to the east, with stones and hollows."""
    rng = np.random.default_rng(2)
    return 3.0 * slope * np.arange(SIDE) + rng.uniform(-0.1, 0.1, (SIDE, SIDE))


@pytest.mark.parametrize(
    ("place", "slope"), [(EAST, 0.0), (EAST, 0.6), (np.s_[40:, 40:], 0.0), (np.s_[:, 20:40], 0.0)], ids=str
)
def test_a_part_whose_ground_goes_on_was_never_classified(place, slope):
    """A half, a corner and a strip across the survey."""
    out = found([place], ground(slope))
    assert out[place].all()
    assert out.sum() == out[place].sum()


@pytest.mark.parametrize(
    ("place", "height"),
    [
        pytest.param(np.s_[20:27, 20:27], 0.0, id="a pond of 21 m"),
        pytest.param(np.s_[20:27, 57:], 6.0, id="a roof of 21 m at the edge"),
        pytest.param(np.s_[12:50, 12:50], 0.0, id="a lake amid the survey"),
        pytest.param(np.s_[10:40, 40:], 8.0, id="a hall at the edge"),
        pytest.param(np.s_[:, 30:], 4.0, id="a wood that is half of the survey"),
        pytest.param(np.s_[:, 60:], 0.0, id="a strip along the edge"),
    ],
)
def test_what_stands_in_classified_ground_is_not_ground(place, height):
    lowest = ground()
    lowest[place] += height
    assert not found([place], lowest).any()


def test_a_part_may_lie_apart_from_classified_ground_and_a_hall_beside_it_is_none_of_it():
    out = found([EAST], ground() + 50.0 * (np.arange(SIDE) > 31), empty=[np.s_[:, 28:36]])
    assert out[:, 36:].all()
    lowest, hall = ground(), np.s_[20:34, 14:32]
    lowest[hall] += 7.0
    out = found([EAST, hall], lowest)
    assert not out[20:34, 14:28].any()
    assert out[:14, 33:].all()
    assert out[:, 33:].mean() > 0.8


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
    for stored, day in days.items():
        assert open_survey(las.patch(path, 90, "<HH", *stored)).info.header_date == day


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


FORMATS = [("1.2", fmt) for fmt in range(4)] + [("1.3", 4), ("1.3", 5)] + [("1.4", fmt) for fmt in range(11)]
CORNER = np.array([500_000.0, 4_000_000.0, 0.0])
N = 3000
DEEP = {3: 257, 7: 257, 10: 257}  # point formats whose colours have 16 bits here; others have 8 in the same fields


def survey(las, name="a.las", *, version="1.4", fmt=6, count=N, **more):
    """Random points of random classes, some withheld, on 300 m x 300 m x 30 m."""
    rng = np.random.default_rng(count + fmt)
    points = np.round(rng.uniform(0, [300, 300, 30], (count, 3)), 3) + CORNER
    classes = rng.choice(np.array([1, 2, 3, 4, 5, 6, 7, 18], np.uint8), count)
    if "red" in laspy.PointFormat(fmt).dimension_names:
        more |= dict(zip(("red", "green", "blue"), rng.integers(0, 256, (3, count)) * DEEP.get(fmt, 1), strict=True))
    return las.write(
        name, points, version=version, fmt=fmt, classification=classes, withheld=rng.random(count) < 0.1, **more
    )


def oracle(path, unit=1.0):
    """What laspy reads, rounded, in metres: all points, and the kind of those that count; how many are left out."""
    data = laspy.read(path)
    axes = [
        np.round(np.asarray(data[name]) * data.header.scales[i] + data.header.offsets[i], 8) * unit
        for i, name in enumerate("XYZ")
    ]
    class_id, withheld = np.asarray(data.classification), np.asarray(data.withheld).astype(bool)
    noise = ~withheld & np.isin(class_id, (7, 18))
    kinds = np.select([class_id == code for code in (2, 3, 4, 5, 6)], [1, 3, 3, 3, 2])
    dropped = {"withheld": int(withheld.sum()), "noise": int(noise.sum()), "not_a_number": 0}
    return np.column_stack([*axes, kinds]), ~withheld & ~noise, dropped


def check_extent(stats, table):
    """West, south, east, north and greatest height against numpy's, of (n, 3) with NaN left out."""
    low = np.fmin.reduce(table, axis=0, initial=np.inf)
    high = np.fmax.reduce(table, axis=0, initial=-np.inf)
    assert (stats.west, stats.south, stats.east, stats.north) == (*low[:2], *high[:2])
    assert stats.highest == np.fmax.reduce(np.abs(table[:, 2]), initial=0.0)


def joined(found):
    return table_of(batch.cloud for batch in found)


def merged(found):
    return reduce(PointStats.merge, [batch.stats for batch in found], PointStats())


@pytest.mark.parametrize("packing", ["plain", "chunks", "variable"])
@pytest.mark.parametrize(("version", "fmt"), FORMATS)
def test_chunks_are_what_laspy_reads(las, version, fmt, packing):
    path = survey(las, version=version, fmt=fmt, geokeys={1024: 1, 3072: 2276})
    expected, counts, dropped = oracle(path, 1200 / 3937)
    if packing != "plain":
        path = las.pack(path, 256) if packing == "chunks" else las.pack(path, counts=[1, 700, 299, 1500, 500])
    reader = open_survey(path, ReadOptions(colour=True))
    found = batches_of(reader, 700)
    assert np.array_equal(joined(found), expected[counts])
    if reader.has_colour:
        data = laspy.read(path)
        red, green, blue = (np.asarray(data[name], int) // DEEP.get(fmt, 1) for name in ("red", "green", "blue"))
        colours = np.concatenate([batch.points.colour for batch in found])
        np.testing.assert_array_equal(colours, (red << 16 | green << 8 | blue)[counts])
    assert reader.has_colour == (fmt in {2, 3, 5, 7, 8, 10})
    total = merged(found)
    check_extent(total, expected)
    assert total.dropped == dropped
    assert total.points == N
    reader.verify(total)
    chunks = reader.chunks(700)
    assert [chunk.points for chunk in chunks] == [batch.stats.points for batch in found]
    assert [chunk.index for chunk in chunks] == list(range(len(chunks)))
    assert len(chunks) > 3


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("points", [64, 10_000])
def test_any_order_of_chunks_of_any_size_gives_the_same_points(tmp_path, kind, points):
    rng = np.random.default_rng(points)
    path = write_kind(kind, tmp_path, np.round(rng.uniform(0, 100, (400, 3)), 3) + CORNER)
    reader = open_survey(path)
    whole = batches_of(open_survey(path))
    order = rng.permutation(len(reader.chunks(points)))
    mixed = batches_of(reader, points, order)
    assert np.array_equal(joined([mixed[i] for i in np.argsort(order)]), joined(whole))
    assert merged(mixed) == merged(whole)
    reader.verify(merged(mixed))
    assert reader.checksum() == hash_survey(path)


def test_long_points_make_small_chunks_and_are_whole(las):
    """However long a point is, a chunk fits into memory."""
    path = survey(las, count=200)
    expected, data = joined(batches_of(open_survey(path))), path.read_bytes()
    start = int.from_bytes(data[96:100], "little")
    wide = np.zeros((200, 65_000), np.uint8)
    wide[:, :30] = np.frombuffer(data[start:], np.uint8).reshape(200, 30)
    path.write_bytes(data[:start] + wide.tobytes())
    reader = open_survey(las.patch(path, 105, "<H", 65_000))
    assert all(chunk.points * 65_000 <= 1 << 26 for chunk in reader.chunks())
    assert np.array_equal(joined(batches_of(reader)), expected)
    with pytest.raises(UsageError, match="at least 1"):
        reader.chunks(0)
    path.write_bytes(data[:-40])
    with pytest.raises(BadInputError, match="points"):
        batches_of(open_survey(path))


# ---- what is counted of points, and the verdict on a file ----


numbers = st.one_of(st.floats(-150, 150), st.sampled_from([np.nan, np.inf, -np.inf, 1e12, -1e12, 101.0, -1.0, 51.5]))
rows = st.lists(st.tuples(numbers, numbers, numbers, st.sampled_from([0, 1, 2, 7, 18])), max_size=40)


def batch(points, *, first=0):
    x, y, z, class_id = np.array(points, float).reshape(-1, 4).T.copy()
    return convert_points((x, y, z), class_id, first, nan_is_no_return=False, kinds=ReadOptions().kinds)


@given(rows, st.data())
def test_stats_of_parts_add_up_however_they_are_grouped(points, data):
    cut = sorted(data.draw(st.lists(st.integers(0, len(points)), max_size=4)))
    edges = zip([0, *cut], [*cut, len(points)], strict=True)
    parts = [batch(points[low:high], first=low).stats for low, high in edges]
    whole = batch(points).stats
    check_extent(whole, np.array(points, float).reshape(-1, 4))
    assert PointStats.from_record(json.loads(json.dumps(whole.to_record()))) == whole
    mixed = data.draw(st.permutations(parts))
    assert reduce(PointStats.merge, parts, PointStats()) == whole
    assert reduce(lambda total, part: part.merge(total), mixed, PointStats()) == whole
    assert whole.bad == any(part.bad for part in parts)


# ---- sums of flight lines ----


def cloud(n=20_000, side=90.0):
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, side, (2, n)).round(3) + np.array([[-41.0], [4_000_000.0]])
    z = (2_000 + rng.normal(size=n)).round(3)
    return LinedPoints(x, y, z, rng.integers(0, 2, n).astype(np.uint8), rng.integers(0, 3, n).astype(np.uint16))


def by_hand(points):
    """Dict of (column, row, line, ground) to the ten sums, in Python's own integers; line 0 is none."""
    found = {}
    for x, y, z, ground, line in zip(*(array[points.line > 0] for array in points), strict=True):
        col, row = int(np.floor(x / 3)), int(np.floor(y / 3))
        e, n, u = (int(np.rint(value * 1e4)) for value in (x - col * 3.0, y - row * 3.0, z))
        own = found.setdefault((col, row, int(line), bool(ground)), [0] * 10)
        for place, value in enumerate((1, e, n, u, e * e, e * n, n * n, e * u, n * u, u * u)):
            own[place] += value
    return found


def as_dict(sums):
    rows = sums.rows()
    cols, own = cell_indices(rows[:, 0] >> 17)
    keys = zip(cols, own, rows[:, 0] >> 1 & 0xFFFF, rows[:, 0] & 1 == 1, strict=True)
    return {tuple(key): sums.tolist() for key, sums in zip(keys, rows[:, 1:], strict=True)}


@pytest.mark.parametrize(("points", "side", "least"), [(3_000, 20.0, 1), (6 * loops.SLOTS, 3_000.0, 3 * loops.SLOTS)])
def test_the_sums_are_those_made_by_hand(points, side, least):
    """Also of more cells than the table holds."""
    points = cloud(points, side=side)
    found = as_dict(LineSums.of(points))
    assert found == by_hand(points)
    assert len(found) > least


@pytest.mark.parametrize("most", [50_000, 200, 40])
@pytest.mark.parametrize("seed", [0, 1])
def test_any_chunks_in_any_order_give_the_same_sample(monkeypatch, most, seed):
    """Half of them stored meanwhile."""
    monkeypatch.setattr(point_stats, "MOST_ROWS", most)
    monkeypatch.setattr(point_stats, "_WAITING_ROWS", 2 * most)
    points, rng = cloud(), np.random.default_rng(seed)
    whole = LineSums.of(points).merged()
    assert len(whole.rows()) <= most
    assert (whole.step > 1) == (most < 5_000)
    joined = [LineSums(), LineSums()]
    for number, chosen in enumerate(np.array_split(rng.permutation(len(points.x)), rng.integers(2, 30))):
        part = LinedPoints(*(np.ascontiguousarray(array[chosen]) for array in points))
        joined[number % 2] = joined[number % 2].merge(LineSums.of(part))
    stored = LineSums.from_record(json.loads(json.dumps(joined[0].to_record())))
    again = joined[1].merge(stored).merged()
    assert again.step == whole.step
    assert np.array_equal(again.rows(), whole.rows())


def write(las, fmt, ids, *, source=0):
    path = las.write(version="1.4" if fmt > 5 else "1.2", fmt=fmt)
    content = laspy.read(path)
    content.point_source_id = np.array(ids, np.uint16)
    content.header.file_source_id = source
    content.write(path)
    return path


@pytest.mark.parametrize(
    ("fmt", "packed"),
    [*((fmt, packed) for fmt in (0, 1, 3, 6, 7) for packed in ("las", "laz")), (6, "octree"), (7, "octree")],
)
def test_lines_of_files(las, fmt, packed):
    path = write(las, fmt, [1, 2, 700, 65535, 0, 0, 0], source=9)
    path = {"las": lambda: path, "laz": lambda: las.pack(path, chunk=3), "octree": lambda: las.octree(path)}[packed]()
    reader = open_survey(path, ReadOptions(lines=True))
    assert sum(len(cloud.easting) for cloud in reader.clouds(3)) == 7
    counts = Counter()
    for (_, _, line, _), sums in as_dict(reader.lines).items():
        counts[line] += sums[0]
    assert counts == {1: 1, 2: 1, 700: 1, 65535: 1, 9: 3}
    quiet = open_survey(path)
    list(quiet.clouds())
    assert quiet.lines.size == 0
