"""The ride operator against slow, plain computations and closed forms."""

from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.ndimage import grey_dilation, map_coordinates

from bumpymap.rating import RideOperator, roll_over
from bumpymap.rating.ride.motion_operator import Rides
from bumpymap.rating.ride.operator import chassis_response, interpolation
from bumpymap.rating.vehicle_profile import load_profile

VEHICLES = {name: load_profile(name).to_dict() for name in ("warthog", "small_rover", "car")}
OPERATORS = {name: RideOperator.of(vehicle, 3.0, 15) for name, vehicle in VEHICLES.items()}


def patches(seed, count=6, sd=0.1):
    relief = np.random.default_rng(seed).normal(0.0, sd, (count, 15, 15))
    relief -= relief.mean(axis=(1, 2), keepdims=True)
    return relief.astype(np.float32)


def envelope_by_scipy(patch, operator, radius):
    """Grey dilation of the bilinear nodes, mirrored far enough on all sides."""
    grid = interpolation(15, operator.fine)
    nodes = grid @ patch.astype(np.float64) @ grid.T
    step = 3.0 / (15 * operator.fine)
    reach = int(radius / step + 1e-9)
    away = np.arange(-reach, reach + 1) * step
    square = away[:, None] ** 2 + away[None, :] ** 2
    under = square <= radius**2 * (1 + 1e-9)
    cap = np.sqrt(np.maximum(radius**2 - square, 0)) - radius
    wide = np.pad(nodes, reach, mode="reflect")
    rolled = grey_dilation(wide, footprint=under, structure=np.where(under, cap, 0.0))
    return rolled[reach:-reach, reach:-reach], step


@pytest.mark.parametrize("name", ["warthog", "small_rover"])
def test_pitch_change_is_what_a_slow_walk_over_the_envelope_gives(name):
    operator, vehicle = OPERATORS[name], VEHICLES[name]
    patch = patches(1, 1)[0]
    envelope, step = envelope_by_scipy(patch, operator, vehicle["wheel"]["radius_m"])
    rng = np.random.default_rng(2)
    x, y, heading = rng.uniform(0, 3, 4000), rng.uniform(0, 3, 4000), rng.uniform(0, 2 * np.pi, 4000)
    taps = chassis_response(vehicle, step / 2)

    def pitch(back):
        total = 0.0
        for forward in (1, -1):
            for left in (1, -1):
                along, beside = forward * vehicle["wheelbase_m"] / 2 - back, left * vehicle["track_m"] / 2
                east = x + np.cos(heading) * along - np.sin(heading) * beside
                north = y + np.sin(heading) * along + np.cos(heading) * beside
                total = total + forward * map_coordinates(envelope, [north / step, east / step], order=1, mode="mirror")
        return total / (2 * vehicle["wheelbase_m"])

    change = sum(tap * (pitch(step / 2 * i) - pitch(step / 2 * (i + 1))) for i, tap in enumerate(taps)) / (step / 2)
    slow = np.abs(change)
    error = slow.std() / np.sqrt(len(slow))
    quick = roll_over(patch[None], operator).pitch_change[0]
    assert quick == pytest.approx(slow.mean(), abs=4 * error + 0.03 * slow.mean())


@given(st.integers(0, 10_000), st.sampled_from(sorted(OPERATORS)))
@settings(max_examples=15, deadline=None)
def test_turning_and_mirroring_a_patch_changes_nothing(seed, name):
    patch = patches(seed, 2)
    rides = roll_over(patch, OPERATORS[name])
    for other in (np.rot90(patch, 1, (1, 2)), patch[:, ::-1], patch[:, :, ::-1], patch.transpose(0, 2, 1)):
        turned = roll_over(np.ascontiguousarray(other), OPERATORS[name])
        assert turned.pitch_change == pytest.approx(rides.pitch_change, rel=1e-4)
        assert turned.roll == pytest.approx(rides.roll, rel=1e-3)


@given(st.integers(0, 10_000), st.integers(1, 40))
@settings(max_examples=15, deadline=None)
def test_a_patch_gets_the_same_bits_alone_and_among_others(seed, count):
    many = patches(seed, count)
    many[::5] = np.nan
    together = roll_over(many, OPERATORS["warthog"])
    for i in range(0, count, 3):
        alone = roll_over(many[i : i + 1], OPERATORS["warthog"])
        for each in fields(Rides):
            assert np.array_equal(getattr(alone, each.name), getattr(together, each.name)[i : i + 1], equal_nan=True)


def test_heights_of_a_patch_are_measured():
    many = patches(5, 4)
    rides = roll_over(many, OPERATORS["warthog"])
    for patch, span, change in zip(many.astype(np.float64), rides.height_range, rides.height_change, strict=True):
        sizes = [abs(patch[2:] - patch[:-2]).ravel(), abs(patch[:, 2:] - patch[:, :-2]).ravel()]
        assert span == pytest.approx(patch.max() - patch.min())
        assert change == pytest.approx(np.concatenate(sizes).mean(), rel=1e-6)


def test_a_patch_with_nan_is_left_out():
    patch = patches(3, 2)
    patch[1, 4, 4] = np.nan
    rides = roll_over(patch, OPERATORS["warthog"])
    assert np.isfinite(rides.pitch_change[0])
    assert np.isnan(rides.pitch_change[1])


def test_long_gentle_waves_agree_with_the_closed_form():
    """A half cosine across the patch is mirrored into an endless wave of 6 m; DESIGN 7 has its C_r along the wave."""
    amplitude, length = 0.01, 6.0
    wave = amplitude * np.cos(np.pi * (np.arange(15) + 0.5) / 15)
    patch = np.broadcast_to(wave, (15, 15)).astype(np.float32)[None]
    vehicle = VEHICLES["warthog"]
    base, track = vehicle["wheelbase_m"], vehicle["track_m"]
    angle = (np.arange(4000) + 0.5) / 4000 * 2 * np.pi
    k = 2 * np.pi / length
    along, beside = np.cos(angle), np.sin(angle)
    # Mean over phases of |2/W A sin(k W/2 cos) cos(k T/2 sin) k cos sin(phase)|; the mean of |sin| is 2 / pi.
    size = amplitude * 2 / base * np.sin(k * base / 2 * along) * np.cos(k * track / 2 * beside) * k * along
    expected = np.mean(np.abs(size)) * 2 / np.pi
    assert roll_over(patch, OPERATORS["warthog"]).pitch_change[0] == pytest.approx(expected, rel=0.05)
