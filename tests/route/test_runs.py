"""What users give to a run and what it leaves: points, files, calls of Python, and yards that are mapped and left."""

import hashlib
import json
import logging
import math
import re

import numpy as np
import pytest
import shapely
from pyproj import CRS, Proj, Transformer
from rings import HALF_M, Ring, crossed_by_tools
from route_maps import COLS, ROWS, SOUTH, WEST, bare_map, place, site, write_folder
from small_surveys import files_in
from tile_maps import CORNERS, MadeUpMap, TileMap, make_route

import bumpymap
from bumpymap.core import NO_TILE, BadInputError, Barred, Georeference, OutputError, UsageError
from bumpymap.layers import open_map
from bumpymap.route import CostSettings, RouteConfig, parse_point, plan_routes
from bumpymap.route.ground import CostGround
from bumpymap.route.output import ROUTE_FILES, check_out, write_route
from bumpymap.route.places import place_in_window
from bumpymap.route.planner import Planner
from bumpymap.route.stops import find_stops, usable_point
from bumpytiles import TileWindow

EVERY = ["map.qgs", "profile.csv", "route.geojson", "route.gpx", "route.json", "route.qml"]
SETTINGS = {"settings": {"risk_m": 25.0, "robust": False}}
pytestmark = [
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
    pytest.mark.usefixtures("without_views"),
]


@pytest.fixture(scope="module")
def source():
    return MadeUpMap.around()


def write(out, source, **options):
    return write_route(make_route(), source, out, manifest=SETTINGS, **options)


def test_a_folder_gets_every_file_and_the_manifest(source, tmp_path):
    out = tmp_path / "new" / "routes"
    check_out(out, overwrite=False)
    assert not out.exists()
    files = write_route(make_route(stops=CORNERS), source, out, manifest=SETTINGS)
    assert sorted(files_in(out)) == EVERY
    assert [path.name for path in files] == [name for name in ROUTE_FILES.names if name in EVERY]
    record = json.loads((out / "route.json").read_text())
    assert record["format"] == "bumpymap-route"
    assert record["settings"] == SETTINGS["settings"]
    assert record["calibration"]["id"] == "c0ffee"
    assert "bumpymap" in record["versions"]
    assert [route["name"] for route in record["routes"]] == ["route"]
    assert [stop["name"] for stop in record["routes"][0]["stops"]] == ["start", "via 1", "goal"]
    assert record["routes"][0]["stops"][0]["x"] == CORNERS[0, 0]
    assert record["notes"] == []
    for entry in record["files"]:
        content = (out / entry["path"]).read_bytes()
        assert (entry["bytes"], entry["sha256"]) == (len(content), hashlib.sha256(content).hexdigest())


@pytest.mark.parametrize("suffix", [".geojson", ".gpx", ".csv", ".GPX"])
def test_one_file_by_its_suffix(suffix, source, tmp_path):
    out = tmp_path / f"way{suffix}"
    assert write(out, source) == [out]
    assert sorted(files_in(tmp_path)) == [out.name]


def test_files_of_an_earlier_run_are_replaced_only_if_allowed_and_links_are_not_followed(source, tmp_path):
    out, mine = tmp_path / "out", tmp_path / "mine"
    write(out, source)
    (out / "profile.csv").unlink()
    for path in (mine, out / "notes.txt"):
        path.write_text("mine")
    for link in (out / "profile.csv", tmp_path / "way.csv"):
        link.symlink_to(mine)
    before = {path: path.read_bytes() for path in out.iterdir()}
    with pytest.raises(OutputError, match="already holds"):
        check_out(out, overwrite=False)
    for target in (tmp_path / "way.csv", out):
        with pytest.raises(OutputError, match=r"already holds|exists"):
            write(target, source)
        assert {path: path.read_bytes() for path in out.iterdir()} == before
        write(target, source, overwrite=True)
    assert not (out / "profile.csv").is_symlink()
    assert not (tmp_path / "way.csv").is_symlink()
    assert sorted(files_in(out)) == sorted([*EVERY, "notes.txt"])
    assert mine.read_text() == "mine"


def test_without_a_crs_gpx_is_left_out_and_said(source, tmp_path, caplog):
    route = make_route(georeference=Georeference(None))
    with caplog.at_level(logging.WARNING):
        files = write_route(route, source, tmp_path, manifest={})
    assert sorted(files_in(tmp_path)) == [name for name in EVERY if name != "route.gpx"]
    assert "route.gpx" not in {path.name for path in files}
    assert "no CRS" in caplog.text
    record = json.loads((tmp_path / "route.json").read_text())
    assert "no CRS" in record["notes"][0]
    assert "lon" not in record["routes"][0]["stops"][0]
    with pytest.raises(BadInputError, match="no CRS"):
        write_route(route, source, tmp_path / "way.gpx", manifest={})


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("way.kml", UsageError, r"\.geojson, \.gpx, \.csv"),
        ("file", OutputError, "it is a file"),
        ("missing/way.csv", OutputError, "there is no folder"),
    ],
)
def test_places_that_cannot_hold_the_files_are_refused(source, tmp_path, name, error, words):
    (tmp_path / "file").touch()
    with pytest.raises(error, match=words):
        check_out(tmp_path / name, overwrite=True)
    with pytest.raises(error, match=words):
        write(tmp_path / name, source, overwrite=True)
    (tmp_path / "route.gpx").mkdir()
    with pytest.raises(OutputError, match="is not a file"):
        write(tmp_path, source, overwrite=True)
    assert sorted(files_in(tmp_path)) == ["file"]


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    return bumpymap.open(write_folder(tmp_path_factory.mktemp("api") / "layers", site()))


def pair(row, col):
    return tuple(float(value) for value in place(row, col).split(","))


def test_a_route_is_a_line_with_figures(layers):
    way = layers.route(pair(20.5, 8.5), place(20.5, 22.5))
    assert np.hypot(*np.diff(way.line, axis=0).T).sum() == pytest.approx(way.figures.length_m, rel=1e-9)
    assert way.profile.distance[-1] == pytest.approx(way.figures.length_m, rel=1e-9)
    assert f"{way.figures.length_m:,.1f} m" in repr(way)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gap", "thickness", "density", "classified"),
    [(0.0, 0.1, 50, True), (0.0, 0.2, 50, False), (1.0, 0.3, 50, False), (2.3, 0.2, 50, True), (2.3, 0.1, 20, False)],
)
def test_a_wall_is_a_wall_for_all_that_read_the_map(tmp_path, gap, thickness, density, classified):
    seed = int(100 * gap + 10 * thickness + density)
    yard = Ring(f"wall {thickness} m", gap, density, 0.01, classified, sides=True, seed=seed)
    layers = yard.map(tmp_path)
    fits = gap >= 2.0
    way = yard.way_out(layers)
    assert (way is not None) == fits
    if fits:
        assert yard.leads_through(way)
        assert way.figures.obstacle_m == 0.0
    crossed = crossed_by_tools(yard, layers)
    assert crossed.pop("Nav2, tiles") <= fits  # a cell of 3 m with a part of the wall in it is closed as a whole
    assert crossed == dict.fromkeys(crossed, fits)


@pytest.mark.slow
def test_without_a_way_the_message_names_the_gap_that_is_too_narrow(tmp_path):
    yard = Ring("wall .2 m", 2.0, 50, 0.01, classified=True, sides=True, seed=5)
    layers = yard.map(tmp_path, vehicle="car")
    with pytest.raises(bumpymap.BadInputError) as raised:
        bumpymap.find_routes(layers, *yard.ends, snap=6.0)
    said = re.search(r"widest opening .* (\S+),(\S+) \(longitude, latitude\), about (\S+) m wide", str(raised.value))
    longitude, latitude, width = map(float, said.groups())
    place = Transformer.from_crs(4326, 32632, always_xy=True).transform(longitude, latitude)
    assert math.dist(place, yard.place.of_scene(HALF_M, 0.0)) < 0.6
    assert 1.5 < width < 2.0


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


def closed_map(code):
    """All tiles closed by one code, but for one."""
    barred = np.full((20, 30), code, np.uint8)
    barred[12, 14] = Barred.NO
    site = TileMap(np.full(barred.shape, 0.1), barred, georeference=PLACE.georeference, has_crs=True)
    site.to_lonlat, site.to_crs = PLACE.to_lonlat, PLACE.to_crs
    return site


def usable(site, row, col, snap=0.0, **areas):
    ground = CostGround(site, CostSettings(), 10**7, **areas)
    return usable_point(ground, "the goal", tuple(site.at(row, col)), snap)


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Barred.UNKNOWN, "unknown ground; `unknown=COST`"),
        (Barred.LITTLE_SEEN, "too little seen; `unknown=COST`"),
        (Barred.SLOPE, r"not passable \(too steep\)"),
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


GOAL = place(1.5, 28.5)


def stops(layers, **settings):
    config = RouteConfig(layers.folder, goal=GOAL, **settings)
    return find_stops(CostGround(open_map(layers.folder), config.cost, 10**7), config)


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
    found = plan_routes(RouteConfig(layers.folder, start=place(ROWS, COLS - 0.5), goal=GOAL))
    assert found.route.stops[0].tolist() == [(WEST + COLS - 0.5) * 3.0, SOUTH * 3.0]


@pytest.mark.parametrize("south", [712_000, 1_700_001, -3])
def test_a_point_on_a_border_lies_in_the_tile_north_of_it(south):
    barred = np.zeros((12, 9), np.uint8)
    barred[6] = Barred.SLOPE
    site = TileMap(np.full(barred.shape, 0.1), barred, south=south)
    plan = Planner(CostGround(site, CostSettings(), 10**6))
    assert np.floor(place_in_window(site.at(6.0, 3.0), site.grid, site.window)).tolist() == [5.0, 3.0]
    assert plan.line(site.at(5.5, 3.0), site.at(1.0, 8.0)) is not None
    assert plan.line(site.at(5.5, 3.0), site.at(11.0, 8.0)) is None
