"""The same points give the same map: however they are delivered and read, wherever they lie and blocks are cut."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rasterio
from hypothesis import HealthCheck, given, settings, strategies as st
from small_surveys import SIDES, alike_surveys, files_in, run, write_las

from bumpymap.layers.products import PRODUCT_NAMES, MapFile

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]

CORNER = np.array([500_013.0, 4_000_020.0, 300.0])
"""Not a corner of a block, so that files and blocks overlap anyhow."""
SPAN = (110.0, 56.0)
"""Some three by two blocks of 48 m."""
OF_THE_CALL = {"surveys", "out", "scratch"}


@pytest.fixture(scope="module")
def points():
    """Rough ground under bushes, on a grid of 1 mm, with points that occur twice; x, y, z, class."""
    rng = np.random.default_rng(0)
    n = 28_000
    x, y = rng.uniform(0, SPAN[0], n), rng.uniform(0, SPAN[1], n)
    bush = rng.random(n) < 0.3
    z = 0.1 * x + 0.8 * np.sin(5 * x) * (x > 60) + 0.01 * rng.normal(size=n) + bush * rng.uniform(0, 2, n)
    cloud = np.column_stack([np.round(x, 3), np.round(y, 3), np.round(z, 3), np.where(bush, 5, 2)])
    return np.concatenate([cloud, cloud[:500]])


def colours(points):
    """Colours of points, 8 bits a channel, (n, 3): smooth over the ground, and darker below; a few points have none."""
    x, y, z = points[:, :3].T
    shade = np.clip(0.6 + 0.1 * (z - 0.1 * x), 0.3, 1.0)[:, None]
    found = np.rint(shade * np.column_stack([40 + x, 90 + y, 200 - x])).astype(int)
    return np.where((points[:, :1] * 1000 % 50 < 1), 0, found)


def write(path, points, offset, bits=16):
    """Write points, with colours of 16 bits, or of 8 in the same fields."""
    kind = points[:, 3].astype(np.uint8)
    rgb = dict(zip(("red", "green", "blue"), colours(points).T * (257 if bits == 16 else 1), strict=True))
    return write_las(path, *(points[:, :3] + CORNER).T, offset=offset, classification=kind, **rgb)


def mapped(files, out, *options):
    with alike_surveys():
        run("map", *files, "--out", out, *options, code=0)
    content = files_in(out)
    assert set(content) == {*PRODUCT_NAMES, MapFile.PHOTO, *SIDES}
    del content["run.json"]
    record = json.loads((out / "run.json").read_text())
    record["files"] = [file for file in record["files"] if file["path"] != "item.json"]  # it names the survey
    settings_of_the_map = {name: value for name, value in record["settings"].items() if name not in OF_THE_CALL}
    kept = {name: value for name, value in record.items() if name not in {"inputs", "seconds", "settings"}}
    return content, kept | {"settings": settings_of_the_map}


@pytest.fixture(scope="module")
def whole(points, tmp_path_factory):
    """What one LAZ file gives that fits into memory, for each way to choose points."""
    folder = tmp_path_factory.mktemp("whole")
    survey = write(folder / "a.laz", points, CORNER)
    found = {ground: mapped([survey], folder / ground, "--ground", ground) for ground in ("auto", "all")}
    (auto, record), (everything, _) = found.values()
    # The property below would hold little were the two the same, or the site all of one kind.
    assert auto["rasters/roughness.tif"] != everything["rasters/roughness.tif"]
    assert sum(count > 0 for count in record["counts"]["by_class"].values()) > 1
    return found


def delivered(points, folder, rng):
    """Write the files of a delivery: how many, split at random or along an axis; return them as they are named."""
    count, axis, offsets = rng.integers(1, 6), rng.integers(3), [(400_000, 3_500_000, 0), (123_456.789, 3_900_000, 17)]
    if rng.random() < 0.5:
        points = rng.permutation(points)
    if axis == 2:
        file = rng.integers(count, size=len(points))
    else:
        file = np.minimum(points[:, axis] / SPAN[axis] * count, count - 1).astype(int)
    names = [f"{n}.{rng.choice(['las', 'laz'])}" for n in range(count)]
    paths = [
        write(folder / name, points[file == n], offsets[rng.integers(2)], rng.choice([8, 16]))
        for n, name in enumerate(names)
    ]
    return [paths[number] for number in rng.permutation(count)]


@settings(max_examples=4, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(seed=st.integers(0, 10**6), ground=st.sampled_from(["auto", "all"]))
def test_no_delivery_and_no_budget_changes_a_byte(points, whole, tmp_path_factory, limit_points, seed, ground):
    folder, rng = tmp_path_factory.mktemp("delivery"), np.random.default_rng(seed)
    files = delivered(points, folder, rng)
    ranges = {"chunk": (2_000, 60_000), "waiting": (8_000, 80_000), "block": (5_000, 40_000)}
    limit_points(**{name: int(rng.integers(*bounds)) for name, bounds in ranges.items()})
    options = ("--ground", ground, "--threads", rng.integers(1, 4), "--set", f"scratch={folder / 'scratch'}")
    content, record = mapped(files, folder / "layers", *options)
    wanted, wanted_record = whole[ground]
    assert [name for name in wanted if content[name] != wanted[name]] == []
    assert record == wanted_record
    assert list(Path(folder / "scratch").iterdir()) == []


def test_the_photo_shows_the_highest_coloured_point_of_each_pixel(points, whole, tmp_path):
    """Bushes too, from whatever points the ground is measured; JPEG changes the colours a little."""
    (tmp_path / "photo.tif").write_bytes(whole["auto"][0][MapFile.PHOTO])
    assert whole["all"][0][MapFile.PHOTO] == whole["auto"][0][MapFile.PHOTO]
    with rasterio.open(tmp_path / "photo.tif") as file:
        photo, mask, profile, place = file.read(), file.dataset_mask() > 0, file.profile, file.transform
    assert (profile["compress"], profile["count"], place.a) == ("jpeg", 3, 0.2)
    rgb, millimetres = colours(points), np.rint((points[:, :2] + CORNER[:2]) * 1000).astype(int)
    corner = np.array([place.c, place.f - 0.2 * len(mask)])
    col, up = (millimetres // 200 - np.rint(corner / 0.2).astype(int)).T
    wanted = np.full((3, *mask.shape), -1)
    for n in np.argsort(points[:, 2])[rgb.any(axis=1)[np.argsort(points[:, 2])]]:
        wanted[:, len(mask) - 1 - up[n], col[n]] = rgb[n]
    np.testing.assert_array_equal(mask, wanted[0] >= 0)
    assert np.abs(photo - wanted)[:, mask].mean() < 5


@pytest.mark.parametrize(("share", "written"), [(0.05, False), (0.2, True)])
def test_a_tenth_of_the_points_must_have_a_colour(points, whole, tmp_path, share, written):
    """Without a photo all other layers are the same."""
    rgb = colours(points) * 257 * (np.arange(len(points)) < share * len(points))[:, None]
    columns = dict(zip(("red", "green", "blue"), rgb.T, strict=True))
    survey = write_las(
        tmp_path / "a.laz", *(points[:, :3] + CORNER).T, classification=points[:, 3].astype(int), **columns
    )
    with alike_surveys():
        run("map", survey, "--out", tmp_path / "layers", code=0)
    found = files_in(tmp_path / "layers")
    assert (MapFile.PHOTO in found) == written
    layers = [name for name in PRODUCT_NAMES if name.endswith(".tif") or name == MapFile.TILES]
    assert [name for name in layers if found[name] != whole["auto"][0][name]] == []


# ---- wherever it lies ----


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


def mapped_at(folder, points, corner, *options):
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


BESIDE_A_BLOCK = np.array([48_000.0 + 3.0, 96_000.0 + 3.0, 100.0])
"""One tile off the corner of a block, which holds the site."""


@pytest.fixture(scope="module")
def alone(site, tmp_path_factory):
    """What the site gives in one block, for each way to choose points."""
    folder = tmp_path_factory.mktemp("alone")
    found = {ground: mapped_at(folder, site, BESIDE_A_BLOCK, "--ground", ground) for ground in ("auto", "all")}
    for table, rasters in found.values():
        assert len(np.unique(table["barred"].astype(str))) > 2
        assert 0.02 < (rasters["obstacle.tif"] == 1).mean() < 0.5
    return found


@pytest.mark.parametrize(("ground", "tiles"), [("auto", (7, 9)), ("all", (13, 0)), ("auto", (100_001, 500_001))])
def test_moved_by_whole_tiles_and_cut_into_other_blocks_it_has_the_same_bits(site, alone, tmp_path, ground, tiles):
    table, rasters = mapped_at(tmp_path, site, BESIDE_A_BLOCK + 3.0 * np.array([*tiles, 0]), "--ground", ground)
    own, own_rasters = alone[ground]
    for mine, theirs in ((own, table), (own_rasters, rasters)):
        assert mine.keys() == theirs.keys()
        for name, values in mine.items():
            np.testing.assert_array_equal(theirs[name], values, err_msg=name)


def test_raised_it_is_as_rough_to_the_last_digits_of_its_heights(site, alone, tmp_path):
    """In single precision, heights above 128 m have one digit less than those of the site."""
    table, rasters = mapped_at(tmp_path, site, BESIDE_A_BLOCK + np.array([0.0, 0.0, 137.25]), "--ground", "all")
    own, own_rasters = alone["all"]
    for name in ("class.tif", "barred.tif", "reason.tif", "obstacle.tif", "passage.tif"):
        np.testing.assert_array_equal(rasters[name], own_rasters[name], err_msg=name)
    for name in ("c_r", "p_fail", "slope", "ransac_residual", "z_variance", "relief"):
        np.testing.assert_allclose(table[name], own[name], rtol=1e-3, atol=1e-4, err_msg=name)
    np.testing.assert_allclose(rasters["heightmap.tif"] - 137.25, own_rasters["heightmap.tif"], atol=1e-4)


@pytest.mark.parametrize(("ground", "way"), [("auto", "mirrored"), ("all", "turned")])
def test_mirrored_or_turned_it_is_as_rough(site, alone, tmp_path, ground, way):
    """What is found from north to south and from west to east in turns may differ in a tile."""
    x, y = (site[:, axis] for axis in (0, 1))
    places = (SIDE - x, y) if way == "mirrored" else (SIDE - y, x)
    table, rasters = mapped_at(tmp_path, np.column_stack([*places, site[:, 2:]]), BESIDE_A_BLOCK, "--ground", ground)
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
