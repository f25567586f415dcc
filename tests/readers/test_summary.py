"""Files and folders: found once each, and no mixture of two versions; what a survey holds, tile by tile."""

import os
import re

import numpy as np
import pytest
from point_files import KINDS, write_kind

import bumpymap.readers.las as las_module
from bumpymap.core import THIN_SEEN, BadInputError, FeatureSettings, Reason
from bumpymap.patches import measure, measure_thin
from bumpymap.readers import (
    BLANK,
    GROUND,
    ReadOptions,
    UnclassifiedPart,
    find_surveys,
    identity,
    open_survey,
    summary as module,
)
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
