"""The parts of a check alone: floor, agreement, filters, metres of positions."""

from dataclasses import replace

import numpy as np
import pytest
from check_records import LIMITS, STRETCH_M, stretches_at
from pyproj import Geod
from scipy.stats import spearmanr

from bumpymap.check import CheckConfig
from bumpymap.check.pipeline import agreement_of
from bumpymap.check.places import local_metres
from bumpymap.check.signals import low_pass
from bumpymap.check.stretches import less_floor
from bumpymap.core import UsageError


def test_independent_noise_is_taken_off_in_power():
    rng = np.random.default_rng(1)
    signal, noise = rng.normal(0, 0.2, 400_000), rng.normal(0, 0.1, 400_000)
    read, floor = np.abs(signal + noise).mean(), np.abs(noise).mean()
    assert less_floor(read, floor) == pytest.approx(np.abs(signal).mean(), rel=5e-3)
    assert less_floor(np.array([0.01]), np.array([0.02])) == 0.0


def test_agreement_by_hand_and_by_scipy_ties_included():
    measured = np.array([0.10, 0.20, 0.30, 0.40, 0.40, 0.50, 0.0])
    c_r = np.array([0.11, 0.30, 0.30, 0.42, 0.20, np.nan, 0.2])
    driven = stretches_at(np.zeros((7, 2)), c_r, 1.0, sd=0.0)
    classes = np.digitize(measured, LIMITS).astype(np.uint8)
    driven = replace(driven, measured=measured, measured_sd=np.zeros(7), place_sd=np.zeros(7), measured_class=classes)
    found = agreement_of(driven)
    assert (found.stretches, found.way_m) == (5, 5 * STRETCH_M)
    assert found.spearman == pytest.approx(spearmanr(c_r[:5], measured[:5]).statistic)
    assert found.median_ratio == pytest.approx(np.median([1.1, 1.5, 1.0, 1.05, 0.5]))
    assert found.median_error == pytest.approx(np.median([0.1, 0.5, 0.0, 0.05, 0.5]))
    assert (found.inside, found.same_class) == (3 / 5, 3 / 5)
    four = agreement_of(driven, np.arange(7) < 4)
    assert four.stretches == 4
    assert np.isnan(four.spearman)


def test_the_low_pass_keeps_slow_and_halves_the_limit():
    time = np.arange(0, 20, 0.01)
    known = np.ones(len(time), bool)
    middle = slice(500, 1500)
    for hertz, share in ((2.0, 1.0), (10.0, 0.5), (25.0, 0.0)):
        kept = low_pass(np.sin(2 * np.pi * hertz * time), known, 100.0, 10.0)[middle]
        assert np.sqrt(2.0) * kept.std() == pytest.approx(share, abs=0.02)


def test_the_low_pass_does_not_reach_over_a_gap():
    values, known = np.zeros(1000), np.ones(1000, bool)
    values[600:] = 1.0
    known[500:600] = False
    kept = low_pass(values, known, 100.0, 10.0)
    assert np.abs(kept[:500]).max() == 0.0
    assert kept[600:] == pytest.approx(1.0)


def test_local_metres_are_those_of_the_ellipsoid():
    lon, lat = np.array([-99.0, -99.0, -98.99]), np.array([19.0, 19.01, 19.0])
    east, north = local_metres(lon, lat)
    _, _, metres = Geod(ellps="WGS84").inv(lon[[0, 0]], lat[[0, 0]], lon[1:], lat[1:])
    assert np.hypot(east[1:] - east[0], north[1:] - north[0]) == pytest.approx(metres, rel=1e-4)


@pytest.mark.parametrize(("drives", "told"), [((), "no drive"), (("a.csv", "b.csv", "a.csv"), "twice")])
def test_a_check_needs_drives_each_once(drives, told):
    with pytest.raises(UsageError, match=told):
        CheckConfig(drives)
