"""The vertical CRS of a survey, from the file or the command line into every layer that holds heights."""

import json

import geopandas
import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from alike_surveys import alike_surveys
from click.testing import CliRunner
from pyproj import CRS

from bumpymap.cli import main
from bumpymap.core import Georeference
from bumpymap.layers.folder import layer_metadata

COMPOUND = CRS("EPSG:32614+5703")
GEOKEYS = {1024: 1, 3072: 32614, 4096: 5703}


def run(*arguments):
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


def write_las(path, wkt=None, geokeys=None):
    rng = np.random.default_rng(0)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = (500_000, 4_000_000, 0), (0.001, 0.001, 0.001)
    header.global_encoding.wkt = wkt is not None
    if wkt:
        header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", wkt.encode() + b"\0"))
    if geokeys:
        words = [1, 1, 0, len(geokeys)] + [word for key in sorted(geokeys) for word in (key, 0, 1, geokeys[key])]
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", np.array(words, "<u2").tobytes()))
    las = laspy.LasData(header)
    las.x, las.y = rng.uniform(500_001, 500_016, 20_000), rng.uniform(4_000_002, 4_000_017, 20_000)
    las.z = 100 + 0.01 * rng.standard_normal(20_000)
    las.write(path)
    return path


@pytest.fixture(scope="module")
def flat(tmp_path_factory):
    """Layers of the survey without a vertical CRS."""
    folder = tmp_path_factory.mktemp("flat")
    with alike_surveys():
        result = run("map", write_las(folder / "site.las", CRS(32614).to_wkt("WKT1_GDAL")), "--out", folder / "out")
    assert result.exit_code == 0, result.output
    return folder / "out"


@pytest.mark.parametrize(
    ("records", "options"),
    [
        ({"wkt": COMPOUND.to_wkt("WKT1_GDAL")}, []),
        ({"geokeys": GEOKEYS}, []),
        ({}, ["--crs", "EPSG:32614+5703"]),
    ],
    ids=["WKT", "GeoTIFF keys", "--crs"],
)
def test_layers_with_heights_carry_it_and_others_do_not(tmp_path, monkeypatch, flat, records, options):
    out = tmp_path / "out"
    # The metadata name the vertical CRS in every layer, see below; here they are those of the survey without one.
    monkeypatch.setattr(
        "bumpymap.layers.folder.layer_metadata", lambda manifest, _: layer_metadata(manifest, Georeference(None))
    )
    with alike_surveys():
        result = run("map", write_las(tmp_path / "site.las", **records), "--out", out, *options)
    assert result.exit_code == 0, result.output
    with rasterio.open(out / "heightmap.tif") as raster:
        assert CRS.from_wkt(raster.crs.to_wkt()) == COMPOUND
        assert not (out / "heightmap.tif.aux.xml").exists()
        with rasterio.open(flat / "heightmap.tif") as plain:
            assert plain.crs.to_epsg() == 32614
            np.testing.assert_array_equal(raster.read(1), plain.read(1))
    tiles, plain = (geopandas.read_parquet(folder / "tiles.parquet") for folder in (out, flat))
    assert tiles.crs == COMPOUND
    assert plain.crs.to_epsg() == 32614
    np.testing.assert_array_equal(tiles.to_crs(4326).bounds, plain.to_crs(4326).bounds)
    crs = json.loads((out / "run.json").read_text(encoding="utf-8"))["crs"]
    assert crs["code"] == "EPSG:32614+5703"
    assert CRS.from_wkt(crs["wkt"]) == COMPOUND
    assert CRS.from_user_input(crs["code"]) == COMPOUND
    assert pyogrio.read_info(out / "cost.fgb")["crs"] == "EPSG:32614"
    for name in ("roughness.tif", "class.tif", "cost.geojson"):
        assert (out / name).read_bytes() == (flat / name).read_bytes(), name


@pytest.mark.parametrize(
    ("wkt", "text"),
    [
        (COMPOUND.to_wkt("WKT1_GDAL"), "NAVD88 height (EPSG:5703); heights in metres"),
        (CRS(32614).to_wkt("WKT1_GDAL"), "none given; heights as in the survey, in metres"),
        (CRS("EPSG:2271+6360").to_wkt("WKT1_GDAL"), "NAVD88 height (ftUS) (EPSG:6360); heights in metres"),
    ],
)
def test_every_layer_names_it_in_its_metadata(tmp_path, wkt, text):
    out = tmp_path / "out"
    result = run("map", write_las(tmp_path / "site.las", wkt), "--out", out)
    assert result.exit_code == 0, result.output
    for raster in out.glob("*.tif"):
        with rasterio.open(raster) as file:
            assert file.tags()["vertical_crs"] == text
    assert pq.read_schema(out / "tiles.parquet").metadata[b"vertical_crs"].decode() == text
    assert json.loads((out / "cost.geojson").read_text(encoding="utf-8"))["vertical_crs"] == text
    assert pyogrio.read_info(out / "cost.fgb")["layer_metadata"]["vertical_crs"] == text
