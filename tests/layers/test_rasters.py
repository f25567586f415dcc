"""Rasters and regions of a map by GDAL and shapely, overviews, RFC 7946; the same bytes for any cut; areas of users."""

import json
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import replace
from functools import partial
from pathlib import Path
from xml.etree import ElementTree as ET

import geopandas
import numpy as np
import pandas as pd
import pytest
import rasterio
import shapely
from cost_maps import SPEEDS, lone_columns, make_field, make_map, regions_of, table_of, write_flatgeobuf, write_geojson
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS, Transformer
from rasterio.env import get_gdal_config
from rio_cogeo import cog_validate
from route_maps import UTM, bare_map
from scipy import ndimage
from scipy.ndimage import uniform_filter
from small_surveys import band

from bumpymap.core import BARRED_TEXT, CANOPY, CLASS_NAMES, FREE, NO_CLASS, REASON_TEXT, BadInputError, Barred
from bumpymap.core.types import BANDS, OBJECT_NAMES, OBSTACLE, UNSEEN, Georeference, ObjectStack, Reason
from bumpymap.layers import GeoJsonCoordinates, Placement, _cog, read_areas, read_points, tiles_in
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, REASON_COLOURS
from bumpymap.layers.folder import write_raster
from bumpymap.layers.map_reader import KeptRasters
from bumpymap.layers.products import MapFile
from bumpymap.layers.route_inputs import FilePoint
from bumpymap.layers.vector import dissolve, region_columns
from bumpytiles import Grid, TileTable, TileWindow

WRITERS = {
    Path(file).stem: lambda cost_map, *rest, file=file: write_raster(file, table_of(cost_map), *rest)
    for file in MapFile
    if file.endswith(".tif") and file not in {MapFile.PASSAGE, MapFile.PHOTO}
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


def holes_of_tiles(col, row):
    """Holes in the union of tiles: what lies inside groups of tiles that share sides."""
    filled = np.zeros((np.ptp(row) + 1, np.ptp(col) + 1), dtype=bool)
    filled[row - row.min(), col - col.min()] = True
    groups, _ = ndimage.label(filled)
    boxes = enumerate(ndimage.find_objects(groups), start=1)
    return sum(ndimage.label(~np.pad(groups[box] == number, 1))[1] - 1 for number, box in boxes)


def check_coverage(polygons, holes=None):
    """Every polygon is valid, they fit together without a gap, and their union has as many holes as expected."""
    assert shapely.is_valid(polygons).all()
    assert shapely.coverage_is_valid(polygons)
    if holes is not None:
        whole = shapely.get_parts(shapely.coverage_union_all(polygons))
        assert shapely.get_num_interior_rings(whole).sum() == holes


KEYS = arrays(np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.integers(0, 3)).filter(np.any)
CHECKERS = np.add.outer(np.arange(6), np.arange(7)).astype(np.uint8) % 2 + 1
DIAGONALS = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2], [0, 2, 0]], np.uint8)
RING_BY_CORNERS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
BESIDE_A_LONG_SIDE = np.array([[1, 1, 1, 1], [2, 2, 3, 3], [0, 2, 3, 0]], np.uint8)


SITES = {
    # name: (georeference, west tile, south tile)
    "south": (Georeference(CRS.from_epsg(32719)), 166_666, 2_000_000),
    "feet": (Georeference(CRS.from_epsg(2271), 1200 / 3937, 1200 / 3937), 130_000, 60_000),
    "northing_first": (Georeference(CRS.from_epsg(2193)), 530_000, 1_730_000),
    "far_north": (Georeference(CRS.from_epsg(32633)), 160_000, 2_920_000),
    "no_crs": (Georeference(None), -7, -5),
}


def map_of_keys(keys, site, stretch=1, shift=(0, 0)):
    """Map with a class for each key, every tile stretched to ``stretch`` tiles side by side."""
    georeference, west, south = SITES[site]
    wide = np.repeat(keys, stretch, axis=1)
    line, col = np.nonzero(wide)
    place = (col + west + shift[0], south + shift[1] - line)
    options = {"georeference": georeference, "easy": True, "grid": Grid(3.0, 1)}
    return make_map(*place, wide[line, col] - 1, np.zeros(len(col)), **options)


def vertices_by_hand(keys):
    """Corners of tiles, (y, x), but for those where one straight border passes, or none."""
    padded = np.pad(keys, 1)
    a, b, c, d = padded[:-1, :-1], padded[:-1, 1:], padded[1:, :-1], padded[1:, 1:]
    return {*zip(*np.nonzero(~(((a == b) & (c == d)) | ((a == c) & (b == d)))), strict=True)}


@pytest.mark.parametrize("site", SITES)
@settings(max_examples=20)
@given(
    keys=KEYS,
    cut=st.sampled_from([(1, 1), (1, 3), (1, 512), (20, 512), (45, 512)]),
    shift=st.tuples(*[st.integers(-9, 9)] * 2),
)
@example(keys=CHECKERS, cut=(1, 512), shift=(-4, 0))
@example(keys=DIAGONALS, cut=(1, 512), shift=(0, 0))
@example(keys=RING_BY_CORNERS, cut=(1, 512), shift=(0, 0))
@example(keys=BESIDE_A_LONG_SIDE, cut=(45, 512), shift=(-80, 0))
@example(keys=np.ones((7, 8), np.uint8), cut=(1, 2), shift=(0, 0))
def test_both_vectors_are_a_coverage_with_the_holes_of_the_tiles(site, keys, cut, shift):
    stretch, size = cut
    made = map_of_keys(keys, site, stretch, shift)
    table, holes = table_of(made), holes_of_tiles(made.patches.col, made.patches.row)
    place = GeoJsonCoordinates.of(Placement.of(table), local=True)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bumpymap.layers.vector.REGION_WINDOW", size)
        outlines = np.concatenate([regions.outlines for regions in dissolve(table)])
    check_coverage(shapely.transform(outlines, place.placement.to_crs), holes)
    if cut == (1, 512):  # no vertices but those that both sides need
        line, col = np.nonzero(keys)
        west, north = made.patches.col.min() - col.min(), made.patches.row.max() + 1 + line.min()
        x, y = shapely.get_coordinates(outlines).T.astype(int)
        assert {*zip((north - y).tolist(), (x - west).tolist(), strict=True)} == vertices_by_hand(keys)
    check_coverage(place.polygons(outlines), holes)


def test_numbers_are_means_over_the_tiles():
    made = make_map([0, 1, 0, 1, 5], [0, 0, 1, 1, 9], [2, 2, NO_CLASS, NO_CLASS, 2], [0, 0, 3, 4, 0])
    p_fail = np.array([0.1, 0.4, np.nan, np.nan, 0.5], np.float32)
    cost_map = replace(made, p_fail=p_fail, patches=replace(made.patches, slope=np.zeros(5)))
    regions = regions_of(cost_map)
    # North first: the lonely tile, then the two unknown ones (for different reasons), then the pair.
    columns, rough, none = region_columns(regions), CLASS_NAMES[2], None
    for name, wanted in {
        "tiles": [1, 1, 1, 2],
        "area_m2": [9.0, 9.0, 9.0, 18.0],
        "class": [2, none, none, 2],
        "class_name": [rough, "unknown", "unknown", rough],
        "reason": [none, REASON_TEXT[Reason(3)], REASON_TEXT[Reason(4)], none],
        "passable": [False, False, False, True],
        "c_r_basis": ["survivors", none, none, "drives"],
    }.items():
        assert columns[name] == wanted, name
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail"):
        values = getattr(cost_map, name).astype(float)
        assert getattr(regions, name) == pytest.approx([values[4], np.nan, np.nan, values[:2].mean()], nan_ok=True)
    hazard = (-np.log([0.9, 0.6]) / cost_map.rule.drive_m).mean()
    cost = 1 + 2.5 * cost_map.c_r[:2].astype(float).mean() + 300 * hazard
    assert regions.hazard == pytest.approx([np.nan] * 3 + [hazard], nan_ok=True)
    assert regions.cost == pytest.approx([np.nan] * 3 + [cost], nan_ok=True)


def test_a_region_of_passable_tiles_lies_in_one_zone():
    cost_map = make_map(np.arange(6), np.zeros(6, int), [1] * 6, [0] * 6, easy=True)
    columns = lone_columns(cost_map) | {"zone": np.array([3, 3, 1, 1, 0, 3], np.int32)}
    columns["barred"][5] = Barred.STEP
    tiles = TileTable.of(cost_map.patches.grid, columns)
    (regions,) = dissolve(replace(table_of(cost_map), tiles=tiles))
    found = region_columns(regions)
    assert (found["tiles"], found["zone"], found["passable"]) == (
        [2, 2, 1, 1],
        [3, 1, None, None],
        [True] * 3 + [False],
    )


def check_rfc7946(path):
    """Hold a file against RFC 7946; the parsed collection comes back. Written apart from what it checks."""
    collection = json.loads(path.read_text(), parse_constant=pytest.fail)
    assert collection["type"] == "FeatureCollection"
    assert "crs" not in collection
    corners = []
    for feature in collection["features"]:
        assert (feature["type"], type(feature["properties"])) == ("Feature", dict)
        geometry = feature["geometry"]
        assert (set(geometry), geometry["type"]) == ({"type", "coordinates"}, "Polygon")
        assert all(ring[0] == ring[-1] for ring in geometry["coordinates"])
        shape = shapely.geometry.shape(geometry)
        assert shape.is_valid
        assert not shape.has_z
        assert shape.exterior.is_ccw
        assert not any(hole.is_ccw for hole in shape.interiors)
        corners.append(shapely.get_coordinates(shape))
    corners = np.concatenate(corners)
    np.testing.assert_array_equal(corners, np.round(corners, 7))
    assert (np.abs(corners) <= [180, 90]).all()
    assert collection["bbox"] == [*corners.min(axis=0), *corners.max(axis=0)]
    return collection


@pytest.fixture(name="site", params=["south", "feet", "northing_first", "far_north"])
def site_fixture(request):
    georeference, west, south = SITES[request.param]
    return make_field(40, 25, west=west, south=south, georeference=georeference)


def back_to_tiles(cost_map, outlines):
    """Longitude and latitude to tiles, by pyproj alone."""
    place = cost_map.georeference
    to_crs = Transformer.from_crs("OGC:CRS84", place.crs, always_xy=True)
    scale = place.metres_per_unit / cost_map.patches.grid.tile_size
    return shapely.transform(outlines, lambda p: np.column_stack(to_crs.transform(p[:, 0], p[:, 1])) * scale)


def test_properties(tmp_path, cost_map):
    write_geojson(regions_of(cost_map), tmp_path / "cost.geojson", local=False)
    found = [feature["properties"] for feature in check_rfc7946(tmp_path / "cost.geojson")["features"]]
    for got in found:
        assert list(got) == [
            *("region", "class", "class_name", "reason", "passable", "zone", "c_r", "c_r_low", "c_r_high"),
            *("c_r_basis", "p_fail", "hazard", "cost", "area_m2", "tiles"),
        ]
        assert got["passable"] == (got["cost"] is not None) == (got["hazard"] is not None)
        assert (got["class"] is None) == (got["c_r"] is None) == (got["reason"] is not None)
    assert {(got["class"] is None, got["passable"]) for got in found} == {(True, False), (False, True), (False, False)}
    assert sum(got["tiles"] for got in found) == len(cost_map.class_id)


def test_geojson_and_flatgeobuf_open_in_geopandas_where_the_tiles_are_with_the_same_values(tmp_path, site):
    regions = regions_of(site)
    write_geojson(regions, tmp_path / "cost.geojson", local=False, about={"vehicle": "warthog"})
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    collection = check_rfc7946(tmp_path / "cost.geojson")
    assert collection["vehicle"] == "warthog"
    assert [feature["id"] for feature in collection["features"]] == [*range(1, len(regions.tiles) + 1)]
    globe, flat = (geopandas.read_file(tmp_path / name) for name in ("cost.geojson", "cost.fgb"))
    assert (globe.crs.to_epsg(), flat.crs) == (4326, site.georeference.crs)
    found = back_to_tiles(site, globe.geometry.to_numpy())
    assert (shapely.hausdorff_distance(found, regions.outlines) * 3.0 < 0.02).all()  # m
    np.testing.assert_allclose(shapely.area(found) * 9.0, globe["area_m2"], rtol=0.02)
    assert flat.geometry.is_valid.all()
    assert flat.geometry.geom_type.unique().tolist() == ["Polygon"]
    unit = site.georeference.metres_per_unit
    assert flat.area.sum() * unit**2 == pytest.approx(9.0 * len(site.class_id), rel=1e-9)
    flat = flat.sort_values("region")  # FlatGeobuf stores features along a Hilbert curve
    boxes = flat.bounds[["minx", "miny", "maxx", "maxy"]].to_numpy() * unit
    np.testing.assert_allclose(boxes, shapely.bounds(regions.outlines) * 3.0, rtol=1e-12)
    tables = (pd.DataFrame(frame.drop(columns="geometry")).reset_index(drop=True) for frame in (flat, globe))
    pd.testing.assert_frame_equal(*tables, check_dtype=False, check_like=True)
    assert globe["passable"].dtype == flat["passable"].dtype == bool


def test_long_sides_follow_the_grid_on_the_globe(tmp_path):
    # Far from the central meridian and far north, a strip of 3 km: its sides bend on the way to degrees.
    col, row = np.meshgrid(np.arange(240_000, 241_000), [2_900_000, 2_900_001])
    cost_map = make_map(
        *(col.ravel(), row.ravel(), np.zeros(2000), np.zeros(2000)),
        georeference=Georeference(CRS.from_epsg(32633)),
        easy=True,
    )
    regions = regions_of(cost_map)
    write_geojson(regions, tmp_path / "cost.geojson", local=False)
    (feature,) = check_rfc7946(tmp_path / "cost.geojson")["features"]
    ring = np.array(feature["geometry"]["coordinates"][0])
    middles = shapely.LineString((ring[:-1] + ring[1:]) / 2)  # where a straight piece is farthest from the true side
    found = shapely.get_coordinates(back_to_tiles(cost_map, middles))
    off = np.abs(found[:, 1] - np.round(found[:, 1])) * 3.0
    along = np.abs(found[:, 0] - np.round(found[:, 0] / 1000) * 1000) > 1.0
    assert off[along].max() < 0.012  # m: the rounding to 7 decimals is 1 cm


def test_across_the_antimeridian_only_local_coordinates_are_written(tmp_path):
    place = Georeference(CRS.from_epsg(32701))
    x, y = Transformer.from_crs(4326, place.crs, always_xy=True).transform(180.0, -17.0)
    regions = regions_of(make_field(8, 6, west=round(x / 3) - 4, south=round(y / 3), georeference=place))
    with pytest.raises(BadInputError, match=r"antimeridian.*`local=True`"):
        write_geojson(regions, tmp_path / "cost.geojson", local=False)
    write_geojson(regions, tmp_path / "cost.geojson", local=True)
    assert geopandas.read_file(tmp_path / "cost.geojson").crs.equals(place.crs, ignore_axis_order=True)


def test_without_crs_only_local_coordinates_are_written(tmp_path):
    cost_map = make_field(8, 6, west=-3, south=-2, georeference=Georeference(None))
    regions, path = regions_of(cost_map), tmp_path / "cost.geojson"
    with pytest.raises(BadInputError, match=r"no CRS.*`crs='EPSG:CODE'`.*`local=True`"):
        write_geojson(regions, path, local=False)
    assert not path.exists()
    write_geojson(regions, path, local=True)
    write_flatgeobuf(regions, tmp_path / "cost.fgb")
    collection = json.loads(path.read_text())
    assert "not RFC 7946" in collection["local_coordinates"]
    assert collection["metres_per_unit"] == 1.0
    globe, flat = geopandas.read_file(path), geopandas.read_file(tmp_path / "cost.fgb")
    assert flat.crs is None
    assert flat.area.sum() == 9.0 * len(cost_map.class_id)
    assert (globe.crs.type_name, globe.crs.name) == ("Engineering CRS", "survey without a CRS")
    assert globe.crs.axis_info[0].unit_conversion_factor == 1.0
    bounds = (shapely.total_bounds(regions.outlines) * 3.0).tolist()
    assert collection["bbox"] == globe.total_bounds.tolist() == flat.total_bounds.tolist() == bounds


def test_coordinates_outside_of_the_crs(tmp_path):
    regions = regions_of(make_field(5, 5, west=300_000_000, south=300_000_000))
    with pytest.raises(BadInputError, match=r"outside the area where its CRS.*`force_crs="):
        write_geojson(regions, tmp_path / "cost.geojson", local=False)


# ---- areas and points of users ----


GRID = Grid(3.0, 15)
WINDOW = TileWindow(160_000, 712_000, 100, 80)
SITE = bare_map(WINDOW)
CORNER = np.array([480_000.0, 2_136_000.0])
"""South-west corner of the site, m."""


def on_site(west, south, east, north):
    """A box, in metres from that corner."""
    return shapely.box(*np.add(CORNER, (west, south)), *np.add(CORNER, (east, north)))


def feature(geometry, **properties):
    return {"type": "Feature", "properties": properties, "geometry": shapely.geometry.mapping(geometry)}


def geojson(path, *features, **more):
    path.write_text(json.dumps({"type": "FeatureCollection", "features": list(features)} | more))
    return path


def blob(seed, *, middle=(150.0, 120.0), size=90.0, corners=9):
    """A star-shaped polygon on the site."""
    rng = np.random.default_rng(seed)
    angle = np.sort(rng.random(corners)) * 2 * np.pi
    radius = size * (0.3 + 0.7 * rng.random(corners))
    return shapely.Polygon(CORNER + middle + np.column_stack([np.cos(angle), np.sin(angle)]) * radius[:, None])


def by_hand(areas, window, test):
    """The relation of every tile of a window to the areas."""
    col, row = np.meshgrid(window.col + np.arange(window.cols), window.row + np.arange(window.rows)[::-1])
    return test(shapely.union_all(areas), shapely.box(col * 3.0, row * 3.0, col * 3.0 + 3.0, row * 3.0 + 3.0))


@pytest.mark.parametrize("seed", range(3))
def test_tiles_in_and_within_areas_tile_by_tile(seed):
    areas = np.array([blob(seed), blob(seed + 50, middle=(250.0, 60.0), size=70.0), blob(seed + 70, size=2.0)])
    for window in (TileWindow(160_010, 712_005, 60, 55), TileWindow(160_045, 712_035, 3, 4)):
        touched, held = tiles_in(areas, window, GRID), tiles_in(areas, window, GRID, wholly=True)
        assert np.array_equal(
            touched, by_hand(areas, window, lambda a, b: shapely.intersects(a, b) & ~shapely.touches(a, b))
        )
        assert np.array_equal(held, by_hand(areas, window, shapely.covers))
        assert not (held & ~touched).any()


def test_sides_on_the_borders_of_tiles():
    """A polygon drawn along tiles touches no others; two such side by side hold the tiles of both."""
    area = on_site(30.0, 60.0, 90.0, 120.0)
    expected = np.zeros((80, 100), bool)
    expected[40:60, 10:30] = True
    halves = [on_site(30.0, 60.0, 61.0, 120.0), on_site(61.0, 60.0, 90.0, 120.0)]
    assert np.array_equal(tiles_in(np.array([area]), WINDOW, GRID), expected)
    assert np.array_equal(tiles_in(np.array([area]), WINDOW, GRID, wholly=True), expected)
    assert np.array_equal(tiles_in(np.array(halves), WINDOW, GRID, wholly=True), expected)
    for how in ({}, {"wholly": True}):
        assert not tiles_in(np.array([], object), WINDOW, GRID, **how).any()
        assert not tiles_in(np.array([area]), TileWindow(0, 0, 4, 4), GRID, **how).any()
        assert tiles_in(np.array([shapely.box(0, 0, 1e7, 1e7)]), WINDOW, GRID, **how).all()


@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32614", "EPSG:32613"])
def test_areas_of_any_crs_come_to_the_same_place(tmp_path, crs):
    area = blob(1)
    transformer = Transformer.from_crs(UTM, crs, always_xy=True)
    dense = shapely.segmentize(area, 0.5)  # a straight side is bent in another CRS
    moved = shapely.transform(dense, lambda xy: np.column_stack(transformer.transform(xy[:, 0], xy[:, 1])))
    stated = {"type": "name", "properties": {"name": crs}}
    (found,) = read_areas(geojson(tmp_path / "areas.geojson", feature(moved), crs=stated), SITE)
    assert found.symmetric_difference(area).area < 0.01 * area.length * 0.01  # 0.1 mm along the outline
    assert np.array_equal(tiles_in(np.array([found]), WINDOW, GRID), tiles_in(np.array([area]), WINDOW, GRID))


def test_a_side_that_is_straight_in_longitude_and_latitude_is_bent_on_the_grid(tmp_path):
    """A strip along a parallel, 2 degrees long: at its middle, its straight side on the grid would be 130 m off."""
    longitude, latitude = SITE.to_lonlat(480_150.0, 2_136_120.0)
    strip = shapely.box(longitude - 1.0, latitude, longitude + 1.0, latitude + 1.0)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(strip)), SITE)
    east = np.linspace(480_001.0, 480_299.0, 30)
    along = SITE.to_lonlat(east, np.full(30, 2_136_120.0))[0]
    edge = SITE.from_lonlat(along, np.full(30, latitude))[1]
    points = [shapely.points(east, edge + step) for step in (0.001, -0.001)]
    assert shapely.covers(found, points[0]).all()
    assert not shapely.covers(found, points[1]).any()


def test_areas_beside_the_map_are_an_error_that_names_them_unless_that_is_allowed(tmp_path, caplog):
    """A way leads through what an area in a wrong place was to close."""
    on, off = shapely.Point(SITE.to_lonlat(480_150.0, 2_136_120.0)).buffer(1e-4), shapely.Point(11.0, 48.0).buffer(1e-3)
    path = geojson(tmp_path / "a.geojson", feature(on, name="pit"), feature(off, name="pond"), feature(off))
    with pytest.raises(BadInputError, match=r"2 of the 3 areas of .* read in WGS 84 .*: number 2, 3\. .*allow_outside"):
        read_areas(path, SITE)
    assert len(read_areas(path, SITE, allow_outside=True)) == 1
    assert "number 2, 3" in caplog.text


def test_projected_numbers_of_a_geojson_are_in_the_crs_of_the_map(tmp_path, caplog):
    """Read as degrees they would lie nowhere, and the way would lead through."""
    area = blob(3)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(area)), SITE)
    assert found.equals(area)
    assert "cannot be degrees" in caplog.text
    beyond = geojson(tmp_path / "b.geojson", feature(shapely.box(4e6, 5e6, 4e6 + 9.0, 5e6 + 9.0)))
    with pytest.raises(BadInputError, match=r"read in .*EPSG:32614.*, do not lie on the map"):
        read_areas(beyond, SITE)


def test_a_map_without_a_crs_takes_areas_in_its_own_coordinates(tmp_path):
    local = bare_map(TileWindow(0, 0, 20, 20), crs=None)
    area = shapely.box(6.0, 6.0, 20.0, 30.0)
    (found,) = read_areas(geojson(tmp_path / "a.geojson", feature(area)), local)
    assert found.equals(area)


def areas(path):
    return read_areas(path, SITE)


PLACES = [(-99.19, 19.318), (-99.1885, 19.3191), (-99.1881, 19.3178)]


def test_points_of_a_geojson_in_their_order(tmp_path):
    points = [shapely.Point(*place, 2250.0) for place in PLACES]
    nowhere = {"type": "Feature", "properties": {"name": "nowhere"}, "geometry": None}
    features = feature(points[0], name="gate"), nowhere, feature(points[1], number=7), feature(points[2], name=" pump ")
    assert read_points(geojson(tmp_path / "stops.geojson", *features)) == [
        FilePoint(name, *place, "lonlat") for name, place in zip(("gate", "2", "pump"), PLACES, strict=True)
    ]
    nameless = geojson(tmp_path / "bare.json", feature(shapely.MultiPoint(PLACES)))
    assert read_points(nameless) == [FilePoint(str(n), *place, "lonlat") for n, place in enumerate(PLACES, start=1)]


GPX = '<?xml version="1.0"?><gpx version="1.1" creator="t" xmlns="http://www.topografix.com/GPX/1/1">{}</gpx>'


def test_waypoints_of_a_gpx_or_else_the_points_of_its_route(tmp_path):
    path = tmp_path / "tour.gpx"
    way = "".join(f'<wpt lat="{y}" lon="{x}"><ele>12</ele><name>w{i}</name></wpt>' for i, (x, y) in enumerate(PLACES))
    route = f'<rte><rtept lat="{PLACES[1][1]}" lon="{PLACES[1][0]}"></rtept></rte>'
    path.write_text(GPX.format(way + route))
    assert read_points(path) == [FilePoint(f"w{i}", *place, "lonlat") for i, place in enumerate(PLACES)]
    path.write_text(GPX.format(route))
    assert read_points(path) == [FilePoint("1", *PLACES[1], "lonlat")]
    path.write_text(GPX.format(""))
    with pytest.raises(BadInputError, match="holds no points"):
        read_points(path)


@pytest.mark.parametrize(
    ("head", "system", "separator"),
    [("lon,lat", "lonlat", ","), ("Longitude;Latitude", "lonlat", ";"), ("x\ty", "crs", "\t")],
)
def test_columns_of_a_csv(tmp_path, head, system, separator):
    path = tmp_path / "points.csv"
    rows = [["id", head, "name"], ["7", "1.5", "-2.25", "the gate"], [""], ["", ""], ["8", " 3e2 ", "4"]]
    path.write_text("\n".join(map(separator.join, rows)), encoding="utf-8-sig")
    assert read_points(path) == [FilePoint("the gate", 1.5, -2.25, system), FilePoint("4", 300.0, 4.0, system)]


@pytest.mark.parametrize(
    ("read", "name", "content", "words"),
    [
        (areas, "a.geojson", json.dumps(feature(shapely.LineString(PLACES))), "holds linestring; areas must be pol"),
        (areas, "a.geojson", '{"type": "FeatureCollection", "features": []}', "holds nothing"),
        (areas, "a.kml", "", "is not a file of polygons"),
        (areas, "a.gpkg", "SQLite format 3", "ogr2ogr"),
        (areas, "b.geojson", None, "is missing"),
        (read_points, "a.csv", "lon,height\n1,2\n", r"a\.csv has the columns lon, height; it needs lon,lat"),
        (read_points, "a.csv", "lon,lat\n1,2\n3,north\n", r"a\.csv, line 3: '3,north'"),
        (read_points, "a.csv", "x;y\n1,5;2,5\n", r"'1,5;2,5' has no two numbers .* decimals with a point"),
        (read_points, "a.csv", "lon,lat\n", "holds no points"),
        (read_points, "a.csv", b"\xff\xfe\x00", "cannot read"),
        (read_points, "a.txt", "1,2", r"Give \.geojson, \.gpx or \.csv"),
        (read_points, "a.geojson", "{", r"cannot read .*a\.geojson: .*\. Give"),
        (
            read_points,
            "a.geojson",
            '{"type": "FeatureCollection", "features": [5]}',
            "features.0 is '5'; it must be an ",
        ),
        (read_points, "a.geojson", '{"type": "Feature", "crs": 5}', "crs is '5'; it must be an object with type, prop"),
        (read_points, "a.geojson", '{"type": "Point", "coordinates": [1e999, 1]}', "the Point of feature 1 is damaged"),
        (read_points, "a.geojson", '{"type": "Polygon", "coordinates": [[[1, 2]]]}', "Polygon of feature 1 is damaged"),
        (read_points, "a.gpx", '<gpx><wpt lat="1"/></gpx>', "a point of it is not a place: lat='1'"),
        (read_points, "a.gpx", "<kml><wpt lat='1' lon='2'/></kml>", "it is no GPX"),
    ],
)
def test_files_that_hold_neither_areas_nor_points_are_refused(tmp_path, read, name, content, words):
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(BadInputError, match=words):
        read(path)


def areas_by_hand(cost_map):
    """Unions of the boxes of tiles that share sides and what they are, found apart from the package."""
    patches, known = cost_map.patches, cost_map.class_id != NO_CLASS
    passable = known & (cost_map.p_fail < 0.5) & (patches.slope <= cost_map.rule.slope_limit_deg)
    kind = np.stack([cost_map.class_id, np.where(known, 0, patches.reason), passable], axis=1).astype(int)
    boxes = shapely.box(patches.col, patches.row, patches.col + 1, patches.row + 1)
    for key in np.unique(kind, axis=0):
        for area in shapely.get_parts(shapely.union_all(boxes[(kind == key).all(axis=1)])):
            yield tuple(key.tolist()), area


@settings(max_examples=60)
@given(
    cells=st.lists(st.sampled_from([None, 0, 1, NO_CLASS]), min_size=1, max_size=36).filter(
        lambda cells: any(cell is not None for cell in cells)
    ),
    cols=st.integers(1, 6),
)
def test_any_small_map_gives_valid_right_hand_regions(cells, cols):
    present = [(i % cols - 3, i // cols - 3, cell) for i, cell in enumerate(cells) if cell is not None]
    col, row, class_id = zip(*present, strict=True)
    cost_map = make_map(col, row, class_id, [3 if cell == NO_CLASS else 0 for cell in class_id])
    regions = regions_of(cost_map)
    got = list(zip(regions.class_id, regions.reason, regions.passable, regions.outlines, strict=True))
    expected = list(areas_by_hand(cost_map))
    assert len(expected) == len(got)
    for key, area in expected:
        assert sum((k, r, p) == key and shapely.equals(area, outline) for k, r, p, outline in got) == 1
    assert shapely.is_valid(regions.outlines).all()
    for outline in regions.outlines:
        assert outline.exterior.is_ccw
        assert not any(hole.is_ccw for hole in outline.interiors)
