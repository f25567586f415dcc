"""Tables of classes and labels, against counts by hand."""

import numpy as np
import pytest

from bumpymap.core import Scan
from bumpymap.lab.evaluate.scan.class_stats import ClassedSectorTable, accuracy_of, class_rows, join_sectors
from bumpymap.scan import classify_filter, polar_sectors

TABLE = ClassedSectorTable(
    class_id={"filter": np.array([0, 0, 1, 2, 2, 2], np.uint8)},
    truth=np.array([0, 1, 1, 2, -1, 0], np.int16),
    stripes=np.array([5.0, 4.0, 3.0, 1.0, 1.0, 2.5]),
    variance=np.array([1.0, 3.0, 5.0, 6.0, 7.0, 20.0]),
    residual=np.full(6, 0.25),
)


def test_rows_hold_medians_and_means_of_each_class():
    smooth, middle, rough = class_rows(TABLE, "filter")
    assert (smooth.sectors, middle.sectors, rough.sectors) == (2, 1, 3)
    assert smooth.share == pytest.approx(1 / 3)
    assert rough.variance == (7.0, 11.0)
    assert rough.stripes == (1.0, 1.5)
    assert middle.residual == (0.25, 0.25)


def test_sectors_without_a_label_are_not_judged():
    found = accuracy_of(TABLE, "filter")
    assert found.confusion == [[1, 0, 1], [1, 1, 0], [0, 0, 1]]
    assert found.right == pytest.approx(3 / 5)
    assert found.even == pytest.approx((1 / 2 + 1 / 2 + 1) / 3)


def test_without_labels_nothing_is_right_or_wrong():
    table = ClassedSectorTable(TABLE.class_id, np.full(6, -1, np.int16), TABLE.stripes, TABLE.variance, TABLE.residual)
    found = accuracy_of(table, "filter")
    assert np.isnan([found.right, found.even]).all()


def test_only_sectors_that_can_be_driven_on_are_gathered():
    rng = np.random.default_rng(4)
    points = np.column_stack([rng.uniform(-15, 15, (40_000, 2)), rng.normal(0, 0.02, 40_000)])
    points[points[:, 0] > 5, 2] += 3 * points[points[:, 0] > 5, 0]
    label = np.where(points[:, 1] > 0, 3, 19).astype(np.uint16)
    stack = polar_sectors(Scan(points.astype(np.float32), label=label))
    table = join_sectors([{"filter": classify_filter(stack)}] * 2)
    assert 0 < stack.traversable.sum() < len(stack.zone)
    assert len(table.truth) == 2 * stack.traversable.sum() == len(table.stripes)
    assert set(table.truth) == {0, 1}
    assert table.variance == pytest.approx(np.tile(stack.variance[stack.traversable], 2))
