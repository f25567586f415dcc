"""Pixel layers of a sparse survey: the values that GDAL's COG driver writes, in files that are valid COGs."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio
from rio_cogeo import cog_validate

from bumpymap.core import CANOPY, FREE, NO_CLASS, OBSTACLE, CostTable, ObjectStack
from bumpymap.layers.geotiff import write_raster


@pytest.fixture(scope="module")
def files(make_map, tmp_path_factory):
    """heightmap.tif and obstacle.tif with all states, each by the sparse writer and by GDAL's driver.

    40 tiles, one of them in each corner of the extent, three beside each other.
    """
    folder, rng = tmp_path_factory.mktemp("sparse"), np.random.default_rng(2)
    col = [0, 0, 302, 302, 100, 101, 102, *rng.integers(3, 99, 33)]
    row = [0, 252, 0, 252, 7, 7, 7, *range(20, 53)]
    made = make_map(col, row, rng.integers(0, 4, 40), np.zeros(40))
    states = rng.choice([FREE, FREE, FREE, OBSTACLE, CANOPY], made.patches.heights.shape).astype(np.uint8)
    share = np.where(np.arange(40) % 2, 0.1, np.nan).astype(np.float32)  # NaN: what is free is not known to be
    table = CostTable.of(replace(made, objects=ObjectStack(states, share, share, share, share)))
    with pytest.MonkeyPatch.context() as patch:
        for writer in ("sparse", "gdal"):
            (folder / writer).mkdir()
            for name in ("heightmap.tif", "obstacle.tif"):
                write_raster(f"rasters/{name}", table, folder / writer / name, {"vehicle": "warthog"})
            patch.setattr("bumpymap.layers.geotiff._SPARSE", 0.0)
    return {name: (folder / "sparse" / name, folder / "gdal" / name) for name in ("heightmap.tif", "obstacle.tif")}


@pytest.mark.parametrize("name", ["heightmap.tif", "obstacle.tif"])
def test_values_and_tags_are_those_of_gdals_driver_in_a_valid_cog(files, name):
    assert cog_validate(files[name][0], strict=True)[:3] == (True, [], [])
    with rasterio.open(files[name][0]) as sparse, rasterio.open(files[name][1]) as gdal:
        assert sparse.profile["blockxsize"] != gdal.profile["blockxsize"]  # two writers
        np.testing.assert_array_equal(sparse.read(1), gdal.read(1))
        for what in ("crs", "transform", "units", "descriptions", "colorinterp"):
            assert getattr(sparse, what) == getattr(gdal, what)
        assert (sparse.tags(), sparse.tags(ns="IMAGE_STRUCTURE")) == (gdal.tags(), gdal.tags(ns="IMAGE_STRUCTURE"))
        np.testing.assert_equal(sparse.nodata, gdal.nodata)
        ours, theirs = sparse.tags(1), gdal.tags(1)
        assert list(ours) == list(theirs)
        for tag in ours:
            if tag.startswith("STATISTICS"):
                assert float(ours[tag]) == pytest.approx(float(theirs[tag]), rel=1e-3)
        if name == "obstacle.tif":
            assert np.unique(sparse.read(1)).tolist() == [0, 1, 2, 3, NO_CLASS]
            assert sparse.colormap(1) == gdal.colormap(1)
            names = [path.with_name(f"{name}.aux.xml").read_text(encoding="utf-8") for path in files[name]]
            assert names[0] == names[1]


def each_four(pixels, nodata):
    """The pixels below each pixel of the next overview, (lines, columns, 4)."""
    lines, columns = (-(-side // 2) for side in pixels.shape)
    even = np.full((2 * lines, 2 * columns), nodata, pixels.dtype)
    even[: pixels.shape[0], : pixels.shape[1]] = pixels
    return even.reshape(lines, 2, columns, 2).swapaxes(1, 2).reshape(lines, columns, 4)


def overviews(path):
    with rasterio.open(path) as file:
        levels = len(file.overviews(1))
        yield file.read(1)
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as file:
            yield file.read(1)


def test_overview_is_the_mean_of_the_known_pixels_among_four(files):
    below, *above = overviews(files["heightmap.tif"][0])
    assert len(above) == 4
    for level in above:
        four = each_four(below.astype(np.float64), np.nan)
        with np.errstate(invalid="ignore"):
            mean = np.nansum(four, axis=2) / np.isfinite(four).sum(axis=2)
        np.testing.assert_array_equal(level, mean.astype(np.float32))
        below = level


def test_an_obstacle_stays_in_every_overview(files):
    order = np.full(256, 9)
    order[[OBSTACLE, 3, CANOPY, FREE]] = range(4)
    below, *above = overviews(files["obstacle.tif"][0])
    for level in above:
        np.testing.assert_array_equal(order[level], order[each_four(below, NO_CLASS)].min(axis=2))
        below = level
    assert (below == OBSTACLE).any()
