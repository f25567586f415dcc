"""What drone software writes, mapped: a DSM as its points are, an orthophoto as photo.tif, and a project of ODM."""

import json
import shlex
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
import rasterio
from click.testing import CliRunner
from pyproj import Transformer
from raster_files import NORTH, WEST, ground, middles, write_raster
from rasterio.transform import Affine
from small_surveys import run, write_las

import bumpymap
from bumpymap.cli import main

pytestmark = pytest.mark.slow
HEIGHTS = ground().astype(np.float32)
MIDDLE = WEST + 14.0


def mapped(out, *arguments):
    outcome = run("map", *arguments, "--out", out, "--threads", 1, code=0)
    return outcome.output


def cloud(path):
    x, y = (side.ravel() for side in middles(HEIGHTS.shape))
    return write_las(path, x, y, HEIGHTS.astype(np.float64).round(2).ravel(), scales=(0.001, 0.001, 0.01))


def test_a_dsm_is_mapped_as_its_pixels_would_be_as_points(tmp_path):
    half = len(HEIGHTS) // 2
    write_raster(tmp_path / "dsm" / "north.tif", HEIGHTS[:half], compress="deflate")
    south = Affine(0.2, 0, WEST, 0, -0.2, NORTH - 0.2 * half)
    write_raster(
        tmp_path / "dsm" / "south.tif", HEIGHTS[half:], transform=south, tiled=True, blockxsize=16, blockysize=16
    )
    mapped(tmp_path / "by_points", cloud(tmp_path / "site.laz"))
    mapped(tmp_path / "by_dsm", tmp_path / "dsm")
    found, wanted = (pq.read_table(tmp_path / out / "tiles.parquet").to_pylist() for out in ("by_dsm", "by_points"))
    assert str(found) == str(wanted)  # NaN too
    record = json.loads((tmp_path / "by_dsm" / "run.json").read_text())
    assert "GeoTIFF (DSM), float32, pixels of 0.2 m" in record["inputs"][0]["format"]
    assert any("a DSM has one height for each pixel" in warning for warning in record["warnings"])
    assert record["inputs"][0]["dropped"]["not_a_number"] == 0


def test_a_dtm_is_measured_from_ground_and_bars_nothing_by_an_obstacle(tmp_path):
    layers = bumpymap.map_survey(write_raster(tmp_path / "dtm.tif", HEIGHTS), tmp_path / "out", dtm=True, threads=1)
    assert layers.manifest["ground_only"]
    assert layers.manifest["settings"]["dtm"]


def colours(easting, northing):
    """Red in the west, blue in the east, with a green that grows to the north, (3, ...), 8 bits."""
    green = np.clip((northing - NORTH + 30.0) * 8.0, 0, 255)
    return np.stack([200 * (easting < MIDDLE), green, 200 * (easting >= MIDDLE)]).astype(np.uint8)


def ortho(path, crs="EPSG:32614", alpha=False, scale=1, dtype="uint8"):
    """Pixels of about 5 cm over the site and 3 m around it."""
    step = 0.05 if crs == "EPSG:32614" else 4.5e-7
    west, north = Transformer.from_crs("EPSG:32614", crs, always_xy=True).transform(WEST - 3, NORTH + 3)
    row, col = np.mgrid[:760, :760] + 0.5
    x, y = west + col * step, north - row * step
    bands = colours(*Transformer.from_crs(crs, "EPSG:32614", always_xy=True).transform(x, y)).astype(dtype) * scale
    if alpha:
        bands = np.concatenate([bands, (255 * (row > 300))[None].astype(dtype)])
    how = {"photometric": "RGB", **({"alpha": "YES"} if alpha else {})}
    return write_raster(path, bands, crs=crs, transform=Affine(step, 0, west, 0, -step, north), **how)


def photo_of(out):
    """Colours (3, n) and whether they are known (n,), with those wanted, of pixels of photo.tif off the border."""
    with rasterio.open(out / "rasters" / "photo.tif") as file:
        (step, _, west, _, down, north), sides = file.transform[:6], (file.width, file.height)
        x, y = np.meshgrid(
            *(
                start + by * (np.arange(n) + 0.5)
                for start, by, n in zip((west, north), (step, down), sides, strict=True)
            )
        )
        inside = (np.abs(x - MIDDLE) > 1) & (x > WEST + 3) & (x < WEST + 25) & (y < NORTH - 3) & (y > NORTH - 25)
        return file.read((1, 2, 3))[:, inside], file.dataset_mask()[inside], colours(x[inside], y[inside]), y[inside]


@pytest.mark.parametrize(
    "how", [{}, {"crs": "EPSG:4326"}, {"dtype": "uint16", "scale": 256}, {"dtype": "uint16", "scale": 16}], ids=str
)
def test_an_orthophoto_of_any_crs_and_depth_is_the_photo_of_a_cloud_without_colours(tmp_path, how):
    mapped(tmp_path / "out", cloud(tmp_path / "site.laz"), "--photo", ortho(tmp_path / "ortho.tif", **how))
    found, known, wanted, _ = photo_of(tmp_path / "out")
    assert known.all()
    assert np.abs(found.astype(int) - wanted).max() < 25  # JPEG
    assert "photo.tif" in (tmp_path / "out" / "map.qgs").read_text()


def test_what_an_orthophoto_leaves_out_is_not_known(tmp_path):
    mapped(tmp_path / "out", cloud(tmp_path / "site.laz"), "--photo", ortho(tmp_path / "ortho.tif", alpha=True))
    _, known, _, northing = photo_of(tmp_path / "out")
    edge = NORTH + 3 - 15.0
    assert not known[northing > edge + 1].any()
    assert known[northing < edge - 1].all()


def test_another_orthophoto_is_another_map_and_the_same_one_is_done(tmp_path):
    site, photo = cloud(tmp_path / "site.laz"), ortho(tmp_path / "ortho.tif")
    mapped(tmp_path / "out", site, "--photo", photo)
    assert "Already done" in mapped(tmp_path / "out", site, "--photo", photo)
    ortho(photo, alpha=True)
    outcome = run("map", site, "--photo", photo, "--out", tmp_path / "out")
    assert (outcome.exit_code, "photo was" in outcome.output) == (3, True)


PHOTOS = {
    "grey": (lambda p: write_raster(p, np.zeros((8, 8), np.uint8)), "1 band of uint8"),
    "floats": (lambda p: write_raster(p, np.zeros((3, 8, 8), np.float32)), "3 bands of float32"),
    "nowhere": (lambda p: write_raster(p, np.zeros((3, 8, 8), np.uint8), transform=Affine.identity()), "where it lies"),
    "elsewhere": (
        lambda p: write_raster(p, np.zeros((3, 8, 8), np.uint8), transform=Affine(1, 0, WEST + 900, 0, -1, NORTH)),
        "lies beside the survey",
    ),
    "no raster": (lambda p: p.write_bytes(b"II*\0" + bytes(99)) and p, "cannot read"),
    "missing": (lambda p: p, "cannot read"),
}


@pytest.mark.parametrize("name", PHOTOS)
def test_what_is_no_orthophoto_of_the_site_is_refused_before_the_points_are_read(tmp_path, name):
    write, why = PHOTOS[name]
    outcome = run("map", cloud(tmp_path / "a.laz"), "--photo", write(tmp_path / "o.tif"), "--out", tmp_path / "out")
    assert (outcome.exit_code, why in outcome.output, (tmp_path / "out").exists()) == (3, True, False), outcome.output


def test_a_project_of_odm_is_mapped_as_it_is_with_its_orthophoto(tmp_path):
    odm = tmp_path / "site"
    cloud(odm / "odm_georeferencing" / "odm_georeferenced_model.laz")
    ortho(odm / "odm_orthophoto" / "odm_orthophoto.tif")
    write_raster(odm / "odm_dem" / "dsm.tif", HEIGHTS + 1.0)
    said = " ".join(mapped(tmp_path / "out", odm).split())
    assert "odm_georeferencing/odm_georeferenced_model.laz and odm_orthophoto/odm_orthophoto.tif" in said
    assert photo_of(tmp_path / "out")[1].all()
    assert "orthophoto: " in run("info", odm).output
    assert json.loads(CliRunner().invoke(main, ["info", str(odm), "--json"]).stdout)["photo"]


def test_a_batch_maps_dsms_and_projects(tmp_path):
    write_raster(tmp_path / "night" / "north.tif", HEIGHTS)
    cloud(tmp_path / "night" / "odm" / "odm_georeferencing" / "odm_georeferenced_model.laz")
    ortho(tmp_path / "night" / "odm" / "odm_orthophoto" / "odm_orthophoto.tif")
    (tmp_path / "night" / "north.tif").rename(tmp_path / "north.tif")
    (tmp_path / "list.csv").write_text("survey,name,photo\nnorth.tif,north,\nnight/odm,odm,\n")
    run("batch", tmp_path / "list.csv", "--out", tmp_path / "out", "--jobs", 1, code=0)
    assert (tmp_path / "out" / "odm" / "rasters" / "photo.tif").exists()
    assert not (tmp_path / "out" / "north" / "rasters" / "photo.tif").exists()


@pytest.mark.realdata
def test_the_two_commands_from_a_pcd_to_nav2_on_a_real_cloud(tmp_path, shared_data):
    page = (Path(__file__).parents[2] / "docs" / "pages" / "slam-to-nav2.md").read_text()
    cloud_of_robot = shared_data / "scans" / "patchwork_128ch" / "000000.pcd"
    for line in page.split("```")[1].strip().splitlines():
        words = [str(tmp_path / word) if word.startswith("slam_") else word for word in shlex.split(line)[1:]]
        run(*(str(cloud_of_robot) if word == "slam.pcd" else word for word in words), code=0)
    datum = json.loads((tmp_path / "slam_nav2" / "datum.json").read_text())
    assert (datum["datum"]["x"], datum["datum"]["y"]) == (0.0, 0.0)
    assert "map.pgm" in (tmp_path / "slam_nav2" / "map.yaml").read_text()
