"""Maps for Nav2, read by ports of the rules of their readers in Nav2, and what holds for every export.

github.com/ros-navigation/navigation2: nav2_map_server/src/map_io.cpp (loadMapYaml, loadMapFromFile, mode raw),
nav2_costmap_2d/plugins/static_layer.cpp (interpretValue), nav2_costmap_2d/src/costmap_2d.cpp (a costmap of an
occupancy grid), plugins/costmap_filters (keepout_filter.cpp, speed_filter.cpp), nav2_smac_planner/src/node_2d.cpp
(getTraversalCost).
"""

import json
import math

import numpy as np
import pytest
import rasterio
import yaml
from PIL import Image
from pyproj import CRS, Geod

from bumpymap.core import NO_TILE, BadInputError, Barred, Georeference, OutputError, UsageError
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

FREE, LETHAL, INSCRIBED, NO_INFORMATION = 0, 254, 253, 255


class OccupancyGrid:
    """map_io: all keys are required, the image lies beside the file, rows are turned upside down."""

    def __init__(self, path):
        doc = yaml.safe_load(path.read_text())
        assert {"image", "resolution", "origin", "free_thresh", "occupied_thresh", "negate"} <= set(doc)
        assert doc["mode"] == "raw"
        self.x, self.y, yaw = map(float, doc["origin"])
        assert yaw == 0.0
        assert 0.0 < doc["free_thresh"] < doc["occupied_thresh"] < 1.0
        shade = np.asarray(Image.open(path.parent / doc["image"]).convert("L"), float) / 255.0
        value = np.round(shade * 255.0)
        self.data = np.where((value >= 0) & (value <= 100), value, -1).astype(np.int8)[::-1]  # row 0 is the south
        self.resolution = float(doc["resolution"])

    def world(self, row, col):
        return self.x + (col + 0.5) * self.resolution, self.y + (row + 0.5) * self.resolution


def static_layer(grid, params):
    """interpretValue for each cell, as unsigned char."""
    value = grid.data.astype(np.uint8).astype(int)
    threshold = params["lethal_cost_threshold"]
    scaled = np.floor(value / threshold * LETHAL).astype(int)
    if params.get("trinary_costmap", True):
        scaled[:] = FREE
    scaled[value >= threshold] = LETHAL
    scaled[value == params.get("inscribed_obstacle_cost_value", 99)] = INSCRIBED
    unknown = NO_INFORMATION if params["track_unknown_space"] else FREE
    scaled[value == params["unknown_cost_value"]] = unknown
    return scaled


def speed_limit(value, base, multiplier):
    """Percent of the top speed; None: no limit."""
    assert value != -1, "unknown cells are errors: the last limit stays"
    limit = value * multiplier + base
    return None if value == 0 or not 0.0 <= limit <= 100.0 else limit


def exported(route_map, out, **settings):
    done = export_map(route_map, out, ExportSettings(to="nav2", **settings))
    params = yaml.safe_load((out / "nav2_params.yaml").read_text())
    grids = [OccupancyGrid(out / f"{name}.yaml") for name in ("map", "keepout_mask", "speed_mask")]
    return done.record, params, grids


def tile_values(folder, name):
    with rasterio.open(folder / name) as file:
        return file.read(1)[::-1]  # row 0 is the south


@pytest.fixture(scope="module")
def whole(route_map, tmp_path_factory):
    return exported(route_map, tmp_path_factory.mktemp("nav2") / "out")


def test_a_costmap_keeps_graded_cost_and_knows_what_is_unknown(whole, folder):
    record, params, (grid, _, _) = whole
    settings = params["global_costmap"]["global_costmap"]["ros__parameters"]
    costmap = static_layer(grid, settings)
    barred, cost = tile_values(folder, "rasters/barred.tif"), tile_values(folder, "cost.tif")
    assert costmap.shape == barred.shape
    unknown = (barred == Barred.UNKNOWN) | (barred == NO_TILE)
    passable = barred == Barred.NO
    assert (costmap[unknown] == NO_INFORMATION).all()
    assert (costmap[~unknown & ~passable] == LETHAL).all()
    assert (costmap[passable] < INSCRIBED).all()
    assert len(np.unique(costmap[passable])) > 10
    multiplier = params["planner_server"]["ros__parameters"]["GridBased"]["cost_travel_multiplier"]
    planner = 1.0 + multiplier * costmap[passable] / 252.0
    step = (record["cost"]["value_98"] - 1.0) / 98.0
    assert np.abs(planner - cost[passable]).max() < 1.1 * step  # half a step of rounding, and decimals dropped
    assert record["cost"]["value_98"] == pytest.approx(np.nanmax(cost), rel=1e-6)
    assert record["tiles"]["passable"] == passable.sum()
    assert record["tiles"]["unknown"] == (barred == Barred.UNKNOWN).sum()


def test_the_speed_filter_keeps_the_ride_under_the_limit(route_map, folder, tmp_path):
    _, params, (_, _, mask) = exported(route_map, tmp_path / "out", comfort=0.2)
    info = params["speed_info_server"]["ros__parameters"]
    assert info["type"] == 1
    c_r = tile_values(folder, "rasters/roughness.tif")
    for value, ride in zip(mask.data.ravel().tolist(), c_r.ravel().tolist(), strict=True):
        limit = speed_limit(value, info["base"], info["multiplier"])
        assert limit is not None, "0 would mean: no limit"
        if math.isnan(ride):
            assert limit == 1
        elif limit > 1:
            assert ride * 2.0 * limit / 100.0 <= 0.2 * (1 + 1e-9)
            assert limit == 100 or ride * 2.0 * (limit + 1) / 100.0 > 0.2


@pytest.mark.parametrize(
    ("resolution", "around"), [("tile", (110_010.0 * 3 + 1.0, 680_008.0 * 3 + 2.0)), ("pixel", None)]
)
def test_cells_lie_where_the_survey_has_them(route_map, folder, tmp_path, around, resolution):
    """Origin at the lower left corner, the first row of the image in the north, shifted by the datum."""
    crop = {} if around is None else {"around": around, "radius": 9.0}
    record, _, (grid, mask, _) = exported(route_map, tmp_path / "out", resolution=resolution, **crop)
    datum = record["datum"]
    rng = np.random.default_rng(1)
    rows, cols = (rng.integers(0, size, 20_000) for size in grid.data.shape)
    x, y = grid.world(rows, cols)
    places = list(zip((x + datum["x"]).tolist(), (y + datum["y"]).tolist(), strict=True))
    with rasterio.open(folder / "rasters/barred.tif") as file:
        barred = np.array([value[0] for value in file.sample(places)])
    with rasterio.open(folder / "rasters/obstacle.tif") as file:
        pixel = np.array([value[0] for value in file.sample(places)])
    cell, kept = grid.data[rows, cols], mask.data[rows, cols]
    unknown, passable = np.isin(barred, [Barred.UNKNOWN, NO_TILE]), barred == Barred.NO
    obstacle, unseen = ((pixel == 1), (pixel == 3)) if resolution == "pixel" else (pixel == 9, pixel == 9)
    assert (cell[~unknown & ~passable] == 100).all()
    assert (cell[obstacle] == 100).all()
    assert (cell[unknown & ~obstacle] == -1).all()
    assert (cell[passable & unseen] == -1).all()
    assert (passable & unseen).any() == (resolution == "pixel")
    seen = passable & ~obstacle & ~unseen
    assert ((cell[seen] >= 0) & (cell[seen] <= 98)).all()
    assert (kept == np.where(seen, 0, 100)).all()  # keepout_filter.cpp: 100 is lethal, 0 changes nothing
    size = 3.0 if resolution == "tile" else 0.2
    assert grid.resolution == pytest.approx(size, abs=1e-12)
    assert np.fmod(abs(grid.x) + 1e-7, grid.resolution) < 1e-5  # aligned with the origin
    if around is not None:
        assert grid.data.shape == (7 * round(3 / size), 7 * round(3 / size))


def test_cost_is_scaled_the_same_in_every_crop_if_asked(route_map, tmp_path):
    middle = ((110_010 + 0.5) * 3, (680_008 + 0.5) * 3)
    crops = [
        exported(route_map, tmp_path / str(radius), around=middle, radius=radius, datum=(0.0, 0.0), max_cost=7.0)
        for radius in (4.0, 13.0)
    ]
    (small, large) = (crop[2][0] for crop in crops)
    off = [round((small.x - large.x) / 3), round((small.y - large.y) / 3)]
    rows, cols = small.data.shape
    np.testing.assert_array_equal(small.data, large.data[off[1] : off[1] + rows, off[0] : off[0] + cols])
    assert crops[0][0]["datum"]["x"] == 0.0


def test_parameters_fit_together(whole):
    _, params, _ = whole
    servers = {name: part["ros__parameters"] for name, part in params.items() if "ros__parameters" in part}
    info = servers["keepout_info_server"]
    assert (info["type"], info["base"], info["multiplier"]) == (0, 0.0, 1.0)
    costmap = params["global_costmap"]["global_costmap"]["ros__parameters"]
    assert costmap["static_layer"]["map_topic"] == servers["map_server"]["topic_name"]
    for name in ("keepout", "speed"):
        topic = servers[f"{name}_info_server"]["filter_info_topic"]
        assert costmap[f"{name}_filter"]["filter_info_topic"] == topic
        assert servers[f"{name}_info_server"]["mask_topic"] == servers[f"{name}_mask_server"]["topic_name"]
    managed = set(servers["lifecycle_manager_bumpymap"]["node_names"])
    assert managed == {name for name in servers if name.endswith("_server")} - {"controller_server", "planner_server"}
    assert costmap["robot_radius"] == 0.7


def test_what_cannot_be_exported(route_map, tmp_path, monkeypatch):
    for wrong in ({"to": "ros"}, {"max_cost": 1.0}, {"every": 0}, {"around": (float("inf"), 0.0)}):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            ExportSettings(**wrong)
    with pytest.raises(BadInputError, match="nothing of the map lies within"):
        export_map(route_map, tmp_path / "out", ExportSettings(around=(110_000.0 * 3 - 500, 680_000.0 * 3)))
    for to, told in (("nav2", "`around`"), ("gridmap", "`resolution='tile'`")):
        monkeypatch.setattr(f"bumpymap.views.export.{to}._MAX_CELLS", 100)
        with pytest.raises(BadInputError, match=told):
            export_map(route_map, tmp_path / "out", ExportSettings(to=to, resolution="pixel"))
    assert not (tmp_path / "out").exists()


GRAPH, NAV2 = ExportSettings(to="graph"), ExportSettings(to="nav2")


def snapshot(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_an_earlier_export_is_replaced_only_if_asked(easy_map, route_map, tmp_path):
    out = tmp_path / "out"
    export_map(easy_map, out, NAV2)
    before = snapshot(out)
    assert sorted(before) == sorted(path.name for path in out.iterdir())
    with pytest.raises(OutputError, match="`overwrite=True`"):
        export_map(route_map, out, NAV2)
    with pytest.raises(OutputError, match="in another format"):
        export_map(route_map, out, GRAPH, overwrite=True)
    assert snapshot(out) == before
    done = export_map(route_map, out, NAV2, overwrite=True)
    after = snapshot(out)
    assert set(after) == set(before)
    assert after["map.pgm"] != before["map.pgm"]
    assert json.loads(after["datum.json"]) == done.record
    assert [path.name for path in done.files][-1] == "datum.json"


@pytest.mark.parametrize("to", ["nav2", "gridmap", "graph", "cost"])
def test_the_same_map_has_the_same_bytes(easy_map, tmp_path, to):
    for name in ("a", "b"):
        export_map(easy_map, tmp_path / name, ExportSettings(to=to))
    assert snapshot(tmp_path / "a") == snapshot(tmp_path / "b")


def test_other_files_stay_links_are_not_followed_and_layers_are_no_place_for_it(easy_map, easy_folder, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "mine"
    out.mkdir()
    for path in (out / "notes.txt", mine):
        path.write_text("mine")
    (out / "map.pgm").symlink_to(mine)
    with pytest.raises(OutputError, match=r"map\.pgm"):
        export_map(easy_map, out, NAV2)
    export_map(easy_map, out, NAV2, overwrite=True)
    assert mine.read_text() == (out / "notes.txt").read_text() == "mine"
    assert not (out / "map.pgm").is_symlink()
    before = snapshot(easy_folder)
    (tmp_path / "odd" / "graph.geojson").mkdir(parents=True)
    for place, told in ((easy_folder, "holds the layers of a run"), (mine, "a file"), (tmp_path / "odd", "not a file")):
        with pytest.raises(OutputError, match=told):
            export_map(easy_map, place, GRAPH, overwrite=True)
    assert snapshot(easy_folder) == before


def test_the_datum_says_where_the_frame_lies(easy_map, make_field, write_map, tmp_path):
    """A way to the north and one to the east of the frame, laid on the ellipsoid from the datum; metres on any map."""
    foot = 1200.0 / 3937.0
    tennessee = Georeference(CRS.from_epsg(2274), foot, foot)  # US survey feet
    west, south = int(1_740_000 * foot / 3), int(660_000 * foot / 3)
    feet_map = write_map(make_field(8, 6, west=west, south=south, georeference=tennessee, easy=True), tmp_path / "feet")
    for site, code, unit in ((easy_map, "EPSG:32614", 1.0), (open_map(feet_map), "EPSG:2274", foot)):
        record = export_map(site, tmp_path / code, NAV2).record
        datum, area, window = record["datum"], record["area"], site.window
        assert (datum["crs"]["code"], record["resolution_m"]) == (code, 3.0)
        assert [(datum[axis] * unit + 1e-6) % 3.0 < 1e-5 for axis in "xy"] == [True, True]
        assert area["east"] - area["west"] == pytest.approx(window.cols * 3.0)
        corner = (datum["x"] * unit + area["west"], datum["y"] * unit + area["south"])
        np.testing.assert_allclose(corner, (window.col * 3.0, window.row * 3.0), atol=1e-6)
        geod = Geod(ellps="WGS84")
        for east, north in ((0.0, 50.0), (50.0, 0.0)):
            end = site.to_lonlat(datum["x"] * unit + east, datum["y"] * unit + north)
            azimuth, _, length = geod.inv(datum["longitude"], datum["latitude"], *end)
            bearing = math.degrees(math.atan2(east, north)) + datum["grid_convergence_deg"]
            assert azimuth == pytest.approx(bearing, abs=1e-3)
            assert length == pytest.approx(50.0 / datum["grid_scale"], rel=1e-5)
        assert abs(datum["grid_convergence_deg"]) > 0.1
