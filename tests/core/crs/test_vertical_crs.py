"""The vertical CRS of a survey, from the file into every layer that holds heights."""

import json

import geopandas
import laspy
import numpy as np
import pyarrow.parquet as pq
import pyogrio
import pytest
import rasterio
from click.testing import CliRunner
from pyproj import CRS

from bumpymap.cli import main


def write_las(path, wkt):
    rng = np.random.default_rng(0)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = (500_000, 4_000_000, 0), (0.001, 0.001, 0.001)
    header.global_encoding.wkt = True
    header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", wkt.encode() + b"\0"))
    las = laspy.LasData(header)
    las.x, las.y = rng.uniform(500_001, 500_016, 20_000), rng.uniform(4_000_002, 4_000_017, 20_000)
    las.z = 100 + 0.01 * rng.standard_normal(20_000)
    las.write(path)
    return path


@pytest.mark.parametrize(
    ("crs", "text"),
    [
        ("EPSG:32614+5703", "NAVD88 height (EPSG:5703); heights in metres"),
        ("EPSG:32614", "none given; heights as in the survey, in metres"),
        ("EPSG:2271+6360", "NAVD88 height (ftUS) (EPSG:6360); heights in metres"),
    ],
)
def test_layers_with_heights_carry_it_others_do_not_and_all_name_it(tmp_path, crs, text):
    out, crs = tmp_path / "out", CRS(crs)
    survey = write_las(tmp_path / "site.las", crs.to_wkt("WKT1_GDAL"))
    result = CliRunner().invoke(main, ["map", str(survey), "--out", str(out)])
    assert result.exit_code == 0, result.output
    in_metres = crs if "ftUS" not in text else crs.sub_crs_list[0]
    for path in out.glob("*.tif"):
        with rasterio.open(path) as raster:
            assert raster.tags()["vertical_crs"] == text
            assert CRS.from_wkt(raster.crs.to_wkt()) == (
                in_metres if path.stem in {"heightmap", "relief"} else crs.to_2d()
            )
    tiles = geopandas.read_parquet(out / "tiles.parquet")
    assert tiles.crs == in_metres
    assert pq.read_schema(out / "tiles.parquet").metadata[b"vertical_crs"].decode() == text
    assert json.loads((out / "cost.geojson").read_text(encoding="utf-8"))["vertical_crs"] == text
    lines = pyogrio.read_info(out / "cost.fgb")
    assert (lines["crs"], lines["layer_metadata"]["vertical_crs"]) == (crs.to_2d().to_string(), text)
    stated = json.loads((out / "run.json").read_text(encoding="utf-8"))["crs"]
    assert CRS.from_wkt(stated["wkt"]) == CRS.from_user_input(stated["code"]) == in_metres
