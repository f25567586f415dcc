"""Maps for robots: Nav2 by ports of the rules of its readers, missions, bags; pictures: what is where, in which colour.

github.com/ros-navigation/navigation2: nav2_map_server/src/map_io.cpp (loadMapYaml, loadMapFromFile, mode raw),
nav2_costmap_2d/plugins/static_layer.cpp (interpretValue), nav2_costmap_2d/src/costmap_2d.cpp (a costmap of an
occupancy grid), plugins/costmap_filters/speed_filter.cpp, nav2_smac_planner/src/node_2d.cpp (getTraversalCost).
docs.qgroundcontrol.com, developer guide, Plan File Format; github.com/mavlink/qgroundcontrol,
src/MissionManager/MissionController.cc (_loadJsonMissionFileV2) and MissionItem.cc. github.com/ANYbotics/grid_map:
grid_map_core/src/GridMapMath.cpp (getPositionFromIndex: index (0, 0) is the corner at +x, +y), grid_map_ros
GridMapMsgHelpers.hpp (layout: dimension 0 is column_index, data column by column).
"""

import json
import math
import shutil
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
import yaml
from cost_maps import make_field
from hypothesis import given, settings, strategies as st
from PIL import Image
from pyproj import CRS, Geod
from small_surveys import band, files_in, run, write_survey
from tile_maps import MadeUpMap

import bumpymap
from bumpymap.core import NO_TILE, Barred, ExportSettings, Georeference, GridSettings, PolarCells, PolarSettings, Scan
from bumpymap.core.errors import BadInputError, OutputError, UsageError
from bumpymap.core.scan_types import cell_numbers, sector_bounds
from bumpymap.layers import CLOSED_COLOUR, UNKNOWN_COLOUR, RideScale, open_map
from bumpymap.layers.scan_folder import SCAN_COLOURS, SECTOR_STATES, point_styles, sector_states
from bumpymap.scan import classify_filter, polar_sectors
from bumpymap.views import export_map, space
from bumpymap.views.light import grey_of, hard_light, levelled
from bumpymap.views.scan_picture import SIDE, paint as paint_image, write_picture
from bumpymap.views.space import painted

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


def pixel_values(folder, name):
    """Values of a raster on its pixels; row 0 is the south."""
    values = band(folder / name)[::-1]
    return values if name.endswith("obstacle.tif") else np.kron(values, np.ones((15, 15), values.dtype))


def sampled(folder, name, band, x, y, datum):
    with rasterio.open(folder / name) as file:
        places = zip((x + datum["x"]).tolist(), (y + datum["y"]).tolist(), strict=True)
        index = file.descriptions.index(band) + 1 if band else 1
        return np.array([value[0] for value in file.sample(places, indexes=index)])


@pytest.fixture(scope="module")
def whole(route_map, tmp_path_factory):
    return exported(route_map, tmp_path_factory.mktemp("nav2") / "out")


def test_a_costmap_keeps_graded_cost_and_knows_what_is_unknown(whole, folder):
    record, params, (grid, _, _) = whole
    settings = params["global_costmap"]["global_costmap"]["ros__parameters"]
    costmap = static_layer(grid, settings)
    barred, cost = pixel_values(folder, "rasters/barred.tif"), pixel_values(folder, "cost.tif")
    objects = pixel_values(folder, "rasters/obstacle.tif")
    assert costmap.shape == barred.shape
    unknown = ((barred == Barred.UNKNOWN) | (barred == NO_TILE)) & (objects != 1)
    passable = (barred == Barred.NO) & np.isin(objects, (0, 2))
    assert (costmap[unknown] == NO_INFORMATION).all()
    assert (costmap[~unknown & (barred != Barred.NO)] == LETHAL).all()
    assert (costmap[passable] < INSCRIBED).all()
    assert len(np.unique(costmap[passable])) > 10
    multiplier = params["planner_server"]["ros__parameters"]["GridBased"]["cost_travel_multiplier"]
    planner, top = 1.0 + multiplier * costmap[passable] / 252.0, record["cost"]["value_98"]
    # Half a step of rounding, and decimals dropped.
    assert np.abs(planner - cost[passable].clip(1.0, top)).max() < 1.1 * (top - 1.0) / 98.0
    assert record["cost"]["highest"] == pytest.approx(np.nanmax(cost[passable]), rel=1e-6)
    assert record["cells"] == {
        name: int(np.isin(costmap, values).sum())
        for name, values in (("free", range(INSCRIBED)), ("lethal", [LETHAL]), ("unknown", [NO_INFORMATION]))
    }


def test_the_speed_filter_keeps_to_the_speed_made_good(whole, folder):
    record, params, (_, _, mask) = whole
    info = params["speed_info_server"]["ros__parameters"]
    assert info["type"] == 1
    speed, top = pixel_values(folder, "rasters/speed.tif"), record["speed"]["value_100_m_per_s"]
    limit = np.vectorize(speed_limit, otypes=[float])(mask.data, info["base"], info["multiplier"])
    assert np.isfinite(limit).all(), "0 would mean: no limit"
    assert (limit[np.isnan(speed)] == 1).all()
    passable = speed > 0
    assert len(np.unique(limit[passable])) > 10
    np.testing.assert_array_equal(limit[passable], np.clip(np.floor(100 * speed[passable] / top * (1 + 1e-6)), 1, 100))


@pytest.mark.parametrize("around", [(110_010.0 * 3 + 1.0, 680_008.0 * 3 + 2.0), None])
def test_cells_lie_where_the_survey_has_them(route_map, folder, tmp_path, around):
    """Origin at the lower left corner, the first row of the image in the north, shifted by the datum."""
    crop = {} if around is None else {"around": around, "radius": 9.0}
    record, _, (grid, mask, _) = exported(route_map, tmp_path / "out", **crop)
    datum = record["datum"]
    rng = np.random.default_rng(1)
    rows, cols = (rng.integers(0, size, 5_000) for size in grid.data.shape)
    x, y = grid.world(rows, cols)
    barred, pixel = (sampled(folder, f"rasters/{name}.tif", None, x, y, datum) for name in ("barred", "obstacle"))
    cell, kept = grid.data[rows, cols], mask.data[rows, cols]
    unknown, passable = np.isin(barred, [Barred.UNKNOWN, NO_TILE]), barred == Barred.NO
    obstacle, unseen = pixel == 1, pixel == 3
    assert (cell[~unknown & ~passable] == 100).all()
    assert (cell[obstacle] == 100).all()
    assert (cell[unknown & ~obstacle] == -1).all()
    assert (cell[passable & unseen] == -1).all()
    assert (passable & unseen).any()
    seen = passable & ~obstacle & ~unseen
    assert ((cell[seen] >= 0) & (cell[seen] <= 98)).all()
    assert (kept == np.where(seen, 0, 100)).all()  # keepout_filter.cpp: 100 is lethal, 0 changes nothing
    assert grid.resolution == pytest.approx(0.2, abs=1e-12)
    assert np.fmod(abs(grid.x) + 1e-7, grid.resolution) < 1e-5  # aligned with the origin
    if around is not None:
        assert grid.data.shape == (105, 105)


@pytest.mark.parametrize("resolution", ["pixel", "tile"])
def test_no_obstacle_lies_in_a_free_cell(obstacle_site, tmp_path, resolution):
    """Posts and walls from 0.2 m on, and boxes, anywhere in their cells, with classes of points and without."""
    site, on_obstacles = obstacle_site
    _, _, (grid, mask, _) = exported(site, tmp_path / "out", resolution=resolution, datum=(0.0, 0.0))
    row, col = (
        np.floor((on_obstacles[:, axis] - low) / grid.resolution + 1e-6).astype(int)
        for axis, low in ((1, grid.y), (0, grid.x))
    )
    assert (grid.data[row, col] == 100).all()
    assert (mask.data[row, col] == 100).all()
    assert (grid.data >= 0)[mask.data == 0].all()
    assert (mask.data == 0).mean() > 0.4


def test_a_coarse_cell_is_as_the_worst_of_its_pixels(obstacle_site, tmp_path):
    site, _ = obstacle_site
    fine, coarse = (exported(site, tmp_path / name, resolution=name)[2][0].data for name in ("pixel", "tile"))
    inside = fine.reshape(coarse.shape[0], 15, coarse.shape[1], 15)
    worst = np.select([(inside == 100).any(axis=(1, 3)), (inside == -1).any(axis=(1, 3))], [100, -1], 0)
    np.testing.assert_array_equal(np.where(coarse <= 98, np.minimum(coarse, 0), coarse), worst)
    assert set(np.unique(worst)) == {-1, 0, 100}


def test_no_cell_is_free_on_ground_that_fails_everywhere(tmp_path):
    """As of a tile that a step closes, and of which what is left fails too, beside one with room for the vehicle."""
    bumpymap.map_survey(Path(__file__).parents[2] / "sample_data" / "quarry.laz", tmp_path / "layers")
    site = open_map(tmp_path / "layers")
    record, _, (grid, _, _) = exported(site, tmp_path / "out")
    assert math.isfinite(record["cost"]["highest"])
    fails = site.read(site.window).p_fail[::-1] >= 0.5
    assert fails.any()
    assert not ((grid.data >= 0) & (grid.data < 100))[np.kron(fails, np.ones((15, 15), np.bool_))].any()


def test_costs_have_one_scale_for_a_vehicle(whole, tmp_path):
    """Very rough ground is 98: C_r at the limit of class 3, half of the drives fail; a level site stays far below."""
    assert whole[0]["cost"]["value_98"] == pytest.approx(1.0 + 2.5 * 0.4 + 300.0 * math.log(2.0) / 10.0)
    bumpymap.map_survey(write_survey(tmp_path / "level.las"), tmp_path / "level")
    for resolution in ("pixel", "tile"):
        record, _, (grid, _, _) = exported(open_map(tmp_path / "level"), tmp_path / resolution, resolution=resolution)
        cost, top = record["cost"]["highest"], record["cost"]["value_98"]
        assert grid.data[grid.data < 100].max() == round(98 * (cost - 1.0) / (top - 1.0)) < 10
        assert f"98: {top:.3f}" in (tmp_path / resolution / "map.yaml").read_text()


@pytest.mark.parametrize("scale", [{}, {"max_cost": 7.0}])
def test_cost_is_scaled_the_same_in_every_crop(route_map, tmp_path, scale):
    crop = {"around": ((110_010 + 0.5) * 3, (680_008 + 0.5) * 3), "datum": (0.0, 0.0)} | scale
    small, large = (exported(route_map, tmp_path / f"{far}", radius=far, **crop)[2][0] for far in (4.0, 13.0))
    col, row = round((small.x - large.x) / 0.2), round((small.y - large.y) / 0.2)
    rows, cols = small.data.shape
    np.testing.assert_array_equal(small.data, large.data[row : row + rows, col : col + cols])
    assert small.x == 110_009 * 3.0  # from the datum


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
    for wrong in ({"to": "ros"}, {"max_cost": 1.0}, {"resolution": "cm"}, {"around": (float("inf"), 0.0)}):
        with pytest.raises(UsageError, match=next(iter(wrong))):
            ExportSettings(**wrong)
    with pytest.raises(BadInputError, match="nothing of the map lies within"):
        export_map(route_map, tmp_path / "out", ExportSettings(around=(110_000.0 * 3 - 500, 680_000.0 * 3)))
    for to, module in (("nav2", "area"), ("gridmap", "gridmap")):
        monkeypatch.setattr(f"bumpymap.views.export.{module}._MAX_CELLS", 8_100)
        with pytest.raises(BadInputError, match=r"`around` and `radius=6` or less, .*`resolution='tile'`"):
            export_map(route_map, tmp_path / "out", ExportSettings(to=to))
    assert not (tmp_path / "out").exists()


GRIDMAP, NAV2 = ExportSettings(to="gridmap"), ExportSettings(to="nav2")


def test_an_export_is_replaced_only_if_asked_never_by_another_format_and_never_layers(easy_map, easy_folder, tmp_path):
    out, before = tmp_path / "out", files_in(easy_folder)
    done = export_map(easy_map, out, NAV2)
    assert json.loads((out / "datum.json").read_text()) == done.record
    for options, place, words in (
        (NAV2, out, "`overwrite=True`"),
        (GRIDMAP, out, "in another format"),
        (GRIDMAP, easy_folder, "holds the layers of a survey"),
    ):
        with pytest.raises((OutputError, UsageError), match=words):
            export_map(easy_map, place, options, overwrite=options is GRIDMAP)
    export_map(easy_map, out, NAV2, overwrite=True)
    assert files_in(easy_folder) == before


def test_the_datum_says_where_the_frame_lies(easy_map, write_map, tmp_path):
    """A way to the north and one to the east of the frame, laid on the ellipsoid from the datum; metres on any map."""
    foot = 1200.0 / 3937.0
    tennessee = Georeference(CRS.from_epsg(2274), foot, foot)  # US survey feet
    west, south = int(1_740_000 * foot / 3), int(660_000 * foot / 3)
    feet_map = write_map(make_field(8, 6, west=west, south=south, georeference=tennessee, easy=True), tmp_path / "feet")
    for site, code, unit in ((easy_map, "EPSG:32614", 1.0), (open_map(feet_map), "EPSG:2274", foot)):
        record = export_map(site, tmp_path / code, NAV2).record
        datum, area, window = record["datum"], record["area"], site.window
        assert (datum["crs"]["code"], record["resolution_m"]) == (code, 0.2)
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


# ---- missions, bags, and grids of scans ----


def load_plan(folder):
    """Return home (lat, lon, altitude) and waypoints (lat, lon, altitude); what the loader requires is there."""
    plan = json.loads((folder / "route.plan").read_text(), parse_constant=pytest.fail)
    assert (plan["fileType"], plan["version"]) == ("Plan", 1)
    assert plan["geoFence"]["version"] == plan["rallyPoints"]["version"] == 2
    mission = plan["mission"]
    assert mission["version"] == 2
    for name in ("firmwareType", "vehicleType", "cruiseSpeed", "hoverSpeed"):
        assert isinstance(mission[name], int | float)
    assert mission["vehicleType"] == 10  # MAV_TYPE_GROUND_ROVER
    assert len(mission["plannedHomePosition"]) == 3
    for number, item in enumerate(mission["items"], start=1):
        assert (item["type"], item["doJumpId"], item["autoContinue"]) == ("SimpleItem", number, True)
        assert (item["command"], item["frame"], len(item["params"])) == (16, 3, 7)
        assert item["params"][3] is None  # a heading of NaN: as the way goes
        assert item["Altitude"] == item["params"][6]
    return mission["plannedHomePosition"], [item["params"][4:] for item in mission["items"]], mission["cruiseSpeed"]


def line_on(route_map, seed=0, corners=7):
    rng = np.random.default_rng(seed)
    bounds = route_map.grid.window_bounds(route_map.window)
    east, north = rng.uniform(bounds.west, bounds.east, corners), rng.uniform(bounds.south, bounds.north, corners)
    return np.stack(route_map.to_lonlat(east, north), axis=1).round(7)


def route_file(path, places, *, collection=True, kind="LineString", **about):
    feature = {"type": "Feature", "properties": {"name": "route"} | about}
    feature["geometry"] = {"type": kind, "coordinates": places}
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [0, 0]}}
    record = {"type": "FeatureCollection", "features": [point, feature]} if collection else feature
    path.write_text(json.dumps(record))
    return path


def export_plan(site, out, route=None, **options):
    return export_map(site, out, ExportSettings(to="plan", route=route, **options))


@pytest.mark.parametrize("kind", ["collection", "feature", "heights", "parts"])
def test_the_corners_are_the_waypoints(route_map, tmp_path, kind):
    line = line_on(route_map)
    places = line.tolist() if kind != "heights" else [[*place, 12.5] for place in line.tolist()]
    about = {"collection": kind == "collection"}
    if kind == "parts":
        about["kind"], places = "MultiLineString", [places[:3], places[3:]]
    done = export_plan(route_map, tmp_path / "out", route_file(tmp_path / "route.geojson", places, **about))
    home, waypoints, speed = load_plan(tmp_path / "out")
    np.testing.assert_array_equal(np.array(waypoints)[:, :2], line[:, ::-1])
    assert (np.array(waypoints)[:, 2] == 0).all()
    assert home[:2] == waypoints[0][:2]
    assert speed == 2.0
    assert done.record["plan"]["waypoints"] == len(line)


def test_home_is_as_high_as_the_ground_at_the_start(route_map, tmp_path):
    window = route_map.window
    row, col = np.argwhere(route_map.read(window, ()).barred == 0)[0]
    start = route_map.to_lonlat((window.col + col + 0.5) * 3.0, (window.row + window.rows - row - 0.5) * 3.0)
    export_plan(route_map, tmp_path / "out", route_file(tmp_path / "r.json", [start, start]))
    heights = route_map.heights(window).reshape(window.rows, 15, window.cols, 15)[row, :, col]
    assert load_plan(tmp_path / "out")[0][2] == pytest.approx(np.nanmean(heights), abs=0.006)


def test_the_route_in_the_folder_of_the_layers_is_taken(easy_folder, tmp_path):
    folder = shutil.copytree(easy_folder, tmp_path / "site")
    site = open_map(folder)
    with pytest.raises(BadInputError, match="`route`"):
        export_plan(site, tmp_path / "out")
    route = route_file(folder / "route.geojson", line_on(site).tolist())
    export_plan(site, tmp_path / "out")
    export_plan(site, tmp_path / "given", folder)
    route.unlink()
    plans = [load_plan(tmp_path / name) for name in ("out", "given")]
    assert len(plans[0][1]) == 7
    assert plans[0] == plans[1]
    with pytest.raises(BadInputError, match="`route`"):  # said before that the folder is occupied
        export_plan(site, tmp_path / "out")


def geo(kind, coordinates):
    return f'{{"type": "{kind}", "coordinates": {coordinates}}}'


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"type": "FeatureCollection", "features": []}', "it holds no line"),
        (geo("LineString", "[[1, 2]]"), r"route\.geojson"),
        (geo("LineString", "[[1, 2], [NaN, 2]]"), "cannot read"),
        (geo("LineString", "[[434100, 5411200], [434110, 5411200]]"), "degrees"),
        (geo("LineString", "[[-99, 19], [9, 48]]"), "point 1 of the route, .* outside of the map"),
        ('{"format": "bumpymap-route", "routes": []}', r"it is no GeoJSON: .* must be an object with type\. Give"),
        ("\0\xff", "cannot read"),
    ],
)
def test_files_that_hold_no_route_on_the_map(route_map, tmp_path, text, words):
    (tmp_path / "route.geojson").write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInputError, match=words):
        export_plan(route_map, tmp_path / "out", tmp_path / "route.geojson")
    assert not (tmp_path / "out").exists()


def test_a_map_without_a_crs_has_no_longitudes(write_map, tmp_path):
    local = make_field(6, 5, georeference=Georeference(None), easy=True)
    local_map = open_map(write_map(local, tmp_path / "local"))
    with pytest.raises(BadInputError, match="a mission is in longitude and latitude, and the map has no CRS"):
        export_plan(local_map, tmp_path / "out", route_file(tmp_path / "r.json", [[1, 2], [1, 3]]))
    datum = export_map(local_map, tmp_path / "nav2", ExportSettings()).record["datum"]
    assert (datum["longitude"], datum["crs"]) == (None, None)


def test_a_route_that_touches_obstacles_is_taken_only_with_the_word_and_recorded(route_map, tmp_path):
    route = route_file(tmp_path / "route.geojson", line_on(route_map).tolist(), obstacle_m=3.25)
    with pytest.raises(BadInputError, match=r"touches obstacles on 3\.2 m"):
        export_plan(route_map, tmp_path / "refused", route)
    done = export_plan(route_map, tmp_path / "out", route, through_obstacles=True)
    assert done.record["plan"]["obstacle_m"] == 3.25


def read_bag(folder):
    """The one message, by the definition that the bag itself holds."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    with Reader(folder) as reader:
        (topic,) = reader.connections
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_msg(topic.msgdef.data, topic.msgtype))
        ((_, time, raw),) = reader.messages()
        assert (topic.topic, topic.msgtype, time) == ("/grid_map", "grid_map_msgs/msg/GridMap", 0)
        return store.deserialize_cdr(raw, topic.msgtype)


def cells(message, name):
    """x, y and value of every cell."""
    array = message.data[message.layers.index(name)]
    outer, inner = array.layout.dim
    assert (outer.label, inner.label) == ("column_index", "row_index")
    rows, cols = inner.size, outer.size
    assert (outer.stride, inner.stride, array.layout.data_offset) == (rows * cols, rows, 0)
    info = message.info
    assert (rows, cols) == (round(info.length_x / info.resolution), round(info.length_y / info.resolution))
    assert (message.outer_start_index, message.inner_start_index) == (0, 0)
    matrix = np.asarray(array.data, np.float32).reshape(cols, rows).T
    first = info.pose.position.x + 0.5 * (info.length_x - info.resolution)
    top = info.pose.position.y + 0.5 * (info.length_y - info.resolution)
    row, col = np.indices(matrix.shape)
    return (first - info.resolution * row).ravel(), (top - info.resolution * col).ravel(), matrix.ravel()


@pytest.mark.parametrize(
    ("resolution", "around"), [("tile", None), ("pixel", (110_010.0 * 3 + 1.0, 680_008.0 * 3 + 2.0))]
)
def test_every_cell_has_the_value_of_the_layers_bit_for_bit(route_map, folder, tmp_path, around, resolution):
    crop = {} if around is None else {"around": around, "radius": 5.0}
    out = tmp_path / "out"
    record = export_map(route_map, out, ExportSettings(to="gridmap", resolution=resolution, **crop)).record
    message = read_bag(out)
    assert message.layers == ["elevation", "c_r", "p_fail", "class", "obstacle"]
    assert message.header.frame_id == "map"
    assert message.info.resolution == pytest.approx(3.0 if resolution == "tile" else 0.2)
    pick = np.random.default_rng(0).permutation(len(cells(message, "c_r")[0]))[:2000]

    def both(layer, file, band=None, nothing=np.nan):
        """Values of the bag and of the raster at the same places."""
        x, y, value = (part[pick] for part in cells(message, layer))
        return np.nan_to_num(value, nan=nothing), sampled(folder, file, band, x, y, record["datum"])

    for name in ("c_r", "p_fail"):
        np.testing.assert_array_equal(*both(name, "rasters/roughness.tif", name))
    np.testing.assert_array_equal(*both("class", "rasters/class.tif", nothing=255.0))
    if resolution == "pixel":
        state, pixel = both("obstacle", "rasters/obstacle.tif", nothing=3.0)
        _, barred = both("obstacle", "rasters/barred.tif")
        unknown = np.isin(barred, [Barred.UNKNOWN, NO_TILE])
        wanted = np.select([pixel == 1, unknown, barred != Barred.NO], [1.0, 3.0, 1.0], np.minimum(pixel, 3.0))
        np.testing.assert_array_equal(state, wanted)
        assert set(np.unique(state)) == {0.0, 1.0, 2.0, 3.0}
        np.testing.assert_array_equal(*both("elevation", "rasters/heightmap.tif"))
        return
    window, elevation = route_map.window, message.data[message.layers.index("elevation")].data
    heights = route_map.heights(window).reshape(window.rows, 15, window.cols, 15).astype(float)
    with warnings.catch_warnings(action="ignore"):  # tiles without a height
        mean = np.nanmean(heights, axis=(1, 3))[:, ::-1]
    np.testing.assert_allclose(elevation, mean.ravel(), rtol=1e-6)


GRIDS = [
    PolarSettings(),
    PolarSettings((1.0, 4.0, 12.0), 28.0, (16, 24, 40), (2, 4, 4)),
    PolarSettings((0.0,), 25.0, (7,), (3,)),
]


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from(GRIDS), st.floats(0.2, 1.0), st.floats(1.0, 40.0), st.floats(-7.0, 7.0))
def test_points_and_places_agree(seed, polar, resolution, reach, heading):
    """The loops that sort points into sectors are the oracle: here the points are the places."""
    centre = np.arange(resolution / 2 - reach, reach, resolution)
    x, y = (values.ravel() for values in np.meshgrid(centre, centre))
    points = np.column_stack([x, y, np.random.default_rng(seed).normal(-1.0, 0.01, len(x))]).astype(np.float32)
    stack = polar_sectors(Scan(points, heading_rad=heading), replace(polar, least_points=3))
    table = np.full(int(np.dot(polar.sectors, polar.rings)) + 1, -1)
    table[cell_numbers(stack)] = np.arange(len(stack.zone))
    places = PolarCells.of(stack.settings, np.hypot(x, y), np.arctan2(y, x) / (2.0 * np.pi))
    same = table[places.cells(stack.azimuth_start_rad)] == stack.point_sector
    # Points are float32, so those on a border may fall to the other side: at most a diagonal or two.
    assert (~same).sum() <= 2 * len(centre)


def test_grids_without_cells_or_with_too_many():
    with pytest.raises(UsageError, match="resolution_m is nan; it must be a finite number greater than 0 m"):
        GridSettings(np.nan, 5.0)
    for resolution, reach in ((2.0, 1.0), (0.01, 50.0)):
        with pytest.raises(UsageError, match="at most 4,000,000"):
            GridSettings(resolution, reach)


pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
    pytest.mark.usefixtures("without_views"),
]


@pytest.fixture
def ground():
    return MadeUpMap.around()


def look(ground, side=1):
    """Return the colours of pixels, so many along each side of a tile, and each tile's number along both axes."""
    shape = ground.window.rows * side, ground.window.cols * side
    return painted(ground, np.full(shape, np.nan)), np.ix_(*(np.arange(count) // side for count in shape))


def test_level_ground_has_the_colour_of_its_ride_cost(ground):
    pixels, place = look(ground, 2)
    barred, c_r = ground.barred[place], ground.c_r[place]
    passable = np.isin(barred, (Barred.NO, Barred.OBSTACLE, Barred.STEP))  # the vehicle fits everywhere
    scale = RideScale.of(ground.manifest)
    np.testing.assert_allclose(pixels[passable], scale.colours(c_r[passable]), atol=1.5)
    closed = ~passable & ~np.isin(barred, (Barred.UNKNOWN, NO_TILE))
    for chosen, colour in ((closed, CLOSED_COLOUR), (barred == Barred.UNKNOWN, UNKNOWN_COLOUR)):
        np.testing.assert_array_equal(pixels[chosen], np.broadcast_to(colour[:3], pixels[chosen].shape))
    assert (pixels[barred == NO_TILE] == space.NO_DATA).all()


def test_a_photo_is_levelled_and_leaves_the_colours_of_the_map_where_it_is_mid_grey():
    rng = np.random.default_rng(4)
    photo = rng.uniform(50, 130, (30, 40, 3))
    photo[3, 5] = np.nan
    seen = levelled(photo)
    known = np.isfinite(photo[..., 0])
    assert np.median(grey_of(seen[known])) == pytest.approx(128, abs=2)
    assert (np.isnan(seen[..., 0]) == ~known).all()
    colours = rng.uniform(0, 255, (30, 40, 3))
    np.testing.assert_allclose(hard_light(colours, np.full(colours.shape, 128.0)), colours, atol=1.5)
    np.testing.assert_allclose(hard_light(colours, np.full(colours.shape, np.nan)), colours, atol=1.5)
    darker, lighter = (hard_light(colours, np.full(colours.shape, value)) for value in (40.0, 220.0))
    assert (darker <= colours + 1).all()
    assert (lighter >= colours - 1).all()


def test_closed_pixels_are_grey_and_not_whole_tiles():
    ground, side = MadeUpMap.around(margin=0), 15
    ground.barred[:] = Barred.SPLIT
    ground.c_r[:] = 0.1
    fits = ground.fits = np.random.default_rng(2).random((ground.window.rows * side, ground.window.cols * side)) < 0.7
    pixels, _ = look(ground, side)
    assert (pixels[~fits] == CLOSED_COLOUR[:3]).all()
    colour = RideScale.of(ground.manifest).colours(np.array(0.1))
    np.testing.assert_allclose(pixels[fits], np.tile(colour, (fits.sum(), 1)), atol=1.5)


def test_islands_are_faint_and_nothing_else_is(ground, monkeypatch):
    whole, _ = look(ground)
    zone = np.where(np.arange(ground.c_r.shape[1]) % 2, 1.0, 2.0) * np.ones_like(ground.c_r)
    counts = {"counts": {"zones": {"pieces": 2, "islands": 1}}}
    monkeypatch.setattr(type(ground), "manifest", ground.manifest | counts)
    read = lambda self, window, _: {"zone": self._cut(zone, window, np.nan)}  # noqa: E731
    monkeypatch.setattr(type(ground), "values", read, raising=False)
    pixels, _ = look(ground)
    faint = np.isin(ground.barred, (Barred.NO, Barred.OBSTACLE, Barred.STEP)) & (zone == 2)
    assert faint.any()
    own = RideScale.of(ground.manifest).colours(ground.c_r[faint])
    np.testing.assert_allclose(pixels[faint], 0.4 * own + 0.6 * 128, atol=1.5)
    np.testing.assert_array_equal(pixels[~faint], whole[~faint])


def paint(scan, classed, range_m=40.0):
    return np.asarray(paint_image(scan, classed, range_m))


def pixel(x, y, reach=40.0):
    """Forward is up, left is left."""
    return int(np.floor((reach - x) * SIDE / (2 * reach))), int(np.floor((reach - y) * SIDE / (2 * reach)))


def with_sectors(classed, **changes):
    return replace(classed, sectors=replace(classed.sectors, **changes))


def with_wall(scan, classed):
    """The wall ahead stands on ground: points of a known height, an obstacle in each of its sectors."""
    stack = classed.sectors
    wall = np.abs(scan.points[:, 0] - 14.0) < 0.1
    height = np.where(wall, scan.points[:, 2] + 1.5, np.nan).astype(np.float32)
    inside = stack.point_sector[wall]
    obstacle = np.isin(np.arange(len(stack.zone)), inside[inside >= 0])
    ground = stack.point_ground & ~wall
    return with_sectors(classed, point_height=height, obstacle=obstacle, point_ground=ground), wall


def test_the_file_holds_what_was_painted_and_the_same_bytes_every_time(scan, classed, tmp_path):
    for name in ("a.png", "b.png"):
        write_picture(scan, classed, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with rasterio.open(tmp_path / "a.png") as file:
        assert file.driver == "PNG"
        np.testing.assert_array_equal(file.read().transpose(1, 2, 0), paint(scan, classed))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.png", "b.png"]


def test_points_stand_where_they_are_ground_in_the_colour_of_its_class_obstacles_in_red(scan, classed):
    classed, wall = with_wall(scan, classed)
    picture, styles = paint(scan, classed), point_styles(classed)
    rows, columns = np.array([pixel(x, y) for x, y in scan.points[:, :2].astype(float)]).T
    height = classed.sectors.point_height
    stands = wall & (height >= 0.25) & (height <= 1.38) & ~classed.sectors.point_airborne
    np.testing.assert_array_equal(styles == 3, stands)
    for style, least in ((0, 0.9), (2, 0.9), (3, 0.99), (4, 0.4)):  # obstacles cover others, and all cover what is grey
        chosen = styles == style
        assert chosen.sum() > 100
        assert (picture[rows[chosen], columns[chosen]] == SCAN_COLOURS[style]).all(axis=1).mean() > least


def test_ground_between_points_has_a_shade_of_its_sector_and_red_lines_over_obstacles(scan, classed):
    """Painted without points: around the middle of a sector, off the range rings, is the hue of its class."""
    nothing = dict.fromkeys(("point_sector", "point_ground", "point_airborne", "point_height"), np.zeros(0, np.int32))
    stack, barred = classed.sectors, with_wall(scan, classed)[0].sectors.obstacle
    plain, hatched = (
        paint(
            Scan(np.zeros((0, 3), np.float32)),
            replace(with_sectors(classed, obstacle=own, **nothing), point_class=np.zeros(0, np.uint8)),
        ).astype(float)
        for own in (np.zeros_like(barred), barred)
    )
    paper = plain[5, SIDE + 5]
    bounds = sector_bounds(stack)
    off = 0
    for number, class_id in enumerate(classed.class_id):
        distance = 0.4 * bounds.near[number] + 0.6 * bounds.far[number]
        azimuth = (bounds.left + bounds.right)[number] / 2
        place = pixel(distance * np.cos(azimuth), distance * np.sin(azimuth))
        around = tuple(slice(axis - 7, axis + 8) for axis in place)
        if class_id < 3:
            wanted = paper + 0.42 * (SCAN_COLOURS[class_id] - paper)
            off += np.abs(plain[place] - wanted).max() > 1.5
        changed = (plain[around] != hatched[around]).any()
        assert changed or not barred[number]
    assert off <= 0.02 * len(classed.class_id)  # under the words of the range rings


def test_the_legend_has_a_swatch_of_every_style_and_says_when_there_is_nothing(scan, classed, nothing):
    for known, is_said in (((scan, classed), False), (nothing, True)):
        panel = paint(*known)[:, SIDE:]
        assert min((panel == colour).all(axis=2).sum() for colour in SCAN_COLOURS) >= 28 * 28
        assert (panel[510:] == 235).all(axis=2).any() == is_said


def test_a_sector_is_free_only_if_it_is_smooth_or_fair_ground_with_nothing_on_it(classed):
    obstacle = np.arange(len(classed.class_id)) % 3 == 0
    states = np.array(SECTOR_STATES)[sector_states(with_sectors(classed, obstacle=obstacle))]
    wanted = np.where(obstacle, "obstacle", np.where(classed.class_id == 2, "rough", "free"))
    assert states.tolist() == np.where(classed.class_id == 255, "not ground", wanted).tolist()


def test_far_points_and_strange_grids_are_no_trouble():
    points = np.array([[1e30, 0, 0], [-1e30, 3, 0], [0, 1e6, 0], [5, 5, 0], [0.1, 0, 9]], np.float32)
    scan = Scan(points)
    for far_m, range_m in ((0.5, 1000.0), (9000.0, 1.0)):
        sectors = polar_sectors(scan, PolarSettings((0.0,), far_m, (3,), (1,)))
        assert paint(scan, classify_filter(sectors), range_m).shape[0] == SIDE


# ---- three dimensions ----


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    """A slope of 0.1, and a way over it."""
    folder = tmp_path_factory.mktemp("space")
    survey = write_survey(folder / "a.las", points=60_000, height=lambda x, _: 0.1 * (x - 500_000) + 50)
    run("map", survey, "--out", folder / "layers", code=0)
    places = "--from", "500005,4000005", "--to", "500015,4000015"
    run("route", folder / "layers", *places, "--out", folder / "way", code=0)
    return folder / "layers", folder / "way"


def test_the_relief_has_its_heights_and_colours_and_ways_lie_over_it(layers):
    drawn = space.space_of(open_map(layers[0]), layers[1])
    used = drawn.vertices[np.unique(drawn.triangles)]
    slope = np.polyfit(used[:, 0], used[:, 2], 1)[0]
    assert slope == pytest.approx(0.1, abs=0.01)
    corners = drawn.vertices[drawn.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] > 0).all()  # seen from above
    assert drawn.colours.shape == drawn.vertices.shape
    assert 0.0 <= drawn.colours.min() < drawn.colours.max() <= 1.0
    (way,) = drawn.ways
    ground = np.polyval(np.polyfit(used[:, 0], used[:, 2], 1), way[:, 0])
    np.testing.assert_allclose(way[:, 2], ground + 0.4, atol=0.1)
    assert np.hypot(*np.diff(way[[0, -1], :2], axis=0)[0]) == pytest.approx(14.1, abs=0.5)


def test_without_a_screen_or_a_driver_it_says_what_to_do(layers, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "VK_DRIVER_FILES"):
        monkeypatch.delenv(name, raising=False)
    assert "--out view.png" in run("view", layers[0]).output
    assert "view.tif is no picture" in run("view", layers[0], "--out", tmp_path / "view.tif").output
    monkeypatch.setattr(space, "find_library", lambda _: None)
    assert "apt-get install libvulkan1" in run("view", layers[0], "--out", tmp_path / "view.png").output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.open3d
def test_open3d_draws_it_without_a_screen(layers, tmp_path):
    picture = tmp_path / "view.png"
    done = run("view", layers[0], "--route", layers[1], "--out", picture)
    if "Vulkan driver" in done.output:
        pytest.skip(done.output)
    assert done.output == f"Open {picture}.\n"
    pixels = np.asarray(Image.open(picture).convert("RGB")).reshape(-1, 3)
    white, black = ((pixels == shade).all(axis=1).mean() for shade in (255, 0))
    assert 0.1 < white < 0.95  # the ground is there, and what lies beside it
    assert 0 < black < 0.05  # so is the way
