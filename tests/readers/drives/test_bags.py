"""Drives from bags: which topics are read, what their messages say, what is refused."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from bags import header, imu, message, odometry, write_bag, write_ros1

from bumpymap.core import BadInputError, missing_resource
from bumpymap.readers import read_drive
from bumpymap.readers.frames.raw import BagReader

T0 = 1_700_000_000_000_000_000
COUNT = 200
RATES = np.random.default_rng(5).normal(0.0, 0.2, (COUNT, 3))
TIMES = np.arange(COUNT) * 0.01


def fix(stamp_ns, lon, lat, *, status=0, sd=0.02):
    return message(
        "sensor_msgs/msg/NavSatFix",
        header=header(stamp_ns, "gps"),
        status=message("sensor_msgs/msg/NavSatStatus", status=status, service=1),
        latitude=lat,
        longitude=lon,
        altitude=2240.0,
        position_covariance=np.diag([sd**2, sd**2, 1.0]).ravel(),
        position_covariance_type=2,
    )


def imus(topic="/imu/data", late=3_000_000, **how):
    """Stored some time after they were measured."""
    stamps = T0 + (TIMES * 1e9).round().astype(int)
    return [(topic, int(stamp) + late, imu(int(stamp), rate, **how)) for stamp, rate in zip(stamps, RATES, strict=True)]


def fixes(topic="/fix", count=20):
    """10 Hz; the third one without a fix."""
    return [
        (topic, T0 + n * 10**8, fix(T0 + n * 10**8, -99.1 + n * 1e-6, 19.4, status=-1 if n == 2 else 0))
        for n in range(count)
    ]


def moves(topic="/odom", count=50, speed=1.5):
    made = []
    for n in range(count):
        stamp = T0 + n * 40_000_000
        each = odometry(stamp, (Rotation.from_euler("z", 0.1), np.array([n * 0.06, 0.0, 0.0])))
        each.twist.twist.linear.x = speed
        made.append((topic, stamp, each))
    return made


def by_time(*parts):
    return sorted((each for part in parts for each in part), key=lambda each: each[1])


def refusal(path, columns=None):
    with pytest.raises(BadInputError) as caught:
        read_drive(str(path), columns)
    return str(caught.value)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_imu_gnss_and_odometry(tmp_path, storage):
    log = read_drive(str(write_bag(tmp_path / "drive", by_time(imus(), fixes(), moves()), storage)))
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


def test_several_bags_are_one_drive(tmp_path):
    first = write_bag(tmp_path / "first", by_time(imus()[:120], fixes()))
    rest = write_bag(tmp_path / "rest", imus()[120:])
    log = read_drive(f"{first},{rest}")
    np.testing.assert_array_equal(log.imu.rate, RATES)
    assert len(log.places.time) == 19


def test_odometry_alone_gives_a_way_without_a_place(tmp_path):
    log = read_drive(str(write_bag(tmp_path / "drive", by_time(imus(), moves()))))
    assert log.places.kind == "local"
    np.testing.assert_allclose(log.places.x, np.arange(50) * 0.06)


def test_of_several_topics_one_is_named(tmp_path):
    bag = write_bag(tmp_path / "drive", by_time(imus(), imus("/camera/imu"), fixes()))
    text = refusal(bag)
    assert "/camera/imu, /imu/data" in text
    assert "`columns='imu=/camera/imu'`" in text
    assert read_drive(str(bag), {"imu": "/camera/imu"}).columns["imu"] == "/camera/imu"
    assert "/camera/imu, /imu/data" in refusal(bag, {"imu": "/fix"})
    assert read_drive(str(bag), {"imu": "/imu/data", "gnss": ""}).places is None


def test_messages_that_arrive_late_are_sorted_by_their_stamps(tmp_path):
    messages = imus()
    messages[50], messages[51] = (
        (messages[50][0], messages[51][1], messages[50][2]),
        (messages[51][0], messages[50][1], messages[51][2]),
    )
    log = read_drive(str(write_bag(tmp_path / "drive", by_time(messages))))
    np.testing.assert_array_equal(log.imu.rate, RATES)
    assert any("sorted by their stamps" in note for note in log.notes)


def test_orientations_stand_in_for_rates(tmp_path):
    turns = Rotation.from_euler("y", 0.1 * np.sin(3.0 * TIMES)[:, None])
    messages = [
        ("/imu", T0 + int(t * 1e9), imu(T0 + round(t * 1e9), (0, 0, 0), has_rate=False, turn=turn))
        for t, turn in zip(TIMES, turns.as_quat(), strict=True)
    ]
    log = read_drive(str(write_bag(tmp_path / "drive", messages)))
    there = log.imu.time - T0 * 1e-9
    np.testing.assert_allclose(log.imu.rate[:, 1], 0.3 * np.cos(3.0 * there), atol=1e-3)


def test_a_bag_without_an_imu_says_what_it_holds(tmp_path):
    text = refusal(write_bag(tmp_path / "drive", fixes()))
    assert "neither angular rates nor attitudes" in text
    assert "/fix (sensor_msgs/msg/NavSatFix)" in text


@pytest.mark.parametrize("read", [read_drive, lambda path: BagReader(Path(path))])
def test_a_wrong_length_in_a_bag_is_no_lack_of_memory(tmp_path, read):
    file = next(write_bag(tmp_path / "drive", imus()).glob("*.mcap"))
    data = file.read_bytes()
    file.write_bytes(data[:9] + (1 << 40).to_bytes(8, "little") + data[17:])
    with pytest.raises(BadInputError, match=r"cannot read the bag .*\.mcap") as caught:
        read(str(file))
    assert not missing_resource(caught.value)


def test_a_bag_of_ros_1(tmp_path):
    stamps = [10**9 * each.header.stamp.sec + each.header.stamp.nanosec for _, _, each in imus()]
    stored = [time_ns for _, time_ns, _ in imus()]
    write_ros1(tmp_path / "drive.bag", zip(stored, stamps, RATES, strict=True))
    log = read_drive(str(tmp_path / "drive.bag"))
    np.testing.assert_array_equal(log.imu.rate, RATES)
    np.testing.assert_allclose(log.imu.time - T0 * 1e-9, TIMES, atol=1e-6)
    (tmp_path / "cut.bag").write_bytes((tmp_path / "drive.bag").read_bytes()[:5000])
    assert "cannot read the bag" in refusal(tmp_path / "cut.bag")
