"""The same ground gives the same map wherever it lies, and however blocks that are measured together cut it."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
from small_surveys import run, write_las

pytestmark = pytest.mark.slow

SIDE = 42.0
"""Of the site, m: one block of 48 m holds it, or it lies across four."""


@pytest.fixture(scope="module")
def site():
    """A slope with boulders, bushes, a wall, a ditch and a hole, in one half with many points and in one with few.

    The points are half a millimetre off the borders of pixels; x, y, z and class.
    """
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, SIDE, (2, 60_000))
    kept = (x < SIDE / 2) | (rng.random(len(x)) < 0.08)
    kept &= np.hypot(x - 30, y - 8) > 3.0
    x, y = (np.floor(1000 * values[kept]) / 1000 + 0.0005 for values in (x, y))
    z = 0.15 * x + 0.05 * np.sin(1.3 * x) * np.cos(1.1 * y) + 0.01 * rng.normal(size=len(x))
    for east, north, radius in rng.uniform((0, 0, 0.3), (SIDE, SIDE, 1.2), (60, 3)):
        z += 0.7 * np.sqrt(np.maximum(0.0, radius**2 - (x - east) ** 2 - (y - north) ** 2))
    wall = (np.abs(y - 20 - 0.3 * x) < 0.2) & (x < 30)
    z += 1.5 * wall - 0.8 * (np.abs(x - 12 - 0.2 * y) < 0.6)
    bush = rng.random(len(x)) < 0.1 * (y > 30)
    z += bush * rng.uniform(0, 1.5, len(x))
    return np.column_stack([x, y, np.round(z, 3), np.where(wall | bush, 5, 2)])


def mapped(folder, points, corner, *options):
    """Map points with their south-west corner at a place; return columns and rasters."""
    name = "_".join(f"{number:.0f}" for number in corner)
    offset = np.add(corner, (0.0005, 0.0005, 0.0))
    survey = write_las(folder / f"{name}.laz", *(points[:, :3] + corner).T, crs=None, offset=offset,
                       classification=points[:, 3].astype(np.uint8))  # fmt: skip
    out = folder / name
    run("map", survey, "--out", out, "--local", "--overwrite", *options, code=0)
    table = pq.read_table(out / "tiles.parquet").drop_columns(["col", "row", "geometry", "bbox"])
    rasters = {path.name: rasterio.open(path).read() for path in sorted((out / "rasters").glob("*.tif"))}
    return {name: flat(table[name].combine_chunks()) for name in table.column_names}, rasters


def flat(values):
    """Values of a column; those of the maps of all tiles in one array."""
    while pa.types.is_list(values.type) or pa.types.is_fixed_size_list(values.type):
        values = values.flatten()
    return values.to_numpy(zero_copy_only=False)


CORNER = np.array([48_000.0 + 3.0, 96_000.0 + 3.0, 100.0])
"""One tile off the corner of a block, which holds the site."""


@pytest.fixture(scope="module")
def alone(site, tmp_path_factory):
    """What the site gives in one block, for each way to choose points."""
    folder = tmp_path_factory.mktemp("alone")
    found = {ground: mapped(folder, site, CORNER, "--ground", ground) for ground in ("auto", "all")}
    for table, rasters in found.values():
        assert len(np.unique(table["barred"].astype(str))) > 2
        assert 0.02 < (rasters["obstacle.tif"] == 1).mean() < 0.5
    return found


@pytest.mark.parametrize("ground", ["auto", "all"])
@pytest.mark.parametrize("tiles", [(7, 9), (13, 0), (100_001, 500_001)])
def test_moved_by_whole_tiles_and_cut_into_other_blocks_it_has_the_same_bits(site, alone, tmp_path, ground, tiles):
    table, rasters = mapped(tmp_path, site, CORNER + 3.0 * np.array([*tiles, 0]), "--ground", ground)
    own, own_rasters = alone[ground]
    for mine, theirs in ((own, table), (own_rasters, rasters)):
        assert mine.keys() == theirs.keys()
        for name, values in mine.items():
            np.testing.assert_array_equal(theirs[name], values, err_msg=name)


@pytest.mark.parametrize("ground", ["auto", "all"])
def test_raised_it_is_as_rough_to_the_last_digits_of_its_heights(site, alone, tmp_path, ground):
    """In single precision, heights above 128 m have one digit less than those of the site."""
    table, rasters = mapped(tmp_path, site, CORNER + np.array([0.0, 0.0, 137.25]), "--ground", ground)
    own, own_rasters = alone[ground]
    for name in ("class.tif", "barred.tif", "reason.tif", "obstacle.tif", "passage.tif"):
        np.testing.assert_array_equal(rasters[name], own_rasters[name], err_msg=name)
    for name in ("c_r", "p_fail", "slope", "ransac_residual", "z_variance", "relief"):
        np.testing.assert_allclose(table[name], own[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(rasters["heightmap.tif"] - 137.25, own_rasters["heightmap.tif"], atol=1e-4)


@pytest.mark.parametrize("ground", ["auto", "all"])
@pytest.mark.parametrize("way", ["mirrored", "turned"])
def test_mirrored_or_turned_it_is_as_rough(site, alone, tmp_path, ground, way):
    """What is found from north to south and from west to east in turns may differ in a tile."""
    x, y = (site[:, axis] for axis in (0, 1))
    places = (SIDE - x, y) if way == "mirrored" else (SIDE - y, x)
    table, rasters = mapped(tmp_path, np.column_stack([*places, site[:, 2:]]), CORNER, "--ground", ground)
    own, own_rasters = alone[ground]
    back = (lambda image: image[:, ::-1]) if way == "mirrored" else (lambda image: np.rot90(image, -1))
    band = rasters["class.tif"][0]
    assert (back(band) != own_rasters["class.tif"][0]).sum() <= 2
    ride, own_ride = back(rasters["roughness.tif"][0]), own_rasters["roughness.tif"][0]
    known = np.isfinite(ride) & np.isfinite(own_ride)
    assert known.mean() > 0.9
    assert np.abs(np.quantile(ride[known] / own_ride[known], [0.05, 0.95]) - 1.0).max() < 0.01
    for name, rtol in (("z_variance", 1e-6), ("slope", 1e-2), ("ransac_residual", 1e-2)):
        np.testing.assert_allclose(np.nansum(table[name]), np.nansum(own[name]), rtol=rtol)
