"""The drives of BorealTC, a real robot's: IMU and wheel speeds in two files each."""

import numpy as np
import pytest

from bumpymap.readers import read_drive

pytestmark = pytest.mark.realdata


def test_every_drive_is_read_without_naming_columns(shared_data):
    folder = shared_data / "drives" / "borealtc"
    files = sorted(folder.glob("*/imu_*.csv"))
    if not files:
        pytest.skip("../shared/data/drives/borealtc is not here")
    for imu in files:
        log = read_drive(f"{imu},{imu.with_name(imu.name.replace('imu', 'pro'))}")
        rows = np.loadtxt(imu, delimiter=",", skiprows=1)
        np.testing.assert_array_equal(log.imu.time, rows[:, 0])
        np.testing.assert_array_equal(log.imu.rate, rows[:, 1:4])
        np.testing.assert_array_equal(log.imu.acceleration, rows[:, 4:])
        assert 8.0 < np.median(np.linalg.norm(log.imu.acceleration, axis=1)) < 11.5
        assert log.places is None
        assert np.isfinite(log.wheels.difference).all()
        assert len(log.notes) == 1  # the unit of the rates
