"""Scans and poses from bags: which are found, how they are read, and what is refused."""

import builtins
import shutil
import sqlite3
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from bags import LIDAR, cloud, lidar_rows, odometry, transforms, write_bag

from bumpymap.core import BadInputError, Robot, UsageError
from bumpymap.readers import BagReader, BagTopics, find_sources, read_message

T0 = 1_700_000_000_000_000_000
STEP = 100_000_000
MOUNT = (Rotation.from_euler("y", 20, degrees=True), np.array([0.3, 0.0, 0.8]))


def points(number, count=40):
    rng = np.random.default_rng(number)
    return rng.uniform(1, 50, (count, 3)).astype(np.float32)


def pose(seconds):
    return Rotation.from_euler("zyx", [0.3 * seconds, 0.05, -0.02]), np.array([2.0 * seconds, 1.0, 0.5])


def matrix(turn, place):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn.as_matrix(), place
    return found


def clouds(count=6, topic="/points", frame="lidar"):
    """Stored 30 ms after they were measured."""
    return [
        (topic, T0 + n * STEP + 30_000_000, cloud(lidar_rows(points(n)), T0 + n * STEP, frame)) for n in range(count)
    ]


def moves(count=20, topic="/odom", child="base", spare=-1):
    """Odometry at 20 Hz from 50 ms before the first scan, each message stored late."""
    times = [T0 + (n + spare) * STEP // 2 for n in range(count)]
    return [(topic, t + 7_000_000, odometry(t, pose((t - T0) * 1e-9), child=child)) for t in times]


def mounted():
    return [("/tf_static", T0 - STEP, transforms(T0 - STEP, ("base", "lidar", MOUNT)))]


def by_time(*parts):
    return sorted((each for part in parts for each in part), key=lambda each: each[1])


def found_in(path, **topics):
    return find_sources([path], BagTopics(**topics))


def check_poses(sources, mount=MOUNT):
    for number, source in enumerate(sources):
        expected = matrix(*pose(number * 0.1)) @ (np.eye(4) if mount is None else matrix(*mount))
        np.testing.assert_allclose(source.pose, expected, atol=1e-4)  # of the arc, 50 ms are a chord


KINDS = [
    ("mcap", None, "folder"),
    ("mcap", "STORAGE", "file"),
    ("sqlite3", None, "folder"),
    ("sqlite3", None, "file"),
    ("sqlite3", "MESSAGE", "folder"),
    ("mcap", "FILE", "folder"),
]


@pytest.mark.parametrize(("storage", "compression", "named"), KINDS)
def test_scans_and_poses_of_every_kind_of_bag(storage, compression, named, tmp_path):
    folder = write_bag(tmp_path / "drive", by_time(mounted(), clouds(), moves()), storage, compression)
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


def test_threads_read_one_bag(tmp_path):
    folder = write_bag(tmp_path / "drive", clouds(40))
    bag, sources = BagReader(folder), found_in(folder)
    with ThreadPoolExecutor(4) as pool:
        scans = list(pool.map(lambda source: read_message(bag, source.message, Robot(0.0), ""), sources))
    for number, scan in enumerate(scans):
        np.testing.assert_array_equal(scan.points, points(number))


def test_messages_of_one_time_are_told_apart(tmp_path):
    same = [("/points", T0, cloud(lidar_rows(points(n)), 0)) for n in range(5)]
    folder = write_bag(tmp_path / "drive", same)
    bag, sources = BagReader(folder), found_in(folder)
    assert {source.message.stamp_ns for source in sources} == {T0}  # no time in the header
    for number in (3, 0, 4, 1, 2):
        scan = read_message(bag, sources[number].message, Robot(0.0), "")
        np.testing.assert_array_equal(scan.points, points(number))


def test_poses_from_transforms(tmp_path):
    rng = np.random.default_rng(0)
    base = Rotation.random(random_state=1), rng.normal(0, 5, 3)
    links = [
        ("/tf", t, transforms(t, ("odom", "base", pose((t - T0) * 1e-9))))
        for t in range(T0 - STEP // 2, T0 + 8 * STEP, STEP // 2)
    ]
    links += [("/tf", t, transforms(t, ("map", "odom", base))) for t in range(T0 - STEP, T0 + 9 * STEP, STEP)]
    sources = found_in(write_bag(tmp_path / "drive", by_time(mounted(), clouds(), links)))
    for number, source in enumerate(sources):
        expected = matrix(*base) @ matrix(*pose(number * 0.1)) @ matrix(*MOUNT)
        np.testing.assert_allclose(source.pose, expected, atol=1e-4)


def test_odometry_of_the_sensor_itself_needs_no_mount(tmp_path):
    check_poses(found_in(write_bag(tmp_path / "drive", by_time(clouds(), moves(child="lidar")))), mount=None)


def test_odometry_that_is_chosen(tmp_path):
    other = [(topic, t, odometry(t, (Rotation.identity(), np.zeros(3)))) for topic, t, _ in moves(topic="/wheels")]
    folder = write_bag(tmp_path / "drive", by_time(mounted(), clouds(), moves(), other))
    check_poses(found_in(folder, odometry="/odom"))
    for source in found_in(folder, odometry="/wheels"):
        np.testing.assert_allclose(source.pose, matrix(*MOUNT), atol=1e-12)
    assert all(source.pose is None for source in found_in(folder))  # neither is the only one
    with pytest.raises(BadInputError, match=r"/odom \(20 messages\), /wheels \(20 messages\).*`odometry='NAME'`"):
        found_in(folder, odometry="/none")


def test_frames_outside_of_the_poses_have_none(tmp_path, caplog):
    folder = write_bag(tmp_path / "drive", by_time(mounted(), clouds(11), moves(7, spare=7)))  # 0.35 to 0.65 s
    known = [source.pose is not None for source in found_in(folder)]
    assert known == [False, False, True, True, True, True, True, True, True, False, False]
    assert "4 of 11 frames have no pose: relative to the first frame, frames span 0 to 1.0 s" in caplog.text


def test_odometry_of_another_clock_is_refused_where_it_was_named(tmp_path, caplog):
    late = [(topic, t, odometry(t + 10**12, pose(0.0))) for topic, t, _ in moves()]
    folder = write_bag(tmp_path / "drive", by_time(mounted(), clouds(), late))
    assert all(source.pose is None for source in found_in(folder))
    assert "6 of 6 frames have no pose" in caplog.text
    with pytest.raises(BadInputError, match="different clocks"):
        found_in(folder, odometry="/odom")


def test_broken_poses_do_no_harm_where_none_are_wanted(tmp_path):
    broken = moves()
    broken[3][2].pose.pose.orientation.w = 7.0
    folder = write_bag(tmp_path / "drive", by_time(mounted(), clouds(), broken))
    with pytest.raises(BadInputError, match=r"poses in .*drive cannot be used: pose \d+ of /odom .* a quaternion"):
        found_in(folder)
    assert [source.pose for source in found_in(folder, poses=False)] == [None] * 6


def test_without_poses_there_are_only_frames(tmp_path, caplog):
    sources = found_in(write_bag(tmp_path / "drive", clouds()))
    assert all(source.pose is None for source in sources)
    assert "'lidar' to one of map and odom" in caplog.text


def test_odometry_without_a_mount_is_refused_where_it_was_named(tmp_path):
    folder = write_bag(tmp_path / "drive", by_time(clouds(), moves()))
    assert all(source.pose is None for source in found_in(folder))
    with pytest.raises(BadInputError, match=r"'base'.*/tf_static.*'lidar'.*`poses='FILE'`"):
        found_in(folder, odometry="/odom")


def test_the_topic_is_asked_for_where_there_are_several(tmp_path):
    folder = write_bag(tmp_path / "drive", by_time(clouds(3), clouds(6, "/rear")))
    with pytest.raises(BadInputError, match=r"/points \(3 messages\), /rear \(6 messages\).*`topic='NAME'`"):
        found_in(folder)
    with pytest.raises(BadInputError, match="has no topic /front"):
        found_in(folder, cloud="/front")
    assert len(found_in(folder, cloud="/rear")) == 6
    with pytest.raises(BadInputError, match=r"no topic of type sensor_msgs/msg/PointCloud2; it holds nav_msgs"):
        found_in(write_bag(tmp_path / "other", moves()))


def test_several_bags_are_one_drive(tmp_path):
    first = write_bag(tmp_path / "drive_2", by_time(mounted(), clouds()[:3], moves()[:9])) / "drive_2.mcap"
    later = write_bag(tmp_path / "drive_10", by_time(clouds()[3:], moves()[9:])) / "drive_10.mcap"
    sources = find_sources([later, first, later], BagTopics())
    assert [(source.path, source.message.number) for source in sources] == [
        (path, number) for path in (first, later) for number in range(3)
    ]
    check_poses(sources)
    loose = tmp_path / "loose"  # a recording that was cut off has no metadata
    loose.mkdir()
    for file in (first, later):
        shutil.copy(file, loose)
    check_poses(find_sources([loose], BagTopics()))


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


def test_a_bad_message_says_where_it_is(tmp_path):
    broken = cloud(lidar_rows(points(0)), T0)
    broken.width = 5000
    folder = write_bag(tmp_path / "drive", [("/points", T0, broken)])
    (source,) = found_in(folder)
    with pytest.raises(BadInputError, match=r"message 0 of /points in .*drive: the point cloud declares 1 x 5,000"):
        read_message(BagReader(folder), source.message, Robot(), "")


def test_what_is_no_bag_or_not_alone(tmp_path):
    folder = write_bag(tmp_path / "drive", clouds(1))
    np.ones((50, 4), "<f4").tofile(tmp_path / "a.bin")
    with pytest.raises(UsageError, match="not both"):
        find_sources([tmp_path / "a.bin", folder], BagTopics())
    with pytest.raises(UsageError, match="`topic` and `odometry`"):
        find_sources([tmp_path / "a.bin"], BagTopics("/points"))
    with pytest.raises(BadInputError, match="does not exist"):
        find_sources([tmp_path / "none.mcap"], BagTopics())
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(BadInputError, match=r"ROS 1.*rosbags-convert"):
        find_sources([tmp_path / "old.bag"], BagTopics())
    with pytest.raises(BadInputError, match="holds no messages"):
        found_in(_emptied(write_bag(tmp_path / "empty", clouds(2), "sqlite3")))
    (source,) = find_sources([tmp_path / "a.bin"], BagTopics())
    assert (source.path, source.message, source.pose) == (tmp_path / "a.bin", None, None)


def _emptied(folder):
    with sqlite3.connect(folder / f"{folder.name}.db3") as base:
        base.execute("DELETE FROM messages")
    return folder


def test_without_rosbags_the_extra_is_named(tmp_path, monkeypatch):
    folder = write_bag(tmp_path / "drive", clouds(1))
    real = builtins.__import__

    def missing(name, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(UsageError, match=r"pip install 'bumpymap\[ros\]'"):
        found_in(folder)


@pytest.mark.later
def test_memory_does_not_grow_with_the_bag(tmp_path):
    """Of 80 scans of 3 MB, no more than a few are held at a time."""
    rows = np.zeros(100_000, LIDAR)
    scans = (("/points", T0 + n, cloud(rows, T0 + n)) for n in range(80))
    folder = write_bag(tmp_path / "drive", scans, compression="STORAGE")
    code = (
        "import resource, sys; from pathlib import Path; from bumpymap.core import Robot;"
        "from bumpymap.readers import *;"
        "path = Path(sys.argv[1]); before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss;"
        "found = find_sources([path], BagTopics()); bag = BagReader(path);"
        "[read_message(bag, each.message, Robot(), '') for each in found];"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)"
    )
    done = subprocess.run([sys.executable, "-c", code, str(folder)], capture_output=True, text=True, check=True)
    assert int(done.stdout) * 1024 < 100e6  # all of them: 256 MB
