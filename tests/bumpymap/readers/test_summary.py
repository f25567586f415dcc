import numpy as np
import pytest

from bumpymap.readers import enough_points, open_survey, summarise
from bumpymap.readers import summary as module
from bumpytiles import Grid


def test_hand_counted_tiles(las):
    # Tiles of 3 m: three points in one, one each in two others; noise and withheld points are in none.
    points = np.array([[0.5, 0.5, 1], [1, 1, 2], [2.999, 2.999, 3], [3.0, 0.0, 4], [-0.001, 0.0, 5], [90, 90, 6]])
    path = las.write(points=points, offset=(0, 0, 0), classes=np.array([2, 1, 1, 2, 1, 7], np.uint8))
    told = []
    summary = summarise(open_survey(path), Grid(), 3, told.append)
    assert (summary.points, summary.tiles, summary.points_per_tile) == (5, 3, 1.0)
    assert summary.density == pytest.approx(1 / 9)
    assert summary.enough_share == pytest.approx(1 / 3)
    assert summary.ground_share == pytest.approx(2 / 5)
    assert summary.ground_tile_share == pytest.approx(2 / 3)
    assert (summary.z_min, summary.z_max) == (1.0, 5.0)
    assert (summary.bounds.west, summary.bounds.east) == (-0.001, 3.0)
    assert sum(told) == 5


def test_merging_on_the_way_changes_nothing(las, monkeypatch):
    rng = np.random.default_rng(4)
    path = las.write("a.laz", np.round(rng.uniform(-50, 50, (5000, 3)), 3), offset=(0, 0, 0))
    whole = summarise(open_survey(path), Grid(), 5)
    monkeypatch.setattr(module, "_MERGE_AT", 10)
    reader = open_survey(path)
    chunks = reader.chunks
    monkeypatch.setattr(reader, "chunks", lambda: chunks(77))
    assert summarise(reader, Grid(), 5) == whole


def test_no_point_that_counts(las):
    path = las.write(classes=np.full(7, 18, np.uint8))
    assert summarise(open_survey(path), Grid(), 3) is None


def test_enough_points_covers_as_many_pixels_as_asked():
    grid = Grid()
    enough = enough_points(grid, 30, 0.25)
    rng = np.random.default_rng(5)
    covered = [np.unique(rng.integers(0, 225, enough)).size / 225 for _ in range(400)]
    assert np.mean(covered) == pytest.approx(0.25, abs=0.01)
    assert enough_points(grid, 500, 0.25) == 500
