"""The operators of C_r and of roll, pitch and heave at several speeds, against slow walks, closed forms and filters."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import grey_dilation, map_coordinates
from scipy.signal import butter, freqs

from bumpymap.rating import MotionOperator, RideOperator, felt_response, move_over, roll_over
from bumpymap.rating.ride.operator import chassis_response, interpolation, weighting_wk
from bumpymap.rating.vehicle_profile import Vehicle

WARTHOG = Vehicle.load("warthog")
RIDE, MOTION = RideOperator.of(WARTHOG, 3.0, 15), MotionOperator.of(WARTHOG, 3.0, 15, (0.5, 2.0))
STIFF = replace(WARTHOG, rocker=replace(WARTHOG.rocker, stiffness_nm_per_rad=0.0))
BASE, TRACK = WARTHOG.wheelbase_m, WARTHOG.track_m
HEIGHT_M, SIDE_M, PIXELS, SPEED = 0.005, 3.0, 60, 2.0
TABLE = {0: 0, 0.1: 31.2, 0.5: 418, 1: 482, 2: 531, 4: 967, 5: 1039, 6.3: 1054, 8: 1036, 16: 768, 31.5: 405, 80: 132}
"""Frequency [Hz] -> Wk times 1000, of table 3 of ISO 2631-1:1997 (true one-third octave frequencies are near)."""


def patches(seed, count=6, sd=0.1):
    relief = np.random.default_rng(seed).normal(0.0, sd, (count, 15, 15))
    return (relief - relief.mean(axis=(1, 2), keepdims=True)).astype(np.float32)


def envelopes_by_scipy(patch, operator, wheel):
    """Grey dilations of the bilinear nodes, mirrored far on all sides, by cylinders in four directions."""
    grid = interpolation(15, operator.fine)
    nodes = grid @ patch.astype(np.float64) @ grid.T
    step, radius = 3.0 / (15 * operator.fine), wheel.radius_m
    reach = int(radius / step + 1e-9)
    away = np.arange(-reach, reach + 1) * step
    wide, rolled = np.pad(nodes, 3 * len(nodes), mode="reflect"), []
    for turn in (0.0, 45.0, 90.0, 135.0):
        cos, sin = np.cos(np.radians(turn)), np.sin(np.radians(turn))
        along, beside = away[None, :] * cos + away[:, None] * sin, away[:, None] * cos - away[None, :] * sin
        under = (abs(along) <= radius + 1e-9) & (abs(beside) <= (wheel.width_m + step) / 2 + 1e-9)
        cap = np.sqrt(np.maximum(radius**2 - along**2, 0)) - radius
        rolled.append(grey_dilation(wide, footprint=under, structure=np.where(under, cap, 0.0)))
    return np.array(rolled), step, 3 * len(nodes)


@pytest.mark.parametrize("name", ["warthog", "small_rover"])
def test_pitch_change_is_what_a_slow_walk_over_the_envelope_gives(name):
    """Ridges from south-west to north-east, and some noise."""
    vehicle = Vehicle.load(name)
    operator = RideOperator.of(vehicle, 3.0, 15)
    patch = (patches(1, 1, 0.03)[0] + np.sin(np.add.outer(range(15), range(15)) / 2.0) / 10.0).astype(np.float32)
    envelopes, step, margin = envelopes_by_scipy(patch, operator, vehicle.wheel)
    rng = np.random.default_rng(2)
    x, y, heading = rng.uniform(0, 3, 4000), rng.uniform(0, 3, 4000), rng.uniform(0, 2 * np.pi, 4000)
    taps = chassis_response(vehicle, step / 2)
    turn = np.rint(heading / (np.pi / 4)) % 4

    def pitch(back):
        total = 0.0
        for forward in (1, -1):
            for left in (1, -1):
                along, beside = forward * vehicle.wheelbase_m / 2 - back, left * vehicle.track_m / 2
                east = x + np.cos(heading) * along - np.sin(heading) * beside
                north = y + np.sin(heading) * along + np.cos(heading) * beside
                place = [turn, north / step + margin, east / step + margin]
                total = total + forward * map_coordinates(envelopes, place, order=1)
        return total / (2 * vehicle.wheelbase_m)

    change = sum(tap * (pitch(step / 2 * i) - pitch(step / 2 * (i + 1))) for i, tap in enumerate(taps)) / (step / 2)
    slow = np.abs(change)
    error = slow.std() / np.sqrt(len(slow))
    by_axis = np.empty((1, 8))
    quick = roll_over(patch[None], operator, by_axis).pitch_change[0]
    assert quick == pytest.approx(slow.mean(), abs=4 * error + 0.03 * slow.mean())
    axis = np.rint((90.0 + np.degrees(heading)) / 22.5) % 8  # azimuths from the north, whose row is the first
    of_axes = np.array([slow[axis == number].mean() for number in range(8)])
    np.testing.assert_allclose(by_axis[0], of_axes, atol=0.2 * quick)
    assert np.argmax(by_axis) == np.argmax(of_axes) == 6


def test_the_axes_of_a_turned_patch_turn_with_it_and_their_mean_is_that_of_all_headings():
    patch, by_axis, turned = patches(4, 20), np.empty((20, 8)), np.empty((20, 8))
    mean = roll_over(patch, RIDE, by_axis).pitch_change
    np.testing.assert_allclose(np.average(by_axis, axis=1, weights=np.diff(RIDE.samples.bounds[1:])), mean, rtol=1e-6)
    roll_over(np.ascontiguousarray(np.rot90(patch, 1, (1, 2))), RIDE, turned)
    np.testing.assert_allclose(np.roll(turned, 4, axis=1), by_axis, rtol=1e-4)


def test_pitch_at_the_profiles_speed_is_that_of_c_r_to_the_bit():
    relief = patches(3, 20, sd=0.05)
    moved = move_over(relief, MotionOperator.of(WARTHOG, 3.0, 15, (0.5, WARTHOG.speed_mps, 2.0)))
    np.testing.assert_array_equal(moved.pitch_change[:, 1], roll_over(relief, RIDE).pitch_change)


def test_heights_of_a_patch_are_measured():
    many = patches(5, 4)
    rides = roll_over(many, RIDE)
    for patch, span, change in zip(many.astype(np.float64), rides.height_range, rides.height_change, strict=True):
        sizes = [abs(patch[2:] - patch[:-2]).ravel(), abs(patch[:, 2:] - patch[:, :-2]).ravel()]
        assert span == pytest.approx(patch.max() - patch.min())
        assert change == pytest.approx(np.concatenate(sizes).mean(), rel=1e-6)


@pytest.fixture(scope="module")
def fine():
    # A thin wheel, of one node: one of true width rides on its edge where the ground falls to the side.
    return MotionOperator.of(replace(STIFF, wheel=replace(WARTHOG.wheel, width_m=0.005)), SIDE_M, PIXELS, (SPEED,))


def waves(wavelength):
    """Cosine waves along x whose mirror images at the patch's edges go on: one patch of them."""
    x = (np.arange(PIXELS) + 0.5) * SIDE_M / PIXELS
    wave = 0.3 + HEIGHT_M * np.cos(2 * np.pi * x / wavelength)
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


@pytest.mark.parametrize(("frequency", "weight"), TABLE.items())
def test_wk_is_that_of_the_standard(frequency, weight):
    assert 1000 * abs(weighting_wk(np.array([frequency]))[0]) == pytest.approx(weight, rel=0.005)


def test_above_ten_hertz_it_falls_like_a_butterworth_filter_of_fourth_order():
    assert felt_response(np.zeros(1))[0] == 0
    frequency = np.geomspace(0.3, 100, 50)
    _, cut = freqs(*butter(4, 2 * np.pi * 10.0, analog=True), worN=2 * np.pi * frequency)
    felt = felt_response(frequency) / ((2j * np.pi * frequency) ** 2 * weighting_wk(frequency))
    np.testing.assert_allclose(felt, cut, rtol=1e-6)
