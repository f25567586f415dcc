"""The parts of a check alone: floor, agreement, turns of the sensor, filters, tiles beside the way."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import spearmanr

from bumpymap.check import CheckConfig
from bumpymap.check.pipeline import agreement_of, spearman
from bumpymap.check.places import local_metres
from bumpymap.check.signals import levelling, low_pass, turned
from bumpymap.check.stretches import less_floor
from bumpymap.core import DrivenStretches, UsageError


def stretches(measured, c_r, spread=0.2, sd=0.0):
    measured, c_r = np.asarray(measured, float), np.asarray(c_r, float)
    nothing = np.zeros(len(measured))
    limits = (0.1, 0.2, 0.4)
    return DrivenStretches(
        drive=nothing.astype(np.int64),
        start_s=nothing,
        end_s=nothing + 1,
        easting=nothing,
        northing=nothing,
        way_m=nothing + 10,
        speed_mps=nothing + 1,
        measured=measured,
        measured_sd=nothing + sd,
        c_r=c_r,
        c_r_low=c_r * (1 - spread),
        c_r_high=c_r * (1 + spread),
        place_sd=nothing,
        class_id=np.digitize(c_r, limits).astype(np.uint8),
        measured_class=np.digitize(measured, limits).astype(np.uint8),
    )


def test_independent_noise_is_taken_off_in_power():
    rng = np.random.default_rng(1)
    signal, noise = rng.normal(0, 0.2, 400_000), rng.normal(0, 0.1, 400_000)
    read, floor = np.abs(signal + noise).mean(), np.abs(noise).mean()
    assert less_floor(read, floor) == pytest.approx(np.abs(signal).mean(), rel=5e-3)
    assert less_floor(np.array([0.01]), np.array([0.02])) == 0.0


def test_spearman_is_that_of_scipy_ties_included():
    rng = np.random.default_rng(2)
    first = rng.integers(0, 6, 40).astype(float)
    second = first + rng.normal(0, 2, 40)
    assert spearman(first, second) == pytest.approx(spearmanr(first, second).statistic)
    assert np.isnan(spearman(first[:4], second[:4]))
    assert np.isnan(spearman(np.ones(9), second[:9]))


def test_agreement_by_hand():
    found = agreement_of(stretches([0.10, 0.20, 0.30, 0.40, 0.50, 0.0], [0.11, 0.30, 0.30, 0.42, np.nan, 0.2]))
    assert found.stretches == 4
    assert found.way_m == 40.0
    assert found.median_ratio == pytest.approx(np.median([1.1, 1.5, 1.0, 1.05]))
    assert found.median_error == pytest.approx(np.median([0.1, 0.5, 0.0, 0.05]))
    assert found.inside == 0.75
    assert found.same_class == 1.0


def test_an_unsure_reading_widens_the_interval():
    far = stretches([0.2], [0.3])
    assert agreement_of(far).inside == 0.0
    assert agreement_of(stretches([0.2], [0.3], sd=0.08)).inside == 1.0


@pytest.mark.parametrize("direction", [[0, 0, 1], [0, 0, -1], [1, 0, 0], [0.3, -0.4, 0.8]])
def test_levelling_turns_a_direction_upwards(direction):
    unit = np.array(direction, float) / np.linalg.norm(direction)
    assert levelling(np.array(direction, float)).apply(unit) == pytest.approx([0, 0, 1], abs=1e-12)


def test_rates_add_up_to_the_attitude():
    rng = np.random.default_rng(3)
    rate = rng.normal(0, 1.0, (500, 3))
    middle = 0.5 * (rate[1:] + rate[:-1])
    expected = Rotation.identity()
    for step in middle / 100.0:
        expected = expected * Rotation.from_rotvec(step)
    assert (turned(rate, 100.0)[-1].inv() * expected).magnitude() < 1e-9


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
    from pyproj import Geod

    lon, lat = np.array([-99.0, -99.0, -98.99]), np.array([19.0, 19.01, 19.0])
    east, north = local_metres(lon, lat)
    for number in (1, 2):
        _, _, metres = Geod(ellps="WGS84").inv(lon[0], lat[0], lon[number], lat[number])
        assert np.hypot(east[number] - east[0], north[number] - north[0]) == pytest.approx(metres, rel=1e-4)


@pytest.mark.parametrize(("drives", "told"), [((), "no drive"), (("a.csv", "b.csv", "a.csv"), "twice")])
def test_a_check_needs_drives_each_once(drives, told):
    with pytest.raises(UsageError, match=told):
        CheckConfig(drives)
