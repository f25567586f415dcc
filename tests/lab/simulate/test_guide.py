"""The line that a vehicle follows."""

import math

import numpy as np
import pytest
from driven_ways import GuideLine

from bumpymap.core.errors import UsageError

CORNERS = np.array([[1.0, 2.0], [7.0, 2.0], [7.0, 10.0]])


def test_points_lie_evenly_on_the_line_from_end_to_end():
    guide = GuideLine.along(CORNERS)
    assert guide.length == pytest.approx(14.0)
    assert guide.points[[0, -1]].tolist() == [[1.0, 2.0], [7.0, 10.0]]
    assert guide.heading == 0.0
    off = np.where(guide.points[:, 0] < 7, guide.points[:, 1] - 2, guide.points[:, 0] - 7)
    assert np.abs(off).max() < 1e-9
    assert np.hypot(*np.diff(guide.points, axis=0).T).max() <= guide.step + 1e-12 <= 0.05 + 1e-12


def test_a_line_moved_to_the_left_keeps_its_distance():
    left = GuideLine.along(CORNERS, 0.3).points
    assert left[0] == pytest.approx((1.0, 2.3))
    assert left[-1] == pytest.approx((6.7, 10.0))
    assert np.hypot(*np.diff(left, axis=0).T).max() < 0.06  # no jump at the corner


def test_progress_is_the_nearest_point_ahead_and_never_goes_back():
    guide = GuideLine.along(CORNERS)
    at, aside = guide.progress(3.0, 2.4, 0)
    assert at * guide.step == pytest.approx(2.0, abs=guide.step)
    assert aside == pytest.approx(0.4, abs=1e-3)
    assert guide.progress(1.5, 2.0, at)[0] == at


def test_a_line_goes_on_straight_beyond_its_end():
    guide = GuideLine.along(CORNERS)
    last = len(guide.points) - 1
    assert guide.ahead(last, 1.0) == pytest.approx((7.0, 11.0), abs=guide.step)
    assert guide.ahead(0, 6.0 + 2.0) == pytest.approx((7.0, 4.0), abs=guide.step)


def test_a_point_is_no_way():
    with pytest.raises(UsageError, match="must be different places"):
        GuideLine.along(np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert math.isclose(GuideLine.along(np.array([[0.0, 0.0], [0.0, 0.01]])).length, 0.01)
