"""The reach from a point: cost and time of the cheapest way to every tile."""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, UsageError
from bumpymap.layers import ReachField
from bumpymap.route.ground import CostGround
from bumpymap.route.places import place_in_window, window_within
from bumpymap.route.search import MOVES, spread
from bumpymap.route.straighten import as_cost
from bumpytiles import kernel

__all__ = ["Reach", "add_up_lengths", "find_reach"]


@kernel
def add_up_lengths(
    back: Annotated[NDArray[np.uint8], 2],
    moves: Annotated[NDArray[np.int64], 2],
    row: float,
    col: float,
    out: Annotated[NDArray[np.float64], 2],
) -> None:
    """Fill the length of the way to each tile, tiles; 0 where there is none.

    Every tile knows the one before it. A way is followed back to a tile whose length is known, and then once more, to
    set what lies between: each tile is visited twice at most, and nothing else has to be held.

    ``back`` is that of `bumpymap.route.search.spread` from the field coordinates (``row``, ``col``); ``out`` comes
    filled with NaN.
    """
    for i in range(back.shape[0]):
        for j in range(back.shape[1]):
            r, c, total = i, j, 0.0
            while math.isnan(out[r, c]):
                k = back[r, c]
                if k >= moves.shape[0]:
                    straight = math.sqrt((r + 0.5 - row) ** 2 + (c + 0.5 - col) ** 2)
                    out[r, c] = straight if k < 255 else 0.0
                    break
                total += math.sqrt(float(moves[k, 0] * moves[k, 0] + moves[k, 1] * moves[k, 1]))
                r -= moves[k, 0]
                c -= moves[k, 1]
            total += out[r, c]
            r, c = i, j
            while math.isnan(out[r, c]):
                k = back[r, c]
                out[r, c] = total
                total -= math.sqrt(float(moves[k, 0] * moves[k, 0] + moves[k, 1] * moves[k, 1]))
                r -= moves[k, 0]
                c -= moves[k, 1]


_IN_PART = (Barred.OBSTACLE, Barred.SPLIT, Barred.UNKNOWN)
"""Tiles that are closed as a whole, but in which the vehicle may fit."""
_ONLY_WHOLE = (
    "ways between obstacles were not looked for, which would take {size} GB of memory: what lies behind a tile that "
    "obstacles split is not counted. Raise `memory`, or give `isochrones` or `isocosts`"
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
        return self.tiles * self.grid.tile_size**2 / 1e4

    @property
    def highest_cost(self) -> float:
        """Cost of the way to the dearest tile, m."""
        return float(np.nanmax(self.cost)) if self.tiles else 0.0


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
            "in the memory limit. Raise `memory`, or limit the map with `isochrones` or `isocosts`"
        )
    cost = as_cost(ground.on_tiles(window, through=False, by_heading=True))
    place = place_in_window(start, site.grid, window)
    spent, back = spread(ground.with_slope(cost, window), place, margin=ground.margin)
    is_passable = np.isfinite(cost[..., 0])
    del cost  # a map may fill the memory that the search is given: what follows takes no more
    length = np.full(spent.shape, np.nan)
    add_up_lengths(back, MOVES, *place, length)
    notes: tuple[str, ...] = ()
    if np.isin(site.read(window, ()).barred, _IN_PART).any():
        from bumpymap.route.passages import BYTES_PER_TILE, reach_over_areas  # with SciPy's graphs, slow to load

        if window.rows * window.cols * BYTES_PER_TILE > ground.memory_bytes:
            notes = (_ONLY_WHOLE.format(size=math.ceil(window.rows * window.cols * BYTES_PER_TILE / 1e9)),)
        else:
            is_passable |= reach_over_areas(ground, window, start, spent, length)
    spent[np.isinf(spent)] = np.nan
    spent *= site.grid.tile_size
    length *= site.grid.tile_size / site.vehicle.speed_mps / 60.0
    length[np.isnan(spent)] = np.nan
    return Reach(
        site.georeference,
        site.grid,
        window,
        cost=spent.astype(np.float32),
        minutes=length.astype(np.float32),
        passable=int(is_passable.sum()),
        limit_m=None if window == site.window else most_m,
        notes=notes,
    )
