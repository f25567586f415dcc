"""Ways over maps in memory and of runs: costs, risk, closed tiles, areas, windows; points, files, mapped yards."""

import hashlib
import json
import logging
import math
import re
from itertools import pairwise

import numpy as np
import pytest
import shapely
from pyproj import CRS, Proj, Transformer
from rings import HALF_M, Ring, crossed_by_tools
from route_maps import COLS, ROWS, SOUTH, WEST, bare_map, place, site, write_folder
from scipy.ndimage import gaussian_filter
from small_surveys import files_in
from tile_maps import CORNERS, WARTHOG, MadeUpMap, TileMap, cheapest_on_pixels, make_route, smooth_field

import bumpymap
from bumpymap.core import NO_TILE, BadInputError, Barred, Georeference, OutputError, RouteVehicle, UsageError
from bumpymap.core.types import CROSSING_UNKNOWN
from bumpymap.layers import open_map
from bumpymap.route import CostSettings, RouteConfig, parse_point, plan_routes
from bumpymap.route.ground import CostGround
from bumpymap.route.measure import way_cost
from bumpymap.route.output import ROUTE_FILES, check_out, write_route
from bumpymap.route.places import in_window, place_in_window
from bumpymap.route.planner import Planner, tile_line
from bumpymap.route.search import find_way, line_cost
from bumpymap.route.stops import find_stops, usable_point
from bumpytiles import TileWindow


def ground_of(site, **settings):
    return CostGround(site, CostSettings(**settings), 10**7)


def planner(site, **settings):
    return Planner(ground_of(site, **settings))


def of_field(field, **settings):
    return ground_of(None, **settings).of_field(field, through=False)


def test_a_heavier_risk_costs_more_and_arrives_more_surely():
    """Smooth hills of ride cost, and risk where the ride is smooth, so that both pull apart."""
    rng = np.random.default_rng(0)
    relief = gaussian_filter(rng.normal(size=(40, 50)), 2.0, mode="wrap")
    rank = relief.argsort(axis=None).argsort().reshape(relief.shape) / relief.size
    barred = np.where(rng.random(relief.shape) < 0.15, Barred.SLOPE, Barred.NO)
    barred[:3], barred[-3:] = Barred.NO, Barred.NO
    site = TileMap(0.02 + 0.5 * rank, barred, p_fail=0.3 * (1 - rank) ** 2)
    stops = np.array([site.at(1.5, 1.5), site.at(38.5, 48.5)])
    risks = (0.0, 30.0, 300.0, 3000.0, 30000.0)
    ways = [planner(site, risk=risk).way(stops).figures for risk in risks]
    rides = [way.cost_m - risk * way.hazard for way, risk in zip(ways, risks, strict=True)]
    for (lighter, heavier), (less, more) in zip(pairwise(ways), pairwise(rides), strict=True):
        assert heavier.hazard <= lighter.hazard * (1 + 1e-3)
        assert more >= less * (1 - 1e-3)
    assert ways[-1].hazard < 0.9 * ways[0].hazard


def test_unknown_ground_is_crossed_only_at_a_price_and_has_a_length_and_no_ride():
    barred = np.zeros((9, 30), np.uint8)
    barred[:, 14:16], barred[:, 16] = CROSSING_UNKNOWN
    site = TileMap(np.full((9, 30), 0.1), barred)
    stops = np.array([site.at(4.5, 1.5), site.at(4.5, 28.5)])
    assert planner(site).way(stops) is None
    way = planner(site, unknown=4.0).way(stops)
    assert way.figures.unknown_m == pytest.approx(9.0, rel=1e-6)
    assert way.figures.cost_m == pytest.approx(24 * 3 * 1.5 + 9 * 4.0, rel=1e-6)
    assert way.figures.seconds == pytest.approx((24 * 3 + 9 * 4.0) / 2.0, rel=1e-6)
    assert way.figures.c_r_mean == pytest.approx(0.1, rel=1e-6)
    unknown = np.isnan(way.profile.c_r)
    assert way.profile.distance[unknown].min() == pytest.approx(12.5 * 3.0, abs=1.0)
    assert unknown.sum() == pytest.approx(9, abs=1)


def test_areas_close_tiles():
    site = TileMap(np.full((20, 30), 0.1))
    stops = np.array([site.at(10.5, 1.5), site.at(10.5, 28.5)])
    (west, south), (east, north) = site.at(20, 14), site.at(5, 16)
    wall = np.array([shapely.box(west + 1, south, east - 1, north)])
    free = planner(site).way(stops)
    around = Planner(CostGround(site, CostSettings(), 10**7, avoid=wall)).way(stops)
    assert free.figures.detour == pytest.approx(1.0)
    assert around.figures.detour > 1.05
    assert not shapely.LineString(around.line).intersects(wall[0])
    assert Planner(CostGround(site, CostSettings(), 10**7, only=wall)).way(stops) is None


def test_ground_that_shows_too_little_is_refused_and_a_way_says_what_it_would_not_have_seen():
    """A thin strip of ten tiles across, but for four in the north."""
    smallest = np.full((30, 40), 0.4)
    smallest[4:, 15:25] = 1.2
    site = TileMap(np.full((30, 40), 0.1), smallest_object=smallest)
    ends = np.array([site.at(20.5, 5.5), site.at(20.5, 34.5)])
    straight, around = (planner(site, seen_width=width).way(ends) for width in (None, 0.5))
    assert around.figures.length_m > 1.3 * straight.figures.length_m
    sizes = [way.figures.seen.object_m for way in (straight, around)]
    assert sizes == pytest.approx([1.2, 0.4])
    assert straight.figures.seen.sentence == (
        "At 10 points/m2, objects narrower than 1.2 m and steps lower than 0.2 m are not seen."
    )
    assert planner(site, seen_width=0.3).way(ends) is None


def test_a_way_keeps_room_beside_obstacles_where_there_is_room():
    site = TileMap(np.full((21, 40), 0.1))
    stops = np.array([site.at(10.5, 2.5), site.at(10.5, 37.5)])
    site.stones = [tuple(site.at(10.6, 20.5))]
    plan = planner(site)
    way = plan.way(stops)
    assert shapely.distance(shapely.LineString(way.line), shapely.Point(site.stones[0])) > site.vehicle.reach_m + 0.3
    assert way.figures.tight_turns_deg == 0.0


def lane(*stones):
    """A lane one tile wide with stones in it, and its ends."""
    barred = np.full((9, 20), Barred.SLOPE)
    barred[4] = Barred.NO
    site = TileMap(np.full((9, 20), 0.1), barred)
    site.stones = [tuple(site.at(*stone)) for stone in stones]
    return site, np.array([site.at(4.5, 1.5), site.at(4.5, 18.5)])


def test_turns_between_obstacles_count_against_arriving():
    site, stops = lane((4.37, 10.5), (4.63, 12.5))
    figures = planner(site).way(stops).figures
    assert 10.0 < figures.tight_turns_deg < 180.0
    assert figures.p_arrives == pytest.approx(np.exp(-figures.hazard - figures.tight_turns_deg / 100))


def test_where_every_way_touches_an_obstacle_there_is_none_unless_it_is_asked_for():
    site, stops = lane((4.5, 10.5))
    assert planner(site).way(stops) is None
    measured = planner(site, through_obstacles=True).way(stops)
    figures, profile = measured.figures, measured.profile
    assert figures.obstacle_m == pytest.approx(2 * site.vehicle.reach_m, abs=0.3)
    assert profile.obstacle.mean() * figures.length_m == pytest.approx(figures.obstacle_m, abs=1.1)
    expected = np.exp(-figures.hazard - figures.tight_turns_deg / 100) * 0.5**figures.obstacle_m
    assert figures.p_arrives == pytest.approx(expected)


def test_a_way_of_no_length_stays_there():
    site = TileMap(np.full((9, 20), 0.1))
    figures = planner(site).way(np.array([site.at(4.5, 2.5)] * 2)).figures
    assert (figures.length_m, figures.cost_m, figures.obstacle_m) == (0.0, 0.0, 0.0)
    assert str(figures.descent_m) == "0.0"


@pytest.mark.parametrize(
    ("settings", "off_deg"),
    [
        ({"climb": 5.0}, 55.0),  # slanting, as on level ground: the climb is the same on all ways
        ({"side_slope": 2.0, "climb": 5.0}, 25.4),
        ({"side_limit": 10.0, "descent": 3.0}, 41.1),
        ({"side_limit": 2.0}, 7.5),
        ({"side_slope": 8.0}, 0.0),  # straight up
    ],
)
def test_up_a_bank_a_way_goes_straight_or_slanting_as_an_exhaustive_search_does(settings, off_deg):
    """A bank of 15 degrees, 18 m wide, from west to east; searched are all places where it is entered and left."""
    tan, rules = math.tan(math.radians(15.0)), CostSettings(**settings)
    site = TileMap(
        np.full((26, 40), 0.04), height=lambda x, y: tan * np.clip(y - site.south * 3.0 - 30.0, 0.0, 18.0) + 0.0 * x
    )
    assert site.gradient(site.window)[12, 20] == pytest.approx([-tan, 0.0], abs=1e-5)
    stops = np.array([site.at(23.5, 4.5), site.at(2.5, 34.5)])
    enter, leave = np.meshgrid(*2 * [np.arange(0.0, 90.05, 0.1)])
    across = tan * np.abs(leave - enter)
    cost = 1.2 * (np.hypot(enter, 22.5) + np.hypot(leave - enter, 18.0) + np.hypot(90.0 - leave, 22.5))
    cost[across > rules.steepest * np.hypot(leave - enter, 18.0)] = np.inf
    best = (cost + rules.side_slope * across).min()
    for way, weight in ((stops, rules.climb), (stops[::-1], rules.descent)):
        found = planner(site, **settings).way(way)
        assert found.figures.cost_m == pytest.approx(best + weight * 18.0 * tan, rel=1e-3)
    x = np.interp(site.south * 3.0 + np.array([30.0, 48.0]), found.line[::-1, 1], found.line[::-1, 0])
    assert math.degrees(math.atan2(np.diff(x)[0], 18.0)) == pytest.approx(off_deg, abs=1.0)


def made_field(rows=600, cols=40, seed=1):
    """Random tiles of every kind; more rows than are computed at once."""
    rng = np.random.default_rng(seed)
    barred = rng.choice([*Barred, NO_TILE], (rows, cols), p=[0.5, 0.15, *[0.05] * 7])
    unknown = (barred == Barred.UNKNOWN) | (barred == NO_TILE)
    p_fail = rng.random(barred.shape) * 0.5
    p_fail[unknown | (rng.random(barred.shape) < 0.1)] = np.nan  # a rating without p_fail
    c_r = np.where(unknown, np.nan, rng.gamma(2.0, 0.1, barred.shape))
    obstacle = np.where(rng.random(barred.shape) < 0.3, rng.random(barred.shape), 0.0)
    site = TileMap(c_r, barred, p_fail, obstacle)
    return site.read(site.window)


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("unknown", [None, 12.5])
@pytest.mark.parametrize("risk", [0.0, 80.0, 4000.0])
def test_cost_of_every_tile(robust, unknown, risk):
    field = made_field(300, 7)
    cost = of_field(field, risk=risk, robust=robust, unknown=unknown)
    hazard = -np.log1p(-np.nan_to_num(field.p_fail.astype(float))) / field.rule.drive_m
    ride = (field.c_r_high if robust else field.c_r).astype(float)
    expected = np.where(field.barred == Barred.NO, 1.0 + field.rule.ride_weight * ride + risk * hazard, np.inf)
    if unknown is not None:
        expected[np.isin(field.barred, CROSSING_UNKNOWN) & ~(field.obstacle > 0)] = unknown
    assert cost.dtype == np.float32
    assert np.array_equal(cost, np.float32(expected))


TALL, WIDE = 120, 140


def map_with_walls(seed):
    """Walls through most of the map, in a random direction: ways must go far around."""
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (TALL, WIDE), most=3, width=2)
    for _ in range(4):
        row, col, half = rng.integers(5, 115), rng.integers(5, 135), rng.integers(20, 70)
        if rng.random() < 0.5:
            cost[row, max(0, col - half) : col + half] = np.inf
        else:
            cost[max(0, row - half) : row + half, col] = np.inf
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2] + rng.random((2, 2))
    return cost, tuple(start), tuple(goal)


def plan(cost, start, goal, memory_tiles=10**6):
    """Plan over tiles of such costs; return the line in field coordinates, and the windows that were read."""
    site = TileMap((np.where(np.isfinite(cost), cost, 1.0) - 1.0) / 5.0, np.where(np.isfinite(cost), 0, Barred.SLOPE))
    ground = CostGround(site, CostSettings(), memory_tiles)
    line = tile_line(ground, site.at(*start), site.at(*goal))
    return None if line is None else in_window(line, site.grid, site.window), site.windows


@pytest.mark.parametrize("seed", range(6))
def test_a_grown_window_gives_the_way_of_the_whole_map(seed):
    cost, start, goal = map_with_walls(seed)
    line, windows = plan(cost, start, goal)
    whole = find_way(cost, start, goal, margin=WARTHOG.reach_m / 3.0)
    assert windows
    if whole is None:
        assert line is None
        return
    assert line_cost(cost, line) == pytest.approx(line_cost(cost, whole), rel=1e-6)
    np.testing.assert_allclose(line[[0, -1]], [start, goal], rtol=0, atol=1e-6)


def test_a_window_that_memory_does_not_hold_is_refused():
    cost = np.ones((TALL, WIDE), np.float32)
    cost[60, :-1] = np.inf  # a way around it leads along the whole map
    with pytest.raises(UsageError, match=r"tiles or more, .* GB of memory; allowed are 5000 tiles.*via points"):
        plan(cost, (50.0, 20.0), (70.0, 20.0), memory_tiles=5000)
    line, windows = plan(cost, (50.0, 20.0), (70.0, 20.0))
    assert line_cost(cost, line) > 200
    assert len(windows) > 1


CODES = (Barred.SLOPE, Barred.OBSTACLE, Barred.UNKNOWN, Barred.STEP, Barred.SPLIT)


def stony_map(seed, size=(26, 34)):
    """A map with closed tiles and stones, some of them beside the ends; and the ends."""
    rng = np.random.default_rng(seed)
    barred = np.where(rng.random(size) < 0.18, rng.choice(CODES, size=size), Barred.NO)
    vehicle = RouteVehicle("cart", float(rng.choice([1.0, 1.18, 1.38, 2.2])), 1.0)
    site = TileMap(rng.uniform(0.05, 0.5, size), barred, vehicle=vehicle)
    site.stones = [tuple(site.at(*place)) for place in rng.uniform(0, size, (140, 2))]
    free = np.argwhere(site.passage(site.window))
    ends = [site.at(*(place + 0.5) / site.grid.pixels) for place in free[rng.integers(len(free), size=2)]]
    return site, np.array(ends)


@pytest.mark.parametrize("seed", [3, 5, 6, 13, 14, 28, 34, 50])
def test_a_way_touches_nothing_and_is_there_wherever_a_search_over_pixels_finds_one(seed):
    site, ends = stony_map(seed)
    ground = ground_of(site)
    line, back = Planner(ground).line(*ends), Planner(ground).line(*ends[::-1])
    start, goal = np.floor(ground.in_window(ends, site.window)).astype(int)
    best = cheapest_on_pixels(ground.on_pixels(site.window), start, goal, site.grid.pixel_size)
    if line is None:
        assert not np.isfinite(best)
        assert back is None
        return
    np.testing.assert_array_equal(line, back[::-1])
    assert way_cost(ground, line) <= 1.03 * best
    way = shapely.LineString(line)
    along = shapely.get_coordinates(shapely.line_interpolate_point(way, np.arange(0.0, way.length, 0.01)))
    middles = (np.floor(np.array(site.stones) / site.grid.pixel_size) + 0.5) * site.grid.pixel_size
    apart = np.hypot(*(along[:, None] - middles).T).min(axis=0)
    assert apart.min() > 0.5 * site.vehicle.width_m - 0.01
    assert ground.is_clear(line)


def test_the_way_of_least_time_takes_less_than_that_of_least_cost():
    rng = np.random.default_rng(9)
    c_r = rng.gamma(2.0, 0.1, (30, 40))
    site = TileMap(c_r, np.where(rng.random(c_r.shape) < 0.1, Barred.SLOPE, Barred.NO))
    slow = np.maximum(c_r / 0.15, 1.0) / 2.0
    ends = np.array([site.at(15.4, 20.7), site.at(2.5, 1.5)])
    ways = {kind: planner(site, by=kind).way(ends) for kind in ("cost", "time")}
    seconds = [way.figures.seconds for way in ways.values()]
    assert seconds[1] < seconds[0]
    assert ways["time"].figures.cost_m == pytest.approx(2.0 * seconds[1], rel=1e-6)
    line = shapely.LineString(in_window(ways["time"].line, site.grid, site.window))
    steps = math.ceil(line.length / 0.007)
    tile = shapely.get_coordinates(line.interpolate((np.arange(steps) + 0.5) / steps, normalized=True)).astype(int)
    assert seconds[1] == pytest.approx(3.0 * slow[*tile.T].mean() * line.length, rel=0.005)


def test_a_way_leads_over_corners_of_pixels_where_half_the_width_is_free():
    """Of the pixels of a diagonal corridor in which the middle fits, each touches the next at a corner alone."""
    barred = np.zeros((10, 10), np.uint8)
    barred[:, 4:7] = Barred.SPLIT
    site, along = TileMap(np.full((10, 10), 0.2), barred), np.arange(13)
    north, south = np.stack([60 + along, 81 + along], 1), np.stack([66 + along, 75 + along], 1)
    to_north = np.stack(np.broadcast_arrays(np.arange(60), north[0, 1]), 1)
    to_south = np.stack(np.broadcast_arrays(np.arange(south[-1, 0], 150), south[-1, 1]), 1)
    pixels = np.concatenate([north, to_north, south, to_south])
    site.stones = [tuple(map(float, site.at(*((pixel + 0.5) / 15)))) for pixel in pixels]
    start, goal = site.at(5.5, 1.5), site.at(5.5, 8.5)
    ground = ground_of(site)
    way = shapely.LineString(Planner(ground).line(start, goal))
    gap = shapely.distance(way, shapely.points(np.array(site.stones))).min()
    assert 0.5 * site.vehicle.width_m < gap < 0.5 * site.vehicle.width_m + 0.2


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
