"""Pitch, roll and heave at several speeds against closed forms of waves, and against the operator of C_r."""

import numpy as np
import pytest

from bumpymap.rating import MotionOperator, RideOperator, felt_response, move_over, roll_over
from bumpymap.rating.ride.motion_operator import heave_filter
from bumpymap.rating.vehicle_profile import load_profile

WARTHOG = load_profile("warthog").to_dict()
STIFF = {**WARTHOG, "rocker": {**WARTHOG["rocker"], "stiffness_nm_per_rad": 0.0}}
BASE, TRACK = WARTHOG["wheelbase_m"], WARTHOG["track_m"]
HEIGHT_M, SIDE_M, PIXELS, SPEED = 0.005, 3.0, 60, 2.0


@pytest.fixture(scope="module")
def fine():
    return MotionOperator.of(STIFF, SIDE_M, PIXELS, (SPEED,))


def waves(wavelength):
    """Cosine waves along x whose mirror images at the patch's edges go on: one patch of them."""
    x = (np.arange(PIXELS) + 0.5) * SIDE_M / PIXELS
    wave = HEIGHT_M * np.cos(2 * np.pi * x / wavelength)
    return np.ascontiguousarray(np.broadcast_to(wave, (1, PIXELS, PIXELS)), np.float32)


def every_heading(wavelength):
    """Waves per metre along and across a vehicle, for all headings."""
    heading = (np.arange(20_000) + 0.5) / 20_000 * np.pi / 2
    return np.cos(heading) / wavelength, np.sin(heading) / wavelength


@pytest.mark.parametrize("wavelength", [3.0, 2.0, 1.5])
def test_waves_pitch_and_roll_and_lift_as_the_closed_forms_say(fine, wavelength):
    moved = move_over(waves(wavelength), fine)
    along, across = every_heading(wavelength)
    # The mean of both sides, or their difference over the track, is again a sine; mean absolute slope 4 A per wave.
    pitch = 8 * HEIGHT_M * along * abs(np.sin(np.pi * BASE * along) * np.cos(np.pi * TRACK * across)) / BASE
    roll = 8 * HEIGHT_M * along * abs(np.cos(np.pi * BASE * along) * np.sin(np.pi * TRACK * across)) / TRACK
    lift = HEIGHT_M * np.cos(np.pi * BASE * along) * np.cos(np.pi * TRACK * across) * abs(felt_response(SPEED * along))
    assert moved.pitch_change[0, 0] == pytest.approx(pitch.mean(), rel=0.05)
    assert moved.roll_change[0] == pytest.approx(roll.mean(), rel=0.05)
    assert moved.heave[0, 0] == pytest.approx(np.sqrt((lift**2 / 2).mean()), rel=0.05)


def test_level_ground_moves_nothing_and_its_height_does_not_matter(fine):
    level = np.full((1, PIXELS, PIXELS), 0.3, np.float32)
    moved = move_over(level, fine)
    assert moved.pitch_change[0, 0] < 1e-5
    assert moved.roll_change[0] < 1e-5
    assert moved.heave[0, 0] < 1e-3


@pytest.mark.parametrize("speed", [0.5, 1.0, 2.0, 6.0])
@pytest.mark.parametrize("frequency", [0.6, 1.0, 2.0, 4.0, 8.0])
def test_the_filter_weighs_a_sine_as_wk_does(speed, frequency):
    taps, where = heave_filter(speed, min(0.05, speed / 25))
    if frequency * min(0.05, speed / 25) / speed > 0.45:
        pytest.skip("more than half a wave in a step")
    assert taps.sum() == pytest.approx(0.0, abs=1e-9 * abs(taps).sum())
    weighed = abs((taps * np.exp(2j * np.pi * frequency / speed * where)).sum())
    assert weighed == pytest.approx(abs(felt_response(np.array([frequency]))[0]), rel=0.03)


def test_pitch_at_the_profiles_speed_is_that_of_c_r_to_the_bit():
    relief = np.random.default_rng(3).normal(0.0, 0.05, (20, 15, 15)).astype(np.float32)
    relief[7] = np.nan
    speeds = (0.5, WARTHOG["speed_mps"], 2.0)
    moved = move_over(relief, MotionOperator.of(WARTHOG, 3.0, 15, speeds))
    rides = roll_over(relief, RideOperator.of(WARTHOG, 3.0, 15))
    np.testing.assert_array_equal(moved.pitch_change[:, 1], rides.pitch_change)
    assert np.isnan(moved.heave[7]).all()
    assert np.isnan(moved.roll_change[7])


def test_a_patch_that_is_turned_or_mirrored_moves_the_same():
    relief = np.random.default_rng(4).normal(0.0, 0.05, (15, 15)).astype(np.float32)
    turned = np.stack([np.rot90(relief, quarter) for quarter in range(4)] + [relief[::-1], relief.T])
    moved = move_over(np.ascontiguousarray(turned), MotionOperator.of(WARTHOG, 3.0, 15, (1.0,)))
    for values in (moved.roll_change, moved.pitch_change[:, 0], moved.heave[:, 0]):
        assert values == pytest.approx(values[0], rel=1e-4)


def test_a_patch_moves_the_same_alone_and_among_others():
    relief = np.random.default_rng(5).normal(0.0, 0.05, (37, 15, 15)).astype(np.float32)
    operator = MotionOperator.of(WARTHOG, 3.0, 15, (0.5, 2.0))
    among, alone = move_over(relief, operator), move_over(relief[20:21], operator)
    np.testing.assert_array_equal(among.heave[20], alone.heave[0])
    np.testing.assert_array_equal(among.roll_change[20], alone.roll_change[0])
