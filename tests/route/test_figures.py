"""Ways over fields of costs, rides of lines, and their figures: scipy's graphs, closed forms, published values."""

import json
import math
import shutil
from dataclasses import replace
from itertools import pairwise, permutations
from types import SimpleNamespace

import numpy as np
import pytest
import shapely
from check_records import stretches_at
from route_maps import place, site, write_folder
from small_surveys import run, write_survey
from tile_maps import TileMap, gap_to_closed, reach_by_graph, smooth_field, with_slope

import bumpymap
from bumpymap.check.stretches import read_line
from bumpymap.core import Barred, DirectionSettings, slope_cost
from bumpymap.layers import open_map
from bumpymap.rating import Calibration, map_calibration
from bumpymap.route import CostSettings, LineVehicle, RouteConfig, ground, measure, plan_routes
from bumpymap.route.ground import CostGround, sample_line
from bumpymap.route.measure import measure_straight_line, measure_way
from bumpymap.route.pipeline import best_order
from bumpymap.route.planner import what_closes
from bumpymap.route.search import (
    MOVES,
    find_way,
    is_clear,
    line_cost,
    seek,
    spread,
    trace,
    wide_margin,
)

SIZE = 3.0


def random_map(rows=30, cols=40, seed=0):
    rng = np.random.default_rng(seed)
    return TileMap(rng.gamma(2.0, 0.1, (rows, cols)), p_fail=rng.random((rows, cols)) * 0.4)


def measured(site, corners, **settings):
    line = np.array([site.at(*corner) for corner in corners])
    return measure_way(CostGround(site, CostSettings(**settings), 10**6), line, line[[0, -1]])


@pytest.mark.parametrize("seed", range(4))
def test_figures_are_sums_over_the_lengths_in_each_tile(seed):
    site = random_map(seed=seed)
    corners = np.random.default_rng(seed).uniform((1, 1), (29, 39), (5, 2))
    found = measured(site, corners).figures
    row, col = np.indices(site.c_r.shape)
    inside = shapely.intersection(shapely.LineString(corners[:, ::-1]), shapely.box(col, row, col + 1, row + 1))
    length = shapely.length(inside) * SIZE
    hazard = -np.log1p(-site.p_fail.astype(float)) / 10.0
    assert found.length_m == pytest.approx(length.sum(), rel=1e-9)
    assert found.c_r_mean == pytest.approx((length * site.c_r).sum() / length.sum(), rel=1e-6)
    assert found.c_r_mean_low == pytest.approx(0.8 * found.c_r_mean, rel=1e-6)
    assert found.c_r_max == pytest.approx(site.c_r[length > 1e-9].max(), rel=1e-6)
    assert found.hazard == pytest.approx((length * hazard).sum(), rel=1e-6)
    assert found.p_arrives == pytest.approx(math.exp(-found.hazard))
    assert found.cost_m == pytest.approx((length * (1 + 5 * site.c_r + 300 * hazard)).sum(), rel=1e-6)
    assert found.seconds == pytest.approx((length * np.maximum(site.c_r / 0.15, 1.0)).sum() / 2.0, rel=1e-6)
    assert found.straight_m == pytest.approx(math.dist(corners[0], corners[-1]) * SIZE, rel=1e-9)


def test_stretches_do_not_change_the_figures(monkeypatch):
    site = random_map(60, 300)
    corners = np.random.default_rng(1).uniform((1, 1), (59, 299), (6, 2))
    whole = measured(site, corners)
    site.windows.clear()
    for room in (measure, ground):
        monkeypatch.setattr(room, "_STRETCH_TILES", 7)
    parts = measured(site, corners)
    assert max(max(window.rows, window.cols) for window in site.windows) <= 11
    assert parts.figures.seen == whole.figures.seen
    for name in set(parts.figures.__dataclass_fields__) - {"seen"}:
        one, same = (getattr(each.figures, name) for each in (parts, whole))
        assert one == (same if same is None else pytest.approx(same, rel=1e-9, nan_ok=True)), name
    for name in parts.profile.__dataclass_fields__:
        np.testing.assert_allclose(getattr(parts.profile, name), getattr(whole.profile, name), rtol=1e-9, atol=1e-9)


def test_a_ramp_climbs_by_its_height_and_the_slope_has_the_sign_of_the_direction():
    slope = 0.05
    site = TileMap(np.full((10, 60), 0.1), height=lambda east, north: slope * (east - 160_000 * SIZE) + 0.0 * north)
    up = measured(site, [(5.5, 2.5), (5.5, 52.5)])
    down = measured(site, [(5.5, 52.5), (5.5, 2.5)])
    assert up.figures.climb_m == pytest.approx(150.0 * slope, abs=0.02)
    assert (up.figures.descent_m, down.figures.climb_m) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert down.figures.descent_m == pytest.approx(up.figures.climb_m, abs=1e-3)
    angle = math.degrees(math.atan(slope))
    inner = slice(3, -3)
    np.testing.assert_allclose(up.profile.slope[inner], angle, atol=0.1)
    np.testing.assert_allclose(down.profile.slope[inner], -angle, atol=0.1)


OPEN, ROUGH = 1.0 + 5.0 * 0.02, 1.0 + 5.0 * 0.4
"""Cost of a metre with a ride weight of 5 m/rad."""


def ground_of(made):
    made.has_crs, made.to_crs = False, lambda x, y: (x, y)
    return CostGround(made, CostSettings(), 10**6)


def look(made, *corners):
    ground = ground_of(made)
    stops = np.array([made.at(*corner) for corner in corners])
    return measure_straight_line(ground, stops, measure_way(ground, stops, stops).figures), ground, stops


def field(rows=9, cols=40):
    return np.full((rows, cols), 0.02), np.zeros((rows, cols), np.uint8)


def test_a_wall_a_gap_in_the_map_and_rough_ground_are_told_with_their_lengths():
    c_r, barred = field()
    barred[:, 10:12], barred[:, 12] = Barred.SLOPE, Barred.FAILS
    c_r[:, 20] = 0.4
    made = TileMap(c_r, barred)
    straight, ground, stops = look(made, (4.5, 3.5), (4.5, 30.5))
    points, step = sample_line(stops, made.grid)
    closed = float((~ground.clear_at(points)).sum()) * step  # the wall, and half the vehicle's width before and behind
    assert straight.closed_m == pytest.approx(closed)
    assert 9.0 + 1.5 < closed < 9.0 + 2.1
    assert straight.cost_m == pytest.approx((81.0 - closed - 3.0) * OPEN + 3.0 * ROUGH, rel=1e-5)
    wall, rough = straight.turns
    assert (wall.why, wall.closed_m) == ("too steep, drives fail", pytest.approx(closed))
    assert [wall.easting, wall.northing] == made.at(4.5, 11.5).tolist()
    assert (rough.closed_m, rough.length_m, "C_r 0.400 rad/m, 3.0 m" in rough.why) == (0.0, pytest.approx(3.0), True)
    for said in (f"closed on {closed:.1f} m", "81 m,", "too steep", "rough ground", "crs:480034.50"):
        assert said in straight.words


def test_beyond_the_map_nothing_is_known_and_the_three_longest_are_named():
    c_r, barred = field()
    for number, col in enumerate((5, 11, 18, 26)):
        barred[:, col : col + number + 1] = Barred.STEP
    straight, *_ = look(TileMap(c_r, barred), (4.5, 1.5), (4.5, 35.5))
    assert [round(turn.closed_m) for turn in straight.turns] == [14, 11, 8]
    straight, *_ = look(TileMap(*field()), (4.5, 1.5), (-4.5, 1.5), (-4.5, 5.5), (4.5, 5.5))
    (beyond,) = straight.turns
    assert "no points" in beyond.why


def test_a_stone_on_open_ground_leaves_no_room():
    made = TileMap(*field())
    made.stones.append(tuple(made.at(4.5, 12.5)))
    straight, *_ = look(made, (4.5, 3.5), (4.5, 30.5))
    (turn,) = straight.turns
    assert "no room beside an obstacle" in turn.why
    assert turn.closed_m == pytest.approx(made.vehicle.width_m + 0.2, abs=0.4)


def test_an_open_line_says_what_it_costs_and_a_point_nothing():
    straight, *_ = look(TileMap(*field()), (4.5, 3.5), (4.5, 30.5))
    assert (straight.closed_m, straight.turns) == (0.0, ())
    assert "is open and costs 89 m; the way costs 89 m" in straight.words
    assert look(TileMap(*field()), (4.5, 3.5), (4.5, 3.5))[0].words == ""


def test_the_command_its_files_and_the_page_say_it(tmp_path):
    layers, out = write_folder(tmp_path / "layers", site()), tmp_path / "way"
    done = run("route", layers, "--from", place(12.5, 5.5), "--to", place(12.5, 25.5), "--out", out, code=0)
    (said,) = [line for line in done.stdout.splitlines() if line.startswith("The straight line, 60 m, is closed")]
    assert "too steep" in said
    straight = json.loads((out / "route.json").read_text())["routes"][0]["straight"]
    assert straight["closed_m"] == pytest.approx(straight["turns"][0]["closed_m"])
    assert math.dist((straight["turns"][0]["x"], 0.0), (float(place(12.5, 15.5).split(",")[0]), 0.0)) < 1e-6
    way = json.loads((out / "route.geojson").read_text())["features"][0]["properties"]
    assert way["why"] == said


def no_way(made, first, last):
    return what_closes(ground_of(made), made.at(*first), made.at(*last))


def test_without_a_way_the_place_where_both_sides_come_closest_is_told():
    c_r, barred = field()
    barred[:, 18:21] = Barred.SLOPE
    said = no_way(TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5))
    assert "come closest at crs:480058.50" in said
    assert "12 m from tile to tile, where there is: too steep" in said


def test_a_start_between_obstacles_does_not_silence_it():
    c_r, barred = field()
    barred[:, 18:21], barred[3:6, 2:5] = Barred.SLOPE, Barred.SPLIT
    assert "come closest" in no_way(TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5))
    barred[:, 18:21], barred[:, 10] = Barred.NO, Barred.OBSTACLE
    assert "leave no opening as wide as the vehicle needs, 1.6 m" in no_way(
        TileMap(c_r, barred), (4.5, 3.5), (4.5, 30.5)
    )


@pytest.mark.parametrize("fixed_end", [True, False])
@pytest.mark.parametrize("seed", range(8))
def test_no_permutation_is_cheaper(seed, fixed_end):
    n = 2 + seed % 5
    costs = np.random.default_rng(seed).uniform(1, 100, (n, n))
    order = best_order(costs, fixed_end=fixed_end)
    orders = [(0, *rest) for rest in permutations(range(1, n)) if not fixed_end or rest[-1] == n - 1]
    assert tuple(order) in orders
    found, *others = (sum(costs[a, b] for a, b in pairwise(one)) for one in (order, *orders))
    assert found == pytest.approx(min(others), rel=1e-12)
    assert best_order(np.full((n, n), np.inf), fixed_end=fixed_end) == list(range(n))  # no order at all


@pytest.mark.parametrize("turned", [False, True])
def test_along_a_border_the_dearer_tile_counts(turned):
    cost = np.array([[1, 5, 1, 2], [3, 1, 1, 2]], np.float32)
    line = np.array([[1.0, 0.5], [1.0, 3.5]])
    cost, line = (cost.T.copy(), line[:, ::-1]) if turned else (cost, line)
    for way in (line, line[::-1]):
        assert line_cost(cost, way) == pytest.approx(0.5 * 3 + 5 + 1 + 0.5 * 2)
        pieces = trace(cost, way)
        assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(line_cost(cost, way))
    cost = np.where(cost == 5, np.inf, cost)
    assert np.isinf(line_cost(cost, line))


def test_ends_may_be_near_closed_tiles_but_the_way_may_come_no_nearer():
    cost = np.ones((8, 8), np.float32)
    cost[4:] = np.inf
    assert is_clear(cost, np.array([[3.9, 4.2], [3.5, 4.5], [2.0, 7.0]]), 0.4)  # straight away from it
    assert not is_clear(cost, np.array([[3.9, 2.0], [3.9, 6.0]]), 0.4)  # along it
    assert not is_clear(cost, np.array([[2.0, 2.0], [3.9, 4.0], [2.0, 6.0]]), 0.4)  # in the middle of a line
    assert is_clear(cost, np.array([[3.999, 4.2], [3.5, 4.5]]), 0.4)
    assert not is_clear(cost, np.array([[3.9, 4.2], [4.1, 4.5], [3.5, 4.5]]), 0.0)


EVEN = np.ones((100, 100), np.float32)


@pytest.mark.parametrize("kind", ["level", "slopes"])
@pytest.mark.parametrize("margin", [0.0, 0.25, 0.4999])
def test_reach_is_that_of_the_same_graph_in_scipy(margin, kind):
    for seed in range(34):
        rng = np.random.default_rng([seed, int(100 * margin)])
        cost = smooth_field(rng, (15, 18), width=seed % 3, closed=rng.uniform(0.0, 0.4))
        start = rng.permutation(np.argwhere(np.isfinite(cost)))[0]
        cost = with_slope(rng, cost, steepest=rng.choice([0.2, np.inf])) if kind == "slopes" else cost
        reach = spread(cost, tuple(start + 0.5), margin)
        np.testing.assert_allclose(reach, reach_by_graph(cost, MOVES, margin, start), rtol=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_a_way_by_moves_costs_what_the_graph_says_or_the_straight_line(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (40, 30), closed=0.2)
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost)))[:2]
    wanted = reach_by_graph(cost, MOVES, wide_margin(0.3), start)[tuple(goal)]
    straight = np.array([start, goal]) + 0.5
    if is_clear(cost, straight, wide_margin(0.3)):
        wanted = min(wanted, line_cost(cost, straight))
    way = find_way(cost, tuple(start + 0.5), tuple(goal + 0.5), margin=0.3)
    if way is None:
        assert math.isinf(wanted)
        return
    found = seek(cost, tuple(start + 0.5), tuple(goal + 0.5), 0.3)
    by_moves = line_cost(found.ground, found.line)
    assert by_moves == pytest.approx(wanted, rel=1e-9)
    assert line_cost(cost, way) <= by_moves
    assert is_clear(cost, way, 0.3)
    assert gap_to_closed(cost, way) >= 0.3 - 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_a_way_is_the_same_back_on_turned_maps_and_on_level_ground_as_without_slopes(seed):
    rng = np.random.default_rng(seed)
    plain = smooth_field(rng, (40, 30), closed=0.1)
    start, goal = rng.permutation(np.argwhere(np.isfinite(plain)))[:2] + np.array([[0.5, 0.5], [0.375, 0.75]])
    cost = with_slope(rng, plain)
    even, swapped = cost._replace(descent=cost.climb), cost._replace(climb=cost.descent, descent=cost.climb)
    way, back, other = (find_way(each, goal, start, margin=0.3) for each in (even, swapped, cost))
    there, uphill = (find_way(each, start, goal, margin=0.3) for each in (even, cost))
    gradient = np.rot90(cost.gradient)[..., ::-1] * np.array([-1, 1], np.float32)
    turned = cost._replace(tiles=np.rot90(cost.tiles), gradient=gradient)
    ends = [(30 - c, r) for r, c in (start, goal)]  # a quarter turn: east is where north was
    for one, same in ((way, there), (back, uphill)):
        np.testing.assert_array_equal(one[::-1], same)
    costs = line_cost(cost, uphill), line_cost(turned, find_way(turned, *ends, margin=0.3))
    assert costs[0] == pytest.approx(costs[1], rel=1e-12)
    assert line_cost(cost, other) != costs[0]
    level = cost._replace(gradient=np.zeros_like(cost.gradient))
    np.testing.assert_array_equal(*(find_way(each, start, goal, margin=0.3) for each in (level, plain)))


@pytest.mark.parametrize("goal", [(4.5, 4.5), (-0.5, 2.0), (12.0, 3.0), (3.0, 1e9)])
def test_ends_in_closed_tiles_or_outside_have_no_way(goal):
    cost = EVEN[:12, :12].copy()
    cost[4, 4] = np.inf
    assert find_way(cost, (1.0, 1.0), goal) is None
    assert find_way(cost, goal, (1.0, 1.0)) is None


@pytest.mark.parametrize("margin", [0.0, 0.2, 0.45])
def test_clear_is_what_shapely_measures(margin):
    """Lines whose ends keep the margin, on random maps."""
    rng, clear = np.random.default_rng(int(100 * margin)), []
    for _ in range(150):
        cost = np.pad(smooth_field(rng, (8, 9), width=1, closed=0.25), 1, constant_values=np.inf)
        line = rng.permutation(np.argwhere(np.isfinite(cost)))[:3] + 0.5 + rng.uniform(-0.04, 0.04, (3, 2))
        gap = gap_to_closed(cost, line)
        assert is_clear(cost, line, margin) == (gap > 0 and gap >= margin)
        clear.append(gap >= margin and gap > 0)
    assert 0.05 < np.mean(clear) < 0.95


@pytest.mark.parametrize("seed", range(4))
def test_a_way_costs_what_its_pieces_do_and_none_lies_in_a_barred_direction(seed):
    rng = np.random.default_rng(seed)
    cost = with_slope(rng, smooth_field(rng, (40, 30), closed=0.1))
    start, goal = rng.permutation(np.argwhere(np.isfinite(cost.tiles)))[:2] + 0.5
    way = find_way(cost, start, goal, margin=0.3)
    pieces, step = trace(cost, way), np.diff(way, axis=0)
    rules = DirectionSettings(climb=6.0, descent=2.0, side_slope=3.0, side_limit=math.degrees(math.atan(0.25 + 1e-6)))
    more, barred = slope_cost(rules, cost.gradient[pieces.row, pieces.col], *step[pieces.part].T)
    each = cost.tiles[pieces.row, pieces.col] + more
    assert (pieces.length * each).sum() == pytest.approx(line_cost(cost, way), rel=1e-9)
    assert not barred.any()


pytestmark = pytest.mark.usefixtures("without_views")

WAVE_M, HEIGHT_M, SIDE_M = 3.0, 0.04, 30.0
WEST, SOUTH = 500_001.0, 4_000_002.0


def across(length=20.0, north=15.0):
    """A line to the east, over the crests of the waves."""
    return [(WEST + 5.0, SOUTH + north), (WEST + 5.0 + length, SOUTH + north)]


def along(length=20.0, east=15.75):
    """A line to the north, along a crest."""
    return [(WEST + east, SOUTH + 5.0), (WEST + east, SOUTH + 5.0 + length)]


@pytest.fixture(scope="module")
def waves(tmp_path_factory):
    """Layers of long even waves that run north, without noise."""
    folder = tmp_path_factory.mktemp("waves")

    def height(x, _):
        return 100.0 + HEIGHT_M * np.sin(2 * np.pi * (x - WEST) / WAVE_M)

    survey = write_survey(folder / "waves.las", points=120_000, side=SIDE_M, height=height)
    return bumpymap.map_survey(survey, folder / "layers")


def test_waves_shake_as_the_closed_form_of_their_drives_says(waves):
    base = 0.92
    expected = 8 * HEIGHT_M * math.sin(math.pi * base / WAVE_M) / (base * WAVE_M)
    ride = bumpymap.ride_along(waves, across(), sigma=0.0)
    c_r, low, high = ride.over(2.0, 18.0)
    assert c_r == pytest.approx(expected, rel=0.15)
    assert low < expected < high
    assert ride.by_line.all()
    assert (ride.seen > 0.9).all()


def test_a_long_line_has_the_ride_of_its_parts(waves):
    there_and_back = [*across(), across()[0]]
    ride = bumpymap.ride_along(waves, [across()[0], *(there_and_back[1:] * 52)])
    assert ride.distance[-1] == pytest.approx(52 * 40.0)
    passes = ride.c_r.reshape(52, 40)
    np.testing.assert_allclose(passes[1:-1], np.broadcast_to(passes[1], (50, 40)), rtol=1e-6)


@pytest.mark.parametrize("length", [0.02, 5.0])
def test_the_ends_of_a_line_are_felt_as_inside_a_longer_one(waves, length):
    short, whole = bumpymap.ride_along(waves, across(length)), bumpymap.ride_along(waves, across())
    inside = bumpymap.ride_along(waves, [(WEST + 2.0, SOUTH + 15.0), across()[1]])
    assert short.over(0.0, length)[0] == pytest.approx(inside.over(3.0, 3.0 + length)[0], rel=0.3)
    assert whole.c_r[0] == pytest.approx(inside.c_r[3], rel=0.02)
    assert whole.a_w[0] == pytest.approx(inside.a_w[3], rel=0.05)
    np.testing.assert_allclose((whole.x[0], whole.y[0]), (WEST + 5.5, SOUTH + 15.0))


def test_the_floor_of_a_vehicle_is_in_the_interval_once(tmp_path):
    survey = write_survey(tmp_path / "flat.las", points=60_000, height=lambda x, _: 100.0 + 0.001 * np.sin(x))
    layers = bumpymap.map_survey(survey, tmp_path / "layers", vehicle="husky")
    ride = bumpymap.ride_along(layers, across(10.0))
    c_r, low, high = ride.over(0.0, 10.0)
    assert c_r == pytest.approx(ride.c_r.mean())
    assert Calibration.shipped("husky").floor <= low < c_r < high


def test_turning_on_an_even_slope_shakes_nobody(tmp_path):
    survey = write_survey(
        tmp_path / "bank.las", points=120_000, side=SIDE_M, height=lambda x, _: 100.0 + 0.3 * (x - WEST)
    )
    layers, turn = bumpymap.map_survey(survey, tmp_path / "layers"), np.linspace(0.0, np.pi / 2, 60)
    arc = np.column_stack([WEST + 5.0 + 15.0 * np.sin(turn), SOUTH + 5.0 + 15.0 * (1.0 - np.cos(turn))])
    assert bumpymap.ride_along(layers, arc).a_w.max() < 0.01


def test_wheels_beside_the_border_of_a_tile_do_not_feel_the_noise_of_the_next(tmp_path):
    layers = bumpymap.map_survey(write_survey(tmp_path / "noisy.las", points=60_000, side=SIDE_M), tmp_path / "layers")
    border, half_track = 3.0 * math.ceil((SOUTH + 12.0) / 3.0) - SOUTH, 0.56
    near, far = (
        bumpymap.ride_along(layers, across(north=border - half_track - beside), sigma=0.0).over(0.0, 20.0)[0]
        for beside in (0.02, 0.7)
    )
    assert near == pytest.approx(far, rel=0.25)


def test_lines_over_noisy_ground_have_the_mean_ride_of_its_tiles_whatever_is_read_with_them(tmp_path):
    rng = np.random.default_rng(1)
    east, north, phase = rng.uniform(-1.0, 1.0, (60, 3, 1)).transpose(1, 0, 2)
    size = 0.003 / (4.0 * np.hypot(east, north) + 0.3)

    def noisy(x, y):
        waves = size * np.sin(4.0 * (east * (x - WEST) + north * (y - SOUTH)) + phase)
        return 100.0 + waves.sum(axis=0) + 0.015 * rng.standard_normal(len(x))

    survey = write_survey(tmp_path / "noisy.las", points=110_000, side=33.0, height=noisy)
    layers = bumpymap.map_survey(survey, tmp_path / "layers")
    places = [(way, place) for way in (across, along) for place in np.arange(6.0, 27.0, 1.4)]
    rides = [bumpymap.ride_along(layers, way(22.0, place), sigma=0.0).over(0.0, 22.0)[0] for way, place in places]
    tiles = bumpymap.open(layers).tiles()
    inner = tiles[tiles["count"] > 800]  # those at the edge of the survey are cut
    assert np.mean(rides) == pytest.approx(inner["c_r"].mean(), rel=0.07)
    alone = bumpymap.ride_along(layers, across(22.0, 16.4), sigma=0.0).c_r
    with_another = bumpymap.ride_along(layers, [*across(22.0, 16.4), *across(22.0, 20.0)[::-1]], sigma=0.0).c_r
    np.testing.assert_allclose(alone[:18], with_another[:18], rtol=1e-6)


def test_the_ride_of_a_metre_does_not_hang_on_how_much_of_the_map_is_read_with_it(tmp_path):
    def posts(x, y):
        return 100.0 + 0.02 * np.sin(9.0 * x) * np.sin(7.0 * y) + (((y - SOUTH) % 3.0 > 2.6) & ((x - WEST) % 3.0 > 2.6))

    survey = write_survey(tmp_path / "posts.las", points=120_000, side=SIDE_M, height=posts)
    layers, (start, end) = bumpymap.map_survey(survey, tmp_path / "layers"), across(north=10.9)
    alone, more = (bumpymap.ride_along(layers, [start, end, *on]) for on in ((), [(end[0], end[1] + 9.0)]))
    np.testing.assert_allclose(alone.c_r[:15], more.c_r[:15], rtol=1e-9)


def test_beyond_the_map_nothing_is_known(waves):
    ride = bumpymap.ride_along(waves, across(length=40.0))
    inside = ride.distance[1:] < 20.0
    assert np.isfinite(ride.c_r[inside]).all()
    assert np.isnan(ride.c_r[ride.distance[:-1] > SIDE_M]).all()
    assert math.isnan(ride.over(30.0, 40.0)[0])
    assert ride.over(0.0, 40.0)[0] == pytest.approx(ride.over(0.0, 26.0)[0], rel=0.1)


def test_an_unsure_place_widens_the_interval_where_it_matters(waves):
    def width(line, sigma):
        _, low, high = bumpymap.ride_along(waves, line, sigma=sigma).over(2.0, 18.0)
        return high / low

    slanting = [(WEST + 5.0, SOUTH + 5.0), (WEST + 8.0, SOUTH + 25.0)]
    assert width(slanting, 1.0) > width(slanting, 0.0)
    assert width(across(), 1.0) == pytest.approx(width(across(), 0.0), rel=0.05)


def test_other_speeds_shake_the_seat_more(waves):
    slow, fast = (bumpymap.ride_along(waves, across(), speed=speed) for speed in (0.5, 1.5))
    assert np.nanmedian(fast.a_w) > 2.0 * np.nanmedian(slow.a_w) > 0.0


@pytest.mark.parametrize("off", [0.0, 1.5])
def test_a_drive_is_held_against_its_own_line_as_far_as_its_positions_are_known(waves, off):
    def of_drive(line):
        """Two stretches of 8 m at 1 m/s, ten samples a second."""
        time, ((x, y), (to_x, to_y)) = np.arange(200) / 10.0, line
        label = np.where(time < 2.0, -1, np.where(time < 18.0, (time >= 10.0).astype(int), -1))
        track = SimpleNamespace(place_sd=lambda at: np.full(len(at), off))
        east, north = (np.interp(time, (0.0, 20.0), ends) for ends in ((x, to_x), (y, to_y)))
        drive = SimpleNamespace(time=time, hertz=10.0, speed=np.ones(200), easting=east, northing=north, track=track)
        two = stretches_at(np.zeros((2, 2)), np.zeros(2), 1.0)
        cut = replace(two, start_s=np.array([2.0, 10.0]), end_s=np.array([10.0, 18.0]), way_m=np.full(2, 8.0))
        return read_line(drive, label, cut, site, vehicle)

    site = open_map(waves)
    vehicle = LineVehicle.of(site, map_calibration(site.manifest, site.grid.tile_size), motion=False)
    slanting = [(WEST + 5.0, SOUTH + 5.0), (WEST + 8.0, SOUTH + 24.8)]
    over, beside = of_drive(across()), of_drive(slanting)
    for line, found in ((across(), over), (slanting, beside)):
        ride = bumpymap.ride_along(waves, line, sigma=max(off, 0.05))
        assert found.c_r == pytest.approx([ride.over(2.0, 10.0)[0], ride.over(10.0, 18.0)[0]], rel=0.1)
        assert (found.c_r_low < found.c_r).all()
    assert (beside.place_sd > 0.1 * beside.c_r).all() == (off > 1.0)
    assert (over.place_sd < 0.1 * over.c_r).all()


@pytest.mark.parametrize(
    ("line", "settings", "message"),
    [
        ([(WEST, SOUTH)], {}, "two points or more"),
        ([(WEST, math.nan), (WEST, SOUTH)], {}, "two points or more"),
        ([(WEST, SOUTH)] * 2, {}, "length is 0"),
        ([(9.1, 48.7), (9.2, 48.7)], {}, "outside the map"),
        ("a line", {}, "are numbers"),
        (across(), {"sigma": -1.0}, "metres from 0 to 5"),
        (across(), {"speed": 40.0}, "holds from"),
    ],
)
def test_senseless_lines_are_refused(waves, line, settings, message):
    with pytest.raises(bumpymap.UsageError, match=message):
        bumpymap.ride_along(waves, line, **settings)


def test_another_calibration_is_refused_and_a_route_does_without(waves, tmp_path):
    other = tmp_path / "husky.json"
    other.write_text(Calibration.shipped("husky").to_json())
    with pytest.raises(bumpymap.BadInputError, match="was made with the calibration"):
        bumpymap.ride_along(waves, across(), calibration=other)
    layers = tmp_path / "layers"
    shutil.copytree(waves, layers)
    manifest = json.loads((layers / "run.json").read_text())
    manifest["calibration"]["id"] = "of-my-own"
    (layers / "run.json").write_text(json.dumps(manifest))
    result = plan_routes(RouteConfig(layers=layers, start="500006,4000017", goal="500026,4000017"))
    assert math.isnan(result.route.figures.c_r_line)
    assert (
        "the ride of the line itself is not known: the map was made with the calibration of-my-own" in result.notes[-1]
    )


def test_a_route_tells_the_ride_of_its_line(waves):
    start, goal = across()
    (way,) = bumpymap.find_routes(waves, start, goal)
    figures = way.figures
    assert figures.c_r_line_low < figures.c_r_line < figures.c_r_line_high
    assert figures.c_r_line > 1.1 * figures.c_r_mean
    assert np.isfinite(way.profile.c_r_line).all()
