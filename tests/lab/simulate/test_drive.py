"""Drives of a made-up vehicle whose motion is known: what is measured, when it counts, when a drive has failed."""

import math

import pytest

from bumpymap.core.errors import UsageError
from bumpymap.lab.simulate.drive import DriveSettings, follow
from bumpymap.lab.simulate.model import Physics, Pose
from bumpymap.lab.simulate.terrain import Strip
from bumpymap.rating.vehicle_profile import load_profile

pytestmark = pytest.mark.slow

PROFILE = load_profile("warthog")
SETTINGS = DriveSettings(settle_s=0.1, ramp_s=0.2, cruise_s=0.1, measure_s=2.0)
STRIP = Strip(3.0, 4.0, 0.5, 10.0, 3.0)


class KinematicVehicle:
    """Goes where its wheels push it, and pitches and tilts as it is told by functions of the time."""

    def __init__(self, pitch_rate=lambda _t: 0.0, tilt=lambda _t: 0.0, grip=lambda _t: 1.0, drift=0.0, beside=0.0):
        self.pitch_rate, self.tilt, self.grip, self.drift = pitch_rate, tilt, grip, drift
        self.time, self.heading = 0.0, STRIP.heading
        self.easting = STRIP.easting - beside * math.sin(STRIP.heading)
        self.northing = STRIP.northing + beside * math.cos(STRIP.heading)
        self.commands = []

    def command(self, left_mps, right_mps):
        self.commands.append((left_mps, right_mps))

    def advance(self, steps):
        seconds = steps * SETTINGS.physics.time_step
        self.time += seconds
        left, right = self.commands[-1]
        self.heading += (right - left) / PROFILE.track_m * seconds
        speed = (left + right) / 2 * self.grip(self.time)
        self.easting += (speed * math.cos(self.heading) - self.drift * math.sin(STRIP.heading)) * seconds
        self.northing += (speed * math.sin(self.heading) + self.drift * math.cos(STRIP.heading)) * seconds

    def pose(self):
        return Pose(self.easting, self.northing, self.heading, self.tilt(self.time), self.pitch_rate(self.time))


def run(**motion):
    vehicle = KinematicVehicle(**motion)
    return vehicle, follow(vehicle, STRIP, PROFILE, SETTINGS)


def test_c_r_is_the_pitch_per_metre():
    _, drive = run(pitch_rate=lambda _t: -0.25)
    assert drive.outcome == "completed"
    assert drive.c_r == pytest.approx(0.25, rel=1e-9)
    assert drive.path_m == pytest.approx(2.0, rel=1e-9)
    assert drive.progress_m == pytest.approx(2.0, rel=1e-9)
    _, aslant = run(pitch_rate=lambda _t: -0.25, beside=0.5)  # of the metres of its path, not of its line
    assert aslant.path_m > 1.001 * aslant.progress_m
    assert aslant.c_r * aslant.path_m == pytest.approx(0.25 * 2.0, rel=1e-9)


def test_pitch_before_the_measurement_does_not_count():
    _, drive = run(pitch_rate=lambda t: 9.0 if t < 0.399 else 0.0)
    assert drive.c_r == 0.0


def test_slow_vehicle_is_stuck_below_a_fifth_of_its_way():
    _, stuck = run(grip=lambda _t: 0.19, pitch_rate=lambda _t: 1.0)
    assert stuck.outcome == "stuck"
    assert math.isnan(stuck.c_r)
    assert run(grip=lambda _t: 0.21)[1].outcome == "completed"


def test_vehicle_past_sixty_degrees_has_rolled_over_at_any_time():
    assert run(tilt=lambda t: math.radians(61) if t > 1.5 else 0.0)[1].outcome == "rolled"
    assert run(tilt=lambda t: math.radians(61) if t < 0.05 else 0.0)[1].outcome == "rolled"
    assert run(tilt=lambda _t: math.radians(59))[1].outcome == "completed"


def test_vehicle_beside_its_line_steers_back():
    vehicle, drive = run(beside=0.5)
    assert vehicle.commands[30][0] > vehicle.commands[30][1]  # it is to the left, so it turns right
    east, north = vehicle.easting - STRIP.easting, vehicle.northing - STRIP.northing
    assert abs(north * math.cos(STRIP.heading) - east * math.sin(STRIP.heading)) < 0.35
    assert drive.outcome == "completed"


def test_vehicle_pushed_off_its_line_has_failed():
    assert run(drift=1.2)[1].outcome == "stuck"


def test_time_step_must_divide_the_time_between_samples():
    with pytest.raises(UsageError, match=r"0\.003 s does not divide"):
        DriveSettings(physics=Physics(time_step=0.003))
    assert DriveSettings(physics=Physics(time_step=0.0005)).steps_per_sample == 20
