import struct

import numpy as np
import pytest
from pypcd4 import Encoding, PointCloud

from bumpymap.core.errors import BadInputError
from bumpymap.readers import ReadOptions, open_survey

POINTS = np.array([[1.5, 2.25, 3.0], [0.0, 0.0, 0.0], [-4.0, 5.5, -6.25], [7.0, 8.0, 9.5]])
ENCODINGS = [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED]


def write(path, points=POINTS, encoding=Encoding.BINARY, dtype=np.float32, **more):
    fields = [*"xyz", *more]
    table = [points[:, i].astype(dtype) for i in range(3)] + list(more.values())
    cloud = PointCloud.from_points(table, fields, [column.dtype for column in table])
    cloud.save(str(path), encoding)
    return path


@pytest.mark.parametrize("chunk", [1, 3, 100])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_encoding_and_precision(tmp_path, read, encoding, dtype, chunk):
    path = write(tmp_path / "a.pcd", encoding=encoding, dtype=dtype, ring=np.arange(4, dtype=np.uint16))
    reader = open_survey(path)
    points, ground = read(reader, chunk)
    assert np.array_equal(points, POINTS)  # a point at the origin is a point
    assert not ground.any()
    assert reader.info.point_count == 4
    assert encoding.value in reader.info.format


@pytest.mark.parametrize("chunk", [1, 2, 100])
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_rows_of_nan_are_beams_without_return(tmp_path, read, encoding, chunk):
    points = POINTS.copy()
    points[0] = points[3, 1] = np.nan
    reader = open_survey(write(tmp_path / "a.pcd", points, encoding))
    got, _ = read(reader, chunk)
    assert np.array_equal(got, POINTS[1:3])
    assert reader.dropped == {"withheld": 0, "noise": 0, "not_a_number": 2}


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_infinite_coordinates_are_refused(tmp_path, encoding):
    points = POINTS.copy()
    points[1], points[2, 0] = np.nan, np.inf
    with pytest.raises(BadInputError, match=r"holds 1 points.*first is point 2 "):
        list(open_survey(write(tmp_path / "a.pcd", points, encoding)).clouds())


def test_count_line_may_be_left_out_and_blanks_may_abound(tmp_path, read):
    path = tmp_path / "a.pcd"
    path.write_text(
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH 2\n"
        "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n1 2 3 \n4  5 6\n"
    )
    assert read(open_survey(path))[0].tolist() == [[1, 2, 3], [4, 5, 6]]


def test_the_pose_of_the_sensor_is_noted(tmp_path):
    path = write(tmp_path / "a.pcd")
    path.write_bytes(path.read_bytes().replace(b"VIEWPOINT 0.0 0.0 0.0", b"VIEWPOINT 9.0 0.0 0.0"))
    assert any("VIEWPOINT" in note for note in open_survey(path).info.notes)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"POINTS 4", b"POINTS 0", "holds no points"),
        (b"POINTS 4", b"POINTS -4", "header"),
        (b"COUNT 1 1 1", b"COUNT 1 1 0", "header"),
        (b"COUNT 1 1 1", b"COUNT 1 1 9999999", "declares 10,000,001 values per point"),
        (b"FIELDS x y z", b"FIELDS x y w", "have no z"),
        (b"SIZE 4 4 4", b"SIZE 4 4", "different length"),
        (b"\nDATA ", b"\nDATA x", "header"),
        (b"TYPE F F F", b"TYPE Q F F", "header"),
        *((b"POINTS 4", b"POINTS %d" % many, f"declares {many:,} points but holds") for many in (5, 10**6, 2**62)),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_headers_that_are_none(tmp_path, encoding, old, new, says):
    path = write(tmp_path / "a.pcd", encoding=encoding)
    path.write_bytes(path.read_bytes().replace(old, new))
    with pytest.raises(BadInputError, match=says):
        list(open_survey(path).clouds())


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


def test_a_compressed_file_that_memory_cannot_hold_is_refused(tmp_path, read):
    path = bomb(tmp_path / "a.pcd", 100_000)
    wanted = 2 * 1_600_000 + 3 * (path.stat().st_size - 200)
    with pytest.raises(
        BadInputError, match=r"unpacked as a whole, which needs 3 MB; 3 MB are available.*DATA binary.*`memory`"
    ):
        open_survey(path, ReadOptions(memory=wanted - 1000))
    points, _ = read(open_survey(path, ReadOptions(memory=wanted + 10_000)))
    assert len(points) == 100_000


@pytest.mark.parametrize("claimed", [1_600_016, 1_700_000])
def test_a_compressed_file_unpacks_to_its_points(tmp_path, claimed):
    with pytest.raises(
        BadInputError, match=rf"declares {claimed:,} bytes of unpacked points, and 100,000 points of 16"
    ):
        open_survey(bomb(tmp_path / "a.pcd", 100_000, claimed))


def test_much_that_is_packed_in_little_is_refused_whatever_memory_there_is(tmp_path):
    with pytest.raises(BadInputError, match=r"would unpack to 320 MB, \d+ times its size.*DATA binary"):
        open_survey(bomb(tmp_path / "a.pcd", 20_000_000), ReadOptions(memory=1 << 40))
