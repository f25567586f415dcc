from dataclasses import fields, replace

import numpy as np
import pytest
import rasterio.features
import shapely
from coverages import check_coverage, holes_of_tiles
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from region_files import regions_of
from scipy import ndimage

from bumpymap.core.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostTable, Reason
from bumpymap.layers import label
from bumpymap.layers._cog import raster_lock
from bumpymap.layers.regions import dissolve


def key_of(class_id, reason, passable):
    return (int(class_id), bool(passable)) if class_id != NO_CLASS else -int(reason)


def may_pass(cost_map):
    """Which tiles are passable, worked out apart from the package."""
    known, steep = cost_map.class_id != NO_CLASS, cost_map.patches.slope > cost_map.rule.slope_limit_deg
    return known & (cost_map.p_fail < 0.5) & ~steep


def check_against_boxes(cost_map, regions):
    """Regions are the unions of the boxes of their tiles, found apart from the package."""
    patches = cost_map.patches
    tiles = {
        (int(c), int(r)): key_of(k, why, free)
        for c, r, k, why, free in zip(
            patches.col, patches.row, cost_map.class_id, patches.reason, may_pass(cost_map), strict=True
        )
    }
    left, found = dict(tiles), []
    while left:
        start, key = next(iter(left.items()))
        todo, members = [start], []
        while todo:
            c, r = todo.pop()
            if left.get((c, r)) != key:
                continue
            del left[c, r]
            members.append((c, r))
            todo += [(c + 1, r), (c - 1, r), (c, r + 1), (c, r - 1)]
        found.append((key, shapely.union_all([shapely.box(c, r, c + 1, r + 1) for c, r in members])))
    assert len(found) == len(regions.outlines)
    got = list(zip(map(key_of, regions.class_id, regions.reason, regions.passable), regions.outlines, strict=True))
    for key, area in found:
        assert sum(key == k and shapely.equals(area, outline) for k, outline in got) == 1


@settings(max_examples=60, deadline=None)
@given(data=st.data(), cols=st.integers(1, 6), rows=st.integers(1, 6))
def test_any_small_map_gives_valid_right_hand_regions(make_map, data, cols, rows):
    cells = data.draw(
        st.lists(st.sampled_from([None, 0, 1, NO_CLASS]), min_size=cols * rows, max_size=cols * rows).filter(
            lambda cells: any(cell is not None for cell in cells)
        )
    )
    present = [(i % cols - 3, i // cols - 3, cell) for i, cell in enumerate(cells) if cell is not None]
    col, row, class_id = zip(*present, strict=True)
    cost_map = make_map(col, row, class_id, [3 if cell == NO_CLASS else 0 for cell in class_id])
    regions = regions_of(cost_map)
    check_against_boxes(cost_map, regions)
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


def joined(batches):
    """Outlines as text, and every column, of all regions in their order."""
    names = ("class_id", "reason", "tiles", "passable", "c_r", "c_r_low", "c_r_high", "p_fail", "hazard", "cost")
    columns = {name: np.concatenate([getattr(batch, name) for batch in batches]) for name in names}
    return columns | {"outlines": shapely.to_wkt(np.concatenate([batch.outlines for batch in batches]))}


def test_a_large_map_is_cut_into_windows_from_its_north_west_corner(make_field, monkeypatch):
    cost_map = make_field(45, 30, holes=0.3)
    monkeypatch.setattr("bumpymap.layers.regions.REGION_WINDOW", 20)
    found = joined(list(dissolve(CostTable.of(cost_map))))
    patches = cost_map.patches
    west, north = patches.col.min(), patches.row.max()
    cell = np.stack([(north - patches.row) // 20, (patches.col - west) // 20], axis=1)
    expected = []
    for key in np.unique(cell, axis=0):  # each cell as a map of its own
        chosen = (cell == key).all(axis=1)
        part = dissolve(CostTable.of(only(cost_map, chosen)))
        expected += list(part)
    assert len(expected) == 6
    expected = joined(expected)
    # A region has vertices at the corners of those beyond the cut, which a map of its window alone does not know.
    own, alone = (shapely.from_wkt(columns.pop("outlines")) for columns in (found, expected))
    assert shapely.equals(own, alone).all()
    assert (shapely.get_num_coordinates(own) >= shapely.get_num_coordinates(alone)).all()
    check_coverage(own, holes_of_tiles(patches.col, patches.row))
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values)


def only(cost_map, chosen):
    """The map of some of its tiles."""

    def cut(record):
        arrays = {field.name: getattr(record, field.name) for field in fields(record)}
        return replace(
            record, **{name: array[chosen] for name, array in arrays.items() if isinstance(array, np.ndarray)}
        )

    return replace(cut(cost_map), patches=cut(cost_map.patches), textures=cut(cost_map.textures))


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
