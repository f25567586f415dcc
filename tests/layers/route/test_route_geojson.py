"""route.geojson: lines where the ways are, figures without NaN, the antimeridian."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from pyproj import CRS, Geod, Transformer
from route_records import CORNERS, FIGURES, make_route

from bumpymap.core import Georeference
from bumpymap.layers.route_lines import split_at_antimeridian, write_route_geojson

US_FOOT = 1200 / 3937
PROPERTIES = {
    *("name", "vehicle", "length_m", "straight_m", "detour", "cost_m", "c_r_mean", "c_r_mean_low", "c_r_mean_high"),
    *("c_r_max", "c_r_max_low", "c_r_max_high", "p_arrives", "p_arrives_note", "p_fail_max", "unknown_m", "why"),
    *("obstacle_m", "tight_turns_deg", "climb_m", "descent_m", "seconds", "risk_m"),
}


def no_such_number(name):
    pytest.fail(f"{name} is not JSON")


def written(routes, path):
    write_route_geojson(routes, path)
    text = path.read_text(encoding="utf-8")
    collection = json.loads(text, parse_constant=no_such_number)
    assert collection["type"] == "FeatureCollection"
    assert ("crs" in collection) == ("local_coordinates" in collection)  # RFC 7946, 4, knows no other than WGS 84
    return collection


def lines_of(collection):
    return [feature for feature in collection["features"] if "LineString" in feature["geometry"]["type"]]


def stops_of(collection):
    return [feature for feature in collection["features"] if feature["geometry"]["type"] == "Point"]


@pytest.mark.parametrize(
    ("epsg", "unit", "middle"),
    [
        (32614, 1.0, (480_000.0, 2_136_000.0)),
        (2271, US_FOOT, (2_600_000.0 * US_FOOT, 250_000.0 * US_FOOT)),
        (2193, 1.0, (1_590_000.0, 5_190_000.0)),  # northing first
    ],
)
def test_a_line_lies_where_the_way_is(epsg, unit, middle, tmp_path):
    corners = np.array([[0.0, 0.0], [2_500.0, 700.0], [2_600.0, -900.0]]) + middle
    route = make_route(corners=corners, georeference=Georeference(CRS.from_epsg(epsg), unit))
    collection = written([route], tmp_path / "route.geojson")
    (line,) = lines_of(collection)
    lon, lat = np.array(line["geometry"]["coordinates"]).T
    assert np.array_equal(np.round([lon, lat], 7), [lon, lat])
    back = Transformer.from_crs(CRS.from_epsg(4326), CRS.from_epsg(epsg), always_xy=True)
    middles = (lon[:-1] + lon[1:]) / 2, (lat[:-1] + lat[1:]) / 2  # RFC 7946: straight in degrees between two positions
    way = shapely.linestrings(corners)
    for xs, ys in ((lon, lat), middles):
        ground = np.column_stack(back.transform(xs, ys)) * unit
        assert shapely.distance(shapely.points(ground), way).max() < 0.015
    ends = np.column_stack(back.transform(lon[[0, -1]], lat[[0, -1]])) * unit
    np.testing.assert_allclose(ends, corners[[0, -1]], atol=0.015)
    assert collection["bbox"] == pytest.approx([lon.min(), lat.min(), lon.max(), lat.max()])


def test_figures_are_those_of_the_route_and_what_is_unknown_is_null(tmp_path):
    route = replace(make_route(), figures=replace(FIGURES, c_r_mean=float("nan"), p_fail_max=float("nan")))
    (line,) = lines_of(written([route], tmp_path / "route.geojson"))
    properties = line["properties"]
    assert set(properties) == PROPERTIES
    assert properties["c_r_mean"] is None
    assert properties["p_fail_max"] is None
    assert properties["p_arrives"] == pytest.approx(np.exp(-0.05 - 0.125) * 0.5**FIGURES.obstacle_m, abs=1e-6)
    assert properties["detour"] == pytest.approx(261.135 / 241.868, abs=1e-6)
    assert (properties["vehicle"], properties["risk_m"], properties["climb_m"]) == ("warthog", 25.0, 4.5)
    assert "estimate" in properties["p_arrives_note"]


def test_stops_have_roles_and_shared_ones_are_written_once(tmp_path):
    routes = [make_route(stops=CORNERS), make_route("alternative 1", CORNERS[[0, 2]])]
    stops = stops_of(written(routes, tmp_path / "route.geojson"))
    assert [stop["properties"] for stop in stops] == [
        {"role": "start", "name": "start"},
        {"role": "via", "name": "via 1"},
        {"role": "goal", "name": "goal"},
    ]


def test_without_a_crs_the_file_says_what_its_coordinates_are(tmp_path):
    collection = written([make_route(georeference=Georeference(None, 0.5))], tmp_path / "route.geojson")
    (line,) = lines_of(collection)
    np.testing.assert_allclose(line["geometry"]["coordinates"], CORNERS / 0.5, atol=1e-3)
    assert "not longitude and latitude" in collection["local_coordinates"]
    assert collection["metres_per_unit"] == 0.5


def test_a_way_over_the_antimeridian_is_cut(tmp_path):
    zone = CRS.from_epsg(32660)
    east = Transformer.from_crs(CRS.from_epsg(4326), zone, always_xy=True)
    corners = np.column_stack(east.transform([179.99, -179.98, 179.995], [-17.0, -17.01, -17.02]))
    route = make_route(corners=corners, georeference=Georeference(zone))
    collection = written([route], tmp_path / "route.geojson")
    (line,) = lines_of(collection)
    assert line["geometry"]["type"] == "MultiLineString"
    parts = [np.array(part) for part in line["geometry"]["coordinates"]]
    assert len(parts) == 3
    assert all(np.abs(np.diff(part[:, 0])).max() < 1.0 for part in parts)
    for before, after in pairwise(parts):
        assert before[-1, 0] == -after[0, 0]
        assert abs(before[-1, 0]) == 180.0
        assert before[-1, 1] == after[0, 1]
    length = sum(Geod(ellps="WGS84").line_length(*part.T) for part in parts)
    on_grid = np.hypot(*np.diff(corners, axis=0).T).sum()
    assert length == pytest.approx(on_grid, rel=2e-3)  # the scale of the projection at the edge of its zone
    west, south, east_side, north = collection["bbox"]
    assert (west, east_side) == pytest.approx((179.99, -179.98), abs=1e-6)
    assert (south, north) == pytest.approx((-17.02, -17.0), abs=1e-6)


@given(
    st.lists(st.tuples(st.integers(-60, 60), st.integers(-80, 80)), min_size=1, max_size=12),
    st.integers(-1800, 1799),
)
def test_a_cut_line_is_the_line(steps, first):
    """Unwrapped, the parts follow the line and end at the antimeridian; taken together they have its corners."""
    lon = (first + np.cumsum([0, *(step for step, _ in steps)])) / 10.0
    lat = np.array([0, *(height for _, height in steps)]) / 1.0
    wrapped = (lon + 180.0) % 360.0 - 180.0
    line = np.column_stack([wrapped, lat])
    parts = split_at_antimeridian(line)
    whole = shapely.linestrings(np.column_stack([lon, lat]))
    for part in parts:
        assert len(part) > 1
        assert np.abs(np.diff(part[:, 0])).max() <= 180.0
        assert np.abs(part[:, 0]).max() <= 180.0
        middle = (part[:-1] + part[1:]) / 2
        near = [
            shapely.distance(shapely.points(middle + np.array([turn, 0.0])), whole)
            for turn in (-720, -360, 0, 360, 720)
        ]
        assert np.min(near, axis=0).max() < 1e-6
    length = sum(shapely.length(shapely.linestrings(part)) for part in parts)
    assert length == pytest.approx(shapely.length(whole), abs=1e-5)
