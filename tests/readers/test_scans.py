"""Scans: every format, files that are none, columns of .bin files, times of points, the order of frames."""

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from survey_kinds import TABLES, write_table

from bumpymap.core import BadInputError, Dropped, Robot, UsageError
from bumpymap.readers import find_frames, read_scan
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
