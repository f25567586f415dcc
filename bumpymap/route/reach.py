"""The reach from a point: cost and time of the cheapest way to every tile."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLOSED_IN_PART, Barred, Floats, UsageError
from bumpymap.layers import Placement, ReachField
from bumpymap.route.ground import CostGround
from bumpymap.route.places import place_in_window, window_within
from bumpymap.route.search import FROM_START, MoveTables, Point, move_tables, spread, sum_along
from bumpymap.route.straighten import as_cost, line_cost

_STRIP = 64
"""Rows of tiles whose speeds are read at once, so that they take no more memory than the search did."""
_IN_PART = (*CLOSED_IN_PART, Barred.UNKNOWN)
"""Tiles that are closed as a whole, but in which the vehicle may fit."""
_ONLY_WHOLE = (
    "ways between obstacles were not looked for, which would take {size} GB of memory: what lies behind a tile that "
    "obstacles split is not counted. Raise `memory`, or give `isochrones`"
)


@dataclass(frozen=True, slots=True)
class Reach(ReachField):
    """Cost and time of the cheapest way to the tiles of a window from one start, and how it was looked for."""

    passable: int = 0
    """Tiles of the window that are not closed, or in which the vehicle fits between obstacles."""
    limit_m: float | None = None
    """How far from the start the window reaches to each side, m; None: it is the whole map."""
    notes: tuple[str, ...] = ()
    """Remarks, such as that ways between obstacles were not looked for."""

    @property
    def tiles(self) -> int:
        """Number of tiles that can be reached."""
        return int(np.isfinite(self.cost).sum())

    @property
    def share(self) -> float:
        """Share of the window's passable tiles that can be reached."""
        return self.tiles / max(self.passable, 1)

    @property
    def area_ha(self) -> float:
        """Area of the tiles that can be reached, ha."""
        return self.tiles * self.placement.grid.tile_size**2 / 1e4

    @property
    def highest_cost(self) -> float:
        """Cost of the way to the dearest tile, m."""
        return float(np.nanmax(self.cost)) if self.tiles else 0.0


def _times(back: NDArray[np.uint8], slow: NDArray[np.float32], start: Point, moves: MoveTables) -> Floats:
    """Return the time of the way to each tile, (rows, cols), that of a metre times tiles; 0 where there is none.

    ``back`` as of `spread`; ``slow`` (rows, cols): time of a metre; ``start``: field coordinates.
    """
    of_move, per_metre = back.ravel(), slow.ravel()
    own, before = np.zeros(back.size + 1), np.full(back.size + 1, back.size, np.int32)
    for row, col in np.argwhere(back == FROM_START).tolist():
        own[row * back.shape[1] + col] = line_cost(slow[..., None], np.array([start, (row + 0.5, col + 0.5)]))
    for k, step in enumerate(moves.step.tolist()):
        to, inner = np.flatnonzero(of_move == k), slice(*moves.first_piece[k : k + 2])
        before[to] = to - step
        tiles, lengths = [0, step, *moves.piece[inner]], [*moves.end[[k, k]], *moves.piece_length[inner]]
        for tile, length in zip(tiles, lengths, strict=True):
            own[to] += length * per_metre[to - step + tile].astype(np.float64)
    return sum_along(before, own)[:-1].reshape(back.shape)


def find_reach(ground: CostGround, start: NDArray[np.float64], most_m: float = math.inf) -> Reach:
    """Find what can be reached from a point: over whole tiles, and between obstacles in tiles that they close in part.

    Between obstacles the cost is that of a path from area to area, which is up to 3 % off.

    ``start`` (2,): easting and northing, m; ``most_m``: tiles farther away than this are of no interest, m. Raises
    UsageError: the window does not fit in the memory limit.
    """
    site = ground.site
    window = window_within(site.window, start / site.grid.tile_size, most_m / site.grid.tile_size)
    if window.cols * window.rows > ground.memory_tiles:
        raise UsageError(
            f"the map of what can be reached spans {window.cols * window.rows:,} tiles; {ground.memory_tiles:,} fit "
            "in the memory limit. Raise `memory`, or limit the map with `isochrones`"
        )
    cost = as_cost(ground.on_tiles(window, through=False, by_heading=True))
    place = place_in_window(start, site.grid, window)
    spent, back = spread(ground.with_slope(cost, window), place, margin=ground.margin)
    is_passable = np.isfinite(cost[..., 0])
    del cost  # a map may fill the memory that the search is given: what follows takes no more
    slow, in_part = np.empty(spent.shape, np.float32), False
    for top, part in window.cut(_STRIP):
        tiles = site.read(part, ("c_r",))
        slow[top : top + part.rows] = ground.slowness(tiles)
        in_part |= bool(np.isin(tiles.barred, _IN_PART).any())
    time = _times(back, slow, place, move_tables(window.cols, ground.margin))
    notes: tuple[str, ...] = ()
    if in_part:
        from bumpymap.route.passages import BYTES_PER_TILE, reach_over_areas  # with SciPy's graphs, slow to load

        if window.rows * window.cols * BYTES_PER_TILE > ground.memory_bytes:
            notes = (_ONLY_WHOLE.format(size=math.ceil(window.rows * window.cols * BYTES_PER_TILE / 1e9)),)
        else:
            is_passable |= reach_over_areas(ground, window, start, spent, time, slow)
    spent[np.isinf(spent)] = np.nan
    spent *= site.grid.tile_size
    time *= site.grid.tile_size / 60.0
    time[np.isnan(spent)] = np.nan
    return Reach(
        Placement(site.georeference, site.grid, window),
        cost=spent.astype(np.float32),
        minutes=time.astype(np.float32),
        passable=int(is_passable.sum()),
        limit_m=None if window == site.window else most_m,
        notes=notes,
    )
