"""Poses in every format are the same poses, matched with frames by time or order; deskewing."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from bumpymap.core import LONGEST_GAP_S, NEAREST_S, BadInputError, PoseTrack, Scan
from bumpymap.readers import deskew, files_beside_poses, read_poses
from bumpymap.readers.poses import _read_file as read_pose_file

TURNS = Rotation.random(6, random_state=3)
PLACES = np.random.default_rng(4).normal(size=(6, 3)) * 1e4
QUATS = TURNS.as_quat()
TIMES = 1_700_000_000.25 + 0.5 * np.arange(6)


def as_poses(turns, places):
    poses = np.tile(np.eye(4), (len(places), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns.as_matrix(), places
    return poses


MATRICES = as_poses(TURNS, PLACES)


def write(path, rows, header=None, separator=","):
    lines = [separator.join(f"{value!r}" if isinstance(value, float) else str(value) for value in row) for row in rows]
    path.write_text("\n".join([*([header] if header else []), *lines]) + "\n")
    return path


def numbers(*columns):
    return [list(map(float, row)) for row in np.column_stack(columns)]


def kitti_rows(poses):
    return poses[:, :3].reshape(-1, 12).tolist()


FORMATS = {
    "kitti": (kitti_rows(MATRICES), None, " "),
    "tum": (numbers(TIMES, PLACES, QUATS), None, " "),
    "tum with a remark": (numbers(TIMES, PLACES, QUATS), "# timestamp tx ty tz qx qy qz qw", " "),
    "tum with commas": (numbers(TIMES, PLACES, QUATS), "# time,x,y,z,qx,qy,qz,qw", ","),
}


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_is_the_same_poses_and_times(tmp_path, name):
    times, poses, is_kitti = read_pose_file(write(tmp_path / "p", *FORMATS[name]))
    np.testing.assert_allclose(poses, MATRICES, atol=1e-9)
    assert (times is None) == is_kitti == (name == "kitti")
    if times is not None:
        np.testing.assert_allclose(times, TIMES, atol=1e-6)


def kitti_row(**change):
    row = [1.0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
    for place, value in change.items():
        row[int(place[1:])] = value
    return " ".join(map(str, row))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# nothing but a remark\n", "empty"),
        ("1 2 3\n", "3 numbers; 12 are required.*TUM"),
        (kitti_row(_3="nan"), "not a finite number"),
        (kitti_row(_0=-1.0), "not a rotation"),
        ("time,x,y,z,qx,qy,qz,qw\n0,1,2,3,0,0,0,1\n", "something else than numbers.*without a line of names; evo_traj"),
        ("0 1 2 3 0 0 0 0\n", "quaternion"),
        ("0 1 2 3 0 0 0 1\n1 2 3 0 0 0 1\n", "pose 1 of .* has 7 numbers; 8"),
        ("PK\x03\x04\0\0", "not a text file. Poses are KITTI"),
    ],
)
def test_what_is_no_pose_is_refused(tmp_path, text, message):
    (tmp_path / "p").write_text(text)
    with pytest.raises(BadInputError, match=message):
        read_pose_file(tmp_path / "p")


# ---- matching ----


def motion(times):
    """Turns and places on a curve, x forward and z up."""
    angle = 0.4 * times
    turns = Rotation.from_euler("zyx", np.column_stack([angle, 0.02 * np.sin(times), 0.03 * np.cos(times)]))
    return turns, np.column_stack([12.0 * np.sin(angle), 12.0 * (1.0 - np.cos(angle)), 0.1 * np.sin(times)])


def drive(count=40, rate=20.0):
    """Times and poses."""
    times = np.arange(count) / rate
    return times, as_poses(*motion(times))


def tum(path, times, poses):
    quats = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    return write(path, numbers(times, poses[:, :3, 3], quats), separator=" ")


def files(folder, names):
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{name}.bin" for name in names]
    for path in paths:
        path.write_bytes(b"")
    return paths


def numbered(folder, count):
    return files(folder, [f"{number:06d}" for number in range(count)])


def interpolated(times, poses, wanted):
    slerp = Slerp(times, Rotation.from_matrix(poses[:, :3, :3]))
    places = np.column_stack([np.interp(wanted, times, poses[:, axis, 3]) for axis in range(3)])
    return as_poses(slerp(wanted), places)


def test_interpolation_is_that_of_scipy_and_ends_where_little_is_known():
    rng = np.random.default_rng(1)
    times = np.cumsum(rng.uniform(0.01, 1.0, 30))
    poses = as_poses(Rotation.random(30, random_state=2), rng.normal(size=(30, 3)))
    wanted = np.concatenate([rng.uniform(times[0], times[-1], 500), times])
    np.testing.assert_allclose(PoseTrack(times, poses).at(wanted), interpolated(times, poses, wanted), atol=1e-9)
    # Two poses a moment apart tell no speed: 10 m/s, and 1 cm of noise.
    times, poses = np.array([0.0, 1e-6, 0.1, 0.2, 0.2 + 1e-6]), np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = [0.0, 0.01, 1.0, 2.0, 2.01]
    beyond = PoseTrack(times, poses).at(np.array([-0.1, 0.3]))
    np.testing.assert_allclose(beyond[:, 0, 3], [-1.0, 3.0], atol=0.03)
    # Poses every second are enough, and rarer ones are not.
    track = PoseTrack(np.array([0.0, 1.0, 1.5 + LONGEST_GAP_S]), np.tile(np.eye(4), (3, 1, 1)))
    assert track.covers(np.array([0.5, 1.1, 1.6, 2.9, 3.1, 3.3])).tolist() == [True, True, False, True, True, False]


STAMPS = [
    lambda ns: f"{ns}",
    lambda ns: f"{ns * 1e-9:.3f}",
    lambda ns: f"{ns // 10**9}.{ns % 10**9:09d}",
    lambda ns: f"{ns // 10**9}_{ns % 10**9}",
    lambda ns: f"frame000104-{ns // 10**9}_{ns % 10**9 // 10**6:03d}",
    lambda ns: f"n015__LIDAR_TOP__{ns // 1000}",
]


@pytest.mark.parametrize("stamp", STAMPS)
def test_frames_named_by_their_time_are_matched_at_another_rate(tmp_path, stamp):
    times, poses = drive(400)
    wanted = np.array([3_013_000_000, 4_067_394_000, 17_777_000_000])
    frames = files(tmp_path / "frames", [stamp(int(ns) + 17 * 10**17) for ns in wanted])
    found = read_poses(tum(tmp_path / "p.txt", 1.7e9 + times, poses), frames)
    assert found.matched_by == "time"
    np.testing.assert_allclose(found.poses, interpolated(times, poses, wanted * 1e-9), atol=3e-3)
    assert [motion.covers(np.array([0.0, 0.1])).all() for motion in found.motions] == [True] * 3
    for motion, pose in zip(found.motions, found.poses, strict=True):
        np.testing.assert_allclose(motion.at(np.zeros(1))[0], pose, atol=1e-6)


@pytest.mark.parametrize("chosen", [slice(None), slice(3, 7)])
def test_a_list_of_times_belongs_to_the_frames_of_its_sequence(tmp_path, chosen):
    times, poses = drive(100, rate=100.0)
    wanted = np.arange(10) * 0.0977
    frames = numbered(tmp_path / "velodyne", 10)
    (tmp_path / "times.txt").write_text("\n".join(f"{t:e}" for t in wanted) + "\n")
    path = tum(tmp_path / "odometry.txt", times, poses)
    found = read_poses(path, frames[chosen])
    np.testing.assert_allclose(found.poses, interpolated(times, poses, wanted)[chosen], atol=1e-5)
    for other in ("0\n1\n2\n", "once\n"):
        (tmp_path / "times.txt").write_text(other)
        with pytest.raises(BadInputError, match="no list of times of the 10 frames"):
            read_poses(path, frames)


@pytest.mark.parametrize("digits", [6, 10])
def test_without_times_of_the_frames_the_order_counts(tmp_path, digits):
    times, poses = drive(6)
    path = tum(tmp_path / "p.txt", times, poses)
    frames = files(tmp_path / "frames", [f"{number:0{digits}d}" for number in range(6)])
    found = read_poses(path, frames)
    assert found.matched_by == "order"
    np.testing.assert_allclose(found.poses, poses, atol=1e-9)
    with pytest.raises(BadInputError, match=r"6 poses, but there are 5 frames.*frames have none: give them times.txt"):
        read_poses(path, frames[:5])


def test_frames_without_a_pose_are_counted_and_times_that_go_back_refused(tmp_path):
    times, poses = drive(100, rate=10.0)
    keep = (times < 3.0) | (times > 6.0)
    wanted = 1.7e9 + np.array([-1.0, -NEAREST_S / 2, 1.0, 3.05, 4.5, 9.95, 12.0])
    frames = files(tmp_path / "frames", [f"{time:.2f}" for time in wanted])
    with pytest.raises(BadInputError, match="3 of 7 frames have no pose, the first is number 0"):
        read_poses(tum(tmp_path / "p.txt", 1.7e9 + times[keep], poses[keep]), frames)
    frames = files(tmp_path / "first", ["1700000000"])
    with pytest.raises(BadInputError, match="go back at pose 3"):
        read_poses(tum(tmp_path / "p.txt", 1.7e9 + times[[0, 1, 3, 2]], poses[:4]), frames)
    repeated = [0, 0, 1, 2]  # count once
    found = read_poses(tum(tmp_path / "p.txt", 1.7e9 + times[repeated], poses[repeated]), frames)
    np.testing.assert_allclose(found.poses, poses[:1], atol=1e-6)


# ---- frames of the poses ----

NEARLY_AXES = Rotation.from_matrix([[0, -1, 0], [0, 0, -1], [1, 0, 0]]) * Rotation.from_euler(
    "xyz", (0.01, -0.02, 0.01)
)
TR = as_poses(NEARLY_AXES, np.array([[-0.01, -0.05, -0.29]]))[0]


def of_camera(poses):
    """Poses of KITTI's camera, in the frame of its first pose."""
    lidar = np.linalg.inv(poses[0]) @ poses
    return TR @ lidar @ np.linalg.inv(TR)


@pytest.mark.parametrize("inside", ["", "sequences/00"])
def test_the_camera_poses_of_kitti_become_those_of_the_lidar(tmp_path, caplog, inside):
    """Odometry of LiDAR scans is written in KITTI's format too, and stays as it is."""
    _, poses = drive()
    path = write(tmp_path / "00.txt", kitti_rows(of_camera(poses)), separator=" ")
    frames = numbered(tmp_path / "sequences/00/velodyne", 40)
    calib = tmp_path / inside / "calib.txt"
    calib.write_text(f"P0: {kitti_row()}\nTr: {' '.join(map(repr, map(float, TR[:3].ravel())))}\n")
    found = read_poses(path, frames)
    np.testing.assert_allclose(found.poses, np.linalg.inv(poses[0]) @ poses, atol=1e-9)
    assert found.calib == calib
    assert "calib.txt turns them into those of the LiDAR" in caplog.text
    assert files_beside_poses(path, frames) == [calib]
    found = read_poses(write(path, kitti_rows(poses), separator=" "), frames)
    np.testing.assert_allclose(found.poses, poses, atol=1e-9)
    assert found.calib is None


def test_camera_poses_without_calib_are_refused(tmp_path):
    times, poses = drive()
    frames = numbered(tmp_path / "velodyne", 40)
    message = r"poses of a camera: 100% of the way.*put the sequence's calib.txt \(with the line Tr:\) beside it"
    for path in (
        write(tmp_path / "poses.txt", kitti_rows(of_camera(poses)), separator=" "),
        tum(tmp_path / "tum.txt", times, of_camera(poses)),
    ):
        with pytest.raises(BadInputError, match=message):
            read_poses(path, frames)
    for calib in ("P0: 1 2 3\n", "Tr: 1 2 3\n"):
        (tmp_path / "calib.txt").write_text(calib)
        with pytest.raises(BadInputError, match="is not a transform"):
            read_poses(tmp_path / "poses.txt", frames)


def test_backwards_uphill_and_sideways_are_a_lidar_and_a_world_that_is_not_upright_is_none(tmp_path):
    frames, path = numbered(tmp_path / "frames", 40), tmp_path / "p.txt"
    for axis, degrees in (("z", 180), ("z", 90), ("y", -35)):
        turn = Rotation.from_euler(axis, degrees, degrees=True)
        poses = as_poses(Rotation.concatenate([turn] * 40), turn.apply(np.outer(np.arange(40.0), [1.0, 0, 0])))
        assert read_poses(write(path, kitti_rows(poses), separator=" "), frames).calib is None
    for world in (TR, np.diag([1.0, -1.0, -1.0, 1.0])):
        with pytest.raises(BadInputError, match="z axis of the LiDAR does not point up"):
            read_poses(write(path, kitti_rows(world @ drive()[1]), separator=" "), frames)


# ---- deskewing: what a sensor measures on the way lies where it sees it standing ----

TRACK = PoseTrack(np.arange(-0.5, 1.5, 0.01), as_poses(*motion(np.arange(-0.5, 1.5, 0.01))))


@pytest.mark.parametrize("first", [0.0, -0.1, -0.05])
def test_points_are_where_the_sensor_sees_them_at_the_time_of_the_frame(first):
    world = np.random.default_rng(2).uniform(-60.0, 60.0, (20_000, 3)) * [1.0, 1.0, 0.05]
    time = np.linspace(first, first + 0.1, 20_000).astype(np.float32)
    (turns, places), (turn, place) = motion(time.astype(np.float64)), motion(np.zeros(1))
    scan = Scan(turns.inv().apply(world - places).astype(np.float32), time=time)
    wanted = turn.inv().apply(world - place)
    assert np.abs(scan.points - wanted).max() > 0.5
    np.testing.assert_allclose(deskew(scan, TRACK).points, wanted, atol=1e-3)
    assert deskew(Scan(scan.points), TRACK).points is scan.points  # without times nothing moves
    assert deskew(scan, PoseTrack(TRACK.times + 9.0, TRACK.poses)) is scan  # nor without poses
    empty = Scan(np.empty((0, 3), np.float32), time=np.empty(0, np.float32))
    assert deskew(empty, TRACK) is empty
