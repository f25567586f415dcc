"""When a vehicle stands: wheels that turn are no standstill, however quiet the ground is."""

import made_drives
import numpy as np
import pytest

from bumpymap.check.measure import find_standing, rough_speed
from bumpymap.check.places import metre_places
from bumpymap.check.signals import even_imu
from bumpymap.core import WheelTrack


def wheels_of(made: made_drives.MadeDrive, *, on_the_spot: bool = False) -> WheelTrack:
    """Return wheel speeds at 5 Hz; on the spot, the sides turn against each other."""
    time, speed, *_ = made_drives.motion(made)
    nothing = np.zeros(len(time[::20]))
    return WheelTrack(time[::20], *((nothing, 2 * speed[::20]) if on_the_spot else (speed[::20], nothing)))


@pytest.mark.parametrize("on_the_spot", [False, True])
def test_slow_driving_over_even_ground_is_no_standstill(on_the_spot):
    made = made_drives.MadeDrive(amplitude=0.002, speed=0.1, seconds=60.0, noise=0.01, turning=0.0)
    log, *_ = made_drives.log_of(made)
    imu = even_imu(log.imu, "slow", 10.0)
    standing = find_standing(imu, rough_speed(imu, None, wheels_of(made, on_the_spot=on_the_spot)), 10.0)
    driven = (imu.time > made.stand + 1.0) & (imu.time < made.seconds - made.stand / 2 - 1.0)
    assert not standing[driven].any()
    assert standing[imu.time < made.stand - 1.0].mean() > 0.8


def test_without_wheels_positions_tell():
    made = made_drives.MadeDrive(seconds=60.0, noise=0.01, place_white=0.015)
    log, *_ = made_drives.log_of(made)
    imu = even_imu(log.imu, "made", 10.0)
    places = metre_places(log.places, log.places.x, log.places.y, log.name)
    standing = find_standing(imu, rough_speed(imu, places, None), 10.0)
    assert standing[imu.time < made.stand - 1.0].mean() > 0.8
    assert not standing[(imu.time > made.stand + 2.0) & (imu.time < 50.0)].any()
    lost = WheelTrack(*np.full((3, 3), np.nan))
    assert np.array_equal(standing, find_standing(imu, rough_speed(imu, places, lost), 10.0))
