"""Drives along ways: of a made-up vehicle whose motion is known, and in DART over ground with a closed form."""

import json
import math
from dataclasses import asdict

import numpy as np
import pytest
from driven_ways import GuideLine, ReliefGround, Stop, WayDrive, drive_way, follow_guide

from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.jobs import sine_c_r
from bumpymap.lab.simulate.model import Pose
from bumpymap.rating.vehicle_profile import load_profile

PROFILE = load_profile("warthog")
SETTINGS = DriveSettings(settle_s=0.1, ramp_s=0.2, cruise_s=0.1)
GUIDE = GuideLine.along(np.array([[3.0, 4.0], [9.0, 4.0], [9.0, 12.0], [14.0, 12.0]]))


class RollingVehicle:
    """Goes where its wheels push it from the start of the guide; pitches and tilts as functions of the time say."""

    def __init__(self, pitch_rate=lambda _t: 0.0, tilt=lambda _t: 0.0, grip=lambda _t: 1.0):
        self.pitch_rate, self.tilt, self.grip = pitch_rate, tilt, grip
        self.time, self.heading = 0.0, GUIDE.heading
        self.easting, self.northing = GUIDE.points[0].tolist()
        self.speeds = (0.0, 0.0)

    def command(self, left_mps, right_mps):
        self.speeds = left_mps, right_mps

    def advance(self, steps):
        seconds = steps * SETTINGS.physics.time_step
        self.time += seconds
        left, right = self.speeds
        self.heading += (right - left) / PROFILE.track_m * seconds
        speed = (left + right) / 2 * self.grip(self.time)
        self.easting += speed * math.cos(self.heading) * seconds
        self.northing += speed * math.sin(self.heading) * seconds

    def pose(self):
        return Pose(self.easting, self.northing, self.heading, self.tilt(self.time), self.pitch_rate(self.time))


def follow(**motion):
    return follow_guide(RollingVehicle(**motion), GUIDE, PROFILE, 3.0, SETTINGS)


def test_a_way_with_corners_is_driven_to_its_end():
    made = follow(pitch_rate=lambda _t: -0.2)
    assert made.outcome == "completed"
    assert made.reached_m == pytest.approx(19.0)
    assert made.aside_m < 0.45
    assert 17.8 < made.path_m < 18.8  # corners are cut a little, and the first 0.2 m are not measured
    # Pitch per time over path: the vehicle is slower in its turns.
    assert made.pitched_rad == pytest.approx(0.2 * (made.seconds - 0.4), rel=0.01)
    assert 0 < made.turning_m < 6
    assert made.turning_rad > 0.2 * made.turning_m


def test_it_stands_at_its_stops_and_then_drives_on():
    stops = (Stop(3.0, 2.0), Stop(9.0, 12.0))
    made = follow_guide(RollingVehicle(), GUIDE, PROFILE, 3.0, SETTINGS, stops)
    plain = follow()
    assert made.outcome == "completed"
    # Braking and speeding up again take 0.1 s each beyond the drive without stops.
    assert made.seconds - plain.seconds == pytest.approx(2.0 + 12.0 + 2 * 0.2, abs=0.25)
    assert made.path_m == pytest.approx(plain.path_m, rel=0.01)


def test_pitch_and_path_are_summed_by_tile():
    made = follow(pitch_rate=lambda t: 0.1 + 0.05 * math.sin(t))
    assert math.fsum(tile[2] for tile in made.tiles) == pytest.approx(made.path_m)
    assert math.fsum(tile[3] for tile in made.tiles) == pytest.approx(made.pitched_rad)
    assert {tile[:2] for tile in made.tiles} >= {(1, 1), (2, 1), (3, 2), (3, 3), (4, 4)}


def test_pitch_before_the_measurement_does_not_count():
    assert follow(pitch_rate=lambda t: 9.0 if t < 0.39 else 0.0).c_r == 0.0


def test_a_vehicle_that_slips_is_stuck_and_has_no_c_r():
    made = follow(grip=lambda t: 1.0 if t < 5 else 0.0)
    assert made.outcome == "stuck"
    assert 4 < made.reached_m < 5
    assert made.seconds < 16
    assert math.isnan(made.c_r)


def test_a_vehicle_that_tips_is_rolled():
    made = follow(tilt=lambda t: math.radians(61) if t > 3 else 0.0)
    assert made.outcome == "rolled"
    assert made.seconds == pytest.approx(3.0, abs=0.02)


def test_a_drive_is_read_back_from_its_record():
    made = follow(pitch_rate=lambda _t: 0.1)
    assert WayDrive.from_record(json.loads(json.dumps(asdict(made)))) == made


def waves(amplitude, wavelength):
    """Sine waves along the easting, 60 m by 12 m, north row first."""
    east = (np.arange(300) + 0.5) * 0.2
    return ReliefGround.from_heightmap(np.tile(amplitude * np.sin(2 * np.pi / wavelength * east), (60, 1)), 0.2)


@pytest.fixture(scope="module")
def _dart():
    pytest.importorskip("dartpy")


@pytest.mark.slow
@pytest.mark.usefixtures("_dart")
class TestInDart:
    def test_level_ground_does_not_shake_not_even_round_corners(self):
        ground = ReliefGround.from_heightmap(np.full((60, 300), 100.0), 0.2)
        made = drive_way(PROFILE, ground, np.array([[3.0, 3.0], [10.0, 3.0], [10.0, 9.0], [14.0, 5.0]]), 3.0)
        assert made.outcome == "completed"
        assert made.aside_m < 0.6
        assert made.c_r < 0.002

    def test_sine_waves_along_the_way_give_the_closed_form(self):
        made = drive_way(PROFILE, waves(0.02, 3.0), np.array([[3.0, 6.0], [34.9, 6.0]]), 3.0, offset=0.1)
        assert made.c_r == pytest.approx(sine_c_r(PROFILE, 0.02, 3.0), rel=0.05)
        again = drive_way(PROFILE, waves(0.02, 3.0), np.array([[3.0, 6.0], [34.9, 6.0]]), 3.0, offset=0.1)
        assert again == made

    def test_a_wall_across_the_way_stops_it_and_a_wall_beside_does_not(self):
        heights = np.zeros((60, 150))
        heights[:30, 75:] = 1.2
        ground = ReliefGround.from_heightmap(heights, 0.2)
        assert drive_way(PROFILE, ground, np.array([[3.0, 9.0], [25.0, 9.0]]), 3.0).outcome != "completed"
        assert drive_way(PROFILE, ground, np.array([[3.0, 9.0], [9.0, 4.0], [25.0, 4.0]]), 3.0).outcome == "completed"
