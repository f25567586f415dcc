"""PLY and PCD: the same points from every encoding, and headers that cannot be believed."""

import shutil
import struct
from dataclasses import replace

import numpy as np
import pytest
from ply_files import write_ply
from survey_kinds import TABLES, read_points, write_table

from bumpymap.core.errors import BadInputError
from bumpymap.readers import ReadOptions, open_survey

POINTS = np.array([[1.5, 2.25, 3.0], [0.0, 0.0, 0.0], [-4.0, 5.5, -6.25], [7.0, 8.0, 9.5], [0.5, 0.25, 1.0]])
every_form = pytest.mark.parametrize("form", TABLES)
PLY = [form for form in TABLES if form.startswith("ply")]


def write(path, form="ply little", points=POINTS, dtype=np.float64, more=None, **how):
    """Write points, and columns of other names, in one of the ``TABLES``."""
    return write_table(path, form, dict(zip("xyz", points.T.astype(dtype), strict=True)) | (more or {}), **how)


def faces(name="face", count=2):
    data = np.zeros(count, [("vertex_indices", object)])
    data["vertex_indices"] = [np.arange(3, dtype=np.int32) + i for i in range(count)]
    return name, data


@every_form
@pytest.mark.parametrize("chunk", [1, 3, 100])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_every_encoding_and_precision(tmp_path, form, dtype, chunk):
    path = write(tmp_path / "a", form, dtype=dtype, more={"ring": np.arange(5, dtype=np.uint16)})
    reader = open_survey(path)
    points, ground = read_points(reader, chunk)
    assert np.array_equal(points, POINTS)  # a point at the origin is a point
    assert not ground.any()
    info = reader.info
    assert (info.point_count, info.bounds, info.has_classes, info.georeference.crs) == (5, None, False, None)
    assert form[4:] in info.format
    assert form.startswith("pcd") or np.dtype(dtype).name in info.format


@every_form
@pytest.mark.parametrize("spelling", ["classification", "scalar_Classification", "class"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_classes(tmp_path, form, spelling, dtype):
    classes = {spelling: np.array([2, 1, 7, 18, 2], dtype)}
    reader = open_survey(write(tmp_path / "a", form, more=classes))
    points, ground = read_points(reader, 2)
    assert np.array_equal(points, POINTS[[0, 1, 4]])
    assert ground.tolist() == [True, False, True]
    assert reader.dropped == {"withheld": 0, "noise": 2, "not_a_number": 0}
    assert reader.info.has_classes is True


@every_form
@pytest.mark.parametrize("chunk", [1, 2, 100])
def test_coordinates_that_are_no_numbers(tmp_path, form, chunk):
    """NaN in PCD is a beam without return; in PLY it is damage, as an infinite coordinate is in both."""
    points = POINTS.copy()
    points[0] = points[3, 1] = np.nan
    reader = open_survey(write(tmp_path / "a", form, points))
    if form.startswith("pcd"):
        assert np.array_equal(read_points(reader, chunk)[0], POINTS[[1, 2, 4]])
        assert reader.dropped == {"withheld": 0, "noise": 0, "not_a_number": 2}
    else:
        with pytest.raises(BadInputError, match=r"holds 2 points.*first is point 0 "):
            list(reader.clouds(chunk))
    points[:4] = np.inf if form.startswith("ply") else np.nan
    points[3] = [np.inf, 1.0, 2.0]
    wanted = r"holds 4 points.*first is point 0 " if form.startswith("ply") else r"holds 1 points.*first is point 3 "
    with pytest.raises(BadInputError, match=wanted):
        list(open_survey(write(tmp_path / "b", form, points)).clouds(chunk))


@pytest.mark.parametrize(
    ("kind", "old", "new", "says"),
    [
        ("ply", "element vertex", "element splat", r"without a 'vertex' element.*splat"),
        ("ply", "double z", "double height", "have no z; they have x, y, height"),
        ("ply", "vertex 5", "vertex 0", "holds no points"),
        *(("ply", "vertex 5", f"vertex {many}", f"declares {many:,} points but holds") for many in (6, 10**6, 10**18)),
        ("pcd", "POINTS 5", "POINTS -4", "header"),
        ("pcd", "COUNT 1 1 1", "COUNT 1 1 0", "header"),
        ("pcd", "COUNT 1 1 1", "COUNT 1 1 9999999", "declares 10,000,001 values per point"),
        ("pcd", "SIZE 8 8 8", "SIZE 8 8", "different length"),
        ("pcd", "\nDATA ", "\nDATA x", "header"),
        ("pcd", "TYPE F F F", "TYPE Q F F", "header"),
        *(("pcd", "POINTS 5", f"POINTS {many}", f"declares {many:,} points but holds") for many in (6, 10**6, 2**62)),
    ],
)
def test_headers_that_cannot_be_believed(tmp_path, kind, old, new, says):
    for form in [form for form in TABLES if form.startswith(kind)]:
        path = write(tmp_path / "a", form)
        path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
        with pytest.raises(BadInputError, match=says):
            list(open_survey(path).clouds())


# ---- PLY ----


@pytest.mark.parametrize("form", PLY)
def test_other_elements_are_passed_over_and_lists_in_the_way_refused(tmp_path, form):
    cameras = "camera", np.zeros(4, [("focal", "f4"), ("id", "u1")])
    before = [cameras, faces("edge")][: 2 if form == "ply ascii" else 1]
    path = write(tmp_path / "a.ply", form=form, before=before, after=[faces()])
    for chunk in (1, 2, 100):
        assert np.array_equal(read_points(open_survey(path), chunk)[0], POINTS)
    rows = np.zeros(5, [("x", "f8"), ("y", "f8"), ("z", "f8"), ("seen_by", object)])
    rows["seen_by"] = [[1, 2], [3], [4, 5, 6], [7], [8]]
    with pytest.raises(BadInputError, match=r"has lists \(seen_by\) and is not read.*Export it again"):
        open_survey(write_ply(tmp_path / "a.ply", rows, order=TABLES[form]))
    if form != "ply ascii":
        with pytest.raises(BadInputError, match=r"lists \(vertex_indices\) of its element 'face', before its vertices"):
            open_survey(write(tmp_path / "b.ply", form=form, before=[faces()]))


@pytest.mark.parametrize("line_end", [b"\n", b"\r\n"])
def test_line_ends_spare_blanks_and_more_digits_than_a_float_has(tmp_path, line_end):
    text = b"ply|format ascii 1.0|comment X|element vertex 3|property float x|property float y|property float z|"
    text += b"end_header|1 2 3 |  4   5 6||500000.001 4000000.002 10.003|"
    path = tmp_path / "a.ply"
    path.write_bytes(text.replace(b"|", line_end))
    for chunk in (1, 2, 3):
        points, _ = read_points(open_survey(path), chunk)
        assert points.tolist() == [[1, 2, 3], [4, 5, 6], [500000.001, 4000000.002, 10.003]]
    head, data = write(path).read_bytes().split(b"end_header\n")
    path.write_bytes(head.replace(b"\n", line_end) + b"end_header" + line_end + data)
    assert np.array_equal(read_points(open_survey(path))[0], POINTS)


BINARY = [form for form in TABLES if form.split()[1] != "ascii"]


@pytest.mark.parametrize("form", BINARY)
def test_coordinates_too_large_for_float32_are_refused(tmp_path, form):
    """Between 2**19 and 2**20 float32 has steps of 1/16 m: a quarter of a pixel of 0.25 m, more of one of 0.2 m."""
    far = POINTS + np.array([394554.0, 640383.0, 790.0])
    coarse, fine = write(tmp_path / "a.ply", form, far, np.float32), ReadOptions(pixel_m=0.2)
    with pytest.raises(BadInputError, match=r"0\.0625 m.*float32.*0\.2 m.*double.*local"):
        open_survey(coarse, fine)
    assert open_survey(coarse, ReadOptions(pixel_m=0.25)).info.point_count == 5
    assert open_survey(write(tmp_path / "b.ply", form, far), fine).info.notes == ()
    assert open_survey(write(tmp_path / "c.ply", form, dtype=np.float32), fine).info.notes == ()
    strays = np.concatenate([np.zeros((2, 3)), np.tile(far, (3, 1))])
    with pytest.raises(BadInputError, match="float32"):  # the first points lie at the origin
        open_survey(write(tmp_path / "d.ply", form, strays, np.float32), fine)
    feet = POINTS + np.array([1_594_554.0, 1_040_383.0, 790.0])  # steps of 1/8 ft
    fine = replace(fine, xy_unit="ft")
    assert open_survey(write(tmp_path / "e.ply", form, feet, np.float32), fine).info.notes


def test_large_coordinates_in_float32_and_the_pose_of_the_sensor_are_noted(tmp_path, caplog):
    far = POINTS + np.array([394554.0, 440383.0, 790.0])
    (note,) = open_survey(write(tmp_path / "a.ply", points=far, dtype=np.float32)).info.notes
    assert note in caplog.text
    assert "0.03125" in note  # the spacing of float32 between 2**18 and 2**19
    path = write(tmp_path / "a.pcd", "pcd binary")
    path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0.0 0.0 0.0", b"VIEWPOINT 9.0 0.0 0.0"))
    assert any("VIEWPOINT" in note for note in open_survey(path).info.notes)


# ---- PCD ----


def bomb(path, points, claimed=0):
    """Write a compressed file of zeros, of 4 bytes for each 375 that it unpacks to; it may claim to unpack to more."""
    lzf = pytest.importorskip("lzf")
    packed = lzf.compress(bytes(16 * points))
    head = (
        "VERSION 0.7\nFIELDS x y z intensity\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 1\nHEIGHT 1\n"
        f"WIDTH {points}\nPOINTS {points}\nDATA binary_compressed\n"
    )
    path.write_bytes(head.encode() + struct.pack("<II", len(packed), claimed or 16 * points) + packed)
    return path


@pytest.mark.parametrize(
    ("points", "claimed", "memory", "says"),
    [
        (100_000, 1_600_016, 1 << 40, "declares 1,600,016 bytes of unpacked points, and 100,000 points of 16"),
        (
            20_000_000,
            0,
            1 << 40,
            r"would unpack to 320 MB, \d+ times its size.*DATA binary",
        ),  # whatever memory there is
        (100_000, 0, 3_200_000, r"as a whole, which needs 3 MB; 3 MB are available.*DATA binary.*`memory`"),
        (100_000, 0, 3_300_000, None),
    ],
)
def test_a_compressed_file_unpacks_to_its_points_and_to_no_flood(tmp_path, points, claimed, memory, says):
    path = bomb(tmp_path / "a.pcd", points, claimed)
    if says is None:
        assert len(read_points(open_survey(path, ReadOptions(memory=memory)))[0]) == points
    else:
        with pytest.raises(BadInputError, match=says):
            open_survey(path, ReadOptions(memory=memory))


# ---- files that are something else ----


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "is empty"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n", "git lfs pull"),
        (b"PK\x03\x04" + bytes(50), "ZIP"),
        (b"\x89MCAP0\r\n" + bytes(50), "a bag of ROS 2, which bumpymap scan reads"),
        (b"SQLite format 3\0" + bytes(50), "If it is a bag"),
        (b"#ROSBAG V2.0\n" + bytes(50), "rosbags-convert"),
        (b"\x1f\x8b\x08" + bytes(50), "gzip"),
        (b"ASTM-E57" + bytes(50), "E57"),
        (b"<!DOCTYPE html><title>404</title>", "HTML"),
        (b"1.0 2.0 3.0\n4.0 5.0 6.0\n", "text file"),
        (b"plyers of the sea\n", "text file"),
        (bytes(5000), "zero bytes"),
        (b"\x89PNG\r\n\x1a\n" + bytes(50), "of an unknown kind .first bytes 89 50 4e"),
    ],
)
def test_what_is_no_point_cloud_is_named(tmp_path, content, says):
    path = tmp_path / "a.laz"
    path.write_bytes(content)
    with pytest.raises(BadInputError, match=says):
        open_survey(path)


def test_content_counts_and_not_the_ending(las, tmp_path):
    path = tmp_path / "really.ply"
    shutil.copy(las.write("a.laz"), path)
    reader = open_survey(path)
    assert reader.info.format.startswith("LAZ")
    assert np.array_equal(read_points(reader)[0], las.points)
