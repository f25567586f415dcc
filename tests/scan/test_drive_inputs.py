"""A drive from files as sensors and odometry write them: columns, clocks and motion do not change the map."""

import json

import laspy
import numpy as np
import pytest
from ply_files import write_ply
from scipy.spatial.transform import Rotation

from bumpymap.core import BadInputError
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.pipeline import scan_frames

START = 1_700_000_000.0
SPEED_MPS, TURN_RADPS = 9.0, 1.0
POSTS = np.random.default_rng(1).uniform(-20.0, 20.0, (40, 2))


def motion(times):
    """Rotations and places of a LiDAR 1.5 m above the ground, on a circle."""
    angle = TURN_RADPS * (np.asarray(times) - START)
    radius = SPEED_MPS / TURN_RADPS
    places = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), np.full(len(angle), 1.5)])
    return Rotation.from_euler("z", angle[:, None]), places


def sweep(time, seed):
    """World points of posts and flat ground that one turn of 0.1 s sees, and the time of each after ``time``."""
    rng = np.random.default_rng(seed)
    ground = np.column_stack([rng.uniform(-25.0, 25.0, (6_000, 2)), np.zeros(6_000)])
    posts = np.column_stack([np.repeat(POSTS, 100, axis=0), np.tile(np.linspace(0.1, 2.0, 100), len(POSTS))])
    world = np.concatenate([ground, posts])
    _, place = motion([time])
    azimuth = np.arctan2(*(world - place)[:, 1::-1].T)
    offset = (azimuth + np.pi) * 0.1 / (2 * np.pi)
    order = np.argsort(offset)
    return world[order], offset[order]


@pytest.fixture(name="drive", scope="module")
def drive_fixture(tmp_path_factory):
    """Five frames with the time of each point in nanoseconds, and poses at 50 Hz."""
    folder = tmp_path_factory.mktemp("drive")
    (folder / "frames").mkdir()
    for number in range(5):
        time = START + 0.1 * number
        world, offset = sweep(time, number)
        turns, places = motion(time + offset)
        rows = np.zeros(len(world), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("t", "<u4")])
        for axis, values in zip("xyz", turns.inv().apply(world - places).T, strict=True):
            rows[axis] = values
        rows["t"] = np.rint(offset * 1e9)
        write_ply(folder / "frames" / f"{time:.3f}.ply", rows)
    times = START + np.arange(-5, 40) / 50.0
    turns, places = motion(times)
    np.savetxt(folder / "tum.txt", np.column_stack([times, places, turns.as_quat()]), fmt="%.9f")
    return folder


def settings(drive, out, **more):
    return ScanConfig(
        (drive / "frames",), out, **{"poses": drive / "tum.txt"} | more, method="filter", products=("table",)
    )


def off_posts(out):
    """Distance of the points above the ground to the nearest post, m."""
    points = laspy.read(out / "gathered.laz").xyz
    high = points[points[:, 2] > 0.3, :2]
    return np.linalg.norm(high[:, None] - POSTS[None], axis=2).min(axis=1)


def test_a_drive_is_deskewed_by_the_poses_between_its_frames(drive, tmp_path):
    config = settings(drive, tmp_path / "out")
    scan_frames(config)
    assert off_posts(config.out).max() < 0.01
    record = json.loads((config.out / "scan.json").read_text(encoding="utf-8"))
    assert record["poses"] == {"matched_by": "time", "calib": None, "deskew": True}
    raw = settings(drive, tmp_path / "raw", deskew=False)
    scan_frames(raw)
    assert off_posts(raw.out).max() > 0.5
    assert not json.loads((raw.out / "scan.json").read_text(encoding="utf-8"))["poses"]["deskew"]


def test_wrong_poses_leave_nothing_in_the_way_of_right_ones(drive, tmp_path):
    """The frames of a refused run are of no use: with the same poses it would be refused again."""
    table = np.loadtxt(drive / "tum.txt")
    right = table[:, 3].copy()
    table[:, 3] += 7.0 * (table[:, 0] - START)
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    config = settings(drive, tmp_path / "out", poses=tmp_path / "tum.txt", deskew=False)
    with pytest.raises(BadInputError, match="height of the same ground differs") as refused:
        scan_frames(config)
    assert not hasattr(refused.value, "__notes__")
    assert not config.out.exists()
    table[:, 3] = right
    np.savetxt(tmp_path / "tum.txt", table, fmt="%.9f")
    assert not scan_frames(config).already_done


def test_a_drive_is_the_same_whatever_the_columns_of_its_files(tmp_path):
    rng, count = np.random.default_rng(3), 12_000
    distance, azimuth = rng.uniform(3.0, 40.0, count), np.linspace(-3.1, 3.1, count)
    columns = [distance * np.cos(azimuth), distance * np.sin(azimuth), -1.0 + 0.01 * rng.normal(size=count)]
    columns += [rng.uniform(size=count), np.arange(count) % 32, np.linspace(0.0, 0.1, count)]
    sectors = set()
    for width in (4, 5, 6):
        path = tmp_path / f"{width}.bin"
        np.column_stack(columns[:width]).astype("<f4").tofile(path)
        (report,) = scan_frames(ScanConfig((path,), tmp_path / path.stem, method="filter", products=("table",))).frames
        sectors.add(report.sectors)
    (found,) = sectors
    assert sum(found) > 0
