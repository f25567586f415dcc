"""Drives that record roll and vertical motion: closed forms on waves, a filter of scipy, repetition."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from known_grounds import PlaneGround, SineGround

from bumpymap.lab.simulate.drive import DriveSettings, Start
from bumpymap.lab.simulate.motion_fit import drive_motion, weighted_acceleration
from bumpymap.rating import felt_response, load_profile

WARTHOG = load_profile("warthog")
BASE, TRACK, HEIGHT_M = WARTHOG.wheelbase_m, WARTHOG.track_m, 0.01
SHORT = DriveSettings(measure_s=5.0)


@dataclass(frozen=True)
class FineWaves(SineGround):
    """Waves whose facets pass faster than 10 Hz."""

    spacing: float = 0.02


@pytest.mark.parametrize("frequency", [0.5, 4.0, 9.0])
def test_a_steady_sine_is_weighed_by_the_response(frequency):
    step = 0.002
    seconds = np.arange(0, 20, step)
    lift = 0.01 * np.sin(2 * np.pi * frequency * seconds)
    felt = weighted_acceleration(np.gradient(lift, step), step)
    late = felt[len(felt) // 2 : -200]
    amplitude = 0.01 * abs(felt_response(np.array([frequency]))[0])
    assert np.sqrt(2 * np.mean(late**2)) == pytest.approx(amplitude, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(("speed", "wavelength"), [(1.0, 0.92), (2.0, 3.0)])
def test_waves_lift_as_the_closed_form_says(speed, wavelength):
    pytest.importorskip("dartpy")
    made = drive_motion(WARTHOG, FineWaves(HEIGHT_M, wavelength), Start(0.0, 0.0, 0.0), speed, SHORT)
    lift = HEIGHT_M * math.cos(math.pi * BASE / wavelength) * felt_response(np.array([speed / wavelength]))[0]
    assert made.a_w == pytest.approx(abs(lift) / math.sqrt(2), rel=0.05)


@pytest.mark.slow
def test_waves_at_an_angle_roll_and_pitch_as_the_closed_forms_say():
    pytest.importorskip("dartpy")
    turn, wavelength = math.radians(40.0), 3.0
    along, across = math.cos(turn) / wavelength, math.sin(turn) / wavelength
    made = drive_motion(WARTHOG, FineWaves(HEIGHT_M, wavelength), Start(0.0, 0.0, turn), 2.0, SHORT)
    pitch = math.sin(math.pi * BASE * along) * math.cos(math.pi * TRACK * across) / BASE
    roll = math.cos(math.pi * BASE * along) * math.sin(math.pi * TRACK * across) / TRACK
    assert made.c_r == pytest.approx(8 * HEIGHT_M * along * pitch, rel=0.05)
    assert made.c_roll == pytest.approx(8 * HEIGHT_M * along * roll, rel=0.05)


@pytest.mark.slow
def test_a_plane_is_hardly_felt_and_a_drive_repeats():
    pytest.importorskip("dartpy")
    made, again = (drive_motion(WARTHOG, PlaneGround((0.1, 0.0)), Start(0.0, 0.0, 0.5), 1.0, SHORT) for _ in range(2))
    assert made == again
    assert max(made.c_r, made.c_roll) < 0.001
    assert made.a_w < 0.01
