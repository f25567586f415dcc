import numpy as np
import pytest
from route_maps import RULE, bare_map

from bumpymap.core import NO_TILE, Barred, TileField
from bumpymap.route import CostSettings
from bumpymap.route.ground import CostGround
from bumpytiles import TileWindow


def made_field(rows=600, cols=40, seed=1):
    """Random tiles of every kind; more rows than are computed at once."""
    rng = np.random.default_rng(seed)
    place = bare_map(TileWindow(160_000, 712_000, cols, rows))
    barred = rng.choice([*Barred, NO_TILE], (rows, cols), p=[0.5, 0.2, 0.05, 0.05, 0.05, 0.05, 0.05, 0.05]).astype(
        np.uint8
    )
    low, middle, high = np.sort(rng.gamma(2.0, 0.1, (3, rows, cols)).astype(np.float32), axis=0)
    p_fail = (rng.random(barred.shape) * 0.5).astype(np.float32)
    obstacle = np.where(rng.random(barred.shape) < 0.3, rng.random(barred.shape), 0.0).astype(np.float32)
    p_fail[rng.random(barred.shape) < 0.1] = np.nan  # a rating without p_fail
    unknown = (barred == Barred.UNKNOWN) | (barred == NO_TILE)
    for band in (low, middle, high, p_fail):
        band[unknown] = np.nan
    return TileField(
        place.grid,
        place.georeference,
        place.window,
        barred=barred,
        c_r=middle,
        c_r_low=low,
        c_r_high=high,
        p_fail=p_fail,
        obstacle=obstacle,
        rule=RULE,
        vehicle=place.vehicle,
    )


def cost_of(field, **settings):
    return CostGround(None, CostSettings(**settings), 1).of_field(field, through=False)


def by_hand(field, i, j, *, risk, robust=False, unknown=None):
    """Cost of one tile in plain Python."""
    code = int(field.barred[i, j])
    if code == Barred.UNKNOWN and unknown is not None and not field.obstacle[i, j] > 0:
        return unknown
    if code != Barred.NO:
        return np.inf
    p_fail = float(field.p_fail[i, j])
    hazard = 0.0 if np.isnan(p_fail) else -np.log1p(-p_fail) / field.rule.drive_m
    shaking = float((field.c_r_high if robust else field.c_r)[i, j])
    return 1.0 + field.rule.ride_weight * shaking + risk * hazard


@pytest.mark.parametrize("robust", [False, True])
@pytest.mark.parametrize("unknown", [None, 12.5])
@pytest.mark.parametrize("risk", [0.0, 80.0, 4000.0])
def test_cost_of_every_tile(robust, unknown, risk):
    field = made_field(300, 7)
    cost = cost_of(field, risk=risk, robust=robust, unknown=unknown)
    expected = [by_hand(field, i, j, risk=risk, robust=robust, unknown=unknown) for i, j in np.ndindex(cost.shape)]
    assert cost.dtype == np.float32
    assert np.array_equal(cost.ravel(), np.float32(expected))
    assert cost.min() >= 1.0


def test_default_risk_is_that_of_the_layers():
    """The values of cost.tif, as the writer makes them, to the last bit."""
    field = made_field()
    factor = RULE.cost(field.c_r.astype(np.float64), RULE.hazard(field.p_fail))
    written = np.where(field.barred == Barred.NO, factor, np.nan).astype(np.float32)
    assert np.array_equal(cost_of(field), np.where(np.isnan(written), np.inf, written))
    assert np.array_equal(cost_of(field), cost_of(field, risk=RULE.fail_weight))
