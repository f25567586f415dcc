"""What can be reached from a point: cost and time of the cheapest way to every tile."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.route._moves import MOVES
from bumpymap.route._reach_kernels import add_up_lengths
from bumpymap.route.planner import Planner
from bumpymap.route.search import spread
from bumpytiles import TileWindow

__all__ = ["Reach", "find_reach", "window_within"]


@dataclass(frozen=True, slots=True)
class Reach:
    """Cost and time of the cheapest way to the tiles of a window; arrays are (rows, cols), north row first."""

    window: TileWindow
    cost: NDArray[np.float32]
    """Cost of the way to the tile's centre, m; NaN if it cannot be reached."""
    minutes: NDArray[np.float32]
    """Driving time of that way at the profile's speed, min; NaN likewise."""
    back: NDArray[np.uint8]
    """The move by which that way enters the tile, see `bumpymap.route.MOVES`; `FROM_START` (254) if it leads straight
    from the start to the middle of the tile, `NOT_REACHED` (255) if there is none."""
    passable: int
    """Tiles of the window that are not closed."""
    tile_size: float
    limit_m: float | None = None
    """How far from the start the window reaches to each side, m; None: it is the whole map."""

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
        return self.tiles * self.tile_size**2 / 1e4

    @property
    def highest_cost(self) -> float:
        """Cost of the way to the dearest tile, m."""
        return float(np.nanmax(self.cost)) if self.tiles else 0.0


def find_reach(planner: Planner, start: NDArray[np.float64], most_m: float = math.inf) -> Reach:
    """Find what can be reached from a point.

    Parameters
    ----------
    planner : Planner
    start : array (2,)
        Easting and northing, m.
    most_m : float
        Tiles farther away than this are of no interest, m.

    Raises
    ------
    UsageError
        The window does not fit in the memory limit.
    """
    site = planner.site
    window = window_within(site.window, start / site.grid.tile_size, most_m / site.grid.tile_size)
    if window.cols * window.rows > planner.memory_tiles:
        raise UsageError(
            f"the map of what can be reached spans {window.cols * window.rows:,} tiles; {planner.memory_tiles:,} fit "
            "in the memory limit. Raise `memory`, or limit the map with `isochrones` or `isocosts`"
        )
    cost = planner.load(window)
    place = planner.place(start, window)
    spent, back = spread(cost, place, margin=planner.margin)
    passable = int(np.isfinite(cost).sum())
    del cost  # a map may fill the memory that the search is given: what follows takes no more
    spent[np.isinf(spent)] = np.nan
    spent *= site.grid.tile_size
    length = np.full(spent.shape, np.nan)
    add_up_lengths(back, MOVES, *place, length)
    length *= site.grid.tile_size / site.vehicle.speed_mps / 60.0
    length[np.isnan(spent)] = np.nan
    return Reach(
        window=window,
        cost=spent.astype(np.float32),
        minutes=length.astype(np.float32),
        back=back,
        passable=passable,
        tile_size=site.grid.tile_size,
        limit_m=None if window == site.window else most_m,
    )


def window_within(whole: TileWindow, start: NDArray[np.float64], most: float) -> TileWindow:
    """Return the part of a map within a distance of a place, tiles east and north of the grid's origin."""
    if not math.isfinite(most):
        return whole
    west = max(whole.col, math.floor(start[0] - most))
    south = max(whole.row, math.floor(start[1] - most))
    east = min(whole.col + whole.cols, math.ceil(start[0] + most) + 1)
    north = min(whole.row + whole.rows, math.ceil(start[1] + most) + 1)
    return TileWindow(west, south, max(east - west, 1), max(north - south, 1))
