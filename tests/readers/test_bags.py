"""Scans, poses and drives from bags and ULog: topics that are found, what their messages say, what is refused."""

import re
import shutil
import sqlite3
import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from bags import LIDAR, as_rclpy, cloud, header, imu, lidar_rows, message, odometry, transforms, write_bag, write_ros1

from bumpymap.core import BadInputError, Robot, UsageError, install_command, missing_resource
from bumpymap.readers import BagReader, BagTopics, find_sources, points_of, read_drive, read_message
from bumpymap.readers.raw_scans import read_cloud

T0 = 1_700_000_000_000_000_000
STEP = 100_000_000
MOUNT = (Rotation.from_euler("y", 20, degrees=True), np.array([0.3, 0.0, 0.8]))


def points(number):
    return np.random.default_rng(number).uniform(1, 50, (40, 3)).astype(np.float32)


def pose(seconds):
    return Rotation.from_euler("zyx", [0.3 * seconds, 0.05, -0.02]), np.array([2.0 * seconds, 1.0, 0.5])


def matrix(turn, place):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn.as_matrix(), place
    return found


def clouds(count=6, topic="/points"):
    """Stored 30 ms after they were measured."""
    stamps = [T0 + n * STEP for n in range(count)]
    return [(topic, t + 30_000_000, cloud(lidar_rows(points(n)), t, "lidar")) for n, t in enumerate(stamps)]


def motion(count=20, topic="/odom", child="base", spare=-1, late=0):
    """Odometry at 20 Hz from 50 ms before the first scan, each message stored late."""
    times = [T0 + (n + spare) * STEP // 2 for n in range(count)]
    return [(topic, t + 7_000_000, odometry(t + late, pose((t - T0) * 1e-9), child=child)) for t in times]


MOUNTED = [("/tf_static", T0 - STEP, transforms(T0 - STEP, ("base", "lidar", MOUNT)))]


def bag_of(folder, *parts, **how):
    return write_bag(folder, sorted((each for part in parts for each in part), key=lambda each: each[1]), **how)


def found_in(path, **topics):
    return find_sources([path], BagTopics(**topics))


def check_poses(sources, mount=MOUNT):
    for number, source in enumerate(sources):
        expected = matrix(*pose(number * 0.1)) @ matrix(*mount)
        np.testing.assert_allclose(source.pose, expected, atol=1e-4)  # of the arc, 50 ms are a chord


@pytest.mark.parametrize(
    ("storage", "compression", "named"),
    [
        ("mcap", None, "folder"),
        ("mcap", "STORAGE", "file"),
        ("sqlite3", None, "file"),
        ("sqlite3", "MESSAGE", "folder"),
        ("mcap", "FILE", "folder"),
    ],
)
def test_scans_and_poses_of_every_kind_of_bag(storage, compression, named, tmp_path):
    folder = bag_of(tmp_path / "drive", MOUNTED, clouds(), motion(), storage=storage, compression=compression)
    path = folder if named == "folder" else next(folder.glob("drive.*"))
    sources = found_in(path)
    assert [source.message.number for source in sources] == list(range(6))
    assert [source.message.stamp_ns for source in sources] == [T0 + n * STEP for n in range(6)]
    assert {source.message.frame_id for source in sources} == {"lidar"}
    check_poses(sources)
    bag = BagReader(path)
    for number in (0, 1, 4, 2, 5, 5):  # forwards, back, and the same again
        scan = read_message(bag, sources[number].message, Robot(0.0), "n")
        np.testing.assert_array_equal(scan.points, points(number))
        np.testing.assert_array_equal(scan.intensity, np.arange(40) % 200)


@pytest.mark.parametrize("same_time", [False, True])
def test_threads_read_one_bag_in_any_order(tmp_path, same_time):
    """Messages of one time, or with no time in the header, are told apart."""
    messages = [("/points", T0, cloud(lidar_rows(points(n)), 0)) for n in range(40)] if same_time else clouds(40)
    folder = write_bag(tmp_path / "drive", messages)
    bag, sources = BagReader(folder), found_in(folder)
    assert len({source.message.stamp_ns for source in sources}) == (1 if same_time else 40)
    order = np.random.default_rng(0).permutation(40)
    with ThreadPoolExecutor(4) as pool:
        scans = list(pool.map(lambda number: read_message(bag, sources[number].message, Robot(0.0), ""), order))
    for number, scan in zip(order, scans, strict=True):
        np.testing.assert_array_equal(scan.points, points(number))


def test_poses_from_transforms_and_of_the_sensor_itself(tmp_path):
    base = Rotation.random(random_state=1), np.random.default_rng(0).normal(0, 5, 3)
    times = range(T0 - STEP, T0 + 9 * STEP, STEP // 2)
    links = [("/tf", t, transforms(t, ("odom", "base", pose((t - T0) * 1e-9)))) for t in times]
    links += [("/tf", t, transforms(t, ("map", "odom", base))) for t in times[::2]]
    sources = found_in(bag_of(tmp_path / "drive", MOUNTED, clouds(), links))
    assert {source.pose_frame for source in sources} == {"map"}
    for number, source in enumerate(sources):
        expected = matrix(*base) @ matrix(*pose(number * 0.1)) @ matrix(*MOUNT)
        np.testing.assert_allclose(source.pose, expected, atol=1e-4)
    own = bag_of(tmp_path / "own", clouds(), motion(child="lidar"))
    check_poses(found_in(own), mount=(Rotation.identity(), np.zeros(3)))


def test_odometry_that_is_chosen(tmp_path):
    other = [(topic, t, odometry(t, (Rotation.identity(), np.zeros(3)))) for topic, t, _ in motion(topic="/wheels")]
    folder = bag_of(tmp_path / "drive", MOUNTED, clouds(), motion(), other)
    check_poses(found_in(folder, odometry="/odom"))
    for source in found_in(folder, odometry="/wheels"):
        np.testing.assert_allclose(source.pose, matrix(*MOUNT), atol=1e-12)
    assert all(source.pose is None for source in found_in(folder))  # neither is the only one
    with pytest.raises(BadInputError, match=r"/odom \(20 messages\), /wheels \(20 messages\).*`odometry='/odom'`"):
        found_in(folder, odometry="/none")


def test_frames_outside_of_the_poses_have_none(tmp_path, caplog):
    folder = bag_of(tmp_path / "drive", MOUNTED, clouds(11), motion(7, spare=7))  # 0.35 to 0.65 s
    known = [source.pose is not None for source in found_in(folder)]
    assert known == [False, False, True, True, True, True, True, True, True, False, False]
    assert "4 of 11 frames have no pose: relative to the first frame, frames span 0 to 1.0 s" in caplog.text


@pytest.mark.parametrize(
    ("parts", "noted", "says"),
    [
        ([], "'lidar' to one of map and odom", "no topic of type nav_msgs/msg/Odometry"),
        ([motion()], "", r"'base'.*/tf_static.*'lidar'.*`poses='FILE'`"),
        ([MOUNTED, motion(late=10**12)], "6 of 6 frames have no pose", "different clocks"),
    ],
    ids=["none", "without a mount", "of another clock"],
)
def test_without_usable_poses_there_are_only_frames_unless_odometry_was_named(tmp_path, caplog, parts, noted, says):
    folder = bag_of(tmp_path / "drive", clouds(), *parts)
    assert [source.pose for source in found_in(folder)] == [None] * 6
    assert noted in caplog.text
    with pytest.raises(BadInputError, match=says):
        found_in(folder, odometry="/odom")


def test_broken_poses_do_no_harm_where_none_are_wanted(tmp_path):
    broken = motion()
    broken[3][2].pose.pose.orientation.w = 7.0
    folder = bag_of(tmp_path / "drive", MOUNTED, clouds(), broken)
    with pytest.raises(BadInputError, match=r"poses in .*drive cannot be used: pose \d+ of /odom .* a quaternion"):
        found_in(folder)
    assert [source.pose for source in found_in(folder, poses=False)] == [None] * 6


def test_the_topic_is_asked_for_where_there_are_several(tmp_path):
    folder = bag_of(tmp_path / "drive", clouds(3), clouds(6, "/rear"))
    with pytest.raises(BadInputError, match=r"/points \(3 messages\), /rear \(6 messages\).*`topic='/points'`"):
        found_in(folder)
    with pytest.raises(BadInputError, match="has no topic /front"):
        found_in(folder, clouds=("/front",))
    assert len(found_in(folder, clouds=("/rear",))) == 6
    with pytest.raises(BadInputError, match=r"no topic of type sensor_msgs/msg/PointCloud2; it holds nav_msgs"):
        found_in(write_bag(tmp_path / "other", motion()))


def test_several_bags_are_one_drive(tmp_path):
    first = bag_of(tmp_path / "drive_2", MOUNTED, clouds()[:3], motion()[:9]) / "drive_2.mcap"
    later = bag_of(tmp_path / "drive_10", clouds()[3:], motion()[9:]) / "drive_10.mcap"
    sources = find_sources([later, first, later], BagTopics())
    assert [source.path for source in sources] == [first] * 3 + [later] * 3
    assert [source.message.number for source in sources] == [0, 1, 2] * 2
    check_poses(sources)
    (tmp_path / "loose").mkdir()  # a recording that was cut off has no metadata
    for file in (first, later):
        shutil.copy(file, tmp_path / "loose")
    check_poses(found_in(tmp_path / "loose"))


@pytest.mark.parametrize("cut", [0.3, 0.9, 0.999, 0.0])
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_bag_that_was_cut_off_is_refused(storage, cut, tmp_path):
    folder = write_bag(tmp_path / "drive", clouds(), storage)
    file = next(file for file in folder.iterdir() if file.suffix in {".mcap", ".db3"})
    file.write_bytes(file.read_bytes()[: int(cut * file.stat().st_size)])
    for path in (file, folder):
        with pytest.raises(BadInputError, match=r"cannot read the bag .*ros2 bag reindex"):
            found_in(path)


def test_a_bag_that_changes_while_it_is_read(tmp_path):
    folder = write_bag(tmp_path / "drive", clouds())
    bag, sources = BagReader(folder), found_in(folder)
    read_message(bag, sources[0].message, Robot(), "")
    file = folder / "drive.mcap"
    file.write_bytes(file.read_bytes() + b"x")
    with pytest.raises(BadInputError, match="changed while it was read"):
        read_message(bag, sources[1].message, Robot(), "")


def test_what_is_no_bag_or_not_alone(tmp_path):
    folder = write_bag(tmp_path / "drive", clouds(1))
    scan, old, none = (tmp_path / name for name in ("a.bin", "old.bag", "none.mcap"))
    np.ones((50, 4), "<f4").tofile(scan)
    old.write_bytes(b"#ROSBAG V2.0\n")
    empty = write_bag(tmp_path / "empty", clouds(2), "sqlite3")
    with sqlite3.connect(empty / "empty.db3") as base:
        base.execute("DELETE FROM messages")
    broken = cloud(lidar_rows(points(0)), T0)
    broken.width = 5000
    for places, topics, error, says in (
        ([scan, folder], BagTopics(), UsageError, "not both"),
        ([scan], BagTopics(("/points",)), UsageError, "`topic` and `odometry`"),
        ([none], BagTopics(), BadInputError, "does not exist"),
        ([old], BagTopics(), BadInputError, r"ROS 1.*rosbags-convert"),
        ([empty], BagTopics(), BadInputError, "holds no messages"),
    ):
        with pytest.raises(error, match=says):
            find_sources(places, topics)
    (source,) = find_sources([scan], BagTopics())
    assert (source.path, source.message, source.pose) == (scan, None, None)
    folder = write_bag(tmp_path / "broken", [("/points", T0, broken)])
    (source,) = found_in(folder)
    with pytest.raises(BadInputError, match=r"message 0 of /points in .*broken: the point cloud declares 1 x 5,000"):
        read_message(BagReader(folder), source.message, Robot(0.0), "")


def test_without_rosbags_the_extra_is_named(tmp_path, monkeypatch):
    folder = write_bag(tmp_path / "drive", clouds(1))
    for name in [name for name in sys.modules if name.startswith("rosbags")]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UsageError, match=re.escape(install_command("ros"))):
        found_in(folder)


@pytest.mark.later
def test_memory_does_not_grow_with_the_bag(tmp_path):
    """Of 80 scans of 3 MB, no more than a few are held at a time."""
    rows = np.zeros(100_000, LIDAR)
    scans = (("/points", T0 + n, cloud(rows, T0 + n)) for n in range(80))
    folder = write_bag(tmp_path / "drive", scans, compression="STORAGE")
    code = """if True:
        import resource, sys
        from pathlib import Path
        from bumpymap.core import Robot
        from bumpymap.readers import *
        path, before = Path(sys.argv[1]), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        bag = BagReader(path)
        for source in find_sources([path], BagTopics()):
            read_message(bag, source.message, Robot(), "")
        print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=True)
    assert int(done.stdout) * 1024 < 100e6  # all of them: 256 MB


# ---- points of messages in any layout of fields, against the arrays they were made from ----


@st.composite
def layouts(draw):
    """Fields in any order and at any offset, of any type, with padding after each."""
    order = draw(st.sampled_from("<>"))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring", "t"]))
    names = [name for name in names if name in "xyz" or draw(st.booleans())]
    kinds = {"intensity": ["f4", "u1", "u2"], "ring": ["u1", "u2", "i4"], "t": ["u4", "f8", "f4"]}
    offsets, formats, end = [], [], 0
    for name in names:
        kind = draw(st.sampled_from(kinds.get(name, ["f4", "f8"])))
        end += draw(st.integers(0, 5))
        offsets.append(end)
        formats.append(order + kind)
        end += np.dtype(kind).itemsize
    step = end + draw(st.integers(0, 7))
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})


@settings(max_examples=60, deadline=None)
@given(layouts(), st.integers(1, 4), st.integers(0, 9), st.integers(0, 40), st.integers(0, 2**32 - 1))
def test_points_of_any_layout(dtype, height, width, padding, seed):
    rng = np.random.default_rng(seed)
    rows = np.zeros((height, width), dtype)
    for name in dtype.names:
        rows[name] = rng.uniform(0, 100, (height, width))
    rows["y"][rng.random((height, width)) < 0.2] = np.nan
    message = cloud(rows, row_step=width * dtype.itemsize + padding)
    expected = np.stack([rows[axis].astype(np.float32) for axis in "xyz"], axis=-1).reshape(-1, 3)
    for each in (message, as_rclpy(message)):
        found = points_of(each)
        np.testing.assert_array_equal(found, expected)
        assert (found.dtype, found.flags.c_contiguous, found.flags.writeable) == (np.float32, True, True)
    intensity = read_cloud(message).intensity
    if "intensity" in dtype.names:
        np.testing.assert_array_equal(intensity, rows["intensity"].astype(np.float32).ravel())
    else:
        assert intensity is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"data": np.zeros(100, np.uint8)}, "holds 100 bytes"),
        ({"width": 2000}, "1 x 2,000 points of 32 bytes"),
        ({"height": 2, "row_step": 8}, "in rows of 8"),
        ({"point_step": 6}, "outside of its 6 bytes"),
        ({"fields": []}, "has no x, y, z; its fields are none"),
        ({"z": 3}, "has no z"),  # a field of several numbers is no coordinate
    ],
)
def test_messages_that_contradict_themselves(change, words):
    message = cloud(lidar_rows(np.ones((1000, 3))))
    values = dict(change)
    message.fields[2].count = values.pop("z", 1)
    for name, value in values.items():
        setattr(message, name, value)
    with pytest.raises(BadInputError, match=words):
        points_of(message)


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
    pytest.importorskip("pyulog")
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
