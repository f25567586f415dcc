"""Alternatives: the hull of cost against risk, and ways over other ground, with ways that are made up."""

from dataclasses import dataclass

import numpy as np
import pytest

from bumpymap.route.alternatives import find_alternatives
from bumpymap.route.ground import WornTiles
from bumpymap.route.measure import MeasuredWay
from bumpytiles import TileWindow


@dataclass
class Figures:
    cost_m: float
    hazard: float


OWN_RISK = 300.0


def way(ride, hazard, row, tiles=10):
    """Return a way along a row of tiles."""
    own = np.column_stack([np.arange(tiles), np.full(tiles, 5 * row)])
    return MeasuredWay(np.zeros((2, 2)), Figures(ride + OWN_RISK * hazard, hazard), None, own)


def planner(ways):
    """Plan among given ways, as a search would."""

    def plan(risk, worn):
        def cost(one):
            figures = one.figures
            total = figures.cost_m + (risk - OWN_RISK) * figures.hazard
            if worn is not None:
                used = {tuple(tile) for tile in worn.tiles}
                share = np.mean([tuple(tile) in used for tile in one.tiles])
                total *= 1 + (worn.factor - 1) * share
            return total

        return min(ways, key=cost)

    return plan


def test_the_hull_is_found_whole_and_in_order():
    hull = [way(100, 0.5, 0), way(120, 0.3, 1), way(160, 0.1, 2), way(250, 0.0, 3)]
    inside = [way(200, 0.4, 4), way(240, 0.2, 5)]
    found = find_alternatives(planner([*hull, *inside]), 4, OWN_RISK)
    assert [each for each, _ in found[:1]] == [hull[2]]
    assert {id(each) for each, _ in found} == {id(each) for each in hull}
    weights = {id(each): weight for each, weight in found}
    assert weights[id(hull[1])] == pytest.approx((160 - 100) / (0.5 - 0.1))  # where its neighbours cost the same
    costs = [each.figures.cost_m for each, _ in found[1:]]
    assert costs == sorted(costs)


def test_where_the_hull_ends_ways_over_other_ground_follow():
    ways = [way(100, 0.0, 0), way(110, 0.0, 1), way(120, 0.0, 2), way(900, 0.0, 3)]
    found = find_alternatives(planner(ways), 4, OWN_RISK)
    assert [each for each, _ in found] == ways[:3]  # the last is not worth proposing


def test_no_way_gives_none():
    assert find_alternatives(lambda _risk, _worn: None, 3, OWN_RISK) == []


@pytest.mark.parametrize("tile", [(10, 20), (13, 21)])
def test_worn_tiles_and_those_beside_them_are_dearer(tile):
    window = TileWindow(10, 20, 4, 3)
    factors = WornTiles(np.array([tile, (500, 500)]), 2.0).factors(window)
    rows, cols = np.mgrid[0:3, 0:4]
    near = np.maximum(abs(window.row + 2 - rows - tile[1]), abs(window.col + cols - tile[0])) <= 1
    assert factors.dtype == np.float32
    assert (factors == np.where(near, 2.0, 1.0)).all()
