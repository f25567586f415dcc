"""Outlines of adjacent areas have the same vertices along their borders."""

import numpy as np
import pytest
import shapely
from coverages import check_coverage, holes_of_tiles
from hypothesis import example, given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from pyproj import CRS, Transformer

from bumpymap.core.types import CostTable, Georeference
from bumpymap.layers import label
from bumpymap.layers.placement import Placement
from bumpymap.layers.regions import dissolve, shared_corners, trace_labels
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import Grid, TileWindow

US_FOOT = 1200 / 3937
SITES = {
    # name: (georeference, west tile, south tile)
    "feet": (Georeference(CRS.from_epsg(2271), US_FOOT, US_FOOT), 130_000, 60_000),
    "far_north": (Georeference(CRS.from_epsg(32633)), 160_000, 2_920_000),
    "no_crs": (Georeference(None), -7, -5),
}
KEYS = arrays(np.uint8, st.tuples(st.integers(1, 8), st.integers(1, 8)), elements=st.integers(0, 3))
CHECKERS = np.add.outer(np.arange(6), np.arange(7)).astype(np.uint8) % 2 + 1
DIAGONALS = np.array([[1, 0, 1], [0, 1, 0], [1, 0, 2], [0, 2, 0]], np.uint8)
RING_BY_CORNERS = np.array([[0, 1, 0], [1, 0, 1], [0, 1, 0]], np.uint8)
BESIDE_A_LONG_SIDE = np.array([[1, 1, 1, 1], [2, 2, 3, 3], [0, 2, 3, 0]], np.uint8)


@settings(max_examples=60, deadline=None)
@given(keys=KEYS.filter(np.any))
@example(keys=CHECKERS)
@example(keys=DIAGONALS)
@example(keys=RING_BY_CORNERS)
@example(keys=BESIDE_A_LONG_SIDE)
def test_outlines_of_areas_are_a_coverage_with_no_vertex_too_many(keys):
    rows, cols = keys.shape
    labels, first, _ = label(keys)
    outlines = trace_labels(labels, TileWindow(-3, 5, cols, rows), slice(0, rows), range(1, len(first) + 1))
    line, col = np.nonzero(keys)
    check_coverage(outlines, holes_of_tiles(col, -line))
    np.testing.assert_array_equal(shapely.area(outlines), np.bincount(labels[labels > 0])[1:])
    marked = {(int(x) - 3, 5 + rows - int(y)) for y, x in np.argwhere(shared_corners(np.pad(keys, 1)))}
    assert {(int(x), int(y)) for x, y in shapely.get_coordinates(outlines)} == marked


def map_of_keys(make_map, keys, site="far_north", stretch=1, shift=(0, 0), **options):
    """Map with a class for each key, every tile stretched to ``stretch`` tiles side by side."""
    georeference, west, south = SITES[site] if isinstance(site, str) else site
    wide = np.repeat(keys, stretch, axis=1)
    line, col = np.nonzero(wide)
    place = (col + west + shift[0], south + shift[1] - line)
    return make_map(*place, wide[line, col] - 1, np.zeros(len(col)), georeference=georeference, easy=True, **options)


def vectors_of(cost_map):
    """Outlines of all regions in both files: in the survey's CRS, and in those of cost.geojson."""
    table = CostTable.of(cost_map)
    place = GeoJsonCoordinates.of(Placement.of(table), local=True)
    outlines = np.concatenate([regions.outlines for regions in dissolve(table)])
    return shapely.transform(outlines, place.placement.to_crs), place.polygons(outlines)


@pytest.mark.parametrize("site", SITES)
@settings(max_examples=25, deadline=None)
@given(keys=KEYS.filter(np.any), stretch=st.sampled_from([1, 20, 45]), shift=st.tuples(*[st.integers(0, 40)] * 2))
@example(keys=CHECKERS, stretch=1, shift=(0, 0))
@example(keys=BESIDE_A_LONG_SIDE, stretch=45, shift=(17, 3))
def test_both_vectors_are_a_coverage_with_the_holes_of_the_tiles(make_map, site, keys, stretch, shift):
    made = map_of_keys(make_map, keys, site, stretch, shift, grid=Grid(3.0, 1))
    for outlines in vectors_of(made):
        check_coverage(outlines, holes_of_tiles(made.patches.col, made.patches.row))


@pytest.mark.parametrize("size", [1, 3])
@settings(max_examples=20, deadline=None)
@given(keys=KEYS.filter(np.any))
@example(keys=np.ones((7, 8), np.uint8))
@example(keys=BESIDE_A_LONG_SIDE)
def test_regions_cut_at_windows_are_a_coverage_too(make_map, size, keys):
    made = map_of_keys(make_map, keys, grid=Grid(3.0, 1))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("bumpymap.layers.regions.REGION_WINDOW", size)
        for outlines in vectors_of(made):
            check_coverage(outlines, holes_of_tiles(made.patches.col, made.patches.row))


ALONG_ANTIMERIDIAN = "+proj=tmerc +lon_0=180 +k=0.9996 +datum=WGS84 +units=m"
"""Sides of tiles lie on the antimeridian."""


def at_antimeridian(crs, latitude):
    """Georeference and a tile at 180 degrees."""
    georeference = Georeference(CRS.from_user_input(crs))
    x, y = Transformer.from_crs(4326, georeference.crs, always_xy=True).transform(180.0, latitude)
    return georeference, round(x / 3), round(y / 3)


@pytest.mark.parametrize("place", [(32701, -17.0), (32760, -77.0), (ALONG_ANTIMERIDIAN, -17.0)])
@settings(max_examples=30, deadline=None)
@given(keys=KEYS.filter(np.any), stretch=st.sampled_from([1, 3, 45]), shift=st.tuples(*[st.integers(-9, 5)] * 2))
@example(keys=CHECKERS, stretch=1, shift=(-4, 0))
@example(keys=BESIDE_A_LONG_SIDE, stretch=45, shift=(-80, 0))
def test_both_sides_of_the_antimeridian_are_a_coverage(make_map, place, keys, stretch, shift):
    made = map_of_keys(make_map, keys, at_antimeridian(*place), stretch, shift, grid=Grid(3.0, 1))
    _, degrees = vectors_of(made)
    assert shapely.is_valid(degrees).all()
    parts = shapely.get_parts(degrees)
    assert set(shapely.get_type_id(parts)) == {shapely.GeometryType.POLYGON}
    bounds = shapely.bounds(parts)
    assert (bounds[:, 2] - bounds[:, 0] < 1.0).all()
    for side in (bounds[:, 0] > 0, bounds[:, 0] < 0):
        if side.any():
            check_coverage(parts[side])
