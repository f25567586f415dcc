"""What can be reached from a point: cost and time of the cheapest way to every tile."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.route._moves import MOVES
from bumpymap.route.planner import Planner
from bumpymap.route.search import NOT_REACHED, spread
from bumpytiles import TileWindow

__all__ = ["Reach", "find_reach"]


@dataclass(frozen=True, slots=True)
class Reach:
    """Cost and time of the cheapest way to the tiles of a window; arrays are (rows, cols), north row first."""

    window: TileWindow
    cost: NDArray[np.float32]
    """Cost of the way to the tile's centre, m; NaN if it cannot be reached."""
    minutes: NDArray[np.float32]
    """Driving time of that way at the profile's speed, min; NaN likewise."""
    back: NDArray[np.uint8]
    """The move by which that way enters the tile, see `bumpymap.route.search.MOVES`; 255 at the start and where the
    tile cannot be reached."""
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
    window = _window(site.window, start / site.grid.tile_size, most_m / site.grid.tile_size)
    if window.cols * window.rows > planner.memory_tiles:
        raise UsageError(
            f"the map of what can be reached spans {window.cols * window.rows:,} tiles; {planner.memory_tiles:,} fit "
            "in the memory limit. Raise `memory`, or limit the map with `isochrones` or `isocosts`"
        )
    cost = planner.load(window)
    place = planner.place(start, window)
    spent, back = spread(cost, place, margin=planner.margin)
    reached = np.isfinite(spent)
    length = _way_lengths(back, place) * site.grid.tile_size
    minutes = np.where(reached, length / site.vehicle.speed_mps / 60.0, np.nan)
    return Reach(
        window=window,
        cost=np.where(reached, spent * site.grid.tile_size, np.nan).astype(np.float32),
        minutes=minutes.astype(np.float32),
        back=back,
        passable=int(np.isfinite(cost).sum()),
        tile_size=site.grid.tile_size,
        limit_m=None if window == site.window else most_m,
    )


def _window(whole: TileWindow, start: NDArray[np.float64], most: float) -> TileWindow:
    """Return the part of a map within a distance, tiles."""
    if not math.isfinite(most):
        return whole
    west = max(whole.col, math.floor(start[0] - most))
    south = max(whole.row, math.floor(start[1] - most))
    east = min(whole.col + whole.cols, math.ceil(start[0] + most) + 1)
    north = min(whole.row + whole.rows, math.ceil(start[1] + most) + 1)
    return TileWindow(west, south, max(east - west, 1), max(north - south, 1))


def _way_lengths(back: NDArray[np.uint8], start: tuple[float, float]) -> NDArray[np.float64]:
    """Return the length of the way to each tile, tiles; 0 where there is none.

    Every tile knows the one before it. Adding the length up to that one and looking at the one before that, each time
    twice as far back, takes as many rounds as the longest way has moves in binary digits.
    """
    cols = back.shape[1]
    moved = back < len(MOVES)
    move = MOVES[np.where(moved, back, 0)]
    length = np.where(moved, np.hypot(move[..., 0], move[..., 1]), 0.0).ravel()
    before = (np.arange(back.size).reshape(back.shape) - np.where(moved, move @ np.array([cols, 1]), 0)).ravel()
    while (before != before[before]).any():
        length = length + length[before]
        before = before[before]
    row, col = np.divmod(before, cols)
    first = np.hypot(row + 0.5 - start[0], col + 0.5 - start[1]).reshape(back.shape)
    return np.where(back == NOT_REACHED, 0.0, length.reshape(back.shape) + first)
