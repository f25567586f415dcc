from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as arrays
from route_maps import RULE, bare_map

from bumpymap.core import NO_TILE, BadInputError, Barred, TileField
from bumpymap.route import GridPoint, cost_of, nearest_usable, parse_point, usable_point
from bumpytiles import TileWindow

MASKS = arrays.arrays(bool, st.tuples(st.integers(1, 40), st.integers(1, 40)), elements=st.booleans())


def distance_by_hand(is_open, row, col, margin):
    """Distance to the nearest shrunk square, tile by tile."""
    best = np.inf
    for i, j in np.argwhere(is_open):
        if i <= row < i + 1 and j <= col < j + 1:
            return 0.0
        down = max(i + margin - row, 0.0, row - (i + 1 - margin))
        right = max(j + margin - col, 0.0, col - (j + 1 - margin))
        best = min(best, np.hypot(down, right))
    return best


@given(MASKS, st.floats(-30, 70), st.floats(-30, 70), st.floats(0.0, 0.5), st.integers(0, 3))
def test_the_nearest_point_in_an_open_tile(mask, row, col, margin, sparse):
    is_open = mask & (np.indices(mask.shape).sum(0) % (1 + 7 * sparse) == 0)  # few open tiles, far away
    found = nearest_usable(is_open, row, col, margin=margin)
    expected = distance_by_hand(is_open, row, col, margin)
    if found is None:
        assert not is_open.any()
        return
    assert found.distance == pytest.approx(expected, abs=1e-9)
    assert np.hypot(found.row - row, found.col - col) == pytest.approx(found.distance, abs=1e-9)
    i, j = int(np.floor(found.row)), int(np.floor(found.col))
    if margin > 1e-6:
        assert is_open[i, j]
        if found.distance > 0:
            assert min(found.row - i, i + 1 - found.row, found.col - j, j + 1 - found.col) >= margin - 1e-9


def test_far_away_in_a_large_window():
    is_open = np.zeros((2000, 1500), bool)
    is_open[1990, 3] = True
    found = nearest_usable(is_open, 5.5, 1400.5)
    assert (found.row, found.col) == (1990.25, 3.75)
    assert found.distance == pytest.approx(np.hypot(1984.75, 1396.75))
    assert nearest_usable(np.zeros((2000, 1500), bool), 5.5, 1400.5) is None


def test_equally_near_points_are_chosen_by_place():
    is_open = np.ones((3, 3), bool)
    is_open[1, 1] = False
    found = nearest_usable(is_open, 1.5, 1.5)
    assert (found.row, found.col) == (0.75, 1.5)


SITE = bare_map(TileWindow(160_000, 712_000, 30, 20))


def field_with(code, *, opened=(12, 14)):
    """All tiles closed by one code, but for one."""
    barred = np.full((20, 30), code, np.uint8)
    barred[opened] = Barred.NO
    known = np.full(barred.shape, 0.1, np.float32)
    return TileField(
        SITE.grid,
        SITE.georeference,
        SITE.window,
        barred=barred,
        c_r=known,
        c_r_low=known,
        c_r_high=known,
        p_fail=known,
        obstacle=known,
        rule=RULE,
        vehicle=SITE.vehicle,
    )


def at(row, col):
    """The point at field coordinates of the site."""
    return GridPoint((160_000 + col) * 3.0, (712_020 - row) * 3.0)


def test_an_open_point_stays_where_it_is():
    field = field_with(Barred.SLOPE)
    point = at(12.01, 14.99)
    assert usable_point(SITE, field, cost_of(field), point) == point


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (Barred.UNKNOWN, "unknown ground; `unknown=COST`"),
        (Barred.OBSTACLE, r"not passable \(obstacle\)"),
        (Barred.SLOPE, r"not passable \(too steep\)"),
        (Barred.FAILS, r"not passable \(drives fail\)"),
        (Barred.STEP, r"not passable \(step\)"),
        (NO_TILE, "a tile without points"),
    ],
)
def test_the_message_says_what_closes_the_tile_and_where_to_go(code, words):
    field = field_with(code)
    with pytest.raises(BadInputError, match=f"the goal lies on .*{words}") as caught:
        usable_point(SITE, field, cost_of(field), at(12.5, 10.5), name="the goal")
    told = str(caught.value)
    assert "is 11.2 m away" in told  # 3.75 tiles of 3 m
    assert "`snap=12`" in told
    longitude_latitude = told.split(" (longitude", maxsplit=1)[0].rsplit(maxsplit=1)[-1]
    assert parse_point(longitude_latitude, SITE) == pytest.approx(at(12.5, 14.25), abs=0.02)


def test_snapping_takes_a_point_that_is_near_enough():
    field = field_with(Barred.SLOPE)
    cost, point = cost_of(field), at(12.5, 10.5)
    with pytest.raises(BadInputError, match=r"11\.2 m away"):
        usable_point(SITE, field, cost, point, snap_m=11.24)
    assert usable_point(SITE, field, cost, point, snap_m=11.25) == pytest.approx(at(12.5, 14.25))
    assert usable_point(SITE, field, cost, point, snap_m=12.0, margin=0.5) == pytest.approx(at(12.5, 14.5))
    outside = at(12.5, 31.0)
    assert usable_point(SITE, field, cost, outside, snap_m=60.0) == pytest.approx(at(12.5, 14.75))


def test_tiles_that_the_user_closed_and_no_open_tile_at_all():
    field = field_with(Barred.NO)
    cost = np.full(field.barred.shape, np.inf, np.float32)
    with pytest.raises(BadInputError, match=r"`avoid` or `only`.*No tile in the 90 m x 60 m around it"):
        usable_point(SITE, field, cost, at(3.5, 3.5))


def test_without_a_crs_the_point_is_given_in_coordinates_of_the_survey():
    local = bare_map(SITE.window, crs=None)
    field = replace(field_with(Barred.STEP), georeference=local.georeference)
    with pytest.raises(BadInputError, match=r"at crs:480042\.75,2136022\.50") as caught:
        usable_point(local, field, cost_of(field), at(12.5, 10.5))
    assert "longitude" not in str(caught.value)
