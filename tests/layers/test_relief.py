"""relief.tif against loops by hand."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from cost_maps import make_field, part_of

from bumpymap.core.types import CostTable
from bumpymap.layers import geotiff
from bumpymap.layers.geotiff import write_raster
from bumpymap.layers.products import MapFile
from bumpytiles import Grid


def thin(cost_map, share, seed=1):
    """The same map with heights in a share of the pixels, in none of every fifth tile; hills, so that means differ."""
    rng = np.random.default_rng(seed)
    heights = cost_map.patches.heights.copy()
    heights += (3.0 * np.sin(cost_map.patches.col / 4.0) + cost_map.patches.row % 7)[:, None, None].astype(np.float32)
    heights[rng.random(heights.shape) >= share] = np.nan
    heights[rng.random(len(heights)) < 0.2] = np.nan
    return replace(cost_map, patches=replace(cost_map.patches, heights=heights))


def written(cost_map, path, **options):
    write_raster(MapFile.RELIEF, CostTable.of(cost_map), path, **options)
    with rasterio.open(path) as file:
        return file.read(1)


def by_hand(cost_map):
    """Means in whole cm, NaN where there are none, and which pixels are in a tile, (rows * 3, cols * 3) each."""
    patches, fine = cost_map.patches, cost_map.patches.grid.pixels
    west, north = patches.col.min(), patches.row.max()
    shape = (3 * (north - patches.row.min() + 1), 3 * (patches.col.max() - west + 1))
    means, tiles = np.full(shape, np.nan), np.zeros(shape, bool)
    third = [int((i + 0.5) * 3 / fine) for i in range(fine)]
    for col, row, heights in zip(patches.col, patches.row, patches.heights.astype(float), strict=True):
        for i in range(3):
            for j in range(3):
                some = heights[[k for k in range(fine) if third[k] == i]][:, [k for k in range(fine) if third[k] == j]]
                y, x = 3 * (north - row) + i, 3 * (col - west) + j
                tiles[y, x] = True
                if np.isfinite(some).any():
                    means[y, x] = np.rint(100 * np.nanmean(some))
    return means, tiles


def near(values, y, x, half):
    return values[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]


@pytest.mark.parametrize("grid", [Grid(), Grid(3.0, 5), Grid(1.5, 16)])
def test_known_pixels_are_means_and_others_are_filled_from_the_nearest(tmp_path, grid):
    cost_map = thin(make_field(30, 25, west=-11, south=-9, grid=grid, holes=0.3), 0.02)
    found = written(cost_map, tmp_path / "relief.tif")
    means, tiles = by_hand(cost_map)
    assert found.shape == means.shape
    known = np.isfinite(means)
    # half a centimetre may fall to either side
    np.testing.assert_allclose(found[known], means[known] / 100, atol=0.0101)
    assert np.mean(np.abs(found[known] - means[known] / 100) < 1e-3) > 0.99
    assert np.isnan(found[~tiles]).all()
    filled = 0
    for y, x in zip(*np.nonzero(tiles & ~known), strict=True):
        half = next((half for half in (1, 2, 4, 8) if np.isfinite(near(means, y, x, half)).any()), None)
        if half is None:
            assert np.isnan(found[y, x])
            continue
        around = near(means, y, x, half) / 100
        assert np.nanmin(around) - 0.011 <= found[y, x] <= np.nanmax(around) + 0.011
        assert found[y, x] == pytest.approx(np.nanmean(around), abs=0.02)
        filled += 1
    assert filled > 100


@pytest.mark.parametrize("share", [0.02, 0.8])
def test_windows_do_not_change_the_bytes(tmp_path, monkeypatch, share):
    cost_map = thin(make_field(70, 50, grid=Grid(3.0, 5), west=-37, south=-20), share)
    written(cost_map, tmp_path / "whole.tif")
    monkeypatch.setattr(geotiff, "_WINDOW_PIXELS", 1)  # one block of tiles
    monkeypatch.setattr(geotiff, "_READ_TILES", 1)
    order = np.random.default_rng(2).permutation(len(cost_map.class_id))
    written(part_of(cost_map, order), tmp_path / "windows.tif")
    assert (tmp_path / "whole.tif").read_bytes() == (tmp_path / "windows.tif").read_bytes()
