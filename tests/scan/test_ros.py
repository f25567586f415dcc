"""A scan run over a bag: frames, poses, map and grids, read back with rosbags; and the documented node of ROS 2."""

import hashlib
import json
import re
import shutil
import sys
from array import array
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags")

from bags import as_rclpy, cloud, lidar_rows, odometry, transforms, write_bag
from rosbags.highlevel import AnyReader

import bumpymap
from bumpymap.core import OutputError, SilentProgress, UsageError
from bumpymap.rating import find_calibration
from bumpymap.readers import BagReader, BagTopics, find_sources
from bumpymap.scan import ScanConfig, scan_frames as scan_alone
from bumpymap.survey import map_surveys

scan_frames = partial(scan_alone, mapper=map_surveys)

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("without_views")]


T0 = 1_700_000_000_000_000_000
STAMPS = [T0 + n * 100_000_000 for n in range(4)]
MOUNT = (Rotation.from_euler("x", 3, degrees=True), np.array([0.4, 0.0, 1.2]))


def pose(stamp):
    seconds = (stamp - T0) * 1e-9
    return Rotation.from_euler("z", 0.4 * seconds), np.array([3.0 * seconds, 0.0, 0.3])


def rigid(turn, place):
    return np.block([[turn.as_matrix(), place[:, None]], [np.zeros(3), 1.0]])


def world():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-22, 24, 45_000), rng.uniform(-22, 22, 45_000)
    return np.column_stack([x, y, np.where(y < 0, 0.2 * rng.standard_normal(len(x)), 0.0)])


def seen(stamp):
    """The world in the frame of the sensor."""
    turn, place = pose(stamp)
    on_base = turn.inv().apply(world() - place)
    return MOUNT[0].inv().apply(on_base - MOUNT[1])


@pytest.fixture(name="bag", scope="module")
def bag_fixture(tmp_path_factory):
    messages = [("/tf_static", T0 - 1, transforms(T0, ("base", "lidar", MOUNT)))]
    for stamp in STAMPS:
        messages += [("/odom", stamp, odometry(stamp, pose(stamp)))]
        messages += [("/points", stamp + 50_000_000, cloud(lidar_rows(seen(stamp)), stamp))]
    return write_bag(tmp_path_factory.mktemp("bag") / "drive", messages)


@pytest.fixture(name="ran", scope="module")
def ran_fixture(bag, tmp_path_factory):
    folder = tmp_path_factory.mktemp("ran")
    how = {"bag": folder / "grids.mcap", "method": "filter", "products": ("table", "cloud"), "vehicle": "warthog"}
    config = ScanConfig((bag,), folder / "out", **how)
    return config, scan_frames(config)


def messages_of(path):
    """By the definitions that the bag itself holds: topic -> messages."""
    found = {}
    with AnyReader([path]) as reader:
        for topic, time, raw in reader.messages():
            found.setdefault(topic.topic, []).append((time, reader.deserialize(raw, topic.msgtype)))
    return found


def test_frames_have_the_names_of_their_stamps_and_the_poses_of_the_bag(ran):
    config, result = ran
    assert [frame["name"] for frame in result.frames] == [f"1700000000_{n}00000000" for n in range(4)]
    for frame, stamp in zip(result.frames, STAMPS, strict=True):
        turn, place = pose(stamp)
        np.testing.assert_allclose(frame["pose"], rigid(turn, place) @ rigid(*MOUNT), atol=1e-6)
    record = json.loads((config.out / "scan.json").read_text(encoding="utf-8"))
    assert [frame["message"]["number"] for frame in record["frames"]] == [0, 1, 2, 3]
    assert {frame["sha256"] for frame in record["frames"]} == {None}
    assert {file["path"].rpartition("/")[2] for file in record["side_files"]} == {"metadata.yaml", "drive.mcap"}
    assert record["bag"]["sha256"] == hashlib.sha256(config.bag.read_bytes()).hexdigest()


def test_a_file_of_poses_is_matched_with_the_times_of_the_bag(bag, tmp_path):
    lines = []
    for time_ns in range(T0 - 10**9, T0 + 2 * 10**9, 10**8):
        turn, place = pose(time_ns)
        numbers = [*np.add(place, (0.0, 500.0, 0.0)), *turn.as_quat()]
        lines.append(" ".join([f"{time_ns // 10**9}.{time_ns % 10**9:09d}", *(f"{number:.9f}" for number in numbers)]))
    (tmp_path / "tum.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    how = {"method": "filter", "products": ("table",), "deskew": False}
    config = ScanConfig((bag,), tmp_path / "out", poses=tmp_path / "tum.txt", **how)
    result = scan_frames(config)
    for frame, stamp in zip(result.frames, STAMPS, strict=True):
        turn, place = pose(stamp)
        np.testing.assert_allclose(np.array(frame["pose"])[:3, :3], turn.as_matrix(), atol=1e-5)
        np.testing.assert_allclose(np.array(frame["pose"])[:3, 3], np.add(place, (0.0, 500.0, 0.0)), atol=1e-4)


def test_grids_are_read_back_in_the_frame_of_the_poses_with_what_is_remembered(ran):
    found, classify = messages_of(ran[0].bag), bumpymap.ScanClassifier(method="filter", vehicle="warthog")
    limits = find_calibration("warthog").map_limits
    assert set(found) == {"/ground/occupancy", "/ground/grid_map"}
    for number, (stamp, frame) in enumerate(zip(STAMPS, ran[1].frames, strict=True)):
        time, message = found["/ground/occupancy"][number]
        assert time == stamp == message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
        info = message.info
        assert (message.header.frame_id, info.width, info.height, info.resolution) == ("odom", 240, 240, 0.25)
        grid = classify(seen(stamp).astype(np.float32), pose=frame["pose"]).grid
        assert (info.origin.position.x, info.origin.position.y) == grid.corner_m
        occupancy = np.asarray(message.data).reshape(240, 240)
        np.testing.assert_array_equal(occupancy, grid.occupancy)
        assert {-1, 0, 98, 100} <= set(occupancy.ravel().tolist()) <= {*range(-1, 99), 100}
        rated = np.isfinite(grid.c_r) & (occupancy < 100)
        assert rated.sum() > 1000
        np.testing.assert_allclose(occupancy[rated], 98 * np.minimum(grid.c_r[rated] / limits[2], 1.0), atol=0.51)
        unrated = (occupancy >= 0) & (occupancy < 100) & ~rated
        assert set(occupancy[unrated].tolist()) <= {round(98 * limit / limits[2]) for limit in limits}
        check_grid_map(found["/ground/grid_map"][number], stamp, grid)


def check_grid_map(stored, stamp, grid):
    """Place the cells by the rules of grid_map: index (0, 0) is the corner at +x, +y."""
    time, message = stored
    assert (time, message.header.frame_id) == (stamp, "odom")
    assert message.layers == ["class", "elevation", "step", "obstacle_height", "clearance", "c_r"]
    layers = {"class": np.where(grid.class_id == 255, np.nan, grid.class_id)}
    assert (message.info.length_x, message.info.length_y, message.info.resolution) == (60.0, 60.0, 0.25)
    assert (message.info.pose.position.x - 30.0, message.info.pose.position.y - 30.0) == grid.corner_m
    for name, values in zip(message.layers, message.data, strict=True):
        matrix = np.asarray(values.data).reshape(240, 240).T  # column by column; rows run to -x, columns to -y
        expected = layers[name] if name in layers else getattr(grid, name)
        np.testing.assert_array_equal(matrix[::-1, ::-1].T, expected)


def test_sensors_on_several_topics_are_one_drive_and_one_grid(tmp_path):
    mounts = {
        "front": (Rotation.identity(), np.array([0.0, 0.0, 1.2])),
        "rear": (Rotation.from_euler("z", 180, degrees=True), np.array([-0.5, 0.0, 1.0])),
    }
    messages = [("/tf_static", T0 - 1, transforms(T0, *(("base", name, mount) for name, mount in mounts.items())))]
    expected, classify = [], bumpymap.ScanClassifier(method="filter")
    for stamp in STAMPS[:2]:
        turn, place = pose(stamp)
        messages.append(("/odom", stamp, odometry(stamp, pose(stamp))))
        scans = []
        for name, (on_base, at) in mounts.items():
            points = on_base.inv().apply(turn.inv().apply(world() - place) - at)
            scans.append(points[points[:, 0] > 0.0].astype(np.float32))  # it looks ahead
            messages.append((f"/{name}", stamp + 10_000_000, cloud(lidar_rows(scans[-1]), stamp, name)))
        sensors = [rigid(*mount) for mount in mounts.values()]
        expected.append(classify.together(scans, sensors=sensors, pose=rigid(turn, place))[0].grid)
    folder = write_bag(tmp_path / "drive", messages)
    how = {"topic": "/front,/rear", "method": "filter", "products": ("table",), "bag": tmp_path / "g.mcap"}
    result = scan_frames(ScanConfig((folder,), tmp_path / "out", **how))
    assert [frame["message"]["topic"] for frame in result.frames] == ["/front", "/rear"] * 2
    assert result.drive is not None
    grids = messages_of(how["bag"])["/ground/occupancy"]
    assert len(grids) == 2
    for (_, message), grid in zip(grids, expected, strict=True):
        own = np.asarray(message.data).reshape(240, 240)
        assert (own == grid.occupancy).mean() > 0.999  # poses are interpolated


def test_a_complete_run_is_recognised(ran, bag, tmp_path):
    assert scan_frames(ran[0]).already_done
    moved = tmp_path / "away.mcap"
    shutil.move(ran[0].bag, moved)
    with pytest.raises(OutputError, match=r"its bag .* is missing"):
        scan_frames(ran[0])
    shutil.move(moved, ran[0].bag)


def test_an_interrupted_run_goes_on_with_what_is_remembered(ran, tmp_path):
    class Ends(SilentProgress):
        def advance(self, steps):
            raise KeyboardInterrupt

    config = replace(ran[0], out=tmp_path / "out", bag=tmp_path / "grids.mcap")
    with pytest.raises(KeyboardInterrupt):
        scan_frames(config, Ends())
    scan_frames(config)
    assert config.bag.read_bytes() == ran[0].bag.read_bytes()


def test_a_bad_message_is_skipped(tmp_path):
    messages = [("/points", stamp, cloud(lidar_rows(seen(stamp)), stamp)) for stamp in STAMPS[:3]]
    messages[1][2].point_step = 5
    folder = write_bag(tmp_path / "drive", messages)
    how = {"skip_bad": True, "method": "filter", "products": ("table",), "bag": tmp_path / "g.mcap"}
    config = ScanConfig((folder,), tmp_path / "out", **how)
    result = scan_frames(config)
    assert list(result.skipped) == [f"{folder}, message 1 of /points"]
    grids = messages_of(config.bag)["/ground/occupancy"]
    assert [time for time, _ in grids] == [STAMPS[0], STAMPS[2]]
    for stamp, (_, message) in zip(STAMPS[::2], grids, strict=True):  # no poses: around the sensor
        assert (message.header.frame_id, message.info.origin.position.x) == ("lidar", -30.0)
        expected = bumpymap.classify_scan(seen(stamp), method="filter").grid.occupancy
        np.testing.assert_array_equal(message.data, expected.ravel())
    assert scan_frames(config).already_done
    with pytest.raises(UsageError, match="needs the pose of every frame"):
        scan_frames(replace(config, out=tmp_path / "other", bag=None, crs="EPSG:32614"))


def test_where_the_grids_cannot_be_written(bag, tmp_path):
    config = ScanConfig((bag,), tmp_path / "out", method="filter", products=("table",), bag=tmp_path / "g.mcap")
    (tmp_path / "g.mcap").write_text("mine")
    with pytest.raises(OutputError, match="exists already"):
        scan_frames(config)
    (tmp_path / "out" / "frames").mkdir(parents=True)
    (tmp_path / "out" / "scan.json").touch()
    for place, said in (
        (tmp_path / "none" / "g.mcap", "no folder"),
        (bag / "new.mcap", "input"),
        (tmp_path / "out" / "frames" / "new.mcap", "which the run replaces"),
    ):
        with pytest.raises(OutputError, match=said):
            scan_frames(replace(config, bag=place, overwrite=True))
    with pytest.raises(UsageError, match=r"ends in \.mcap"):
        replace(config, bag=tmp_path / "g.db3")
    assert (tmp_path / "g.mcap").read_text() == "mine"


PAGE = Path(__file__).resolve().parents[2] / "docs" / "pages" / "robots.md"


class _Strict:
    """A message that takes only the types that rclpy takes."""

    def __init__(self, **fields):
        object.__setattr__(self, "kinds", {name: type(value) for name, value in fields.items()})
        for name, value in fields.items():
            setattr(self, name, value)

    def __setattr__(self, name, value):
        assert type(value) is self.kinds[name], f"{name} is {type(value)}"
        object.__setattr__(self, name, value)


def occupancy_grid():
    place = _Strict(x=0.0, y=0.0, z=0.0)
    origin = _Strict(position=place, orientation=_Strict(x=0.0, y=0.0, z=0.0, w=1.0))
    info = _Strict(map_load_time=SimpleNamespace(), resolution=0.0, width=0, height=0, origin=origin)
    return _Strict(header=SimpleNamespace(), info=info, data=array("b"))


class _Node:
    """A node that calls back with recorded messages, and keeps what is published."""

    def __init__(self, name):
        self.published, self.warnings = [], []

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, callback, profile):
        self.callback = callback

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


def as_received(message):
    """As rclpy gives it."""
    cloud = as_rclpy(message)
    stamp = SimpleNamespace(sec=message.header.stamp.sec, nanosec=message.header.stamp.nanosec)
    cloud.header = SimpleNamespace(frame_id=message.header.frame_id, stamp=stamp)
    return cloud


def test_the_documented_node_classifies_recorded_messages(bag, monkeypatch):
    scans, reader = [seen(stamp).astype(np.float32) for stamp in STAMPS], BagReader(bag)
    recorded = [reader.read(source.message) for source in find_sources([bag], BagTopics())]
    broken = as_received(recorded[0])
    broken.width *= 2
    nodes = []

    def spin(node):
        nodes.append(node)
        for message in (*map(as_received, recorded), broken):
            node.callback(message)

    (code,) = [
        block for block in re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL) if "rclpy" in block
    ]
    assert len([line for line in code.splitlines() if line.strip()]) <= 30
    fakes = {
        "rclpy": {"init": lambda: None, "spin": spin},
        "rclpy.node": {"Node": _Node},
        "rclpy.qos": {"qos_profile_sensor_data": object()},
        "nav_msgs.msg": {"OccupancyGrid": occupancy_grid},
        "sensor_msgs.msg": {"PointCloud2": object},
    }
    for name in ("nav_msgs", "sensor_msgs", *fakes):
        module = ModuleType(name)
        module.__dict__.update(fakes.get(name, {}))
        monkeypatch.setitem(sys.modules, name, module)
    exec(compile(code, str(PAGE), "exec"), {"__name__": "__main__"})  # noqa: S102 (our own page)
    (node,) = nodes
    for stamp, grid, scan in zip(STAMPS, node.published, scans, strict=True):
        side = grid.info.width
        assert (grid.header.frame_id, grid.header.stamp.nanosec) == ("lidar", stamp % 10**9)
        expected = bumpymap.classify_scan(scan).grid.occupancy
        np.testing.assert_array_equal(np.array(grid.data, np.int8).reshape(side, side), expected)
    (warning,) = node.warnings
    assert "declares 1 x 90,000 points" in warning
