from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from bumpymap.core.types import CLASS_NAMES, NO_CLASS, CostTable
from bumpymap.layers import MapSummary
from bumpymap.layers.summary import summarise


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.sampled_from([0, 1, 2, 3, NO_CLASS]), min_size=1, max_size=30), st.integers(0, 9), st.integers(1, 40)
)
def test_counts_and_medians_are_those_of_all_tiles(make_map, class_id, seed, cols):
    tiles = np.arange(len(class_id))
    cost_map = make_map(tiles % cols, tiles // cols, class_id, [3 if k == NO_CLASS else 0 for k in class_id], seed=seed)
    summary = summarise(CostTable.of(cost_map))
    assert summary.tiles == len(class_id)
    assert summary.points == cost_map.patches.count.sum()
    assert summary.median_count == np.median(cost_map.patches.count)
    assert summary.by_class == tuple(class_id.count(k) for k in range(4))
    free = (cost_map.class_id != NO_CLASS) & (cost_map.p_fail < 0.5)
    assert summary.passable == (free & (cost_map.patches.slope <= cost_map.rule.slope_limit_deg)).sum()
    assert summary.by_reason == (0, 0, 0, class_id.count(NO_CLASS), 0, 0)
    for number, group in enumerate([0, 1, 2, 3, NO_CLASS]):
        chosen = cost_map.class_id == group
        for found, values, near in (
            (summary.median_c_r, cost_map.c_r, 1e-4),
            (summary.median_slope, cost_map.patches.slope, 1e-3),
        ):
            known = values[chosen][np.isfinite(values[chosen])].astype(float)
            expected = np.median(known) if len(known) else np.nan
            assert found[number] == pytest.approx(expected, abs=near, nan_ok=True)


def test_the_median_of_the_last_class_is_of_the_tiles_that_their_c_r_puts_there(make_map):
    cost_map = make_map(np.arange(5), np.zeros(5, int), [3, 3, 3, 3, 0], [0] * 5)
    cost_map.c_r[:] = [0.1, 0.2, 0.5, 0.7, 0.05]
    cost_map.p_fail[:] = [0.9, 0.02, 0.9, 0.0, 0.0]  # the second is too steep
    summary = summarise(CostTable.of(cost_map), (0.1, 0.2, 0.4))
    assert summary.failing == 2
    assert summary.median_c_r[3] == pytest.approx(0.6, abs=1e-4)
    assert summary.by_class == (1, 0, 0, 4)


def test_unknown_are_the_tiles_without_a_class():
    """Those with one of which too little was seen are not passable, but not unknown."""
    counts = {
        "tiles": 10,
        "points": 99,
        "passable": 5,
        "by_class": dict(zip(CLASS_NAMES, (5, 1, 1, 1), strict=True)),
        "by_reason": {"too few points": 2},
        "barred": {"unknown ground": 3, "step": 2},
    }
    summary = MapSummary.of(counts)
    assert summary.unknown == 2
    assert summary.crossing == {"passable": 5, "unknown ground": 2, "too little seen": 1, "step": 2}


def test_strips_do_not_change_the_summary(make_field, monkeypatch):
    table = CostTable.of(make_field(50, 40))
    whole = summarise(table)
    monkeypatch.setattr("bumpymap.layers.summary._STRIP", 1)
    for found, expected in zip(astuple(summarise(table)), astuple(whole), strict=True):
        np.testing.assert_array_equal(found, expected)
