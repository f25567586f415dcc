"""route.gpx: GPX 1.1, read by GDAL, in the order of its schema."""

from dataclasses import replace
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import shapely
from hypothesis import given, strategies as st
from pyogrio.raw import read
from pyproj import CRS, Transformer
from route_records import CORNERS, UTM, make_route

from bumpymap.core import BadInputError, Georeference
from bumpymap.layers.route_lines import track_points, write_gpx

NAMESPACE = "{http://www.topografix.com/GPX/1/1}"
ORDER = {
    # element: its children in the order of the schema
    "gpx": ("metadata", "wpt", "rte", "trk", "extensions"),
    "metadata": ("name", "desc", "author", "copyright", "link", "time", "keywords", "bounds", "extensions"),
    "trk": ("name", "cmt", "desc", "src", "link", "number", "type", "extensions", "trkseg"),
    "trkseg": ("trkpt", "extensions"),
    **dict.fromkeys(
        ("wpt", "trkpt"),
        ("ele", "time", "magvar", "geoidheight", "name", "cmt", "desc", "src", "link", "sym", "type", "fix"),
    ),
}


def checked(path):
    """Parse a file and hold every element against the schema's order."""
    root = ET.parse(path).getroot()  # noqa: S314 (our own file)
    assert root.tag == f"{NAMESPACE}gpx"
    assert (root.get("version"), bool(root.get("creator"))) == ("1.1", True)
    for element in root.iter():
        name = element.tag.removeprefix(NAMESPACE)
        children = [child.tag.removeprefix(NAMESPACE) for child in element]
        places = [ORDER[name].index(child) for child in children] if children else []
        assert places == sorted(places)
        if name in {"wpt", "trkpt"}:
            assert -180.0 <= float(element.get("lon")) < 180.0
            assert -90.0 <= float(element.get("lat")) <= 90.0
    return root


def test_gdal_reads_the_track_where_the_way_is(tmp_path):
    route = make_route(stops=CORNERS)
    write_gpx([route, make_route("two")], tmp_path / "route.gpx")
    checked(tmp_path / "route.gpx")
    _, _, geometry, columns = read(tmp_path / "route.gpx", layer="tracks", columns=["name"])
    assert columns[0].tolist() == ["route", "two"]
    to_grid = Transformer.from_crs(CRS.from_epsg(4326), UTM.crs, always_xy=True)
    line = shapely.from_wkb(geometry)[0].geoms[0]
    ground = np.column_stack(to_grid.transform(*shapely.get_coordinates(line).T))
    assert shapely.hausdorff_distance(shapely.linestrings(ground), shapely.linestrings(CORNERS)) < 0.015
    _, _, waypoints, columns = read(tmp_path / "route.gpx", layer="waypoints", columns=["name"])
    assert columns[0].tolist() == ["start", "via 1", "goal"]
    stops = shapely.get_coordinates(shapely.from_wkb(waypoints))
    np.testing.assert_allclose(np.column_stack(to_grid.transform(*stops.T)), CORNERS, atol=0.015)
    _, _, _, heights = read(tmp_path / "route.gpx", layer="track_points", columns=["ele"])
    expected = track_points(route)[:, 2]
    np.testing.assert_allclose(heights[0][: len(expected)], expected, atol=6e-4)
    assert np.isnan(expected).any()


@given(st.integers(2, 12), st.floats(0.5, 40.0), st.integers(0, 1000))
def test_a_track_has_every_corner_and_every_point_of_the_profile_in_order(corners, step, seed):
    rng = np.random.default_rng(seed)
    line = CORNERS[0] + np.cumsum(rng.uniform(-30.0, 30.0, (corners, 2)), axis=0)
    route = make_route(corners=line, step=step)
    points = track_points(route)
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points[:, :2], axis=0).T))])
    length = np.hypot(*np.diff(line, axis=0).T).sum()
    assert along[-1] == pytest.approx(length)  # no shortcut, no way back
    for wanted in (line, np.column_stack([route.profile.easting, route.profile.northing])):
        off = np.hypot(*(wanted[:, None] - points[None, :, :2]).transpose(2, 0, 1)).min(axis=1)
        assert off.max() < 1e-5


def test_characters_that_xml_cannot_hold_are_replaced(tmp_path):
    write_gpx([make_route("a\x00b\ud800 <&> é")], tmp_path / "route.gpx")
    assert checked(tmp_path / "route.gpx").findtext(f"{NAMESPACE}trk/{NAMESPACE}name") == "a?b? <&> é"


def test_a_point_on_the_antimeridian_is_west_of_it(tmp_path):
    zone = CRS.from_epsg(32660)
    x, y = Transformer.from_crs(CRS.from_epsg(4326), zone, always_xy=True).transform(180.0, -17.0)
    corners = np.array([[x, y], [x + 50.0, y]])
    write_gpx([make_route(corners=corners, georeference=Georeference(zone))], tmp_path / "route.gpx")
    checked(tmp_path / "route.gpx")


def test_without_a_crs_it_is_refused(tmp_path):
    with pytest.raises(BadInputError, match="no CRS"):
        write_gpx([replace(make_route(), georeference=Georeference(None))], tmp_path / "route.gpx")
    assert not list(tmp_path.iterdir())
