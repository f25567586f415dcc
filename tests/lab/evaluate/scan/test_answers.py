"""Answers and tables of classes, against counts by hand and a search over all limits."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from bumpymap.core import Scan
from bumpymap.lab import LABEL_SETS
from bumpymap.lab.evaluate.scans import (
    DEVIATION,
    ClassedSectorTable,
    accuracy_of,
    all_answers,
    best_limits,
    class_rows,
    join_sectors,
    z_deviation,
)
from bumpymap.scan import classify_filter, polar_sectors

TABLE = ClassedSectorTable(
    class_id={"filter": np.array([0, 0, 1, 2, 2, 2, 255], np.uint8)},
    truth=np.array([0, 1, 1, 2, -1, 0, 2], np.int16),
    traversable=np.array([True] * 6 + [False]),
    stripes=np.array([5.0, 4.0, 3.0, 1.0, 1.0, 2.5, np.nan]),
    variance=np.array([1.0, 3.0, 5.0, 6.0, 7.0, 20.0, 500.0]),
    residual=np.full(7, 0.25),
    deviation=np.array([1.0, 2.0, 2.0, 5.0, 6.0, 1.0, 0.0]),
)


def test_a_sector_without_ground_is_rough_to_a_method_and_constants_stay_constant():
    answers = all_answers(TABLE)
    assert answers["filter"].tolist() == [0, 0, 1, 2, 2, 2, 2]
    assert [answers[f"always {k}"].tolist() for k in range(3)] == [[k] * 7 for k in range(3)]
    assert answers[DEVIATION].tolist() == [0, 1, 1, 2, 2, 0, 2]


def test_sectors_without_a_label_are_not_judged():
    found = accuracy_of(TABLE.truth, all_answers(TABLE)["filter"])
    assert found.confusion == [[1, 0, 1], [1, 1, 0], [0, 0, 2]]
    assert found.right == pytest.approx(4 / 6)
    assert found.recall == pytest.approx([1 / 2, 1 / 2, 1])
    assert found.even == pytest.approx((1 / 2 + 1 / 2 + 1) / 3)


@pytest.mark.parametrize("seed", range(5))
def test_no_limits_are_better_than_the_best(seed):
    rng = np.random.default_rng(seed)
    truth = rng.integers(0, 3, 30).astype(np.int16)
    values = truth * 0.5 + rng.normal(0, 0.5, 30)
    limits = best_limits(values, truth)

    def even(pair):
        return accuracy_of(truth, np.searchsorted(pair, values, side="right")).even

    assert limits[0] <= limits[1]
    # Forty quantiles of thirty values leave few of them out.
    best = max(even(pair) for pair in combinations_with_replacement(np.sort(values), 2))
    assert even(limits) == pytest.approx(best, abs=0.03)


def test_rows_hold_medians_and_means_of_each_class():
    smooth, middle, rough = class_rows(TABLE, "filter")
    assert (smooth["sectors"], middle["sectors"], rough["sectors"]) == (2, 1, 3)
    assert smooth["share"] == pytest.approx(1 / 3)
    assert (rough["variance"], rough["stripes"], middle["residual"]) == ((7.0, 11.0), (1.0, 1.5), (0.25, 0.25))


def test_sectors_without_ground_are_gathered_and_have_no_row():
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-15, 15, (40_000, 2)), rng.normal(0, 0.02, 40_000)])
    points[points[:, 0] > 5, 2] += 3 * points[points[:, 0] > 5, 0]
    label = np.where(points[:, 1] > 0, 3, 19).astype(np.uint16)
    stack = polar_sectors(Scan(points.astype(np.float32), label=label))
    scan = Scan(points.astype(np.float32), label=label)
    table = join_sectors([{"filter": classify_filter(stack)}] * 2, [z_deviation(scan, stack)] * 2, LABEL_SETS["rellis"])
    assert 0 < stack.traversable.sum() < len(stack.zone)
    assert len(table.truth) == 2 * len(stack.zone) == len(table.stripes)
    assert set(table.truth) == {0, 1}
    assert table.variance == pytest.approx(np.tile(stack.variance, 2), nan_ok=True)
    for row in (0, len(stack.zone) - 1):
        assert table.deviation[row] == pytest.approx(points[stack.point_sector == row, 2].std(), abs=1e-5)
    assert sum(row["sectors"] for row in class_rows(table, "filter")) == 2 * stack.traversable.sum()
    assert (join_sectors([{"filter": classify_filter(stack)}], [np.zeros(len(stack.zone))], None).truth == -1).all()
