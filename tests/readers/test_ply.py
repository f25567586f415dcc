import numpy as np
import pytest
from ply_files import write_ply

from bumpymap.core.errors import BadInputError
from bumpymap.readers import open_survey

POINTS = np.array([[394554.5, 640383.25, 790.5], [394555.0, 640384.5, 791.0], [394556.25, 640385.0, 790.75]])
FORMATS = [("ascii", "="), ("little", "<"), ("big", ">")]


def write(path, columns, **how):
    data = np.zeros(len(next(iter(columns.values()))), [(key, value.dtype) for key, value in columns.items()])
    for key, value in columns.items():
        data[key] = value
    return write_ply(path, data, **how)


def columns(dtype=np.float64, points=POINTS, **more):
    return {axis: points[:, i].astype(dtype) for i, axis in enumerate("xyz")} | more


def faces(name="face", count=2):
    data = np.zeros(count, [("vertex_indices", object)])
    data["vertex_indices"] = [np.arange(3, dtype=np.int32) + i for i in range(count)]
    return name, data


def cameras():
    return "camera", np.zeros(4, [("focal", "f4"), ("id", "u1")])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("name", "order"), FORMATS)
def test_every_encoding_and_precision(tmp_path, read, name, order, dtype):
    path = write(tmp_path / "a.ply", columns(dtype), order=order)
    reader = open_survey(path)
    points, ground = read(reader)
    assert np.array_equal(points, POINTS)
    assert not ground.any()
    info = reader.info
    assert info.point_count == 3
    assert name in info.format
    assert np.dtype(dtype).name in info.format
    assert info.bounds is None
    assert info.has_classes is False
    assert info.georeference.crs is None


@pytest.mark.parametrize(("name", "order"), FORMATS)
def test_other_elements_and_properties_are_passed_over(tmp_path, read, name, order):
    table = {"nx": np.full(3, 1.5), "red": np.arange(3, dtype=np.uint8)} | columns()
    before = [cameras(), faces("edge")][: 2 if order == "=" else 1]
    path = write(tmp_path / "a.ply", table, order=order, before=before, after=[faces()])
    for chunk in (1, 2, 100):
        points, _ = read(open_survey(path), chunk)
        assert np.array_equal(points, POINTS)


@pytest.mark.parametrize("order", ["<", ">", "="])
def test_lists_in_vertices_and_before_binary_ones_are_refused(tmp_path, order):
    lists = np.empty(3, object)
    lists[:] = [[1, 2], [3], [4, 5, 6]]
    with pytest.raises(BadInputError, match=r"has lists \(seen_by\) and is not read.*Export it again"):
        open_survey(write(tmp_path / "a.ply", columns() | {"seen_by": lists}, order=order))
    if order != "=":
        with pytest.raises(BadInputError, match=r"lists \(vertex_indices\) of its element 'face', before its vertices"):
            open_survey(write(tmp_path / "a.ply", columns(), order=order, before=[faces()]))


@pytest.mark.parametrize("spelling", ["classification", "scalar_Classification", "Classification", "class"])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize(("name", "order"), FORMATS)
def test_classes(tmp_path, read, spelling, dtype, name, order):
    table = columns(points=POINTS[[0, 1, 2, 0, 1]], **{spelling: np.array([2, 1, 7, 18, 2], dtype)})
    reader = open_survey(write(tmp_path / "a.ply", table, order=order))
    points, ground = read(reader, 2)
    assert np.array_equal(points, POINTS[[0, 1, 1]])
    assert ground.tolist() == [True, False, True]
    assert reader.dropped == {"withheld": 0, "noise": 2, "not_a_number": 0}
    assert reader.info.has_classes is True


@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_line_ends_blank_lines_and_spare_blanks(tmp_path, read, line_end):
    text = "ply|format ascii 1.0|comment X|element vertex 3|property float x|property float y|property float z|"
    text += "end_header|1 2 3 |  4   5 6||7 8 9|"
    path = tmp_path / "a.ply"
    path.write_bytes(text.replace("|", line_end).encode())
    for chunk in (1, 2, 3):
        points, _ = read(open_survey(path), chunk)
        assert points.tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]


def test_crlf_header_of_a_binary_file(tmp_path, read):
    path = write(tmp_path / "a.ply", columns())
    head, data = path.read_bytes().split(b"end_header\n")
    path.write_bytes(head.replace(b"\n", b"\r\n") + b"end_header\r\n" + data)
    points, _ = read(open_survey(path))
    assert np.array_equal(points, POINTS)


def test_text_keeps_more_digits_than_a_float(tmp_path, read):
    path = tmp_path / "a.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        "500000.001 4000000.002 10.003\n"
    )
    reader = open_survey(path)
    assert read(reader)[0].tolist() == [[500000.001, 4000000.002, 10.003]]
    assert reader.info.notes == ()


def test_large_coordinates_in_float32_are_noted(tmp_path, caplog):
    (note,) = open_survey(write(tmp_path / "a.ply", columns(np.float32))).info.notes
    assert note in caplog.text
    assert "0.0625" in note  # the spacing of float32 between 2**19 and 2**20
    assert open_survey(write(tmp_path / "b.ply", columns(np.float64))).info.notes == ()
    small = columns(np.float32, POINTS - POINTS[0])
    assert open_survey(write(tmp_path / "c.ply", small)).info.notes == ()


@pytest.mark.parametrize(("name", "order"), FORMATS)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("chunk", [1, 2, 100])
def test_coordinates_that_are_no_numbers(tmp_path, name, order, value, chunk):
    points = np.vstack([POINTS, POINTS])
    points[1, 2] = points[4, 0] = value
    reader = open_survey(write(tmp_path / "a.ply", columns(points=points), order=order))
    with pytest.raises(BadInputError, match=r"holds 2 points.*first is point 1 "):
        list(reader.clouds(chunk))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("element vertex", "element splat", r"without a 'vertex' element.*splat"),
        ("double z", "double height", r"have no z; they have x, y, height"),
        ("vertex 3", "vertex 0", "0 vertices"),
        *(("vertex 3", f"vertex {many}", f"declares {many:,} points but holds") for many in (4, 10**6, 10**18)),
    ],
)
@pytest.mark.parametrize(("name", "order"), FORMATS)
def test_headers_that_are_none(tmp_path, name, order, old, new, says):
    path = write(tmp_path / "a.ply", columns(), order=order)
    path.write_bytes(path.read_bytes().replace(old.encode(), new.encode()))
    with pytest.raises(BadInputError, match=says):
        list(open_survey(path).clouds())
