"""reach.tif and isochrones.geojson, read back by others."""

import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio
import shapely
from pyproj import Geod
from rio_cogeo.cogeo import cog_validate
from route_records import UTM

from bumpymap.core import BadInputError
from bumpymap.layers import ReachField
from bumpymap.layers.reach import write_isochrones, write_reach
from bumpytiles import BLOCK_TILES, Grid, TileWindow

WINDOW = TileWindow(160_003, 680_007, 3 * BLOCK_TILES + 5, 2 * BLOCK_TILES + 3)


@pytest.fixture(scope="module")
def reach():
    """Cost grows with the distance from a tile; a strip in the east cannot be reached."""
    rows, cols = np.mgrid[: WINDOW.rows, : WINDOW.cols]
    cost = (3.0 * np.hypot(rows - 20, cols - 15)).astype(np.float32)
    cost[:, -7:] = np.nan
    return ReachField(UTM, Grid(), WINDOW, cost, cost / 60.0)


@pytest.mark.parametrize("with_minutes", [True, False])
def test_another_reader_reads_the_raster_bit_for_bit(reach, with_minutes, tmp_path):
    reach = reach if with_minutes else replace(reach, minutes=None)
    path = tmp_path / "reach.tif"
    write_reach(reach, path, {"vehicle": "warthog"})
    assert cog_validate(path)[0]
    with rasterio.open(path) as file:
        assert file.descriptions == (("cost", "minutes") if with_minutes else ("cost",))
        assert file.units == (("m", "min") if with_minutes else ("m",))
        assert (file.crs.to_epsg(), np.isnan(file.nodata), file.tags()["vehicle"]) == (32614, True, "warthog")
        np.testing.assert_array_equal(file.read(1), reach.cost)
        if with_minutes:
            np.testing.assert_array_equal(file.read(2), reach.minutes)
        assert file.xy(0, 0) == (WINDOW.col * 3.0 + 1.5, (WINDOW.row + WINDOW.rows) * 3.0 - 1.5)


def isochrones(reach, levels, path, by="cost"):
    write_isochrones(reach, levels, path, by=by, about={"vehicle": "warthog"})
    collection = json.loads(path.read_text(), parse_constant=pytest.fail)
    shapes = [
        None if feature["geometry"] is None else shapely.geometry.shape(feature["geometry"])
        for feature in collection["features"]
    ]
    return collection, shapes


def test_isochrones_hold_the_ground_within_their_level(reach, tmp_path):
    levels = [30.0, 90.0, 60.0, 60.0]
    collection, shapes = isochrones(reach, levels, tmp_path / "isochrones.geojson")
    properties = [feature["properties"] for feature in collection["features"]]
    assert [entry["within"] for entry in properties] == [90.0, 60.0, 30.0]
    assert (collection["vehicle"], properties[0]["unit"]) == ("warthog", "m")
    assert collection["bbox"] == pytest.approx(shapes[0].bounds)
    for level, entry, shape in zip([90.0, 60.0, 30.0], properties, shapes, strict=True):
        assert shape.is_valid
        assert shape.geom_type == "MultiPolygon"
        tiles = int((reach.cost <= level).sum())
        assert entry["area_m2"] == 9.0 * tiles
        area = abs(Geod(ellps="WGS84").geometry_area_perimeter(shape)[0])
        assert area == pytest.approx(9.0 * tiles, rel=2e-3)  # the scale of the projection
        for polygon in shape.geoms:
            assert polygon.exterior.is_ccw
            assert not any(hole.is_ccw for hole in polygon.interiors)
    assert shapes[0].buffer(1e-7).covers(shapes[1])
    assert shapes[1].buffer(1e-7).covers(shapes[2])


def test_minutes_and_what_none_can_reach(reach, tmp_path):
    collection, shapes = isochrones(reach, [1.0, 0.5], tmp_path / "a.geojson", by="minutes")
    assert [feature["properties"]["unit"] for feature in collection["features"]] == ["min", "min"]
    assert all(shapes)
    nothing = replace(reach, cost=np.full_like(reach.cost, np.nan))
    collection, shapes = isochrones(nothing, [5.0], tmp_path / "b.geojson")
    assert (shapes, "bbox" in collection) == ([None], False)


@pytest.mark.parametrize("levels", [[], [0.0, 5.0], [float("nan")]])
def test_levels_that_mean_nothing_are_refused(reach, levels, tmp_path):
    with pytest.raises(BadInputError, match="positive"):
        write_isochrones(reach, levels, tmp_path / "a.geojson", by="cost")
    assert not list(tmp_path.iterdir())
