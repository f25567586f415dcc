"""Agreement of ways, on numbers counted by hand."""

import math

import numpy as np
import pytest
from _route_trial import LineFigures, WayResult, agree, arrivals, stopped_at_obstacle, wilson
from driven_ways import WayDrive


def way(name, c_r, driven, *, p_arrives=1.0, failed=0, cost=None, tiles=()):
    """A way of 10 m: predicted C_r, C_r of the drives that arrived, number of those that did not."""
    hazard = -math.log(p_arrives)
    figures = LineFigures(10.0, c_r, 0.8 * c_r, 1.2 * c_r, 2 * c_r, hazard, cost or 10 * (1 + 5 * c_r), 0.0, 0.0, 0.0)
    drives = [WayDrive("completed", 10.0, 10 * value, 10.0, turning_rad=value, tiles=list(tiles)) for value in driven]
    drives += [WayDrive("stuck", 3.0, 9.0, 3.0) for _ in range(failed)]
    return WayResult(0, name, figures, drives)


def test_agreement_of_ways_that_were_driven():
    found = agree([way("best", 0.1, [0.1, 0.1]), way("best", 0.15, [0.1]), way("best", 0.3, [], failed=2)])
    assert found.ways == 2
    assert found.median_error == pytest.approx(0.25)
    assert found.median_ratio == pytest.approx(1.25)
    assert found.held == 0.5
    assert found.raw_ratio == pytest.approx(2.5)
    assert found.noise_ratio == pytest.approx(2.0)
    assert found.turning_share == pytest.approx(0.1)
    assert found.spread == 0.0


def test_nothing_is_claimed_where_no_drive_arrived():
    found = agree([way("best", 0.3, [], failed=2)])
    assert found.ways == 0
    assert math.isnan(found.median_error)


def test_arrivals_count_each_way_once():
    ways = [way("best", 0.1, [0.1] * 3, failed=1, p_arrives=0.9), way("best", 0.1, [0.1] * 4, p_arrives=0.5)]
    found = arrivals(ways)
    assert (found.ways, found.drives) == (2, 8)
    assert found.expected == pytest.approx(0.7)
    assert found.arrived == pytest.approx(0.875)
    assert (found.low, found.high) == wilson(1.75, 2)
    assert found.held
    assert found.ways_held == 1  # 3 of 4 allow 0.9; 4 of 4 do not allow 0.5


def test_a_drive_that_ends_at_an_obstacle_is_counted(made_up):
    field = made_up.read(made_up.window)
    field.obstacle[0, 3] = 0.2
    line = np.array([[0.5, 0.5], [0.5, 9.5]])
    at = [stopped_at_obstacle(field, line, WayDrive("stuck", reached_m=metres)) for metres in (5.9, 6.1, 11.9, 12.1)]
    assert at == [False, True, True, False]  # the tile is 7.5 m to 10.5 m from the start
    assert not stopped_at_obstacle(field, line, WayDrive("completed", reached_m=9.0))


def test_wilson_is_the_set_of_shares_that_the_score_test_does_not_reject():
    for successes, trials in ((0, 20), (3, 20), (20, 20), (7.5, 10)):
        low, high = wilson(successes, trials)
        seen = successes / trials
        shares = np.linspace(0.0005, 0.9995, 1000)
        kept = np.abs(seen - shares) <= 1.959964 * np.sqrt(shares * (1 - shares) / trials)
        assert (shares[kept].min(), shares[kept].max()) == pytest.approx((low, high), abs=2e-3)
