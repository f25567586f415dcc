"""PLY, PCD and rasters of heights: the same points from every encoding, and headers that cannot be believed."""

import shutil
import struct
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from point_files import NORTH, TABLES, WEST, ground, middles, read_points, write_ply, write_raster, write_table
from rasterio.transform import Affine

from bumpymap.core import BadInputError
from bumpymap.readers import ReadOptions, find_surveys, open_survey, project_photo

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


HEIGHTS = ground(70, 90)
EMPTY = np.zeros(HEIGHTS.shape, bool)
EMPTY[10:25, 30:50] = True
STORED = {
    "strips": {},
    "one strip": {"blockysize": 70, "compress": "deflate"},
    "tiles": {"tiled": True, "blockxsize": 32, "blockysize": 16},
    "deflate": {"compress": "deflate", "predictor": 3, "tiled": True, "blockxsize": 16, "blockysize": 16},
    "lzw": {"compress": "lzw"},
    "zstd": {"compress": "zstd"},
    "lerc": {"compress": "lerc", "max_z_error": 0.0},
    "packbits": {"compress": "packbits"},
    "bigtiff": {"BIGTIFF": "YES"},
    "big endian": {"ENDIANNESS": "BIG"},
    "float64": {"dtype": "float64"},
    "nan is nodata": {"nodata": np.nan},
    "undeclared": {"nodata": None},
    "cog": {"driver": "COG", "blocksize": 128},
}


def points_of(path, points=500_000, **options):
    """Easting, northing and height of all points, in some order of their own, and their kinds."""
    reader = open_survey(path, ReadOptions(**options))
    clouds = [reader.convert(chunk, reader.fetch(chunk)).cloud for chunk in reader.chunks(points)]
    table = np.concatenate([np.column_stack([c.easting, c.northing, c.upward]) for c in clouds])
    return table[np.lexsort(table.T)], np.concatenate([c.kind for c in clouds])


def wanted():
    table = np.stack([*middles(HEIGHTS.shape), HEIGHTS], axis=-1)[~EMPTY]
    return table[np.lexsort(table.T.round(6))]


@pytest.mark.parametrize("name", STORED)
def test_the_middles_of_pixels_with_a_height_are_points_however_they_are_stored(tmp_path, name):
    how = {"dtype": "float32", "nodata": -9999.0} | STORED[name]
    held = np.where(
        EMPTY, -9999.0 if how["nodata"] != how["nodata"] or how["nodata"] is None else how["nodata"], HEIGHTS
    )
    held = np.where(EMPTY & (name == "nan is nodata"), np.nan, held).astype(how["dtype"])
    found, _ = points_of(write_raster(tmp_path / "dsm.tif", held, **how))
    np.testing.assert_allclose(found, wanted(), atol=1e-4)


def test_whole_numbers_with_scale_and_offset_and_a_mask(tmp_path):
    held = np.rint((HEIGHTS - 100.0) / 0.01).astype(np.int16)
    path = write_raster(tmp_path / "dsm.tif", held, scale=0.01, mask=(~EMPTY * 255).astype(np.uint8))
    np.testing.assert_allclose(points_of(path)[0], wanted(), atol=1e-4)


def test_south_up(tmp_path):
    upside = Affine(0.2, 0, WEST, 0, 0.2, NORTH - 0.2 * len(HEIGHTS))
    held = np.where(EMPTY, np.nan, HEIGHTS)[::-1].astype(np.float32)
    np.testing.assert_allclose(
        points_of(write_raster(tmp_path / "a.tif", held, transform=upside))[0], wanted(), atol=1e-4
    )


@pytest.mark.parametrize("points", [7, 1000])
@pytest.mark.parametrize("name", ["strips", "one strip", "tiles"])
def test_every_pixel_is_in_one_chunk(tmp_path, points, name):
    path = write_raster(tmp_path / "dsm.tif", HEIGHTS.astype(np.float32), **STORED[name])
    chunks = open_survey(path).chunks(points)
    assert [chunk.first for chunk in chunks] == np.cumsum([0, *(chunk.points for chunk in chunks)])[:-1].tolist()
    assert max(chunk.points for chunk in chunks) <= points
    np.testing.assert_array_equal(points_of(path, points)[0], points_of(path)[0])


def test_units_of_the_crs_the_band_and_the_vertical_datum(tmp_path):
    feet = {"crs": "EPSG:2227+6360", "pixel": 1.0}  # US survey feet, both
    found, _ = points_of(write_raster(tmp_path / "feet.tif", HEIGHTS.astype(np.float32), **feet))
    foot = 1200 / 3937
    assert found[:, 2].max() == pytest.approx(HEIGHTS.max() * foot, abs=1e-4)
    assert found[:, 0].min() == pytest.approx((WEST + 0.5) * foot, abs=1e-6)
    path = write_raster(tmp_path / "band.tif", HEIGHTS.astype(np.float32))
    with rasterio.open(path, "r+") as file:
        file.units = ("ft",)
    assert points_of(path)[0][:, 2].max() == pytest.approx(HEIGHTS.max() * 0.3048, abs=1e-4)
    path = write_raster(tmp_path / "datum.tif", HEIGHTS.astype(np.float32), crs="EPSG:32614+5703")
    assert open_survey(path).info.georeference.crs.sub_crs_list[-1].to_epsg() == 5703


def test_a_dtm_is_ground_and_a_dsm_is_not_classified(tmp_path):
    path = write_raster(tmp_path / "a.tif", HEIGHTS.astype(np.float32))
    assert set(points_of(path, keep_classes=True)[1]) == {1}
    assert set(points_of(path, keep_classes=True, dtm=True)[1]) == {2}
    assert "so none bars a tile" in " ".join(open_survey(path, ReadOptions(dtm=True)).info.notes)


def rgb(rows=8, cols=8):
    return np.full((3, rows, cols), 99, np.uint8)


def huge(path, side, block=256):
    """A raster without a single block, of some kilobytes to megabytes."""
    how = {"driver": "GTiff", "dtype": "float32", "count": 1, "height": side, "width": side, "crs": "EPSG:32614"}
    how |= {"tiled": True, "blockxsize": block, "blockysize": block, "sparse_ok": True, "BIGTIFF": "YES"}
    with rasterio.open(path, "w", transform=Affine(0.05, 0, WEST, 0, -0.05, NORTH), **how):
        pass
    return path


FLAT = np.full((8, 8), 5, np.float32)
REFUSED = {
    "rotated": (lambda p: write_raster(p, FLAT, transform=Affine(0.2, 0.1, WEST, 0.1, -0.2, NORTH)), "gdalwarp"),
    "nowhere": (lambda p: write_raster(p, FLAT, transform=Affine.identity()), "does not say where it lies"),
    "picture": (lambda p: write_raster(p, rgb()), "3 bands of uint8.*`photo`"),
    "hillshade": (lambda p: write_raster(p, FLAT.astype(np.uint8)), "hillshade"),
    "complex": (lambda p: write_raster(p, FLAT.astype(np.complex64)), "Heights are one band"),
    "coarse": (lambda p: write_raster(p, FLAT, pixel=1.5), "1.5 m wide.*at most 1 m"),
    "degrees": (
        lambda p: write_raster(p, FLAT, crs="EPSG:4326", transform=Affine(1e-6, 0, -99.1, 0, -1e-6, 19.4)),
        "gdalwarp -r bilinear -t_srs EPSG:32614",
    ),
    "block of 4 GB": (lambda p: huge(p, 32_768, 32_768), "blocks of 4,295 MB"),
    "1.6e11 pixels": (lambda p: huge(p, 400_000, 4096), "declares 160,000,000,000 pixels"),
    "4e8 pixels of nothing": (lambda p: huge(p, 20_000, 4096), "for each byte"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_in_a_sentence(tmp_path, name):
    write, why = REFUSED[name]
    with pytest.raises(BadInputError, match=f"(?s){why}") as caught:
        open_survey(write(tmp_path / "dsm.tif"))
    assert "dsm.tif" in str(caught.value)


def test_damage_is_reported_with_the_file(tmp_path):
    path = write_raster(tmp_path / "dsm.tif", ground().astype(np.float32), compress="deflate", blockysize=16)
    data = path.read_bytes()
    for cut in (9, 200, len(data) // 2, len(data) - 10):
        path.write_bytes(data[:cut])
        with pytest.raises(BadInputError, match=r"dsm\.tif"):
            points_of(path)
    path.write_bytes(data[:1000] + bytes(len(data) - 1000))
    with pytest.raises(BadInputError, match="cannot read the heights of"):
        points_of(path)


def test_files_beside_a_raster_are_not_read(tmp_path):
    path = write_raster(tmp_path / "dsm.tif", FLAT, transform=Affine.identity(), crs=None)
    path.with_suffix(".tfw").write_text(f"0.2\n0\n0\n-0.2\n{WEST}\n{NORTH}\n")
    with pytest.raises(BadInputError, match="a file beside it does, which is not read"):
        open_survey(path)


def test_a_folder_gives_its_clouds_or_else_its_rasters_but_no_layers(tmp_path):
    dsm, layer, ortho = (write_raster(tmp_path / n, FLAT) for n in ("dsm.tif", "out/rasters/cost.tif", "b/part.TIFF"))
    (tmp_path / "out" / "run.json").write_text("{}")
    assert find_surveys([tmp_path]) == sorted([dsm, ortho])
    (tmp_path / "b" / "site.laz").write_bytes(b"LASF")
    assert find_surveys([tmp_path]) == [tmp_path / "b" / "site.laz"]
    assert find_surveys([layer]) == [layer]


def test_a_project_of_odm_gives_its_cloud_or_else_its_dsm_and_its_orthophoto(tmp_path):
    odm = tmp_path / "site"
    dsm = write_raster(odm / "odm_dem" / "dsm.tif", FLAT)
    for other in ("odm_dem/dtm.tif", "odm_filterpoints/point_cloud.ply", "entwine_pointcloud/ept.json"):
        (odm / other).parent.mkdir(exist_ok=True)
        (odm / other).write_bytes(b"")
    assert (find_surveys([odm]), project_photo([odm])) == ([dsm], None)
    photo = write_raster(odm / "odm_orthophoto" / "odm_orthophoto.tif", rgb())
    cloud = odm / "odm_georeferencing" / "odm_georeferenced_model.laz"
    cloud.parent.mkdir()
    cloud.write_bytes(b"LASF")
    assert (find_surveys([tmp_path]), find_surveys([odm]), project_photo([odm])) == ([cloud], [cloud], photo)
    assert project_photo([odm, tmp_path]) is None
