"""Simulated drives: motion in DART against closed forms, sensors whose faults have the size they are said to have."""

import numpy as np
import pytest
from driven_ways import RecordSettings, ReliefGround, Stop, record_way
from known_grounds import sine_c_r
from pyproj import Transformer
from scipy.spatial.transform import Rotation
from sensed_drives import (
    GRAVITY,
    START_S,
    DriveSensors,
    TrueDrive,
    mount_rotation,
    sense_drive,
    write_drive_files,
)

from bumpymap.rating.vehicle_profile import load_profile

PROFILE = load_profile("warthog")
RATE_HZ = 500.0
ORIGIN = np.array([480_000.0, 2_136_000.0, 2300.0])


def circle(speed, turn, seconds=20.0, pitch_rate=0.0):
    """A drive in a level circle, or straight to the east; ``pitch_rate`` is only what the sensor says."""
    time = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    heading = turn * time
    place = np.stack([speed * time, 0 * time, 0 * time], axis=1)
    if turn:
        place = speed / turn * np.stack([np.sin(heading), 1 - np.cos(heading), 0 * time], axis=1)
    rates, velocity = np.tile([0.0, pitch_rate, turn], (len(time), 1)), np.tile([speed, 0.0, 0.0], (len(time), 1))
    rotation = Rotation.from_euler("Z", heading[:, None]).as_matrix()
    return TrueDrive(RATE_HZ, place + ORIGIN, rotation, rates, velocity)


def sensed(drive, seed=1, **faults):
    return sense_drive(drive, DriveSensors(**faults), seed)


@pytest.mark.slow
def test_a_recorded_drive_stands_stops_and_shakes_as_the_closed_form_says():
    pytest.importorskip("dartpy")
    east = (np.arange(200) + 0.5) * 0.2
    waves = ReliefGround.from_heightmap(np.tile(0.02 * np.sin(2 * np.pi * east / 3), (30, 1)), 0.2)
    settings = RecordSettings(stand_before_s=2.0, stand_after_s=1.0, stops=(Stop(15.0, 1.5),))
    result, motion = record_way(PROFILE, waves, np.array([[3.0, 3.0], [33.0, 3.0]]), settings)
    assert result.outcome == "completed"
    assert result.c_r == pytest.approx(sine_c_r(PROFILE, 0.02, 3.0), rel=0.1)
    still = np.linalg.norm(motion.velocity, axis=1) < 0.02
    changes = np.flatnonzero(np.diff(still.astype(int)))
    assert len(changes) == 4  # starts, stops, starts again, stops
    assert 1.3 < (changes[2] - changes[1]) / motion.rate_hz < 2.5
    felt = motion.specific_force[200:800]
    assert np.linalg.norm(felt, axis=1) == pytest.approx(GRAVITY, abs=0.02)
    moved = np.einsum("nij,nj->ni", motion.rotation, motion.velocity)[1:] / motion.rate_hz
    assert np.diff(motion.place, axis=0) == pytest.approx(moved, abs=1e-7)
    small = np.einsum("nji,njk->nik", motion.rotation[:-1], motion.rotation[1:])
    assert small[:, 0, 2] == pytest.approx(motion.rates[1:, 1] / motion.rate_hz, abs=2e-6)


def test_perfect_sensors_read_the_motion_and_a_mounting_turns_it():
    drive = circle(speed=1.5, turn=0.3, pitch_rate=0.2)
    found = sensed(drive)
    imu, places = found.imu, found.places
    assert imu.rate == pytest.approx(np.tile([0, 0.2, 0.3], (len(imu.time), 1)), abs=1e-9)
    assert imu.acceleration[5:-5] == pytest.approx(np.tile([0, 0.45, GRAVITY], (len(imu.time) - 10, 1)), abs=1e-4)
    at = places.time - START_S
    assert places.x == pytest.approx(np.interp(at, drive.time, drive.place[:, 0]), abs=1e-3)
    turned = sensed(drive, mount_deg=(3.0, -5.0, 4.0)).imu
    assert turned.rate @ mount_rotation((3.0, -5.0, 4.0)).T == pytest.approx(imu.rate)


def test_files_hold_the_log(tmp_path):
    log = sense_drive(circle(speed=1.0, turn=0.5), DriveSensors(), 1, "lap", "EPSG:32614")
    still = sense_drive(circle(0.0, 0.0), DriveSensors(), 1, crs="EPSG:32614").places
    back = Transformer.from_crs("EPSG:4326", "EPSG:32614", always_xy=True).transform(still.x[0], still.y[0])
    assert back == pytest.approx((480_000.0, 2_136_000.0), abs=1e-3)
    imu, gnss = write_drive_files(log, tmp_path)
    assert (imu.name, gnss.name) == ("lap_imu.csv", "lap_gnss.csv")
    held = np.loadtxt(imu, delimiter=",", skiprows=1)
    assert held[:, :4] == pytest.approx(np.column_stack([log.imu.time, log.imu.rate]), abs=1e-6)
    assert np.loadtxt(gnss, delimiter=",", skiprows=1)[:, 1] == pytest.approx(log.places.x, abs=1e-9)
