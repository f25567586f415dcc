"""Missions, checked by the rules of QGroundControl's loader.

docs.qgroundcontrol.com, developer guide, Plan File Format; github.com/mavlink/qgroundcontrol,
src/MissionManager/MissionController.cc (_loadJsonMissionFileV2) and MissionItem.cc.
"""

import json
from dataclasses import replace

import numpy as np
import pytest

from bumpymap.core import BadInputError, Georeference
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

NUMBER = (int, float)


def load_plan(path):
    """Return home (lat, lon, altitude) and waypoints (lat, lon, altitude); what the loader requires is there."""

    def refuse(name):
        raise AssertionError(f"{name} is not JSON")

    plan = json.loads(path.read_text(), parse_constant=refuse)
    assert plan["fileType"] == "Plan"
    assert plan["version"] == 1
    assert plan["geoFence"]["version"] == plan["rallyPoints"]["version"] == 2
    mission = plan["mission"]
    assert mission["version"] == 2
    assert all(
        isinstance(mission[name], NUMBER) for name in ("firmwareType", "vehicleType", "cruiseSpeed", "hoverSpeed")
    )
    assert mission["vehicleType"] == 10  # MAV_TYPE_GROUND_ROVER
    assert len(mission["plannedHomePosition"]) == 3
    for number, item in enumerate(mission["items"], start=1):
        assert item["type"] == "SimpleItem"
        assert item["doJumpId"] == number
        assert item["autoContinue"] is True
        assert (item["command"], item["frame"]) == (16, 3)
        assert len(item["params"]) == 7
        assert item["params"][3] is None  # a heading of NaN: as the way goes
        assert item["Altitude"] == item["params"][6]
    return mission["plannedHomePosition"], [item["params"][4:] for item in mission["items"]], mission["cruiseSpeed"]


def line_on(route_map, seed=0, corners=7):
    rng = np.random.default_rng(seed)
    bounds = route_map.grid.window_bounds(route_map.window)
    east, north = rng.uniform(bounds.west, bounds.east, corners), rng.uniform(bounds.south, bounds.north, corners)
    return np.stack(route_map.to_lonlat(east, north), axis=1).round(7)


def route_file(path, geometry, *, collection=True):
    feature = {"type": "Feature", "properties": {"name": "route"}, "geometry": geometry}
    point = {"type": "Feature", "properties": {}, "geometry": {"type": "Point", "coordinates": [0, 0]}}
    record = {"type": "FeatureCollection", "features": [point, feature]} if collection else feature
    path.write_text(json.dumps(record))
    return path


@pytest.mark.parametrize("kind", ["collection", "feature", "heights", "parts"])
def test_the_corners_are_the_waypoints(route_map, tmp_path, kind):
    line = line_on(route_map)
    places = line.tolist() if kind != "heights" else [[*place, 12.5] for place in line.tolist()]
    geometry = {"type": "LineString", "coordinates": places}
    if kind == "parts":
        geometry = {"type": "MultiLineString", "coordinates": [places[:3], places[3:]]}
    route = route_file(tmp_path / "route.geojson", geometry, collection=kind == "collection")
    done = export_map(route_map, tmp_path / "out", ExportSettings(to="plan", route=route))
    home, waypoints, speed = load_plan(tmp_path / "out" / "route.plan")
    np.testing.assert_array_equal(np.array(waypoints)[:, :2], line[:, ::-1])
    assert (np.array(waypoints)[:, 2] == 0).all()
    assert home[:2] == waypoints[0][:2]
    assert speed == 2.0
    assert done.record["plan"]["waypoints"] == len(line)


def test_home_is_as_high_as_the_ground_at_the_start(route_map, tmp_path):
    window = route_map.window
    barred = route_map.read(window, ()).barred
    row, col = np.argwhere(barred == 0)[0]
    middle = (window.col + col + 0.5) * 3.0, (window.row + window.rows - row - 0.5) * 3.0
    start = route_map.to_lonlat(*middle)
    route = route_file(tmp_path / "r.json", {"type": "LineString", "coordinates": [start, start]})
    export_map(route_map, tmp_path / "out", ExportSettings(to="plan", route=route))
    home, _, _ = load_plan(tmp_path / "out" / "route.plan")
    heights = route_map.heights(window).reshape(window.rows, 15, window.cols, 15)[row, :, col]
    assert home[2] == pytest.approx(np.nanmean(heights), abs=0.006)


def test_the_route_in_the_folder_of_the_layers_is_taken(easy_folder, tmp_path):
    easy_map = open_map(easy_folder)
    with pytest.raises(BadInputError, match="`route`"):
        export_map(easy_map, tmp_path / "out", ExportSettings(to="plan"))
    route = route_file(easy_folder / "route.geojson", {"type": "LineString", "coordinates": line_on(easy_map).tolist()})
    try:
        export_map(easy_map, tmp_path / "out", ExportSettings(to="plan"))
        export_map(easy_map, tmp_path / "given", ExportSettings(to="plan", route=easy_folder))
    finally:
        route.unlink()
    plans = [load_plan(tmp_path / name / "route.plan") for name in ("out", "given")]
    assert len(plans[0][1]) == 7
    assert plans[0] == plans[1]
    with pytest.raises(BadInputError, match="`route`"):  # told before that the folder is occupied
        export_map(easy_map, tmp_path / "out", ExportSettings(to="plan"))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "cannot read"),
        ("[]", "cannot read"),
        ('{"type": "FeatureCollection", "features": []}', "it holds no line"),
        ('{"type": "FeatureCollection", "features": [{"type": "Feature", "geometry": null}]}', "no line"),
        ('{"type": "LineString", "coordinates": [[1, 2]]}', r"route\.geojson"),
        ('{"type": "LineString", "coordinates": [[1, 2], ["a", 2]]}', "cannot read"),
        ('{"type": "LineString", "coordinates": [[1, 2], [NaN, 2]]}', "cannot read"),
        ('{"type": "LineString", "coordinates": [[434100, 5411200], [434110, 5411200]]}', "degrees"),
        ('{"type": "LineString", "coordinates": [[-99, 19], [9, 48]]}', "point 1 of the route, .* outside of the map"),
        ('{"format": "bumpymap-route", "routes": []}', r"it is no GeoJSON: .* must be an object with type\. Give"),
        ("\0\xff", "cannot read"),
    ],
)
def test_files_that_hold_no_route_on_the_map(route_map, tmp_path, text, told):
    (tmp_path / "route.geojson").write_bytes(text.encode("latin-1"))
    with pytest.raises(BadInputError, match=told):
        export_map(route_map, tmp_path / "out", ExportSettings(to="plan", route=tmp_path / "route.geojson"))
    assert not (tmp_path / "out").exists()


def test_a_map_without_a_crs_has_no_longitudes(make_field, write_map, tmp_path):
    local = make_field(6, 5, georeference=Georeference(None), easy=True)
    local_map = open_map(write_map(local, tmp_path / "local"))
    route = route_file(tmp_path / "r.json", {"type": "LineString", "coordinates": [[1, 2], [1, 3]]})
    with pytest.raises(BadInputError, match="a mission is in longitude and latitude, and the map has no CRS"):
        export_map(local_map, tmp_path / "out", ExportSettings(to="plan", route=route))
    record = export_map(local_map, tmp_path / "nav2", ExportSettings()).record
    assert record["datum"]["longitude"] is None
    assert record["datum"]["crs"] is None


def test_a_route_that_touches_obstacles_is_taken_only_with_the_word_and_recorded(route_map, tmp_path):
    route = route_file(tmp_path / "route.geojson", {"type": "LineString", "coordinates": line_on(route_map).tolist()})
    route.write_text(route.read_text().replace('"name": "route"', '"name": "route", "obstacle_m": 3.25'))
    settings = ExportSettings(to="plan", route=route)
    with pytest.raises(BadInputError, match=r"touches obstacles on 3\.2 m"):
        export_map(route_map, tmp_path / "refused", settings)
    done = export_map(route_map, tmp_path / "out", replace(settings, through_obstacles=True))
    assert done.record["plan"]["obstacle_m"] == 3.25
