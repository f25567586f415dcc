"""Points of users: how they are written, where they lie, what closes them and how far they are moved."""

import re

import numpy as np
import pytest
import shapely
from pyproj import CRS, Proj
from route_maps import bare_map, write_folder
from route_sites import COLS, ROWS, SOUTH, WEST, place, site
from tile_maps import TileMap

from bumpymap.core import NO_TILE, BadInputError, Barred, UsageError
from bumpymap.layers import open_map
from bumpymap.route import CostSettings, RouteConfig, parse_point, plan_routes
from bumpymap.route.ground import CostGround
from bumpymap.route.places import place_in_window
from bumpymap.route.planner import Planner
from bumpymap.route.stops import find_stops, usable_point
from bumpytiles import TileWindow

SITE = bare_map()
"""300 m x 240 m at easting 480,000, northing 2,136,000 of UTM zone 14N."""


FEET = bare_map(TileWindow(655_000, 187_000, 60, 50), crs=CRS.from_epsg(2229), unit=1200 / 3937)
WRITTEN = ["{0},{1}", "{0}, {1}", "{0} {1}", "{0:.9e},{1:.9E}", "+{0},{1}", "crs:{0},{1}", "  CRS : {0} ; {1} "]


@pytest.mark.parametrize(("place", "metres"), [(SITE, (480_123.25, 2_136_200.5)), (FEET, (1_965_030.0, 561_060.0))])
def test_longitude_and_latitude_and_coordinates_of_the_crs_are_told_apart(place, metres):
    for text in WRITTEN:
        assert parse_point(text.format(*place.to_crs(*metres)), place) == pytest.approx(metres, abs=1e-5)
    longitude, latitude = place.to_lonlat(*metres)
    for text in (f"{longitude:.12f},{latitude:.12f}", f"lonlat:{longitude:.12f},{latitude:.12f}"):
        assert parse_point(text, place) == pytest.approx(metres, abs=1e-4)


@pytest.mark.parametrize(
    "text", ["", "480100", "a,b", "1,2,3", "utm:1,2", "1,2 m", "nan,nan", "inf,1", "1;;2", "0x10,2", "1_0,2", "-,-"]
)
def test_what_is_no_point_is_refused(text):
    with pytest.raises(UsageError, match=r"is not a point\. Give LON,LAT such as"):
        parse_point(text, SITE)


def test_a_point_outside_the_map_is_refused_with_the_extent_in_both_systems():
    for text in ("11.5,48.1", "480301,2136100", "lonlat:480100,2136100", "crs:-99.19,19.31", "200,95"):
        with pytest.raises(BadInputError) as caught:
            parse_point(text, SITE)
        told = str(caught.value)
        assert f"the point {text} lies outside the map, which spans x 480000.00 to 480300.00, y 2136000.00 to" in told
        assert "2136240.00 in WGS 84 / UTM zone 14N (EPSG:32614), or longitude" in told
        stated = [float(number) for number in re.findall(r"-?\d+\.\d{6}", told)]
        corners = np.array([(x, y) for x in (480_000, 480_300) for y in (2_136_000, 2_136_240)], float)
        longitude, latitude = Proj(32614)(corners[:, 0], corners[:, 1], inverse=True)
        assert stated == pytest.approx([longitude.min(), longitude.max(), latitude.min(), latitude.max()], abs=1e-6)


def test_points_near_the_map_are_taken_if_asked():
    with pytest.raises(BadInputError, match="outside"):
        parse_point("480304,2136243", SITE, beyond_m=4.9)
    assert parse_point("480304,2136243", SITE, beyond_m=5.0) == (480_304.0, 2_136_243.0)
    assert parse_point("480000,2136000", SITE) == (480_000.0, 2_136_000.0)  # the sides in the west and south
    with pytest.raises(BadInputError, match="outside"):
        parse_point("480300,2136000", SITE)


def test_a_point_that_could_be_meant_both_ways_must_be_named():
    """Near the origin of a CRS around 0 degrees, small numbers are coordinates of both."""
    crs = CRS.from_proj4("+proj=tmerc +lat_0=0 +lon_0=0 +datum=WGS84")
    place = bare_map(TileWindow(-100_000, -100_000, 200_000, 200_000), crs=crs)
    with pytest.raises(BadInputError, match=r"both as longitude.*Write lonlat:1\.5,0\.5 or crs:1\.5,0\.5"):
        parse_point("1.5,0.5", place)
    assert parse_point("crs:1.5,0.5", place) == (1.5, 0.5)
    assert parse_point("lonlat:1.5,0.5", place) == pytest.approx(place.from_lonlat(1.5, 0.5))
    assert parse_point("1500,500", place) == (1500.0, 500.0)


def test_a_map_without_a_crs_knows_its_own_coordinates_only():
    place = bare_map(TileWindow(0, 0, 10, 10), crs=None)
    assert parse_point("11.5,20", place) == (11.5, 20.0)
    with pytest.raises(BadInputError, match="has no CRS"):
        parse_point("lonlat:11.5,20", place)
    with pytest.raises(BadInputError, match=r"x 0\.00 to 30\.00, y 0\.00 to 30\.00 in local coordinates") as caught:
        parse_point("40,20", place)
    assert "longitude 0" not in str(caught.value)


def test_swapped_numbers_are_noticed():
    longitude, latitude = SITE.to_lonlat(480_100.0, 2_136_100.0)
    for text, meant in ((f"{latitude:.7f},{longitude:.7f}", "-99"), ("2136100,480100", "480100,2136100")):
        with pytest.raises(BadInputError, match=f"did you mean {meant}"):
            parse_point(text, SITE)


PLACE = bare_map(TileWindow(160_000, 712_000, 30, 20))


def closed_map(code, *, place=PLACE):
    """All tiles closed by one code, but for one; points are placed as on a map in a CRS, or without one."""
    barred = np.full((20, 30), code, np.uint8)
    barred[12, 14] = Barred.NO
    site = TileMap(np.full(barred.shape, 0.1), barred, georeference=place.georeference, has_crs=place.has_crs)
    site.to_lonlat, site.to_crs = place.to_lonlat, place.to_crs
    return site


def usable(site, row, col, snap=0.0, **areas):
    ground = CostGround(site, CostSettings(), 10**7, **areas)
    return usable_point(ground, "the goal", tuple(site.at(row, col)), snap)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Barred.UNKNOWN, "unknown ground; `unknown=COST`"),
        (Barred.SLOPE, r"not passable \(too steep\)"),
        (Barred.FAILS, r"not passable \(drives fail\)"),
        (Barred.STEP, r"not passable \(step\)"),
        (NO_TILE, "a tile without points"),
    ],
)
def test_the_message_says_what_closes_the_tile_and_where_to_go(code, words):
    site = closed_map(code)
    with pytest.raises(BadInputError, match=f"the goal lies on .*{words}") as caught:
        usable(site, 12.5, 10.5)
    told = str(caught.value)
    away = float(told.split(" m away", maxsplit=1)[0].rsplit(maxsplit=1)[-1])
    assert 10.5 < away < 12.0  # the middle of the open tile is 12 m away, its side 10.5 m
    assert f"`snap={np.ceil(away):.0f}`" in told
    near = parse_point(told.split(" (longitude", maxsplit=1)[0].rsplit(maxsplit=1)[-1], PLACE)
    assert np.hypot(*np.subtract(near, site.at(12.5, 10.5))) == pytest.approx(away, abs=0.06)
    assert tuple(usable(site, 12.5, 10.5, snap=12.0)) == pytest.approx(near, abs=0.02)
    with pytest.raises(BadInputError, match="m away"):
        usable(site, 12.5, 10.5, snap=10.0)


def test_areas_that_the_user_closed_and_no_open_tile_at_all():
    site = closed_map(Barred.NO)
    everywhere = np.array([shapely.box(*site.at(20, 0), *site.at(0, 30))])
    with pytest.raises(BadInputError, match=r"`avoid` or `only`.*No tile in the 90 m x 60 m around it"):
        usable(site, 3.5, 3.5, avoid=everywhere)


def test_without_a_crs_the_point_is_given_in_coordinates_of_the_survey():
    site = closed_map(Barred.STEP, place=bare_map(PLACE.window, crs=None))
    with pytest.raises(BadInputError, match=r"at crs:48004\d\.\d\d,21360\d\d\.\d\d") as caught:
        usable(site, 12.5, 10.5)
    assert "longitude" not in str(caught.value)


GOAL = place(1.5, 28.5)


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("stops") / "layers", site())


def stops(layers, **settings):
    config = RouteConfig(layers, goal=GOAL, **settings)
    return find_stops(CostGround(open_map(layers), config.cost, 10**7), config)


def test_a_point_beside_the_map_is_moved_onto_it(layers):
    outside = place(10.5, -0.5)
    with pytest.raises(BadInputError, match="outside the map"):
        stops(layers, start=outside, snap=1.4)
    found = stops(layers, start=outside, snap=4.0)
    assert found.points[0] == pytest.approx(np.array([WEST * 3.0 + 0.1, (SOUTH + ROWS - 10.5) * 3.0]))
    assert "moved by 1.9 m" in found.notes[0]


def test_points_on_the_sides_of_the_map_lie_in_their_tiles(layers):
    corner = f"{WEST * 3.0},{SOUTH * 3.0}"
    with pytest.raises(BadInputError, match="unknown ground"):
        stops(layers, start=corner)
    found = plan_routes(RouteConfig(layers, start=place(ROWS, COLS - 0.5), goal=GOAL))
    assert found.routes[0].stops[0].tolist() == [(WEST + COLS - 0.5) * 3.0, SOUTH * 3.0]


@pytest.mark.parametrize("south", [712_000, 1_700_001, -3])
def test_a_point_on_a_border_lies_in_the_tile_north_of_it(south):
    barred = np.zeros((12, 9), np.uint8)
    barred[6] = Barred.SLOPE
    site = TileMap(np.full(barred.shape, 0.1), barred, south=south)
    plan = Planner(CostGround(site, CostSettings(), 10**6))
    assert np.floor(place_in_window(site.at(6.0, 3.0), site.grid, site.window)).tolist() == [5.0, 3.0]
    assert plan.line(site.at(5.5, 3.0), site.at(1.0, 8.0)) is not None
    assert plan.line(site.at(5.5, 3.0), site.at(11.0, 8.0)) is None
