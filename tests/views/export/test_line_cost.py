import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from bumpymap.views.export.graph import line_cost

CELL = st.integers(0, 11)


def integral(factor, start, stop):
    """The same by cutting the line with the square of every tile (GEOS)."""
    line = shapely.LineString([np.array(start)[::-1] + 0.5, np.array(stop)[::-1] + 0.5])
    rows, cols = np.indices(factor.shape).reshape(2, -1)
    squares = shapely.box(cols, rows, cols + 1, rows + 1)
    touched = shapely.intersects(squares, line)
    if not np.isfinite(factor.ravel()[touched]).all():
        return np.inf
    return float((shapely.length(shapely.intersection(squares[touched], line)) * factor.ravel()[touched]).sum())


@given(st.integers(0, 2**32 - 1), CELL, CELL, CELL, CELL, st.sampled_from([0.0, 0.03, 0.15]))
@settings(max_examples=150, deadline=None)
def test_the_integral_over_every_tile(seed, row, col, to_row, to_col, closed):
    rng = np.random.default_rng(seed)
    factor = rng.uniform(1.0, 9.0, (12, 12))
    factor[rng.random(factor.shape) < closed] = np.inf
    ends = np.array([[row, col]]), np.array([[to_row, to_col]])
    found = line_cost(factor, *ends)[0]
    expected = integral(factor, (row, col), (to_row, to_col)) if (row, col) != (to_row, to_col) else 0.0
    assert found == pytest.approx(expected, rel=1e-9)
    assert line_cost(factor, *ends[::-1])[0] == pytest.approx(found, rel=1e-12)


def test_a_line_of_many_tiles_in_parts(monkeypatch):
    factor = np.random.default_rng(0).uniform(1, 2, (40, 50))
    start = np.random.default_rng(1).integers(0, 40, (300, 2))
    stop = np.random.default_rng(2).integers(0, 40, (300, 2))
    at_once = line_cost(factor, start, stop)
    monkeypatch.setattr("bumpymap.views.export.graph._CHUNK", 500)
    np.testing.assert_array_equal(line_cost(factor, start, stop), at_once)
    assert len(line_cost(factor, start[:0], stop[:0])) == 0
