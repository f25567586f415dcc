"""True motions against closed forms."""

import math

import numpy as np
import pytest
from sensed_drives import GRAVITY, TrueDrive, read_motion, save_motion

from bumpymap.core import BadInputError


def test_a_vehicle_at_rest_on_a_slope_feels_gravity_turned_by_the_slope(standing):
    felt = standing(pitch=math.radians(10)).specific_force((0.3, 0.1, 0.5))
    assert felt == pytest.approx(
        np.tile([-GRAVITY * math.sin(math.radians(10)), 0, GRAVITY * math.cos(math.radians(10))], (len(felt), 1))
    )


@pytest.mark.parametrize("ahead", [0.0, 0.4])
def test_a_circle_gives_the_centripetal_acceleration_at_the_sensor(circle, ahead):
    drive = circle(speed=2.0, turn=0.5)
    felt = drive.specific_force((ahead, 0.0, 0.0))[1:-1]
    assert felt[:, 1] == pytest.approx(2.0 * 0.5, rel=1e-5)
    assert felt[:, 0] == pytest.approx(-ahead * 0.5**2, abs=1e-5)
    assert felt[:, 2] == pytest.approx(GRAVITY)


def test_ride_is_pitch_motion_over_way(circle):
    drive = circle(speed=2.0, turn=0.5, pitch_rate=-0.3)
    way, c_r = drive.ride(np.array([1.0, 2.0]), np.array([2.0, 5.0]))
    assert way == pytest.approx([2.0, 6.0], rel=1e-5)
    assert c_r == pytest.approx(0.15, rel=1e-5)


def test_ride_of_a_standstill_is_unknown(standing):
    way, c_r = standing().ride(np.array([1.0]), np.array([2.0]))
    assert way == 0
    assert np.isnan(c_r).all()


def test_a_sensor_ahead_on_a_vehicle_that_heads_north_is_north_of_it(standing):
    drive = standing(yaw=math.pi / 2)
    assert drive.place_of((0.5, 0.2, 1.0))[0] - drive.place[0] == pytest.approx([-0.2, 0.5, 1.0])


def test_a_motion_is_kept_in_a_file(circle, tmp_path):
    drive = circle(speed=2.0, turn=0.5)
    save_motion(drive, tmp_path / "drive.npz")
    again = read_motion(tmp_path / "drive.npz")
    assert again.rate_hz == drive.rate_hz
    assert (again.place == drive.place).all()
    for name in ("rotation", "rates", "velocity", "wheels"):
        assert getattr(again, name) == pytest.approx(getattr(drive, name), abs=1e-6)
    assert [path.name for path in tmp_path.iterdir()] == ["drive.npz"]


def test_another_file_is_refused(tmp_path):
    np.savez(tmp_path / "other.npz", heights=np.zeros(3))
    for name in ("other.npz", "none.npz"):
        with pytest.raises(BadInputError, match=f"{name} is not a recorded motion.*record the drive again"):
            read_motion(tmp_path / name)


def test_pitch_motion_is_summed_at_100_hz_as_in_a_calibration(circle):
    rng = np.random.default_rng(1)
    drive = circle(speed=1.0, turn=0.0)
    rates = rng.standard_normal(drive.rates.shape)
    shaken = TrueDrive(drive.rate_hz, drive.place, drive.rotation, rates, drive.velocity, drive.wheels)
    _, _, pitched = shaken.sampled
    every = np.abs(rates[::5, 1])
    assert pitched[-1] == pytest.approx(np.trapezoid(every) / 100)
