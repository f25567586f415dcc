"""Drives from bags: which topics are read, what their messages say, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from bags import header, imu, message, odometry, write_bag, write_ros1
from drive_tables import refusal

from bumpymap.core import BadInputError, missing_resource
from bumpymap.readers import close_log_reader, read_drive
from bumpymap.readers.raw_scans import BagReader

T0 = 1_700_000_000_000_000_000
COUNT = 200
RATES = np.random.default_rng(5).normal(0.0, 0.2, (COUNT, 3))
TIMES = np.arange(COUNT) * 0.01


def imus(topic="/imu/data"):
    """Stored 3 ms after they were measured."""
    stamps = [T0 + round(t * 1e9) for t in TIMES]
    return [(topic, stamp + 3_000_000, imu(stamp, rate)) for stamp, rate in zip(stamps, RATES, strict=True)]


def fixes():
    """10 Hz; the third one without a fix."""
    common = {"latitude": 19.4, "altitude": 2240.0, "position_covariance_type": 2}
    common["position_covariance"] = np.diag([0.02**2, 0.02**2, 1.0]).ravel()
    made = []
    for n, stamp in enumerate(range(T0, T0 + 20 * 10**8, 10**8)):
        status = message("sensor_msgs/msg/NavSatStatus", status=-1 if n == 2 else 0, service=1)
        own = {"header": header(stamp, "gps"), "status": status, "longitude": -99.1 + n * 1e-6}
        made.append(("/fix", stamp, message("sensor_msgs/msg/NavSatFix", **own, **common)))
    return made


def moves():
    made = [
        odometry(T0 + n * 40_000_000, (Rotation.from_euler("z", 0.1), np.array([n * 0.06, 0, 0]))) for n in range(50)
    ]
    for each in made:
        each.twist.twist.linear.x = 1.5
    return [("/odom", T0 + n * 40_000_000, each) for n, each in enumerate(made)]


def bag(tmp_path, *parts, name="drive", **how):
    messages = sorted((each for part in parts for each in part), key=lambda each: each[1])
    return str(write_bag(tmp_path / name, messages, **how))


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_imu_gnss_and_odometry(tmp_path, storage):
    log = read_drive(bag(tmp_path, imus(), fixes(), moves(), storage=storage))
    np.testing.assert_allclose(log.imu.time - T0 * 1e-9, TIMES, atol=1e-6)
    np.testing.assert_array_equal(log.imu.rate, RATES)
    np.testing.assert_array_equal(log.imu.acceleration[7], [0.1, 0.2, 9.8])
    assert log.places.kind == "lonlat"
    assert len(log.places.time) == 19
    np.testing.assert_allclose(log.places.error, 0.02)
    np.testing.assert_allclose(log.places.x[:3], [-99.1, -99.1 + 1e-6, -99.1 + 3e-6])
    np.testing.assert_array_equal(log.wheels.speed, 1.5)
    assert np.isnan(log.wheels.difference).all()
    assert dict(log.columns) == {"imu": "/imu/data", "gnss": "/fix", "odometry": "/odom"}
    assert any("1 of 20 positions of /fix were taken without a fix" in note for note in log.notes)


def test_several_bags_are_one_drive_and_odometry_alone_gives_a_way_without_a_place(tmp_path):
    log = read_drive(f"{bag(tmp_path, imus()[:120], moves(), name='a')},{bag(tmp_path, imus()[120:], name='b')}")
    np.testing.assert_array_equal(log.imu.rate, RATES)
    assert log.places.kind == "local"
    np.testing.assert_allclose(log.places.x, np.arange(50) * 0.06)


def test_of_several_topics_one_is_named(tmp_path):
    place = bag(tmp_path, imus(), imus("/camera/imu"), fixes())
    text = refusal(place)
    both = "/camera/imu (200 messages), /imu/data (200 messages)"
    assert both in text
    assert "`columns='imu=/camera/imu'`" in text
    assert read_drive(place, {"imu": "/camera/imu"}).columns["imu"] == "/camera/imu"
    assert both in refusal(place, {"imu": "/fix"})
    assert read_drive(place, {"imu": "/imu/data", "gnss": ""}).places is None


def test_messages_that_arrive_late_are_sorted_by_their_stamps(tmp_path):
    messages = imus()
    (topic, first, one), (_, second, other) = messages[50:52]
    messages[50:52] = (topic, second, one), (topic, first, other)
    log = read_drive(bag(tmp_path, messages))
    np.testing.assert_array_equal(log.imu.rate, RATES)
    assert any("sorted by their stamps" in note for note in log.notes)


def test_orientations_stand_in_for_rates(tmp_path):
    turns = Rotation.from_euler("y", 0.1 * np.sin(3.0 * TIMES)[:, None]).as_quat()
    stamps = [T0 + round(t * 1e9) for t in TIMES]
    made = [("/imu", t, imu(t, (0, 0, 0), has_rate=False, turn=turn)) for t, turn in zip(stamps, turns, strict=True)]
    log = read_drive(bag(tmp_path, made))
    np.testing.assert_allclose(log.imu.rate[:, 1], 0.3 * np.cos(3.0 * (log.imu.time - T0 * 1e-9)), atol=1e-3)


@pytest.mark.parametrize("read", [read_drive, lambda path: BagReader(Path(path))])
def test_a_wrong_length_in_a_bag_is_no_lack_of_memory(tmp_path, read):
    file = next(Path(bag(tmp_path, imus())).glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(data[:9] + (1 << 40).to_bytes(8, "little") + data[17:])
    with pytest.raises(BadInputError, match=r"cannot read the bag .*\.mcap") as caught:
        read(str(file))
    assert not missing_resource(caught.value)


def test_a_bag_of_ros_1(tmp_path):
    stamps = [T0 + round(t * 1e9) for t in TIMES]
    write_ros1(tmp_path / "drive.bag", zip([stamp + 3_000_000 for stamp in stamps], stamps, RATES, strict=True))
    log = read_drive(str(tmp_path / "drive.bag"))
    np.testing.assert_array_equal(log.imu.rate, RATES)
    np.testing.assert_allclose(log.imu.time - T0 * 1e-9, TIMES, atol=1e-6)
    (tmp_path / "cut.bag").write_bytes((tmp_path / "drive.bag").read_bytes()[:5000])
    assert "cannot read the bag" in refusal(tmp_path / "cut.bag")


def test_a_log_that_says_nothing_of_motion_says_what_it_holds(tmp_path):
    text = refusal(bag(tmp_path, fixes()))
    assert "neither angular rates nor attitudes" in text
    assert "/fix (sensor_msgs/msg/NavSatFix)" in text


def test_a_log_that_takes_too_long_is_refused_and_the_next_is_read(tmp_path, monkeypatch):
    place = bag(tmp_path, imus())
    close_log_reader()
    monkeypatch.setattr("bumpymap.readers.drives.SECONDS", 1e-3)
    monkeypatch.setattr("bumpymap.readers.drives.SECONDS_PER_BYTE", 0.0)
    with pytest.raises(BadInputError, match=r"the decoder did not finish.*damaged"):
        read_drive(place)
    monkeypatch.undo()
    assert len(read_drive(place).imu.time) == COUNT
