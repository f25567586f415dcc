"""Answers with and without a method, against counts by hand and a search over all limits."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

from bumpymap.lab.evaluate.scans import DEVIATION, ClassedSectorTable, accuracy_of, all_answers, best_limits

TABLE = ClassedSectorTable(
    class_id={"filter": np.array([0, 0, 1, 2, 2, 2, 255], np.uint8)},
    truth=np.array([0, 1, 1, 2, -1, 0, 2], np.int16),
    traversable=np.array([True] * 6 + [False]),
    stripes=np.full(7, 5.0),
    variance=np.full(7, 0.1),
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


def test_without_labels_nothing_is_right_or_wrong():
    found = accuracy_of(np.full(7, -1), np.zeros(7, int))
    assert np.isnan([found.right, found.even, *found.recall]).all()


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
