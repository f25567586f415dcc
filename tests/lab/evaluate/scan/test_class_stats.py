"""Tables of classes, against counts by hand."""

import numpy as np
import pytest

from bumpymap.core import Scan
from bumpymap.lab.evaluate.scans import ClassedSectorTable, class_rows, join_sectors, z_deviation
from bumpymap.readers import LABEL_SETS
from bumpymap.scan import classify_filter, polar_sectors

TABLE = ClassedSectorTable(
    class_id={"filter": np.array([0, 0, 1, 2, 2, 2, 255], np.uint8)},
    truth=np.array([0, 1, 1, 2, -1, 0, 2], np.int16),
    traversable=np.array([True] * 6 + [False]),
    stripes=np.array([5.0, 4.0, 3.0, 1.0, 1.0, 2.5, np.nan]),
    variance=np.array([1.0, 3.0, 5.0, 6.0, 7.0, 20.0, 500.0]),
    residual=np.full(7, 0.25),
    deviation=np.full(7, 0.25),
)


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
