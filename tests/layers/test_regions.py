"""Regions of a map: what they cover, their numbers, and borders whose vertices both sides share."""

from dataclasses import replace

import numpy as np
import pytest
import rasterio.features
import shapely
from cost_maps import part_of
from coverages import check_coverage, holes_of_tiles
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS, Transformer
from region_files import regions_of
from scipy import ndimage

from bumpymap.core.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostTable, Georeference, Reason
from bumpymap.layers import label
from bumpymap.layers._cog import raster_lock
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import dissolve
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import Grid

KEYS = arrays(np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.integers(0, 3)).filter(np.any)
CHECKERS = np.add.outer(np.arange(6), np.arange(7)).astype(np.uint8) % 2 + 1
DIAGONALS = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2], [0, 2, 0]], np.uint8)
RING_BY_CORNERS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
BESIDE_A_LONG_SIDE = np.array([[1, 1, 1, 1], [2, 2, 3, 3], [0, 2, 3, 0]], np.uint8)
ALONG_ANTIMERIDIAN = "+proj=tmerc +lon_0=180 +k=0.9996 +datum=WGS84 +units=m"
"""Sides of tiles lie on the antimeridian."""


def at_antimeridian(crs, latitude):
    """Georeference and a tile at 180 degrees."""
    georeference = Georeference(CRS.from_user_input(crs))
    x, y = Transformer.from_crs(4326, georeference.crs, always_xy=True).transform(180.0, latitude)
    return georeference, round(x / 3), round(y / 3)


SITES = {
    # name: (georeference, west tile, south tile)
    "feet": (Georeference(CRS.from_epsg(2271), 1200 / 3937, 1200 / 3937), 130_000, 60_000),
    "far_north": (Georeference(CRS.from_epsg(32633)), 160_000, 2_920_000),
    "no_crs": (Georeference(None), -7, -5),
    "antimeridian": at_antimeridian(32701, -17.0),
    "far_south at the antimeridian": at_antimeridian(32760, -77.0),
    "along the antimeridian": at_antimeridian(ALONG_ANTIMERIDIAN, -17.0),
}


def map_of_keys(make_map, keys, site, stretch=1, shift=(0, 0)):
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


@settings(max_examples=60)
@given(keys=KEYS)
@example(keys=CHECKERS)
@example(keys=DIAGONALS)
@example(keys=RING_BY_CORNERS)
@example(keys=BESIDE_A_LONG_SIDE)
def test_outlines_have_the_vertices_that_both_sides_need_and_no_others(make_map, keys):
    made = map_of_keys(make_map, keys, "no_crs")
    outlines = regions_of(made).outlines
    _, west, north = SITES["no_crs"]
    vertices = {(north + 1 - int(y), int(x) - west) for x, y in shapely.get_coordinates(outlines)}
    assert vertices == vertices_by_hand(keys)


@pytest.mark.parametrize("site", SITES)
@settings(max_examples=20)
@given(
    keys=KEYS,
    cut=st.sampled_from([(1, 1), (1, 3), (1, 512), (20, 512), (45, 512)]),
    shift=st.tuples(*[st.integers(-9, 9)] * 2),
)
@example(keys=CHECKERS, cut=(1, 512), shift=(-4, 0))
@example(keys=BESIDE_A_LONG_SIDE, cut=(45, 512), shift=(-80, 0))
@example(keys=np.ones((7, 8), np.uint8), cut=(1, 2), shift=(0, 0))
def test_both_vectors_are_a_coverage_with_the_holes_of_the_tiles(make_map, site, keys, cut, shift):
    stretch, size = cut
    made = map_of_keys(make_map, keys, site, stretch, shift)
    table, holes = CostTable.of(made), holes_of_tiles(made.patches.col, made.patches.row)
    place = GeoJsonCoordinates.of(Placement.of(table), local=True)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bumpymap.layers.regions.REGION_WINDOW", size)
        outlines = np.concatenate([regions.outlines for regions in dissolve(table)])
    check_coverage(shapely.transform(outlines, place.placement.to_crs), holes)
    degrees = place.polygons(outlines)
    assert shapely.is_valid(degrees).all()
    parts = shapely.get_parts(degrees)
    assert set(shapely.get_type_id(parts)) == {shapely.GeometryType.POLYGON}
    if site == "no_crs":
        check_coverage(parts, holes)
        return
    west, _, east, _ = shapely.bounds(parts).T
    assert (east - west < 1.0).all()
    sides = [parts[west >= 0], parts[west < 0]] if "antimeridian" in site else [parts]
    for side in sides:
        check_coverage(side, holes if len(side) == len(parts) else None)


def areas_by_hand(cost_map):
    """Unions of the boxes of tiles that share sides and what they are, found apart from the package."""
    patches, known = cost_map.patches, cost_map.class_id != NO_CLASS
    steep = patches.slope > cost_map.rule.slope_limit_deg
    passable = known & (cost_map.p_fail < 0.5) & ~steep
    kind = np.stack([cost_map.class_id, np.where(known, 0, patches.reason), passable], axis=1).astype(int)
    west, south = patches.col.min(), patches.row.min()
    for key in np.unique(kind, axis=0):
        chosen = (kind == key).all(axis=1)
        grid = np.zeros((np.ptp(patches.row) + 1, np.ptp(patches.col) + 1), bool)
        grid[patches.row[chosen] - south, patches.col[chosen] - west] = True
        labels, count = ndimage.label(grid)
        for number in range(1, count + 1):
            row, col = np.nonzero(labels == number)
            corner = col + west, row + south
            yield tuple(key.tolist()), shapely.union_all(shapely.box(*corner, corner[0] + 1, corner[1] + 1))


@settings(max_examples=60)
@given(
    cells=st.lists(st.sampled_from([None, 0, 1, NO_CLASS]), min_size=1, max_size=36).filter(
        lambda cells: any(cell is not None for cell in cells)
    ),
    cols=st.integers(1, 6),
)
def test_any_small_map_gives_valid_right_hand_regions(make_map, cells, cols):
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


def test_numbers_are_means_over_the_tiles(make_map):
    made = make_map([0, 1, 0, 1, 5], [0, 0, 1, 1, 9], [2, 2, NO_CLASS, NO_CLASS, 2], [0, 0, 3, 4, 0])
    p_fail = np.array([0.1, 0.4, np.nan, np.nan, 0.5], np.float32)
    cost_map = replace(made, p_fail=p_fail, patches=replace(made.patches, slope=np.zeros(5)))
    regions = regions_of(cost_map)
    # North first: the lonely tile, then the two unknown ones (for different reasons), then the pair.
    assert regions.tiles.tolist() == [1, 1, 1, 2]
    assert regions.class_id.tolist() == [2, NO_CLASS, NO_CLASS, 2]
    assert regions.reason.tolist() == [0, 3, 4, 0]
    assert regions.passable.tolist() == [False, False, False, True]
    assert regions.class_name.tolist() == [CLASS_NAMES[2], "unknown", "unknown", CLASS_NAMES[2]]
    assert regions.c_r_basis.tolist() == ["survivors", None, None, "drives"]
    assert regions.reason_text[1] == REASON_TEXT[Reason.TOO_MANY_HOLES]
    assert regions.area_m2.tolist() == [9.0, 9.0, 9.0, 18.0]
    for name in ("c_r", "c_r_low", "c_r_high", "p_fail"):
        values = getattr(cost_map, name).astype(float)
        assert getattr(regions, name) == pytest.approx([values[4], np.nan, np.nan, values[:2].mean()], nan_ok=True)
    hazard = -np.log([0.9, 0.6]) / cost_map.rule.drive_m
    assert regions.hazard[3] == pytest.approx(hazard.mean())
    assert regions.cost[3] == pytest.approx(1 + 2.5 * cost_map.c_r[:2].astype(float).mean() + 300 * hazard.mean())
    assert np.isnan(regions.cost[:3]).all()
    assert np.isnan(regions.hazard[:3]).all()


COLUMNS = ("class_id", "reason", "tiles", "passable", "c_r", "c_r_low", "c_r_high", "p_fail", "hazard", "cost")


def test_a_large_map_is_cut_into_windows_from_its_north_west_corner(make_field, monkeypatch):
    cost_map = make_field(45, 30, holes=0.3)
    monkeypatch.setattr("bumpymap.layers.regions.REGION_WINDOW", 20)
    patches = cost_map.patches
    cell = np.stack([(patches.row.max() - patches.row) // 20, (patches.col - patches.col.min()) // 20], axis=1)
    found, expected = list(dissolve(CostTable.of(cost_map))), []
    for key in np.unique(cell, axis=0):  # each cell as a map of its own
        expected += dissolve(CostTable.of(part_of(cost_map, (cell == key).all(axis=1))))
    assert len(expected) == 6
    for name in COLUMNS:
        values = [np.concatenate([getattr(batch, name) for batch in batches]) for batches in (found, expected)]
        np.testing.assert_array_equal(*values)
    # A region has vertices at the corners of those beyond the cut, which a map of its window alone does not know.
    own, alone = (np.concatenate([batch.outlines for batch in batches]) for batches in (found, expected))
    assert shapely.equals(own, alone).all()
    assert (shapely.get_num_coordinates(own) >= shapely.get_num_coordinates(alone)).all()
    check_coverage(own, holes_of_tiles(patches.col, patches.row))


@settings(max_examples=60)
@given(keys=arrays(np.uint8, st.tuples(st.integers(1, 7), st.integers(1, 7)), elements=st.integers(0, 2)))
def test_areas_are_those_of_scipy_in_reading_order(keys):
    labels, first, last = label(keys)
    expected = np.zeros(keys.shape, int)
    for key in (1, 2):
        part, _ = ndimage.label(keys == key)
        expected += np.where(part, part + expected.max(), 0)
    assert (labels > 0).tolist() == (keys > 0).tolist()
    pairs = set(zip(labels.ravel().tolist(), expected.ravel().tolist(), strict=True)) - {(0, 0)}
    assert len(pairs) == len(first) == expected.max()  # one to one
    assert (np.diff(first) > 0).all()
    for number in range(len(first)):
        inside = np.flatnonzero(labels == number + 1)
        assert (inside[0], inside[-1]) == (first[number], last[number])


def test_no_raster_is_written_while_outlines_are_traced(make_field, monkeypatch):
    """Blocks of both share GDAL's cache, from which one thread may push those that another has not finished."""
    trace, held = rasterio.features.shapes, []
    monkeypatch.setattr(
        rasterio.features, "shapes", lambda *args, **more: held.append(raster_lock().locked()) or trace(*args, **more)
    )
    assert regions_of(make_field(20, 16))
    assert held
    assert all(held)
