from dataclasses import replace

import numpy as np
import pytest
import rasterio.features
import shapely
from cost_maps import part_of
from coverages import check_coverage, holes_of_tiles
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from region_files import regions_of
from scipy import ndimage

from bumpymap.core.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostTable, Reason
from bumpymap.layers import label
from bumpymap.layers._cog import raster_lock
from bumpymap.layers.regions import dissolve


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


@settings(max_examples=60, deadline=None)
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


@settings(max_examples=60, deadline=None)
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
