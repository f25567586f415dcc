"""Missions by the rules of QGroundControl's loader, bags of grid_map read back with rosbags, and grids of scans.

docs.qgroundcontrol.com, developer guide, Plan File Format; github.com/mavlink/qgroundcontrol,
src/MissionManager/MissionController.cc (_loadJsonMissionFileV2) and MissionItem.cc. github.com/ANYbotics/grid_map:
grid_map_core/src/GridMapMath.cpp (getPositionFromIndex: index (0, 0) is the corner at +x, +y), grid_map_ros
GridMapMsgHelpers.hpp (layout: dimension 0 is column_index, data column by column).
"""

import json
import shutil
import warnings
from dataclasses import replace

import numpy as np
import pytest
import rasterio
from hypothesis import given, settings, strategies as st

from bumpymap.core import (
    NO_TILE,
    BadInputError,
    Barred,
    Georeference,
    GridSettings,
    PolarCells,
    PolarSettings,
    Scan,
    UsageError,
    cell_numbers,
)
from bumpymap.layers import open_map
from bumpymap.scan import polar_sectors
from bumpymap.views import ExportSettings, export_map


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


def test_a_map_without_a_crs_has_no_longitudes(make_field, write_map, tmp_path):
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


def sampled(folder, name, band, x, y, datum):
    with rasterio.open(folder / name) as file:
        places = zip((x + datum["x"]).tolist(), (y + datum["y"]).tolist(), strict=True)
        index = file.descriptions.index(band) + 1 if band else 1
        return np.array([value[0] for value in file.sample(places, indexes=index)])


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
