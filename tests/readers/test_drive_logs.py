"""Drives from bags and ULog: which topics are read, what their messages say, what is refused."""

import struct
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("pyulog")
pytest.importorskip("rosbags")

from bags import header, imu, message, odometry, write_bag, write_ros1

from bumpymap.core import BadInputError, missing_resource
from bumpymap.readers import BagReader, read_drive

CODES = {"uint64_t": "Q", "float": "f", "double": "d", "int32_t": "i", "uint8_t": "B", "bool": "?"}
MAGIC = b"\x55\x4c\x6f\x67\x01\x12\x35\x01"


def _message(kind, body):
    return struct.pack("<HB", len(body), ord(kind)) + body


def _field(text):
    """(type, count, name) of ``float[3] gyro_rad``."""
    kind, name = text.split()
    base, _, count = kind.partition("[")
    return base, int(count.rstrip("]") or 1) if count else 1, name


def ulog(topics, dropouts=()):
    """Bytes of a ULog of topics: name, perhaps with ``:instance`` -> (fields, rows of flat numbers); dropouts in ms."""
    parts = [MAGIC, struct.pack("<Q", 0), _message("B", bytes(40))]
    formats = {}
    for name, (fields, _) in topics.items():
        formats.setdefault(name.partition(":")[0], fields)
    parts += [_message("F", f"{name}:{';'.join(fields)};".encode()) for name, fields in formats.items()]
    for number, name in enumerate(topics):
        bare, _, instance = name.partition(":")
        parts.append(_message("A", struct.pack("<BH", int(instance or 0), number) + bare.encode()))
    rows = []
    for number, (fields, values) in enumerate(topics.values()):
        layout = "<" + "".join(CODES[kind] * count for kind, count, _ in map(_field, fields))
        rows += [(row[0], _message("D", struct.pack("<H", number) + struct.pack(layout, *row))) for row in values]
    parts += [data for _, data in sorted(rows, key=lambda each: each[0])]
    parts += [_message("O", struct.pack("<H", each)) for each in dropouts]
    return b"".join(parts)


def refusal(path, columns=None):
    with pytest.raises(BadInputError) as caught:
        read_drive(str(path), columns)
    return str(caught.value)


# ---- bags ----

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


# ---- ULog ----

MICROS = (5_000_000 + np.arange(250) * 4000).tolist()
FLU = np.random.default_rng(2).normal(0.0, 0.2, (250, 3)).astype(np.float32).astype(float)
FRD = FLU * [1, -1, -1]


def sensor():
    """At rest, x forward, y right, z down: the specific force points up, along -z."""
    fields = ["uint64_t timestamp", "float[3] gyro_rad", "float[3] accelerometer_m_s2"]
    return fields, [(t, *rate, 0.5, -0.25, -9.75) for t, rate in zip(MICROS, FRD, strict=True)]


def gps(*, new=True):
    """Of ten positions, the first without a fix; as newer or older versions of PX4 store them."""
    fields = ["double latitude_deg", "double longitude_deg"] if new else ["int32_t lat", "int32_t lon"]
    scale = (lambda degrees: degrees) if new else (lambda degrees: round(degrees * 1e7))
    places = [(scale(19.4 + n * 1e-6), scale(-99.1)) for n in range(10)]
    rows = [(5_000_000 + n * 100_000, *place, 1 if n == 0 else 6, 0.015) for n, place in enumerate(places)]
    return ["uint64_t timestamp", *fields, "uint8_t fix_type", "float eph"], rows


def log_of(path, topics, **how):
    path.write_bytes(ulog(topics, **how))
    return str(path)


@pytest.mark.parametrize(("topic", "new"), [("vehicle_gps_position", True), ("sensor_gps", False)])
def test_sensors_and_positions(tmp_path, topic, new):
    log = read_drive(log_of(tmp_path / "a.ulg", {"sensor_combined": sensor(), topic: gps(new=new)}))
    np.testing.assert_allclose(log.imu.time, np.array(MICROS) * 1e-6)
    np.testing.assert_allclose(log.imu.rate, FLU)
    np.testing.assert_array_equal(log.imu.acceleration[3], [0.5, 0.25, 9.75])
    assert len(log.places.time) == 9
    np.testing.assert_allclose(log.places.y, 19.4 + np.arange(1, 10) * 1e-6, atol=1e-9)
    np.testing.assert_allclose(log.places.error, 0.015, rtol=1e-6)
    assert log.columns["imu"] == "sensor_combined"
    assert any("turned into x forward, y left, z up" in note for note in log.notes)


def test_the_first_of_several_sensors_and_the_estimated_way(tmp_path):
    axes = ["uint64_t timestamp", "float[3] xyz"]
    place = ["uint64_t timestamp", "float x", "float y", "bool xy_valid"]
    topics = {
        "vehicle_angular_velocity:1": (axes, [(t, 9.0, 9.0, 9.0) for t in MICROS]),
        "vehicle_angular_velocity": (axes, [(t, *rate) for t, rate in zip(MICROS, FRD, strict=True)]),
        "vehicle_acceleration": (axes, [(t, 0.0, 0.0, -9.75) for t in MICROS]),
        "vehicle_local_position": (place, [(t, 0.01 * n, 5.0, n >= 10) for n, t in enumerate(MICROS)]),
    }
    log = read_drive(log_of(tmp_path / "a.ulg", topics, dropouts=(120, 80)))
    np.testing.assert_allclose(log.imu.rate, FLU)
    np.testing.assert_array_equal(log.imu.acceleration[:, 2], 9.75)
    assert log.places.kind == "local"
    np.testing.assert_allclose(log.places.x, [5.0] * 240)  # east
    np.testing.assert_allclose(log.places.y, 0.01 * np.arange(10, 250), rtol=1e-6)  # north
    assert any("dropped out 2 times, for 0.2 s in all" in note for note in log.notes)


def test_rates_of_attitudes_are_about_the_same_axes(tmp_path):
    time = np.array(MICROS) * 1e-6
    # x forward, y right, z down in north, east, down: nose up is a positive turn about y
    turn = Rotation.from_euler("ZY", np.stack([0.3 + 0 * time, 0.1 * np.sin(2 * time)], 1)).as_quat()
    rows = [(t, q[3], *q[:3]) for t, q in zip(MICROS, turn, strict=True)]
    log = read_drive(log_of(tmp_path / "a.ulg", {"vehicle_attitude": (["uint64_t timestamp", "float[4] q"], rows)}))
    # x forward, y left, z up: nose up is a negative one
    np.testing.assert_allclose(log.imu.rate[:, 1], -0.2 * np.cos(2 * log.imu.time), atol=2e-3)
    np.testing.assert_allclose(log.imu.rate[:, [0, 2]], 0.0, atol=2e-3)


def test_a_log_that_holds_no_rates_says_what_it_holds(tmp_path):
    for place, topic in (
        (bag(tmp_path, fixes()), "/fix (sensor_msgs/msg/NavSatFix)"),
        (log_of(tmp_path / "b.ulg", {"vehicle_gps_position": gps()}), "vehicle_gps_position"),
    ):
        text = refusal(place)
        assert "neither angular rates nor attitudes" in text
        assert topic in text


def test_a_damaged_ulog_is_read_as_far_as_it_goes(tmp_path):
    path, whole = tmp_path / "a.ulg", ulog({"sensor_combined": sensor()})
    for damaged, says in ((b"time,wx\n", "no ULog"), (whole[:60], "a.ulg")):
        path.write_bytes(damaged)
        assert says in refusal(path)
    path.write_bytes(whole[: len(whole) // 2])
    assert 20 < len(read_drive(str(path)).imu.time) < 250


def test_a_log_that_is_read_without_end_is_refused_and_the_next_is_read(tmp_path, monkeypatch):
    """Definitions whose last message is longer than what is left: pyulog goes back by its length for ever."""
    whole = ulog({"a": (["uint64_t timestamp"], [])})
    first = whole.index(b"Fa:") - 2
    layout = whole[first : whole.index(b"A\0\0\0a") - 2]
    endless = whole[:first] + 1500 * layout + struct.pack("<HB", 20_000, 1) + bytes(10)
    (tmp_path / "endless.ulg").write_bytes(endless)
    monkeypatch.setattr("bumpymap.readers.drives.SECONDS", 0.5)
    with pytest.raises(BadInputError, match=r"endless\.ulg: the decoder did not finish.*damaged"):
        read_drive(str(tmp_path / "endless.ulg"))
    monkeypatch.undo()
    assert len(read_drive(log_of(tmp_path / "good.ulg", {"sensor_combined": sensor()})).imu.time) == 250
