"""Why there is no way between two points, and what would help."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BARRED_TEXT, NO_TILE, Barred
from bumpymap.route.planner import Planner
from bumpymap.route.search import spread

__all__ = ["explain_no_way"]

_NAMED = 3


def explain_no_way(planner: Planner, points: NDArray[np.float64]) -> str:
    """Return the message for the first two points without a way between them.

    Parameters
    ----------
    planner : Planner
    points : array (k, 2)
        Easting and northing of the stops, m.
    """
    for number, (start, goal) in enumerate(pairwise(points)):
        if np.isfinite(planner.leg_cost(start, goal)):
            continue
        window, size = planner.site.window, planner.site.grid.tile_size
        between = f"there is no way from point {number + 1} to point {number + 2}"
        if window.cols * window.rows > planner.memory_tiles:
            return f"{between} over passable ground"
        cost = planner.load(window)
        barred = planner.site.read(window, ()).barred
        reached = [
            np.isfinite(spread(cost, planner.place(end, window), margin=planner.margin)[0]) for end in (start, goal)
        ]
        areas = [f"{int(part.sum()):,} tiles ({part.sum() * size**2 / 1e4:,.2f} ha)" for part in reached]
        smaller = min(reached, key=lambda part: int(part.sum()))
        return (
            f"{between}: {areas[0]} can be reached from the first, {areas[1]} from the second, and no tile from both. "
            f"The smaller area is closed in by {_closed_by(smaller, barred)}. Choose other points, cross unknown "
            "ground with `unknown=COST`, or map the survey for another vehicle"
        )
    return "there is no way through all points"


def _closed_by(area: NDArray[np.bool_], barred: NDArray[np.uint8]) -> str:
    """Say what bars the tiles around an area, the most frequent first."""
    beside = np.zeros_like(area)
    padded = np.pad(area, 1)
    beside |= padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    codes, counts = np.unique(barred[beside & ~area], return_counts=True)
    texts = {NO_TILE: "ground that was not surveyed"} | {int(code): text for code, text in BARRED_TEXT.items()}
    texts[Barred.NO] = "areas that are not to be entered, or passages too narrow for the vehicle"
    if not len(codes):
        return "the edge of the map"
    found = [texts[int(codes[at])] for at in np.argsort(-counts, kind="stable")[:_NAMED]]
    return ", ".join(found)
