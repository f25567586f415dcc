"""Scans and poses in every format: files that are none, columns, times and order of points and frames, deskewing."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from point_files import TABLES, write_table
from scipy.spatial.transform import Rotation, Slerp

from bumpymap.core import LONGEST_GAP_S, NEAREST_S, BadInputError, Dropped, PoseTrack, Robot, Scan, UsageError
from bumpymap.readers import deskew, files_beside_poses, find_frames, read_poses, read_scan
from bumpymap.readers.poses import _read_file as read_pose_file
from bumpymap.readers.raw_scans import point_seconds

# ---- formats ----

NAN, INF = float("nan"), float("inf")
ROWS = np.array(
    [
        [5.0, 1.0, -1.5, 0.1],
        [0.0, 0.0, 0.0, 0.0],
        [NAN, 1.0, 2.0, 0.2],
        [0.1, -0.2, -0.3, 0.3],
        [9.0, -4.0, INF, 0.4],
        [-7.5, 3.25, 0.5, 0.5],
        [0.0, 0.0, 0.0, 0.6],
    ],
    dtype=np.float32,
)
LABEL = np.array([3, 0, 0, 7, 0, 300, 0], np.uint16)
KEPT = [0, 5]
DROPPED = Dropped(no_return=2, not_finite=2, on_robot=1)


def write_kitti(folder, label=None, rows=ROWS):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "000007.bin"
    rows.astype("<f4").tofile(path)
    if label is not None:
        label.mkdir(parents=True, exist_ok=True)
        (LABEL.astype("<u4") | 0x50000).tofile(label / "000007.label")
    return path


def check(scan, label):
    np.testing.assert_array_equal(scan.points, ROWS[KEPT, :3])
    np.testing.assert_allclose(scan.intensity, ROWS[KEPT, 3], rtol=1e-6)
    assert scan.points.dtype == scan.intensity.dtype == np.float32
    assert scan.dropped == DROPPED
    if label:
        assert scan.label.dtype == np.uint16
        assert scan.label.tolist() == LABEL[KEPT].tolist()
    else:
        assert scan.label is None


@pytest.mark.parametrize("form", TABLES)
def test_every_format_gives_the_same_scan_and_is_refused_cut_off(tmp_path, form):
    path, columns = tmp_path / f"frame 3.{form[:3]}", dict(zip(("x", "y", "z", "intensity"), ROWS.T, strict=True))
    for label in ({}, {"label": LABEL}):
        scan = read_scan(write_table(path, form, columns | label))
        assert scan.name == "frame 3"
        check(scan, label=bool(label))
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(BadInputError):
        read_scan(path)


def test_text_pcd_without_counts_and_with_several_values_a_field(tmp_path):
    path = tmp_path / "a.pcd"
    for count, normals in (("COUNT 3 1 1 1 1\n", "9 9 9"), ("", "9")):
        head = f"VERSION .7\nFIELDS normal x y z label\nSIZE 4 4 4 4 2\nTYPE F F F F U\n{count}WIDTH 2\nHEIGHT 1\n"
        tail = f"VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n{normals} 1 2 3 4 \n{normals}  5 6 7 8\n"
        path.write_text(head + tail)
        scan = read_scan(path)
        assert scan.points.tolist() == [[1, 2, 3], [5, 6, 7]]
        assert scan.label.tolist() == [4, 8]


@pytest.mark.parametrize(
    ("points", "labels"),
    [
        ("bare", None),
        ("beside", "beside"),
        ("sequences/04/velodyne", "sequences/04/labels"),
        ("Rellis-3D/00000/os1_cloud_node_kitti_bin", "Rellis-3D/00000/os1_cloud_node_semantickitti_label_id"),
    ],
)
def test_kitti_without_and_with_labels_where_data_sets_put_them(tmp_path, points, labels):
    check(read_scan(write_kitti(tmp_path / points, labels and tmp_path / labels)), label=labels is not None)


def test_returns_from_the_robot_or_from_nothing_are_left_out(tmp_path):
    path = write_kitti(tmp_path)
    assert read_scan(path, Robot(radius_m=0.0)).dropped.on_robot == 0
    assert read_scan(path, Robot(radius_m=6.0)).dropped.on_robot == 2
    boxed = read_scan(path, Robot(radius_m=0.0, box_m=(-8.0, 1.0, -1.0, 4.0)))
    assert boxed.dropped.on_robot == 2
    assert boxed.points.tolist() == ROWS[:1, :3].tolist()
    for wrong in ({"radius_m": -1.0}, {"radius_m": NAN}, {"box_m": (1.0, 0.0, 0.0, 1.0)}):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            Robot(**wrong)
    for row in ([0.0, 0.0, 0.0, 0.0], [NAN, NAN, NAN, 0.0]):
        scan = read_scan(write_kitti(tmp_path, rows=np.tile(np.float32(row), (50, 1))))
        assert scan.points.shape == (0, 3)  # a scan of nothing is empty, and says why
        assert scan.dropped.no_return + scan.dropped.not_finite == 50


def test_something_else_and_labels_of_something_else_are_refused(tmp_path):
    for name, data, says in (
        ("a.ply", b"\x89PNG\r\n\x1a\n" + bytes(200), "not a point cloud"),
        ("a.pcd", b"\x89PNG\r\n\x1a\n" + bytes(200), "not a point cloud"),
        ("a.bin", np.random.default_rng(1).bytes(16_000), "does not hold float32"),
        ("a.bin", bytes(30), "truncated"),
        ("a.las", b"LASF" + bytes(400), "bumpymap map"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(BadInputError, match=says):
            read_scan(tmp_path / name)
    columns = dict(zip("xyz", np.full((3, 3), 5.0), strict=True)) | {"label": np.array([1, -2, 3], np.int32)}
    with pytest.raises(BadInputError, match="labels"):
        read_scan(write_table(tmp_path / "b.ply", "ply little", columns))
    path = write_kitti(tmp_path)
    for count in (6, 8):
        np.zeros(count, "<u4").tofile(tmp_path / "000007.label")
        with pytest.raises(BadInputError, match="do not belong together"):
            read_scan(path)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "points", "dropped"),
    [
        ("monoforce/husky/1666877643_267394304.ply", 64_801, Dropped(65_873, 0, 398)),
        ("monoforce/husky_oru/1714571815_451803923.ply", 19_092, Dropped()),
        ("patchwork_128ch/000000.pcd", 205_898, Dropped(34_102, 0, 0)),
    ],
)
def test_real_scans(shared_data, name, points, dropped):
    scan = read_scan(shared_data / "scans" / name)
    assert scan.points.shape == (points, 3)
    assert scan.dropped == dropped


# ---- the number of columns of a .bin scan is told from its values: never wrong, and in doubt asked for ----


def seen(rows):
    return rows[(rows[:, :3] != 0.0).any(axis=1)]


def as_bytes(rows):
    """Intensities of 0 to 255."""
    rows = seen(rows)
    return np.column_stack([rows[:, :3], np.rint(rows[:, 3] * 255), rows[:, 4:]])


ORDERS = {
    "organised": lambda rows: rows,
    "shuffled": lambda rows: np.random.default_rng(1).permutation(seen(rows)),
    "bytes": as_bytes,
    "nan": lambda rows: np.where((rows[:, :3] == 0.0).all(axis=1)[:, None] & (np.arange(6) < 3), np.nan, rows),
    "thin": lambda rows: seen(rows)[::17],
}


def read(path, values, columns=None):
    """The points, intensities and times of a file of these values."""
    np.ascontiguousarray(values, np.float32).tofile(path)
    return read_scan(path, Robot(0.0), columns)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("seed", range(3))
def test_made_up_scans_of_any_order_are_told_and_no_answer_is_wrong(tmp_path, order, seed):
    """Random sizes, cuts and orders: the right width, or a refusal; of a whole scan, the width."""
    rng, path = np.random.default_rng(seed), tmp_path / "a.bin"
    lines, columns = int(rng.choice([16, 31, 64])), int(rng.integers(500, 900))
    rows = np.zeros((lines * columns, 6), np.float32)  # x, y, z, intensity, ring, time; (0, 0, 0) without a return
    rows[:, :3] = rng.uniform(-50.0, 50.0, (len(rows), 3)) * (rng.random((len(rows), 1)) > 0.05)
    rows[:, 3] = rng.uniform(0.1, 0.5, len(rows))
    rows[:, 4], rows[:, 5] = np.divmod(np.arange(len(rows)), columns) / np.array([[1.0], [10.0 * columns]])
    rows = ORDERS[order](rows)
    rows = rows[: len(rows) // 60 * 60]  # the size fits every width
    kept = seen(rows[np.isfinite(rows[:, 0])])
    for width in (4, 5, 6):
        scan = read(path, rows[:, :width])
        np.testing.assert_array_equal(scan.points, kept[:, :3])
        np.testing.assert_array_equal(scan.intensity, kept[:, 3])
        assert (scan.time is None) == (width < 6)
        for other in {4, 5, 6} - {width}:
            with pytest.raises(BadInputError, match=f"fit {width} of 4, 5 or 6 columns"):
                read(path, rows[:, :width], other)
        part = rows[int(rng.integers(len(rows))) :, :width]
        cut = int(rng.integers(0, 2) * rng.integers(1, width))
        with suppress(BadInputError):
            points = read(path, part.ravel()[: max(part.size - cut, 1)]).points
            assert cut == 0 or part.size < 200
            assert np.array_equal(points, seen(part[np.isfinite(part[:, 0])])[:, :3]) or cut
    with pytest.raises(BadInputError, match="fit none of 4, 5 or 6 columns"):
        read(path, rows[:, :3])


def test_numbers_that_no_scan_has_are_refused_unless_the_user_says_the_columns(tmp_path):
    values = np.random.default_rng(4).uniform(-50.0, 50.0, 60 * 400)
    for wrong, words in ((values, "fit none of"), (np.ones(60), "fit 4 or 5 or 6 of"), (np.ones(7), "fit none of")):
        with pytest.raises(BadInputError, match=words):
            read(tmp_path / "a.bin", wrong)
    for width in (4, 5, 6):
        scan = read(tmp_path / "a.bin", values, width)
        np.testing.assert_array_equal(scan.points, values.reshape(-1, width)[:, :3].astype(np.float32))
        assert scan.time is None  # the columns are not rings and times
    with pytest.raises(BadInputError, match="48 float32 values"):
        read(tmp_path / "a.bin", values[:48], 5)


@pytest.mark.realdata
@pytest.mark.parametrize("folder", ["kitti_labelled", "solid_state_labelled"])
def test_real_scans_have_four_columns(shared_data, tmp_path, folder):
    """Also with columns that were made up, and cut so that the size fits every width."""
    for file in sorted((shared_data / "scans" / folder).glob("*.bin")):
        rows = np.fromfile(file, "<f4").reshape(-1, 4)
        rows = rows[: len(rows) // 60 * 60]
        wide = np.column_stack([rows, np.arange(len(rows)) // 2000, np.linspace(0, 0.1, len(rows))])
        for width in (4, 5, 6):
            scan = read(tmp_path / "a.bin", wide[:, :width])
            np.testing.assert_array_equal(scan.points, seen(rows)[:, :3])


# ---- units of time ----


@pytest.mark.parametrize("unit", [1.0, 1e6, 1e9])
@pytest.mark.parametrize("start", [0.0, -0.1, 1.6e9, 4321.5])
def test_seconds_microseconds_and_nanoseconds(unit, start):
    exact = np.linspace(0.0, 0.0999, 1000)
    column = (start + exact) * unit
    found, day = point_seconds(column)
    np.testing.assert_allclose(found, exact + min(start, 0.0), atol=2e-6)
    assert found.dtype == np.float32
    assert (day is None) == (start < 1e9)
    assert day is None or abs(day - start) < 1e-5


def test_missing_times_and_times_of_no_clear_unit():
    column = 1.6e9 + np.linspace(0.0, 0.1, 11)
    column[[0, 5]] = [np.nan, 0.0]  # beams without return
    found, _ = point_seconds(column)
    np.testing.assert_allclose(found[[1, 10]], [0.0, 0.09], atol=1e-6)
    assert np.isnan(found[[0, 5]]).all()
    for unclear in ([0.0] * 9, [0.0, 1e3, 2e3], [], [5.0, 4e12], [np.nan] * 4):
        assert point_seconds(np.array(unclear)) == (None, None)


# ---- finding frames ----


def fill(folder, *names):
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"x")
    return folder


@pytest.mark.parametrize(
    ("inside", "asked", "names"),
    [
        ("", "", ["frame9.bin", "frame10.bin", "frame100.bin"]),  # by number
        ("velodyne", "", ["frame9.bin", "frame10.bin", "frame100.bin"]),
        ("os1_cloud_node_kitti_bin", "", ["frame9.bin", "frame10.bin", "frame100.bin"]),
        ("", "scan.dat", ["scan.dat"]),  # a named file may have any ending
    ],
)
def test_frames_of_a_folder_and_of_a_sequence_of_a_data_set_are_in_order(tmp_path, inside, asked, names):
    fill(tmp_path / "04" / inside, "frame10.bin", "frame9.bin", "frame100.bin", ".hidden.bin", "poses.txt", "scan.dat")
    fill(tmp_path / "04" / "labels", "0.label")
    assert [path.name for path in find_frames([tmp_path / "04" / asked])] == names


def test_what_cannot_be_taken_is_refused(tmp_path):
    for places, says in (
        ([], "no scan was given"),
        ([tmp_path / "none"], "does not exist"),
        ([fill(tmp_path / "texts", "a.txt")], "holds no scans"),
        ([fill(tmp_path / "survey", "a.laz")], "bumpymap map .*survey --out DIR maps it"),
        ([fill(tmp_path / "survey", "a.laz") / "a.laz"], "is a survey"),
        ([fill(tmp_path / "mixed", "a.bin", "a.ply")], "several formats"),
        ([Path("/dev/null")], "neither"),
    ):
        with pytest.raises(BadInputError, match=says):
            find_frames(places)


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
