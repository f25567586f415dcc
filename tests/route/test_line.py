import numpy as np
import pytest
from route_oracles import gap_to_closed, integral, smooth_field

from bumpymap.route.straighten import is_clear, line_cost, trace


def random_line(rng, shape, corners=4):
    return rng.uniform(0, 1, (corners, 2)) * shape


@pytest.mark.parametrize("seed", range(5))
def test_cost_is_the_integral_over_tiles(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (20, 30), width=0)
    line = random_line(rng, cost.shape)
    assert line_cost(cost, line) == pytest.approx(integral(cost, line), rel=1e-3)
    assert line_cost(cost, line[::-1]) == pytest.approx(line_cost(cost, line), rel=1e-13)
    cut = np.insert(line, 1, 0.3 * line[0] + 0.7 * line[1], axis=0)
    assert line_cost(cost, cut) == pytest.approx(line_cost(cost, line), rel=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_pieces_are_in_order_add_up_and_lie_in_their_tiles(seed):
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (20, 30), width=0)
    line = random_line(rng, cost.shape)
    pieces = trace(cost, line)
    lengths = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert pieces.length.sum() == pytest.approx(lengths.sum(), rel=1e-12)
    assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(line_cost(cost, line), rel=1e-12)
    middle = np.cumsum(pieces.length) - pieces.length / 2
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    r, c = (np.interp(middle, ends, line[:, axis]) for axis in (0, 1))
    np.testing.assert_array_equal(pieces.row, np.floor(r))
    np.testing.assert_array_equal(pieces.col, np.floor(c))
    step = np.abs(np.diff(pieces.row)) + np.abs(np.diff(pieces.col))
    assert step.max() <= 1  # from tile to neighbour; random lines go through no corner


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


@pytest.mark.parametrize("seed", range(3))
def test_through_corners_and_along_borders_turned_lines_cost_the_same(seed):
    """Corners at whole and half tiles: every special case of borders, in all turns of the map."""
    rng = np.random.default_rng(seed)
    cost = smooth_field(rng, (9, 9), width=0, closed=0.1)
    for _ in range(100):
        line = rng.integers(0, 19, (3, 2)) / 2
        total, clear = line_cost(cost, line), is_clear(cost, line, 0.2)
        for _ in range(4):
            cost, line = np.rot90(cost), np.column_stack([9 - line[:, 1], line[:, 0]])
            for turned, way in ((cost, line[::-1]), (cost[::-1], line * [-1, 1] + [9, 0])):
                assert line_cost(turned, way) == pytest.approx(total, rel=1e-12)
                assert is_clear(turned, way, 0.2) == clear
        if np.isfinite(total):
            pieces = trace(cost, line)
            assert (pieces.length * cost[pieces.row, pieces.col]).sum() == pytest.approx(total, rel=1e-12)


def test_on_the_edge_of_the_window_the_tile_inside_is_traced():
    cost = np.ones((3, 4), np.float32)
    edge = np.array([[0.0, 0.0], [3.0, 0.0], [3.0, 4.0], [0.0, 4.0], [0.0, 0.0]])
    pieces = trace(cost, edge)
    assert pieces.length.sum() == pytest.approx(14)
    assert (pieces.row.min(), pieces.row.max(), pieces.col.min(), pieces.col.max()) == (0, 2, 0, 3)
    with pytest.raises(ValueError, match="leaves the window"):
        trace(cost, np.array([[1.0, 1.0], [1.0, 4.01]]))


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


def test_ends_may_be_near_closed_tiles_but_the_way_may_come_no_nearer():
    cost = np.ones((8, 8), np.float32)
    cost[4:] = np.inf
    assert is_clear(cost, np.array([[3.9, 4.2], [3.5, 4.5], [2.0, 7.0]]), 0.4)  # straight away from it
    assert not is_clear(cost, np.array([[3.9, 2.0], [3.9, 6.0]]), 0.4)  # along it
    assert not is_clear(cost, np.array([[2.0, 2.0], [3.9, 4.0], [2.0, 6.0]]), 0.4)  # in the middle of a line
    assert is_clear(cost, np.array([[3.999, 4.2], [3.5, 4.5]]), 0.4)
    assert not is_clear(cost, np.array([[3.9, 4.2], [4.1, 4.5], [3.5, 4.5]]), 0.0)
