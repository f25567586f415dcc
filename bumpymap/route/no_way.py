"""Why there is no way between two points, and what would help."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from bumpymap.core import BARRED_TEXT, NO_TILE, Barred
from bumpymap.route.planner import Planner
from bumpymap.route.search import spread
from bumpymap.route.snap import place_text
from bumpytiles import TileWindow

__all__ = ["explain_no_way"]


def explain_no_way(planner: Planner, points: NDArray[np.float64], names: Sequence[str]) -> str:
    """Return the message for the first two points without a way between them.

    Parameters
    ----------
    planner : Planner
    points : array (k, 2)
        Easting and northing of the stops, m.
    names : sequence of str
        How the message calls each of them.
    """
    for number, (start, goal) in enumerate(pairwise(points)):
        if np.isfinite(planner.leg_cost(start, goal)):
            continue
        window, size = planner.site.window, planner.site.grid.tile_size
        between = f"there is no way from {names[number]} to {names[number + 1]}"
        if window.cols * window.rows > planner.memory_tiles:
            return f"{between} over passable ground"
        cost = planner.load(window)
        barred = planner.site.read(window, ()).barred
        reached = [
            np.isfinite(spread(cost, planner.place(end, window), margin=planner.margin)[0]) for end in (start, goal)
        ]
        areas = [_area(int(part.sum()), size) for part in reached]
        closest = _closest(planner, *reached)
        beside = _beside(min(reached, key=lambda part: int(part.sum())), barred)
        unknown = ""
        if planner.settings.unknown is None and Barred.UNKNOWN in beside:
            unknown = "cross unknown ground with `unknown=COST`, "
        return (
            f"{between}: {areas[0]} can be reached from the first, {areas[1]} from the second, and no tile from both. "
            f"Beside the smaller area lie: {_described(beside, planner)}. {closest}Choose other points, {unknown}"
            "map the survey for another vehicle, or drive through what the map takes for an obstacle with "
            "`through_obstacles`"
        )
    return "there is no way through all points"


def _closest(planner: Planner, first: NDArray[np.bool_], second: NDArray[np.bool_]) -> str:
    """Say where the two areas come closest, and what lies between them."""
    if not (first.any() and second.any()):
        return ""
    apart, (rows, cols) = distance_transform_edt(~second, return_indices=True)
    row, col = np.unravel_index(np.where(first, apart, np.inf).argmin(), first.shape)
    ends = np.array([[row, col], [rows[row, col], cols[row, col]]]) + 0.5
    window, size = planner.site.window, planner.site.grid.tile_size
    middle = planner.at(ends.mean(axis=0), window)
    between = planner.site.read(TileWindow.around(*planner.site.grid.index(middle)[:, None]), ()).barred
    code = int(between[0, 0])
    why = BARRED_TEXT[Barred(code)] if code in BARRED_TEXT and code != Barred.NO else "no passable ground"
    return (
        f"They come closest at {place_text(planner.site, middle)}, {math.dist(*ends) * size:.0f} m from tile to tile, "
        f"where there is: {why}. "
    )


def _area(tiles: int, size: float) -> str:
    return f"{tiles:,} tile{'' if tiles == 1 else 's'} ({tiles * size**2 / 1e4:,.2f} ha)"


def _beside(area: NDArray[np.bool_], barred: NDArray[np.uint8]) -> list[int]:
    """Return what the tiles around an area are, codes of `Barred` or NO_TILE, the most frequent first."""
    beside = np.zeros_like(area)
    padded = np.pad(area, 1)
    beside |= padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:]
    codes, counts = np.unique(barred[beside & ~area], return_counts=True)
    return [int(codes[at]) for at in np.argsort(-counts, kind="stable")]


def _described(codes: Sequence[int], planner: Planner) -> str:
    """Say what bars the tiles around an area: the reasons of those that are not passable together, then the rest."""
    narrow = "passages too narrow for the vehicle"
    has_areas = planner.avoid is not None or planner.only is not None
    texts = {
        int(Barred.NO): f"tiles that `avoid` or `only` closes, or {narrow}" if has_areas else narrow,
        int(Barred.UNKNOWN): BARRED_TEXT[Barred.UNKNOWN],
        NO_TILE: "ground that was not surveyed",
    }
    reasons = [BARRED_TEXT[Barred(code)] for code in codes if code not in texts]
    found = [f"tiles that are not passable ({', '.join(reasons)})"] if reasons else []
    return "; ".join([*found, *(texts[code] for code in codes if code in texts)]) or "the edge of the map"
