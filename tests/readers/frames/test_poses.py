"""Poses in KITTI's and in CSV form are the same poses; what is none is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from bumpymap.core.errors import BadInputError
from bumpymap.readers import read_poses

TURNS = Rotation.random(6, random_state=3)
PLACES = np.random.default_rng(4).normal(size=(6, 3)) * 1e4


def matrices():
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = TURNS.as_matrix(), PLACES
    return poses


def write(path, rows, header=None, separator=","):
    lines = [separator.join(f"{value!r}" if isinstance(value, float) else value for value in row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path


def test_kitti(tmp_path):
    path = write(tmp_path / "poses.txt", matrices()[:, :3].reshape(6, 12).tolist(), separator=" ")
    np.testing.assert_allclose(read_poses(path, 6), matrices(), atol=1e-9)


@pytest.mark.parametrize("header", ["time,x,y,z,qx,qy,qz,qw", "Time, X, Y, Z, Qx, Qy, Qz, Qw"])
def test_csv_with_quaternions(tmp_path, header):
    rows = [["12:30:01", *map(float, row)] for row in np.hstack([PLACES, TURNS.as_quat()])]
    np.testing.assert_allclose(read_poses(write(tmp_path / "p.csv", rows, header), 6), matrices(), atol=1e-9)


def test_csv_columns_are_found_by_name(tmp_path):
    quats = TURNS.as_quat()
    rows = [[float(v) for v in (*q[[3, 0, 1, 2]], *p[::-1])] for q, p in zip(quats, PLACES, strict=True)]
    path = write(tmp_path / "p.csv", rows, "qw,qx,qy,qz,z,y,x")
    np.testing.assert_allclose(read_poses(path, 6), matrices(), atol=1e-9)


def test_csv_with_matrices_is_freed_from_rounding(tmp_path):
    header = "stamp," + ",".join(f"T{r}{c}" for r in range(3) for c in range(4))
    rows = [["1.5", *(f"{v:.3f}" for v in pose[:3].ravel())] for pose in matrices()]
    poses = read_poses(write(tmp_path / "p.csv", rows, header), 6)
    np.testing.assert_allclose(poses, matrices(), atol=2e-3)
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (6, 1, 1)), atol=1e-12)


@pytest.mark.parametrize("count", [5, 7, 0])
def test_another_number_of_frames_is_refused(tmp_path, count):
    path = write(tmp_path / "poses.txt", matrices()[:, :3].reshape(6, 12).tolist(), separator=" ")
    with pytest.raises(BadInputError, match=f"6 poses, but there are {count} frames;"):
        read_poses(path, count)


def kitti_row(**change):
    row = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
    for place, value in change.items():
        row[int(place[1:])] = value
    return " ".join(map(str, row))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("# nothing but a remark\n", "empty"),
        ("1 2 3\n", "3 numbers; 12"),
        (kitti_row(_3="nan"), "not a finite number"),
        (kitti_row(_7="inf"), "not a finite number"),
        (kitti_row(_0=-1.0), "not a rotation"),
        (kitti_row(_0=2.0), "not a rotation"),
        ("time,x,y,z\n1,2,3,4\n", "T00"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0,0\n", "quaternion"),
        ("x,y,z,qx,qy,qz,qw\n1,2,word,0,0,0,1\n", "not a finite number"),
        ("x,y,z,qx,qy,qz,qw\n1,2,3,0,0,0\n", "6 numbers; 7"),
        ("x,y,z,qx,qy,qz,qw\n", "0 poses, but there are 1 frames"),
    ],
)
def test_what_is_no_pose_is_refused(tmp_path, text, message):
    (tmp_path / "p").write_text(text)
    with pytest.raises(BadInputError, match=message):
        read_poses(tmp_path / "p", 1)


def test_no_file_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="cannot read"):
        read_poses(tmp_path / "none.txt", 1)
