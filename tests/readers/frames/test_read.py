"""One scan in every format it may come in, and files that are none."""

import numpy as np
import pytest
from ply_files import write_ply
from pypcd4 import Encoding, PointCloud

from bumpymap.core import Dropped, Robot
from bumpymap.core.errors import BadInputError, UsageError
from bumpymap.readers import read_scan

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


def table(label):
    names = ["x", "y", "z", "intensity"] + (["label"] if label else [])
    rows = np.empty(len(ROWS), [(n, "u2" if n == "label" else "f4") for n in names])
    for column, name in enumerate(names[:4]):
        rows[name] = ROWS[:, column]
    if label:
        rows["label"] = LABEL
    return rows


def write_pcd(path, encoding, label=True):
    fields = ("x", "y", "z", "intensity") + (("label",) if label else ())
    types = (np.float32,) * 4 + ((np.uint16,) if label else ())
    columns = [*ROWS.T, *([LABEL] if label else [])]
    PointCloud.from_points(columns, fields, types).save(str(path), encoding=encoding)
    return path


def write_kitti(folder, label=None, name="000007", rows=ROWS):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.bin"
    rows.astype("<f4").tofile(path)
    if label is not None:
        label.parent.mkdir(parents=True, exist_ok=True)
        (LABEL.astype("<u4") | 0x50000).tofile(label)
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


@pytest.mark.parametrize("label", [True, False])
@pytest.mark.parametrize("order", ["<", ">", "="])
def test_ply(tmp_path, label, order):
    scan = read_scan(write_ply(tmp_path / "frame 3.ply", table(label), order=order))
    assert scan.name == "frame 3"
    check(scan, label)


@pytest.mark.parametrize("label", [True, False])
@pytest.mark.parametrize("encoding", [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED])
def test_pcd(tmp_path, encoding, label):
    check(read_scan(write_pcd(tmp_path / "a.pcd", encoding, label)), label)


def test_text_pcd_without_counts_and_with_several_values_a_field(tmp_path):
    head = "VERSION .7\nFIELDS normal x y z label\nSIZE 4 4 4 4 2\nTYPE F F F F U\nCOUNT 3 1 1 1 1\n"
    tail = "WIDTH 2\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n"
    (tmp_path / "a.pcd").write_text(head + tail + "9 9 9 1 2 3 4\n9 9 9 5 6 7 8\n")
    scan = read_scan(tmp_path / "a.pcd")
    assert scan.points.tolist() == [[1, 2, 3], [5, 6, 7]]
    assert scan.label.tolist() == [4, 8]
    bare = head.replace("COUNT 3 1 1 1 1\n", "")
    (tmp_path / "b.pcd").write_text(bare + tail + "9 1 2 3 4\n9 5 6 7 8\n")
    assert read_scan(tmp_path / "b.pcd").label.tolist() == [4, 8]


def test_kitti_without_and_with_labels_where_data_sets_put_them(tmp_path):
    check(read_scan(write_kitti(tmp_path / "bare")), label=False)
    beside = tmp_path / "beside"
    check(read_scan(write_kitti(beside, beside / "000007.label")), label=True)
    semantic = tmp_path / "sequences" / "04"
    check(read_scan(write_kitti(semantic / "velodyne", semantic / "labels" / "000007.label")), label=True)
    rellis = tmp_path / "Rellis-3D" / "00000"
    folder = rellis / "os1_cloud_node_semantickitti_label_id"
    check(read_scan(write_kitti(rellis / "os1_cloud_node_kitti_bin", folder / "000007.label")), label=True)


def test_the_robot_is_what_it_is_said_to_be(tmp_path):
    path = write_kitti(tmp_path)
    assert read_scan(path, Robot(radius_m=0.0)).dropped.on_robot == 0
    assert read_scan(path, Robot(radius_m=6.0)).dropped.on_robot == 2
    boxed = read_scan(path, Robot(radius_m=0.0, box_m=(-8.0, 1.0, -1.0, 4.0)))
    assert boxed.dropped.on_robot == 2
    assert boxed.points.tolist() == ROWS[:1, :3].tolist()


@pytest.mark.parametrize("wrong", [{"radius_m": -1.0}, {"radius_m": NAN}, {"box_m": (1.0, 0.0, 0.0, 1.0)}])
def test_a_robot_that_is_none_is_refused(wrong):
    with pytest.raises(UsageError, match=next(iter(wrong))):
        Robot(**wrong)


@pytest.mark.parametrize("row", [[0.0, 0.0, 0.0, 0.0], [NAN, NAN, NAN, 0.0]])
def test_a_scan_of_nothing_is_empty_and_says_why(tmp_path, row):
    scan = read_scan(write_kitti(tmp_path, rows=np.tile(np.float32(row), (50, 1))))
    assert scan.points.shape == (0, 3)
    assert scan.dropped.no_return + scan.dropped.not_finite == 50


def write_all(folder):
    yield write_ply(folder / "binary.ply", table(label=True))
    yield write_ply(folder / "text.ply", table(label=True), order="=")
    for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED):
        yield write_pcd(folder / f"{encoding.value}.pcd", encoding)
    yield write_kitti(folder)


def test_a_truncated_file_is_refused(tmp_path):
    for path in write_all(tmp_path):
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) - 30])
        with pytest.raises(BadInputError):
            read_scan(path)


@pytest.mark.parametrize("count", [6, 8])
def test_labels_of_another_length_are_refused(tmp_path, count):
    path = write_kitti(tmp_path)
    np.zeros(count, "<u4").tofile(tmp_path / "000007.label")
    with pytest.raises(BadInputError, match="do not belong together"):
        read_scan(path)


def test_something_else_is_refused(tmp_path):
    for name in ("a.ply", "a.pcd"):
        (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(200))
        with pytest.raises(BadInputError, match="not a point cloud"):
            read_scan(tmp_path / name)
    (tmp_path / "a.bin").write_bytes(np.random.default_rng(1).bytes(16_000))
    with pytest.raises(BadInputError, match="does not hold float32"):
        read_scan(tmp_path / "a.bin")
    (tmp_path / "a.las").write_bytes(b"LASF" + bytes(400))
    with pytest.raises(BadInputError, match="bumpymap map"):
        read_scan(tmp_path / "a.las")


def test_labels_that_are_no_ids_are_refused(tmp_path):
    rows = np.zeros(3, [("x", "f4"), ("y", "f4"), ("z", "f4"), ("label", "i4")])
    rows["x"], rows["label"] = 5.0, [1, -2, 3]
    with pytest.raises(BadInputError, match="labels"):
        read_scan(write_ply(tmp_path / "a.ply", rows))


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
