"""The loop of a robot: memory of the classifier, and the documented node of ROS 2, run without ROS."""

import copy
import re
import sys
import tracemalloc
from array import array
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import bumpymap
from bumpymap import GroundGrid, ScanClassifier

PAGE = Path(__file__).resolve().parents[2] / "docs" / "pages" / "robots.md"


def revolution(seed, count=60_000, lost=0.1):
    """Ground around a sensor; some beams give no return."""
    rng = np.random.default_rng(seed)
    angle, distance = rng.uniform(0, 2 * np.pi, count), rng.uniform(0.3, 45, count)
    z = -1.5 + np.where(angle < np.pi, 0.0, rng.normal(0, 0.15, count))
    points = np.column_stack([distance * np.cos(angle), distance * np.sin(angle), z]).astype(np.float32)
    points[rng.random(count) < lost] = np.nan
    return points


@pytest.mark.parametrize("method", ["filter", None])
def test_memory_neither_grows_nor_varies_from_scan_to_scan(method):
    classify, grid = ScanClassifier(method=method), GroundGrid()
    scans = [revolution(seed) for seed in range(8)]
    for scan in (revolution(0, lost=1e-4), scans[0]):  # buffers grow to the largest scan
        grid.occupancy(classify(scan).sectors)
    tracemalloc.start()
    try:
        peaks, ends = [], []
        for scan in (*scans[3:], *scans[3:]):
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            grid.occupancy(classify(scan).sectors)
            after, peak = tracemalloc.get_traced_memory()
            peaks.append(peak - before)
            ends.append(after)
    finally:
        tracemalloc.stop()
    assert max(peaks) < 1.1 * min(peaks)  # sectors come and go at the edge
    assert max(peaks) < 100 * len(scans[0])  # bytes a point
    assert ends[-1] - ends[2] < 4 * len(scans[0])  # less than any array with a row per point, over 7 scans


@pytest.mark.parametrize("radius_m", [0.0, 0.5])
def test_a_grid_from_the_sensor_on_leaves_out_beams_without_return(radius_m):
    polar = {"zone_starts_m": (0.0, 4.0), "sectors": (16, 24), "rings": (2, 4), "end_m": 30.0}
    classify = ScanClassifier(method="filter", polar=polar, robot={"radius_m": radius_m})
    points = np.nan_to_num(revolution(0))
    nothing = (points == 0.0).all(axis=1)
    result, alone = classify(points), classify(points[~nothing])
    assert (result.point_class[nothing] == 255).all()
    np.testing.assert_array_equal(result.point_class[~nothing], alone.point_class)
    assert (alone.sector_class < 255).sum() > 50


class _Strict:
    """A message that takes only the types that rclpy takes."""

    def __init__(self, **fields):
        object.__setattr__(self, "kinds", {name: type(value) for name, value in fields.items()})
        for name, value in fields.items():
            setattr(self, name, value)

    def __setattr__(self, name, value):
        assert type(value) is self.kinds[name], f"{name} is {type(value)}"
        object.__setattr__(self, name, value)


class _Header(SimpleNamespace):
    pass


class _Stamp(SimpleNamespace):
    pass


def occupancy_grid():
    place = _Strict(x=0.0, y=0.0, z=0.0)
    origin = _Strict(position=place, orientation=_Strict(x=0.0, y=0.0, z=0.0, w=1.0))
    info = _Strict(map_load_time=_Stamp(), resolution=0.0, width=0, height=0, origin=origin)
    return _Strict(header=_Header(), info=info, data=array("b"))


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
    from bags import as_rclpy

    cloud = as_rclpy(message)
    stamp = _Stamp(sec=message.header.stamp.sec, nanosec=message.header.stamp.nanosec)
    cloud.header = _Header(frame_id=message.header.frame_id, stamp=stamp)
    return cloud


def test_the_documented_node_classifies_recorded_messages(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    from bags import cloud, lidar_rows, write_bag

    from bumpymap.readers import BagReader, BagTopics, find_sources

    scans = [revolution(seed) for seed in range(3)]
    messages = [("/points", n, cloud(lidar_rows(scan), n + 5)) for n, scan in enumerate(scans)]
    folder = write_bag(tmp_path / "bag", messages)
    bag = BagReader(folder)
    recorded = [bag.read(source.message) for source in find_sources([folder], BagTopics())]
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
    for name, parts in fakes.items():
        module = ModuleType(name)
        module.__dict__.update(parts)
        monkeypatch.setitem(sys.modules, name, module)
        package = name.partition(".")[0]
        if package not in fakes:
            monkeypatch.setitem(sys.modules, package, ModuleType(package))
    exec(compile(code, str(PAGE), "exec"), {"__name__": "__main__"})  # noqa: S102 (our own page)
    (node,) = nodes
    assert len(node.published) == 3
    for number, (grid, scan) in enumerate(zip(node.published, scans, strict=True)):
        side = grid.info.width
        assert (grid.header.frame_id, grid.header.stamp.nanosec) == ("lidar", number + 5)
        expected = GroundGrid(grid.info.resolution, side * grid.info.resolution / 2).occupancy(
            bumpymap.classify_scan(scan).sectors
        )
        np.testing.assert_array_equal(np.array(grid.data, np.int8).reshape(side, side), expected)
    (warning,) = node.warnings
    assert "declares 1 x 120,000 points" in warning


@pytest.mark.parametrize("method", [None, "filter"])
def test_threads_share_a_classifier(method):
    classify = ScanClassifier(method=method)
    scans = [revolution(seed, count) for seed, count in enumerate((60_000, 15_000, 40_000, 15_000))]
    alone = [classify(scan).point_class.copy() for scan in scans]

    def classes(number):
        return classify(scans[number % len(scans)]).point_class.copy()

    with ThreadPoolExecutor(len(scans)) as threads:
        for number, found in enumerate(threads.map(classes, range(16))):
            np.testing.assert_array_equal(found, alone[number % len(scans)])


def test_a_classifier_goes_to_another_process_with_its_settings():
    classify = ScanClassifier(method="filter", robot={"radius_m": 8.0}, vehicle="warthog")
    scan = revolution(0)
    here, there = classify(scan), copy.copy(classify)(scan)  # as pickle does it
    np.testing.assert_array_equal(here.point_class, there.point_class)
    np.testing.assert_array_equal(here.sector_c_r, there.sector_c_r)
