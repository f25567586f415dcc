"""The made-up street, a drive along it, and the map of that drive."""

import numpy as np
import pyarrow.parquet as pq
import pytest
from made_street import LANES_M, drive_street, make_street, noisy_poses
from scipy.ndimage import binary_dilation

from bumpymap.lab.worlds.scans.lidar import Sensor
from bumpymap.lab.worlds.scans.things import Label
from bumpymap.scan import ScanConfig, scan_frames

pytestmark = pytest.mark.slow

SENSOR = Sensor(lines=40, columns=720, noise_m=0.005, end_m=60.0, lost=0.0)
FRAMES = 8


@pytest.fixture(name="street", scope="module")
def street_fixture():
    return make_street(3, 42.0)


@pytest.fixture(name="drive", scope="module")
def drive_fixture(street):
    return drive_street(street, SENSOR, FRAMES)


@pytest.mark.open3d
def test_what_stands_is_where_it_is_said_and_cars_move(street, drive):
    scans, poses = drive
    blocked = binary_dilation(street.blocked(0.25, 1.38, 0.1), iterations=2)
    moved = []
    for scan, pose in zip(scans, poses, strict=True):
        car = scan.label == Label.VEHICLE
        x, y, z = (scan.points[car].astype(float) @ pose[:3, :3].T + pose[:3, 3]).T
        parked = np.abs(y) > LANES_M
        inside = parked & (x > 0.5) & (x < 41.5) & (z < 1.2) & (z > 0.5)
        held = blocked[(10 * (21.0 - y[inside])).astype(int), (10 * x[inside]).astype(int)]
        assert held.mean() > 0.97
        moved.append(np.median(x[~parked & (y < 0.0) & (x > pose[0, 3])]))
    assert 3.0 < np.mean(np.diff(moved)) < 4.0


@pytest.mark.open3d
@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_the_lanes_of_a_drive_are_smooth_and_passable(drive, tmp_path, noise):
    scans, poses = drive
    (tmp_path / "drive").mkdir()
    for number, scan in enumerate(scans):
        rows = np.column_stack([scan.points, scan.intensity]).astype("<f4")
        rows.tofile(tmp_path / "drive" / f"{number}.bin")
    given = noisy_poses(poses, 2, 0.05 * noise, 0.3 * noise)
    np.savetxt(tmp_path / "poses.txt", given[:, :3].reshape(-1, 12))
    config = ScanConfig(
        (tmp_path / "drive",), tmp_path / "out", poses=tmp_path / "poses.txt", products=("table",), method="filter"
    )
    agree = scan_frames(config).merged["poses"]
    assert agree["after_m"] < 0.01
    assert (agree["before_m"] > 0.02) == bool(noise)
    table = pq.read_table(tmp_path / "out" / "map" / "tiles.parquet", columns=["col", "row", "class", "barred"])
    tiles = {(tile["col"], tile["row"]): tile for tile in table.to_pylist()}
    lanes = [tiles[col, row] for col in range(2, 9) for row in (-1, 0)]
    assert sum(tile["class"] in {0, 1} for tile in lanes) >= (14 if noise == 0.0 else 13)
    # What moving things leave of themselves splits some tiles: there the way is found on pixels.
    assert sum(tile["barred"] in {None, "split by an obstacle"} for tile in lanes) >= 13
