"""Rasters of a map: values by rasterio, tables as GDAL reads them, overviews, and the same bytes for any cut."""

from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import rasterio
from cost_maps import SPEEDS, lone_columns, make_field, make_map, table_of
from pyproj import CRS
from rasterio.env import get_gdal_config
from rio_cogeo import cog_validate
from scipy.ndimage import uniform_filter
from small_surveys import band

from bumpymap.core import CANOPY, CLASS_NAMES, FREE, NO_CLASS, OBJECT_NAMES, OBSTACLE, UNSEEN, ObjectStack
from bumpymap.core.types import BANDS, BARRED_TEXT, REASON_TEXT, Georeference, Reason
from bumpymap.layers import _cog
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS
from bumpymap.layers.folder import write_raster
from bumpymap.layers.map_reader import KeptRasters
from bumpymap.layers.products import SOME_NAMES, MapFile
from bumpytiles import Grid, TileTable

WRITERS = {
    Path(file).stem: lambda cost_map, *rest, file=file: write_raster(file, table_of(cost_map), *rest)
    for file in MapFile
    if file.endswith(".tif") and file not in {MapFile.PASSAGE, *SOME_NAMES}
}


@pytest.fixture(scope="module")
def rasters(tmp_path_factory, cost_map):
    folder = tmp_path_factory.mktemp("rasters")
    for name, write in WRITERS.items():
        write(cost_map, folder / f"{name}.tif", {"vehicle": "warthog"})
    return {name: folder / f"{name}.tif" for name in WRITERS}


def of_tiles(path, cost_map):
    """Pixels of the tiles, (bands, tiles, pixels, pixels), and of what holds none; placed apart from the package."""
    size = cost_map.patches.grid.tile_size / cost_map.georeference.metres_per_unit
    with rasterio.open(path) as file:
        pixels, place, side = file.read(), file.transform, round(size / file.res[0])
    left = np.rint((cost_map.patches.col * size - place.c) / place.a).astype(int)
    top = np.rint(((cost_map.patches.row + 1) * size - place.f) / place.e).astype(int)
    index = top[:, None, None] + np.arange(side)[:, None], left[:, None, None] + np.arange(side)
    rest = np.ones(pixels.shape[1:], bool)
    rest[index] = False
    assert rest.any()
    return pixels[:, *index], pixels[:, rest]


@pytest.mark.parametrize("name", WRITERS)
def test_is_a_strictly_valid_cog_in_the_right_place(rasters, cost_map, name):
    assert cog_validate(rasters[name], strict=True) == (True, [], [])
    col, row = cost_map.patches.col, cost_map.patches.row
    with rasterio.open(rasters[name]) as file:
        assert file.crs.to_epsg() == 32614
        assert file.bounds == (3.0 * col.min(), 3.0 * row.min(), 3.0 * col.max() + 3.0, 3.0 * row.max() + 3.0)
        side = {"heightmap": 0.2, "obstacle": 0.2, "relief": 1.0}.get(name, 3.0)
        assert file.transform == rasterio.Affine(side, 0.0, file.bounds.left, 0.0, -side, file.bounds.top)
        assert (file.tags()["vehicle"], file.tags()["AREA_OR_POINT"]) == ("warthog", "Area")


def test_roughness_of_a_tile_is_its_value(rasters, cost_map):
    with rasterio.open(rasters["roughness"]) as file:
        assert file.descriptions == tuple(band.name for band in BANDS)
        assert file.units == tuple(band.unit or None for band in BANDS)
        assert set(file.dtypes) == {"float32"}
        assert np.isnan(file.nodatavals).all()
    found, rest = of_tiles(rasters["roughness"], cost_map)
    columns = lone_columns(cost_map)
    columns["zone"] = np.where(columns["zone"] > 0, columns["zone"], np.nan)
    for wanted, values in zip(BANDS, found, strict=True):
        np.testing.assert_array_equal(values.ravel(), columns[wanted.name].astype(np.float32))
    assert np.isnan(rest).all()


@pytest.mark.parametrize("name", ["class", "reason"])
def test_classes_and_reasons(rasters, cost_map, name):
    with rasterio.open(rasters[name]) as file:
        assert (file.descriptions, file.dtypes, file.nodata) == ((name,), ("uint8",), NO_CLASS)
        assert [kind.name for kind in file.colorinterp] == ["palette"]
        assert file.colormap(1)[NO_CLASS][3] == 0
    found, rest = of_tiles(rasters[name], cost_map)
    np.testing.assert_array_equal(found.ravel(), cost_map.class_id if name == "class" else cost_map.patches.reason)
    assert (rest == NO_CLASS).all()  # what holds no points has no reason: nodata, not "ok"


def test_cost_and_speed_are_those_of_passable_tiles_and_unknown_ground_has_none(rasters, cost_map):
    with rasterio.open(rasters["cost"]) as file:
        assert (file.descriptions, file.dtypes) == (("cost",), ("float32",))
        assert np.isnan(file.nodata)
        names = ("ride_weight_m_per_rad", "fail_weight_m", "drive_m", "slope_limit_deg")
        ride, fail, drive, steep = (float(file.tags()[name]) for name in names)
    p_fail = cost_map.p_fail.astype(float)
    with np.errstate(divide="ignore"):
        expected = 1 + ride * cost_map.c_r.astype(float) - fail * np.log(1 - p_fail) / drive
    passable = (cost_map.class_id != NO_CLASS) & (p_fail < 0.5) & (cost_map.patches.slope <= steep)
    assert 0 < passable.sum() < (cost_map.class_id != NO_CLASS).sum()
    found, rest = of_tiles(rasters["cost"], cost_map)
    np.testing.assert_allclose(found.ravel(), np.where(passable, expected, np.nan), rtol=1e-6)
    assert np.isnan(rest).all()
    with rasterio.open(rasters["speed"]) as file:
        assert (file.descriptions, file.units, file.dtypes) == (("speed",), ("m/s",), ("float32",))
    (c_r, slow), c = np.transpose([(c_r, 1.0 / speed) for c_r, speed in SPEEDS]), cost_map.c_r.astype(float)
    speed = 1.0 / (np.interp(c, c_r, slow) * np.maximum(c / c_r[1], 1.0))
    speed = np.where(cost_map.class_id == NO_CLASS, np.nan, np.where(passable, speed, 0.0))
    found, rest = of_tiles(rasters["speed"], cost_map)
    np.testing.assert_allclose(found.ravel(), speed, rtol=1e-6)
    assert np.isnan(rest).all()


def test_obstacles_are_pixels_of_the_tiles(cost_map, tmp_path):
    rng = np.random.default_rng(3)
    objects = rng.choice(np.array([FREE, OBSTACLE, CANOPY, UNSEEN], np.uint8), cost_map.patches.heights.shape)
    share = np.mean(objects == OBSTACLE, axis=(1, 2)).astype(np.float32)
    share[5] = np.nan  # its free pixels are not known to be free
    stack = ObjectStack(objects, share, share, share, share)
    write_raster(MapFile.OBSTACLE, table_of(replace(cost_map, objects=stack)), tmp_path / "obstacle.tif")
    expected = np.where(objects == UNSEEN, 3, objects)
    expected[5] = np.where(objects[5] == FREE, 3, expected[5])
    found, rest = of_tiles(tmp_path / "obstacle.tif", cost_map)
    np.testing.assert_array_equal(found[0], expected)
    assert (rest == NO_CLASS).all()


VALUES = {
    "class": (CLASS_NAMES, CLASS_COLOURS),
    "reason": (tuple(REASON_TEXT.values()), REASON_COLOURS),
    "barred": (tuple(BARRED_TEXT.values()), BARRED_COLOURS),
    "obstacle": (OBJECT_NAMES, OBJECT_COLOURS),
}
RAT_COLUMNS = {"Value": "5", "Count": "1", "Class": "2", "Red": "6", "Green": "7", "Blue": "8", "Alpha": "9"}
"""The usages are those of GDAL's GDALRATFieldUsage."""


def check_value_table(raster, name, scratch):
    """Hold names and attribute table of band 1, as GDAL itself reads them, against its pixels and its palette."""
    rasterio.shutil.copy(raster, scratch, driver="VRT")
    band = ET.parse(scratch).getroot().find("VRTRasterBand")  # noqa: S314 (GDAL has just written it)
    wanted, colours = VALUES[name]
    assert tuple(element.text for element in band.findall("CategoryNames/Category")) == wanted
    table = band.find("GDALRasterAttributeTable")
    assert table.get("tableType") == "thematic"
    columns = {field.findtext("Name"): field.findtext("Usage") for field in table.findall("FieldDefn")}
    assert columns == RAT_COLUMNS
    with rasterio.open(raster) as file:
        counts, palette = np.bincount(file.read(1).ravel(), minlength=256), file.colormap(1)
    codes = [code for code in range(len(wanted)) if (name, code) != ("reason", Reason.NO_POINTS)]
    rows = [[cell.text for cell in row.findall("F")] for row in table.findall("Row")]
    assert rows == [[str(cell) for cell in (code, counts[code], wanted[code], *colours[code])] for code in codes]
    assert [palette[code][:3] for code in codes] == [colours[code][:3] for code in codes]
    assert counts[codes].sum() + counts[NO_CLASS] == counts.sum() > counts[NO_CLASS]


@pytest.mark.parametrize("name", VALUES)
def test_gdal_finds_names_colours_and_true_counts_beside_a_raster_of_codes(rasters, tmp_path, name):
    with rasterio.open(rasters[name]) as file:
        assert sorted(path.rsplit("/", 1)[-1] for path in file.files) == [f"{name}.tif", f"{name}.tif.aux.xml"]
    check_value_table(rasters[name], name, tmp_path / "seen.vrt")


def levels_of(path):
    """Band 1, and each of its overviews."""
    with rasterio.open(path) as file:
        found, levels = [file.read(1)], len(file.overviews(1))
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as file:
            found.append(file.read(1))
    return found


def each_four(pixels, nodata):
    """The pixels below each pixel of the next overview, (lines, columns, 4)."""
    lines, columns = (-(-side // 2) for side in pixels.shape)
    even = np.full((2 * lines, 2 * columns), nodata, pixels.dtype)
    even[: pixels.shape[0], : pixels.shape[1]] = pixels
    return even.reshape(lines, 2, columns, 2).swapaxes(1, 2).reshape(lines, columns, 4)


def test_overviews_average_and_most_frequent(tmp_path):
    cost_map = make_field(300, 200, grid=Grid(3.0, 2), holes=0.0)
    for name in ("roughness", "class", "speed"):
        WRITERS[name](cost_map, tmp_path / f"{name}.tif")
        assert cog_validate(tmp_path / f"{name}.tif", strict=True)[:2] == (True, [])
    full, small, _ = levels_of(tmp_path / "roughness.tif")
    four = each_four(full, np.nan)
    with np.errstate(invalid="ignore"):
        np.testing.assert_allclose(small, np.nansum(four, axis=2) / np.isfinite(four).sum(axis=2), rtol=1e-5)
    full, small, _ = levels_of(tmp_path / "class.tif")
    codes = np.array([*range(4), NO_CLASS])
    counts = (each_four(full, NO_CLASS)[..., None] == codes).sum(axis=2)
    decided = (counts == counts.max(axis=2, keepdims=True)).sum(axis=2) == 1
    assert decided.mean() > 0.5
    np.testing.assert_array_equal(small[decided], codes[counts.argmax(axis=2)[decided]])
    full, small, _ = levels_of(tmp_path / "speed.tif")
    assert (full == 0).any()
    assert (each_four(full, np.nan) == small[..., None]).any(axis=2)[np.isfinite(small)].all()  # none in between


@pytest.mark.parametrize("small", [0, 1 << 30], ids=["on disk", "in memory"])
def test_a_large_raster_of_several_bands_has_the_same_overviews(tmp_path, monkeypatch, small):
    """They are made before it is converted; blocks without values take no room."""
    monkeypatch.setattr(_cog, "SMALL", small)
    row, col = (axis.ravel() for axis in np.indices((260, 520))[:, :, [*range(64), 519]])
    class_id = np.random.default_rng(3).integers(0, 4, len(row))
    cost_map = make_map(col, row, class_id, np.zeros(len(row)), grid=Grid(3.0, 1))
    one, two = tmp_path / "one.tif", tmp_path / "two.tif"
    WRITERS["roughness"](cost_map, one)
    monkeypatch.setattr(_cog, "OVERVIEWS_FIRST_FROM", 0)
    WRITERS["roughness"](cost_map, two)
    assert cog_validate(two, strict=True)[:2] == (True, [])
    assert two.stat().st_size < one.stat().st_size + 1000
    for options in ({}, {"overview_level": 0}, {"overview_level": 1}):
        with rasterio.open(one, **options) as first, rasterio.open(two, **options) as second:
            np.testing.assert_array_equal(first.read(), second.read())
            assert [first.tags(band) for band in first.indexes] == [second.tags(band) for band in second.indexes]
            assert first.overviews(1) == second.overviews(1)


def test_unknown_ground_is_unknown_in_overviews_too(tmp_path):
    # One tile in four has a class. GDAL's own overviews leave nodata out of the count: all of them would have one.
    cost_map = make_field(700, 60, grid=Grid(3.0, 1), holes=0.0)
    known = (cost_map.patches.col % 2 == 0) & (cost_map.patches.row % 2 == 0)
    class_id = np.where(known, 0, NO_CLASS).astype(np.uint8)
    reason = np.where(known, Reason.OK, Reason.TOO_FEW_POINTS).astype(np.uint8)
    cost_map = replace(cost_map, class_id=class_id, patches=replace(cost_map.patches, reason=reason))
    WRITERS["class"](cost_map, tmp_path / "class.tif")
    full, *smaller = levels_of(tmp_path / "class.tif")
    assert (full == 0).sum() == known.sum()
    assert len(smaller) == 3
    assert all((level == NO_CLASS).all() for level in smaller)


@pytest.mark.parametrize(
    "georeference", [None, Georeference(CRS.from_epsg(2271), 1200 / 3937, 1200 / 3937)], ids=["metres", "feet"]
)
def test_heightmap_is_the_heights_side_by_side(tmp_path, georeference):
    cost_map = make_field(20, 10, west=130_000, south=60_000, georeference=georeference)
    path, unit = tmp_path / "heightmap.tif", cost_map.georeference.metres_per_unit
    WRITERS["heightmap"](cost_map, path)
    found, rest = of_tiles(path, cost_map)
    np.testing.assert_array_equal(found[0], cost_map.patches.heights)
    assert np.isnan(rest).all()
    with rasterio.open(path) as file:
        assert (file.descriptions, file.units) == (("height",), ("m",))
        assert file.crs.to_epsg() == (2271 if georeference else 32614)
        assert file.res == pytest.approx((0.2 / unit, 0.2 / unit), rel=1e-12)
        assert file.bounds.left == pytest.approx(cost_map.patches.col.min() * 3.0 / unit, rel=1e-12)


ODD = CRS("+proj=ob_tran +o_proj=tmerc +o_lat_p=30 +o_lon_p=0 +lon_0=5 +type=crs")


@pytest.mark.parametrize("name", ["class", "heightmap"])
def test_a_crs_without_geotiff_keys_is_in_the_side_file_beside_names_and_counts(tmp_path, name):
    path = tmp_path / f"{name}.tif"
    WRITERS[name](make_field(8, 6, georeference=Georeference(ODD)), path)
    with rasterio.open(path) as file:
        assert "+proj=ob_tran" in file.crs.to_wkt()
    if name in VALUES:
        check_value_table(path, name, tmp_path / "seen.vrt")


def test_threads_take_turns_to_write_and_to_read_rasters(tmp_path):
    """GDAL flushes blocks that another thread has not finished: for those of a raster that is read, and at a smaller
    limit of its cache, which is the limit of the process."""
    path = tmp_path / "class.tif"
    write, kept = partial(write_raster, MapFile.CLASS, table_of(make_field(9, 9))), KeptRasters()

    def read():
        with kept.keep(), kept.opened(path) as file:
            return file.read(1)

    write(path)
    wanted, before = read(), get_gdal_config("GDAL_CACHEMAX")
    with ThreadPoolExecutor(2) as others:
        with _cog.raster_lock():
            begun = [others.submit(write, tmp_path / "again.tif"), others.submit(read)]
            assert not wait(begun, 0.3).done
            assert get_gdal_config("GDAL_CACHEMAX") == before
        np.testing.assert_array_equal(begun[1].result(), wanted)
        begun[0].result()
    assert (tmp_path / "again.tif").read_bytes() == path.read_bytes()
    assert get_gdal_config("GDAL_CACHEMAX") == before


@pytest.mark.parametrize("name", WRITERS)
def test_small_rasters_are_made_in_memory_with_the_same_bytes(rasters, cost_map, tmp_path, monkeypatch, name):
    monkeypatch.setattr("bumpymap.layers._cog.SMALL", 0)
    WRITERS[name](cost_map, tmp_path / f"{name}.tif", {"vehicle": "warthog"})
    made_in_memory = {path.name: path.read_bytes() for path in rasters[name].parent.glob(f"{name}.*")}
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == made_in_memory


def test_overviews_of_a_photo_show_the_coloured_pixels_alone(tmp_path):
    table, colour = table_of(make_field(40, 40, holes=0.0)), np.array([200, 100, 50])
    photo = (np.indices((15, 15)).sum(axis=0) % 2)[..., None] * np.tile(colour, (table.tiles.tiles, 1, 1, 1))
    tiles = TileTable.of(table.tiles.grid, table.tiles.read([]) | {"photo": photo.astype(np.uint8)})
    write_raster(MapFile.PHOTO, replace(table, tiles=tiles), tmp_path / "photo.tif")
    assert cog_validate(tmp_path / "photo.tif", strict=True) == (True, [], [])
    with rasterio.open(tmp_path / "photo.tif", overview_level=0) as file:
        assert np.abs(file.read()[:, file.dataset_mask() > 0] - colour[:, None]).mean() < 3


def test_a_mostly_empty_survey_gives_valid_files_without_its_empty_blocks(tmp_path):
    """40 tiles, one of them in each corner of the extent, three beside each other; overviews keep the lone ones."""
    rng = np.random.default_rng(2)
    col = [0, 0, 302, 302, 100, 101, 102, *rng.integers(3, 99, 33)]
    row = [0, 252, 0, 252, 7, 7, 7, *range(20, 53)]
    made = make_map(col, row, rng.integers(0, 4, 40), np.zeros(40))
    states = rng.choice([FREE, FREE, FREE, OBSTACLE, CANOPY], made.patches.heights.shape).astype(np.uint8)
    share = np.where(np.arange(40) % 2, 0.1, np.nan).astype(np.float32)  # NaN: what is free is not known to be
    table = table_of(replace(made, objects=ObjectStack(states, share, share, share, share)))
    for name in (MapFile.HEIGHTMAP, MapFile.OBSTACLE):
        path = tmp_path / Path(name).name
        write_raster(name, table, path, {"vehicle": "warthog"})
        assert cog_validate(path, strict=True)[:3] == (True, [], [])
        assert path.stat().st_size < 200_000  # of 17 million pixels
    heights, states = levels_of(tmp_path / "heightmap.tif"), levels_of(tmp_path / "obstacle.tif")
    assert len(heights) == len(states) == 5
    for height, state in zip(heights, states, strict=True):
        corners = [0, 0, -1, -1], [0, -1, 0, -1]
        assert np.isfinite(height[corners]).all()
        assert (state[corners] != NO_CLASS).all()
        assert np.isfinite(height).mean() < 0.01


def thin(cost_map, share, seed=1):
    """The same map with heights in a share of the pixels, in none of every fifth tile; hills, so that means differ."""
    rng = np.random.default_rng(seed)
    heights = cost_map.patches.heights.copy()
    heights += (3.0 * np.sin(cost_map.patches.col / 4.0) + cost_map.patches.row % 7)[:, None, None].astype(np.float32)
    heights[rng.random(heights.shape) >= share] = np.nan
    heights[rng.random(len(heights)) < 0.2] = np.nan
    return replace(cost_map, patches=replace(cost_map.patches, heights=heights))


def relief_of(cost_map, path):
    write_raster(MapFile.RELIEF, table_of(cost_map), path)
    return band(path)


def means_of_thirds(cost_map):
    """Means in whole cm, NaN where there are none, and which pixels are in a tile, (rows * 3, cols * 3) each."""
    patches, side = cost_map.patches, cost_map.patches.grid.pixels
    third = ((np.arange(side) + 0.5) * 3 // side).astype(int)
    row = 3 * (patches.row.max() - patches.row)[:, None, None] + third[:, None]
    col = 3 * (patches.col - patches.col.min())[:, None, None] + third
    total, count, tiles = np.zeros((3, row.max() + 1, col.max() + 1))
    np.add.at(total, (row, col), np.nan_to_num(patches.heights.astype(float)))
    np.add.at(count, (row, col), np.isfinite(patches.heights))
    tiles[row, col] = 1
    with np.errstate(invalid="ignore"):
        return np.rint(100 * total / count), tiles > 0


@pytest.mark.parametrize("grid", [Grid(), Grid(3.0, 5), Grid(1.5, 16)])
def test_known_pixels_are_means_and_others_are_filled_from_the_nearest(tmp_path, grid):
    cost_map = thin(make_field(30, 25, west=-11, south=-9, grid=grid, holes=0.3), 0.02)
    found = relief_of(cost_map, tmp_path / "relief.tif")
    means, tiles = means_of_thirds(cost_map)
    known = np.isfinite(means)
    # half a centimetre may fall to either side
    np.testing.assert_allclose(found[known], means[known] / 100, atol=0.0101)
    assert np.mean(np.abs(found[known] - means[known] / 100) < 1e-3) > 0.99
    assert np.isnan(found[~tiles]).all()
    filled = np.full(means.shape, np.nan)
    for half in (8, 4, 2, 1):  # the smallest square around a pixel that holds some
        share, total = (
            uniform_filter(part, 2 * half + 1, mode="constant") for part in (1.0 * known, np.nan_to_num(means))
        )
        filled = np.where(share > 1e-6, total / np.maximum(share, 1e-6), filled)
    unknown = tiles & ~known
    np.testing.assert_allclose(found[unknown], filled[unknown] / 100, atol=0.02)
    assert np.isfinite(filled[unknown]).sum() > 100
