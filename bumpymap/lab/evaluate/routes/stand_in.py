"""A plain planner: the cheapest way from tile to neighbouring tile, then shortened where a straight line is cheaper."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.evaluate.routes.predicted import cut_at_tiles

__all__ = ["GridPlanner"]

Floats = NDArray[np.float64]
_SAMPLE = 0.1
"""Distance of the places at which the room beside a line is checked, tiles."""


class GridPlanner:
    """Plans with scikit-image over four neighbours; tests and evaluations can take it in the place of another planner.

    Parameters
    ----------
    margin : float
        Distance that a shortened way keeps from closed tiles, tiles.
    """

    def __init__(self, margin: float) -> None:
        self._margin = margin

    def __call__(self, cost: Floats, start: Floats, goal: Floats) -> Floats | None:
        """Plan a way; see `Planner`."""
        from skimage.graph import route_through_array

        ends = [tuple(int(index) for index in place) for place in (start, goal)]
        if not all(np.isfinite(cost[end]) for end in ends):
            return None
        open_cost = np.where(np.isfinite(cost), cost, -1.0)
        try:
            tiles, _ = route_through_array(open_cost, *ends, fully_connected=False, geometric=True)
        except ValueError:  # no way
            return None
        line = np.concatenate([[start], np.array(tiles[1:-1]).reshape(-1, 2) + 0.5, [goal]])
        return self._shortened(cost, line)

    def _shortened(self, cost: Floats, line: Floats) -> Floats:
        """Leave out corners from the start on, as far as each straight piece is clear and no dearer."""
        legs = [_cost_of(cost, pair) for pair in np.stack([line[:-1], line[1:]], axis=1)]
        so_far = np.concatenate([[0.0], np.cumsum(legs)])
        kept, at = [0], 0
        while at < len(line) - 1:
            for to in range(len(line) - 1, at, -1):
                piece = line[[at, to]]
                dear = to > at + 1 and _cost_of(cost, piece) > so_far[to] - so_far[at] + 1e-9
                if to == at + 1 or not (dear or self._blocked(cost, piece)):
                    break
            kept.append(to)
            at = to
        return line[kept]

    def _blocked(self, cost: Floats, piece: Floats) -> bool:
        """Return whether a straight piece comes closer than the margin to a closed tile or the rim of the map."""
        a, b = piece
        share = np.linspace(0, 1, max(int(np.hypot(*(b - a)) / _SAMPLE), 1) + 1)
        places = a + share[:, None] * (b - a)
        turn = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        around = places[:, None] + self._margin * np.stack([np.sin(turn), np.cos(turn)], axis=1)
        row, col = np.floor(around).astype(np.int64).reshape(-1, 2).T
        inside = (row >= 0) & (col >= 0) & (row < cost.shape[0]) & (col < cost.shape[1])
        return not inside.all() or not np.isfinite(cost[row, col]).all()


def _cost_of(cost: Floats, piece: Floats) -> float:
    pieces = cut_at_tiles(piece)
    return float(cost[pieces.row, pieces.col] @ pieces.length)
