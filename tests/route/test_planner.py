"""Ways over maps in memory: weights of risk, closed tiles, areas, stops."""

import math

import numpy as np
import pytest
import shapely
from tile_maps import TileMap

from bumpymap.core import Barred
from bumpymap.route.ground import CostGround
from bumpymap.route.no_way import widest_opening
from bumpymap.route.planner import Planner
from bumpymap.route.settings import CostSettings


def planner(site, **settings):
    return Planner(CostGround(site, CostSettings(**settings), 10**7))


def rough_map(seed, rows=60, cols=70, barred_share=0.15):
    """Smooth hills of ride cost, and risk where the ride is smooth, so that both pull apart."""
    rng = np.random.default_rng(seed)
    relief = rng.normal(size=(rows, cols))
    for _ in range(4):
        relief += np.roll(relief, 1, 0) + np.roll(relief, 1, 1) + np.roll(relief, -1, 0) + np.roll(relief, -1, 1)
    rank = relief.argsort(axis=None).argsort().reshape(relief.shape) / relief.size
    barred = np.where(rng.random(relief.shape) < barred_share, Barred.SLOPE, Barred.NO)
    barred[:3], barred[-3:] = Barred.NO, Barred.NO
    return TileMap(0.02 + 0.5 * rank, barred, p_fail=0.3 * (1 - rank) ** 2)


def test_a_heavier_risk_costs_more_and_arrives_more_surely():
    site = rough_map(0)
    stops = np.array([site.at(1.5, 1.5), site.at(58.5, 68.5)])
    ways = [planner(site).way(stops, risk) for risk in (0.0, 30.0, 300.0, 3000.0, 30000.0)]
    hazard = [way.figures.hazard for way in ways]
    ride = [way.figures.cost_m - 300.0 * way.figures.hazard for way in ways]
    for first, second in zip(range(4), range(1, 5), strict=True):
        assert hazard[second] <= hazard[first] * (1 + 1e-3)
        assert ride[second] >= ride[first] * (1 - 1e-3)
    assert hazard[-1] < 0.9 * hazard[0]


def test_unknown_ground_is_crossed_only_at_a_price():
    barred = np.zeros((9, 30), np.uint8)
    barred[:, 14:17] = Barred.UNKNOWN
    site = TileMap(np.full((9, 30), 0.1), barred)
    stops = np.array([site.at(4.5, 1.5), site.at(4.5, 28.5)])
    assert planner(site).way(stops) is None
    way = planner(site, unknown=4.0).way(stops)
    assert way.figures.unknown_m == pytest.approx(9.0, rel=1e-6)
    assert way.figures.cost_m == pytest.approx(24 * 3 * 1.5 + 9 * 4.0, rel=1e-6)


def test_areas_close_tiles():
    site = TileMap(np.full((20, 30), 0.1))
    stops = np.array([site.at(10.5, 1.5), site.at(10.5, 28.5)])
    (west, south), (east, north) = site.at(20, 14), site.at(5, 16)
    wall = np.array([shapely.box(west + 1, south, east - 1, north)])
    free = planner(site).way(stops)
    around = Planner(CostGround(site, CostSettings(), 10**7, avoid=wall)).way(stops)
    assert free.figures.detour == pytest.approx(1.0)
    assert around.figures.detour > 1.05
    assert not ({14, 15} & set(around.tiles[around.tiles[:, 1] < site.south + 15][:, 0] - site.west))
    assert Planner(CostGround(site, CostSettings(), 10**7, only=wall)).way(stops) is None


def test_a_way_keeps_room_beside_obstacles_where_there_is_room():
    site = TileMap(np.full((21, 40), 0.1))
    stops = np.array([site.at(10.5, 2.5), site.at(10.5, 37.5)])
    site.stones = [tuple(site.at(10.6, 20.5))]
    plan = planner(site)
    way = plan.way(stops)
    assert shapely.distance(shapely.LineString(way.line), shapely.Point(site.stones[0])) > site.vehicle.reach_m + 0.3
    assert way.figures.tight_turns_deg == 0.0


def test_turns_between_obstacles_count_against_arriving():
    barred = np.full((9, 20), Barred.SLOPE)
    barred[4] = Barred.NO
    site = TileMap(np.full((9, 20), 0.1), barred)
    site.stones = [tuple(site.at(4.37, 10.5)), tuple(site.at(4.63, 12.5))]
    figures = planner(site).way(np.array([site.at(4.5, 1.5), site.at(4.5, 18.5)])).figures
    assert 10.0 < figures.tight_turns_deg < 180.0
    assert figures.p_arrives == pytest.approx(np.exp(-figures.hazard - figures.tight_turns_deg / 100))


def test_where_every_way_touches_an_obstacle_there_is_none_unless_it_is_asked_for():
    barred = np.full((9, 20), Barred.SLOPE)
    barred[4] = Barred.NO
    site = TileMap(np.full((9, 20), 0.1), barred)
    site.stones = [tuple(site.at(4.5, 10.5))]
    stops = np.array([site.at(4.5, 1.5), site.at(4.5, 18.5)])
    assert planner(site).way(stops) is None
    plan = planner(site, through_obstacles=True)
    measured = plan.way(stops)
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


def test_a_corridor_that_an_obstacle_fills_is_left_for_another_far_away():
    barred = np.full((24, 20), Barred.SLOPE)
    barred[2], barred[20] = Barred.NO, Barred.NO
    barred[:21, 1], barred[:21, 18] = Barred.NO, Barred.NO
    site = TileMap(np.full((24, 20), 0.1), barred)
    stops = np.array([site.at(2.5, 1.5), site.at(2.5, 18.5)])
    assert planner(site).way(stops).figures.detour == pytest.approx(1.0, abs=1e-6)
    site.stones = [tuple(site.at(2.5, 10.5))]
    figures = planner(site).way(stops).figures
    assert figures.obstacle_m == 0.0
    assert figures.length_m > 2 * 17 * 3.0


@pytest.mark.parametrize(("half", "width"), [(0.65, 1.4), (0.45, 1.0)])
def test_the_widest_opening_in_a_wall_is_found_and_measured(half, width):
    site = TileMap(np.full((20, 20), 0.1))
    south, north = site.at(20, 10)[1], site.at(0, 10)[1]
    line, wall = np.arange(south + 0.1, north, 0.2), site.at(0, 10)[0] + 0.1
    stops = np.array([site.at(15.5, 3.5), site.at(15.5, 16.5)])
    gap, narrower = site.at(2.2, 10)[1] + 0.1, site.at(15.5, 10)[1]
    site.stones = [(wall, y) for y in line if abs(y - gap) > half and abs(y - narrower) > 0.25]
    place, found = widest_opening(planner(site).ground, *stops)
    assert math.dist(place, (wall, gap)) < 0.5
    assert found == pytest.approx(width, abs=0.21)
    site.stones = [(wall, y) for y in line]
    assert widest_opening(planner(site).ground, *stops) is None
