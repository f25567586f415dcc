"""What the map says of a line."""

import math

import numpy as np
import pytest
from _route_trial import cut_at_tiles, predict_line

from bumpymap.core import CostRule, Georeference, RouteVehicle, TileField
from bumpytiles import Grid, TileWindow

RULE = CostRule(5.0, 300.0, 10.0, 30.0)


def field_of(c_r, p_fail=0.0, barred=0):
    c_r = np.asarray(c_r, np.float32)
    full = [np.broadcast_to(np.float32(value), c_r.shape).copy() for value in (p_fail, 0.0)]
    return TileField(
        Grid(),
        Georeference(None),
        TileWindow(0, 0, c_r.shape[1], c_r.shape[0]),
        np.broadcast_to(np.uint8(barred), c_r.shape).copy(),
        c_r,
        c_r / 2,
        c_r * 2,
        *full,
        RULE,
        RouteVehicle("warthog", 1.37, 1.0),
    )


@pytest.mark.parametrize("seed", range(20))
def test_pieces_add_up_and_lie_in_their_tiles(seed):
    rng = np.random.default_rng(seed)
    line = rng.uniform(0, 8, (4, 2))
    if seed % 4 == 0:
        line = np.round(line * 2) / 2  # along borders and through corners
    pieces = cut_at_tiles(line)
    legs = np.hypot(*np.diff(line, axis=0).T)
    assert pieces.length.sum() == pytest.approx(legs.sum())
    # Dense samples of the line count the same tiles.
    share = (np.arange(20000) + 0.5) / 20000
    dense = np.zeros((9, 9))
    for a, b, leg in zip(line[:-1], line[1:], legs, strict=True):
        row, col = np.floor(a + share[:, None] * (b - a)).astype(int).T
        np.add.at(dense, (row, col), leg / 20000)
    exact = np.zeros((9, 9))
    np.add.at(exact, (pieces.row, pieces.col), pieces.length)
    assert exact == pytest.approx(dense, abs=2e-3)


def test_a_whole_way_by_hand():
    field = field_of([[0.1, 0.2, np.nan]], p_fail=0.5)
    raw = np.array([[0.2, 0.4, np.nan]])
    said = predict_line(field, np.array([[0.5, 0.5], [0.5, 2.5]]), raw)
    assert said.length_m == pytest.approx(6.0)
    c_r = (1.5 * 0.1 + 3 * 0.2) / 4.5
    assert (said.c_r, said.c_r_low, said.c_r_high, said.c_r_raw) == pytest.approx((c_r, c_r / 2, 2 * c_r, 2 * c_r))
    assert said.hazard == pytest.approx(6.0 * math.log(2) / 10)
    assert said.p_arrives == pytest.approx(0.5**0.6)
    assert said.cost_m == pytest.approx(6 * (1 + 5 * c_r) + 300 * said.hazard)
    assert (said.unknown_m, said.barred_m, said.obstacle_m) == pytest.approx((1.5, 0, 0))


def test_ground_on_which_every_drive_fails_leaves_no_hope():
    field = field_of([[0.1, 0.2, 0.1]])
    field.p_fail[0, 1] = 1.0
    field.barred[0, 1] = 4
    said = predict_line(field, np.array([[0.5, 0.5], [0.5, 2.5]]), field.c_r)
    assert said.p_arrives == 0.0
    assert said.cost_m == math.inf
    assert said.barred_m == pytest.approx(3.0)
