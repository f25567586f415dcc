"""Pixel layers of a sparse survey: the values that GDAL's COG driver writes, in files that are valid COGs."""

import numpy as np
import pytest
import rasterio
from rio_cogeo import cog_validate

from bumpymap.core import CANOPY, FREE, NO_CLASS, OBSTACLE, CostTable
from bumpymap.layers.geotiff import write_raster
from bumpytiles import TileTable


@pytest.fixture(scope="module")
def scattered(make_map):
    """40 tiles, one of them in each corner of the extent, three beside each other."""
    rng = np.random.default_rng(2)
    col = [0, 0, 502, 502, 100, 101, 102, *rng.integers(3, 99, 33)]
    row = [0, 402, 0, 402, 7, 7, 7, *range(20, 53)]
    return CostTable.of(make_map(col, row, rng.integers(0, 4, 40), np.zeros(40)))


@pytest.fixture(scope="module")
def files(scattered, tmp_path_factory):
    """The same raster by the sparse writer and by GDAL's driver."""
    folder = tmp_path_factory.mktemp("sparse")
    paths = folder / "sparse.tif", folder / "gdal.tif"
    write_raster("heightmap.tif", scattered, paths[0], {"vehicle": "warthog"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.layers.geotiff._SPARSE", 0.0)
        write_raster("heightmap.tif", scattered, paths[1], {"vehicle": "warthog"})
    return paths


def test_values_and_tags_are_those_of_gdals_driver(files):
    with rasterio.open(files[0]) as sparse, rasterio.open(files[1]) as gdal:
        assert sparse.profile["blockxsize"] != gdal.profile["blockxsize"]  # two writers
        np.testing.assert_array_equal(sparse.read(1), gdal.read(1))
        assert (sparse.crs, sparse.transform, sparse.units) == (gdal.crs, gdal.transform, gdal.units)
        assert (sparse.descriptions, sparse.tags()) == (gdal.descriptions, gdal.tags())
        ours, theirs = sparse.tags(1), gdal.tags(1)
        assert list(ours) == list(theirs)
        for name in ours:
            if name.startswith("STATISTICS"):
                assert float(ours[name]) == pytest.approx(float(theirs[name]), rel=1e-3)


def test_overview_is_the_mean_of_the_known_pixels_among_four(files):
    with rasterio.open(files[0]) as file:
        below = file.read(1).astype(np.float64)
    for level in range(4):
        lines, columns = below.shape
        four = np.pad(below, ((0, lines % 2), (0, columns % 2)), constant_values=np.nan)
        four = four.reshape(-(-lines // 2), 2, -(-columns // 2), 2)
        known = np.isfinite(four).sum(axis=(1, 3))
        with np.errstate(invalid="ignore"):
            mean = np.nansum(four, axis=(1, 3)) / known
        with rasterio.open(files[0], overview_level=level) as overview:
            below = overview.read(1).astype(np.float64)
        np.testing.assert_array_equal(below, mean.astype(np.float32))
        assert known.any()


@pytest.fixture(scope="module")
def obstacles(scattered, tmp_path_factory):
    """obstacle.tif of the same tiles, with all states, by both writers."""
    folder = tmp_path_factory.mktemp("obstacles")
    found = scattered.tiles.read(("objects", "obstacle"))
    rng = np.random.default_rng(3)
    found["objects"] = rng.choice([FREE, FREE, FREE, OBSTACLE, CANOPY], found["objects"].shape).astype(np.uint8)
    found["obstacle"][::2], found["obstacle"][1::2] = np.nan, 0.1
    table = CostTable(scattered.georeference, scattered.rule, TileTable.of(scattered.tiles.grid, found))
    paths = folder / "sparse.tif", folder / "gdal.tif"
    write_raster("obstacle.tif", table, paths[0], {"vehicle": "warthog"})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bumpymap.layers.geotiff._SPARSE", 0.0)
        write_raster("obstacle.tif", table, paths[1], {"vehicle": "warthog"})
    return paths


def test_obstacles_are_those_of_gdals_driver(obstacles):
    with rasterio.open(obstacles[0]) as sparse, rasterio.open(obstacles[1]) as gdal:
        assert sparse.profile["blockxsize"] != gdal.profile["blockxsize"]  # two writers
        pixels = sparse.read(1)
        np.testing.assert_array_equal(pixels, gdal.read(1))
        assert np.unique(pixels).tolist() == [0, 1, 2, 3, NO_CLASS]
        assert (sparse.crs, sparse.transform, sparse.nodata) == (gdal.crs, gdal.transform, gdal.nodata)
        assert (sparse.descriptions, sparse.tags()) == (gdal.descriptions, gdal.tags())
        assert (sparse.colormap(1), sparse.colorinterp) == (gdal.colormap(1), gdal.colorinterp)
        assert sparse.tags(ns="IMAGE_STRUCTURE") == gdal.tags(ns="IMAGE_STRUCTURE")
        ours, theirs = sparse.tags(1), gdal.tags(1)
        assert list(ours) == list(theirs)
        for name in ours:
            if name.startswith("STATISTICS"):
                assert float(ours[name]) == pytest.approx(float(theirs[name]), rel=1e-3)
    names = [path.with_name(f"{path.name}.aux.xml").read_text(encoding="utf-8") for path in obstacles]
    assert names[0] == names[1]
    assert "<Category>obstacle</Category>" in names[0]


def test_an_obstacle_stays_in_every_overview(obstacles):
    order = np.full(256, 9)
    order[[OBSTACLE, 3, CANOPY, FREE]] = range(4)
    with rasterio.open(obstacles[0]) as file:
        below = file.read(1)
        levels = len(file.overviews(1))
    for level in range(levels):
        lines, columns = below.shape
        four = np.pad(below, ((0, lines % 2), (0, columns % 2)), constant_values=NO_CLASS)
        worst = order[four].reshape(-(-lines // 2), 2, -(-columns // 2), 2).min(axis=(1, 3))
        with rasterio.open(obstacles[0], overview_level=level) as overview:
            below = overview.read(1)
            assert overview.colormap(1)[OBSTACLE] == (84, 48, 5, 255)
        np.testing.assert_array_equal(order[below], worst)
    assert (below == OBSTACLE).any()


def test_both_are_valid_cogs(files, obstacles):
    for path in (files[0], obstacles[0]):
        assert cog_validate(path, strict=True)[:3] == (True, [], [])
