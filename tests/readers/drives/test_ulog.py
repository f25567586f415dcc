"""Drives from ULog: topics, units and axes of PX4."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pyulog")

from ulogs import ulog

from bumpymap.core import BadInputError
from bumpymap.readers import read_drive

COUNT = 250
MICROS = 5_000_000 + np.arange(COUNT) * 4000
FLU = np.random.default_rng(2).normal(0.0, 0.2, (COUNT, 3)).astype(np.float32).astype(float)
FRD = FLU * [1, -1, -1]
SENSOR = ["uint64_t timestamp", "float[3] gyro_rad", "float[3] accelerometer_m_s2"]


def sensor():
    """At rest, x forward, y right, z down: the specific force points up, along -z."""
    return SENSOR, [(t, *rate, 0.5, -0.25, -9.75) for t, rate in zip(MICROS.tolist(), FRD, strict=True)]


def fixes(new):
    fields = ["double latitude_deg", "double longitude_deg"] if new else ["int32_t lat", "int32_t lon"]
    scale = (lambda degrees: degrees) if new else (lambda degrees: round(degrees * 1e7))
    rows = [
        (5_000_000 + n * 100_000, scale(19.4 + n * 1e-6), scale(-99.1), 1 if n == 0 else 6, 0.015) for n in range(10)
    ]
    return ["uint64_t timestamp", *fields, "uint8_t fix_type", "float eph"], rows


def write(path, topics, **how):
    path.write_bytes(ulog(topics, **how))
    return str(path)


def refusal(path):
    with pytest.raises(BadInputError) as caught:
        read_drive(str(path))
    return str(caught.value)


@pytest.mark.parametrize("new", [True, False])
@pytest.mark.parametrize("topic", ["vehicle_gps_position", "sensor_gps"])
def test_sensors_and_positions(tmp_path, new, topic):
    log = read_drive(write(tmp_path / "a.ulg", {"sensor_combined": sensor(), topic: fixes(new)}))
    np.testing.assert_allclose(log.imu.time, MICROS * 1e-6)
    np.testing.assert_allclose(log.imu.rate, FLU)
    np.testing.assert_array_equal(log.imu.acceleration[3], [0.5, 0.25, 9.75])
    assert len(log.places.time) == 9
    np.testing.assert_allclose(log.places.y, 19.4 + np.arange(1, 10) * 1e-6, atol=1e-9)
    np.testing.assert_allclose(log.places.error, 0.015, rtol=1e-6)
    assert log.columns["imu"] == "sensor_combined"
    assert any("turned into x forward, y left, z up" in note for note in log.notes)


def test_the_first_of_several_sensors_and_the_estimated_way(tmp_path):
    topics = {
        "vehicle_angular_velocity:1": (
            ["uint64_t timestamp", "float[3] xyz"],
            [(t, 9.0, 9.0, 9.0) for t in MICROS.tolist()],
        ),
        "vehicle_angular_velocity": (
            ["uint64_t timestamp", "float[3] xyz"],
            [(t, *rate) for t, rate in zip(MICROS.tolist(), FRD, strict=True)],
        ),
        "vehicle_acceleration": (
            ["uint64_t timestamp", "float[3] xyz"],
            [(t, 0.0, 0.0, -9.75) for t in MICROS.tolist()],
        ),
        "vehicle_local_position": (
            ["uint64_t timestamp", "float x", "float y", "bool xy_valid"],
            [(t, 0.01 * n, 5.0, n >= 10) for n, t in enumerate(MICROS.tolist())],
        ),
    }
    log = read_drive(write(tmp_path / "a.ulg", topics, dropouts=(120, 80)))
    np.testing.assert_allclose(log.imu.rate, FLU)
    np.testing.assert_array_equal(log.imu.acceleration[:, 2], 9.75)
    assert log.places.kind == "local"
    assert len(log.places.time) == COUNT - 10
    np.testing.assert_allclose(log.places.x, 5.0)  # east
    np.testing.assert_allclose(log.places.y, 0.01 * np.arange(10, COUNT), rtol=1e-6)  # north
    assert any("dropped out 2 times, for 0.2 s in all" in note for note in log.notes)


def test_rates_of_attitudes_are_about_the_same_axes(tmp_path):
    time = MICROS * 1e-6
    # x forward, y right, z down in north, east, down: nose up is a positive turn about y
    turn = Rotation.from_euler("ZY", np.stack([0.3 + 0 * time, 0.1 * np.sin(2 * time)], 1)).as_quat()
    rows = [(t, q[3], *q[:3]) for t, q in zip(MICROS.tolist(), turn, strict=True)]
    log = read_drive(write(tmp_path / "a.ulg", {"vehicle_attitude": (["uint64_t timestamp", "float[4] q"], rows)}))
    # x forward, y left, z up: nose up is a negative one
    np.testing.assert_allclose(log.imu.rate[:, 1], -0.2 * np.cos(2 * log.imu.time), atol=2e-3)
    np.testing.assert_allclose(log.imu.rate[:, [0, 2]], 0.0, atol=2e-3)


def test_what_is_no_ulog_or_holds_no_drive(tmp_path):
    (tmp_path / "a.ulg").write_bytes(b"time,wx\n")
    assert "no ULog" in refusal(tmp_path / "a.ulg")
    path = write(tmp_path / "b.ulg", {"vehicle_gps_position": fixes(new=True)})
    text = refusal(path)
    assert "neither angular rates nor attitudes" in text
    assert "vehicle_gps_position" in text
    whole = ulog({"sensor_combined": sensor()})
    (tmp_path / "c.ulg").write_bytes(whole[:60])
    refusal(tmp_path / "c.ulg")
    (tmp_path / "d.ulg").write_bytes(whole[: len(whole) // 2])
    assert 20 < len(read_drive(str(tmp_path / "d.ulg")).imu.time) < COUNT
