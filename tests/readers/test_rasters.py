"""Rasters of heights: what their pixels mean, how they are stored, and what is refused."""

import numpy as np
import pytest
import rasterio
from raster_files import NORTH, WEST, ground, middles, write_raster
from rasterio.transform import Affine

from bumpymap.core import BadInputError
from bumpymap.readers import ReadOptions, find_surveys, open_survey, project_photo

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
