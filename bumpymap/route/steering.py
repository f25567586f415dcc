"""Steer a way past obstacles: where the vehicle does not fit on it, it is planned again on pixels.

Tiles tell that a vehicle gets through, pixels where. A way is cut into sections between points at which the vehicle
fits; each section on which it does not fit throughout is searched again on the pixels around it.
"""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.route.ground import PIXEL_MARGIN, CostGround, window_around
from bumpymap.route.passages import LEAST_SAVING_M
from bumpymap.route.search import find_way
from bumpytiles import Grid

__all__ = ["sample_line", "steer_clear"]

Floats = NDArray[np.float64]

_SECTION_TILES = 24
"""Usual length of a section."""
_LONGEST_TILES = 96
"""A longer section is not searched."""
_AROUND_TILES = 5
"""How far beside a section a way round obstacles is searched."""
_STEP = 0.5
"""Distance of the points of a line that are examined, in pixels."""


def steer_clear(ground: CostGround, line: Floats) -> Floats | None:
    """Return a line near a given one on which the vehicle fits throughout; None if there is none.

    Parameters
    ----------
    ground : CostGround
        The map, with costs.
    line : array (m, 2)
        Easting and northing of the corners, m.

    Returns
    -------
    array (k, 2) or None
        Between the same ends.
    """
    grid = ground.site.grid
    points, step = sample_line(line, grid)
    if step == 0.0:
        return line
    cuts = _cuts(ground.clear_at(points), _SECTION_TILES * grid.tile_size / step, len(points))
    parts = [line[:1]]
    for first, last in pairwise(cuts):
        part = _between(line, points, first, last, step)
        if not ground.is_clear(part, with_room=True):
            too_long = (last - first) * step > _LONGEST_TILES * grid.tile_size
            steered = None if too_long else _search(ground, part)
            if steered is None and not ground.is_clear(part):
                return None
            part = part if steered is None else steered
        parts.append(part[1:])
    return np.concatenate(parts)


def sample_line(line: Floats, grid: Grid) -> tuple[Floats, float]:
    """Return points in the middle of even parts of a line, half a pixel apart, and the length of a part, m."""
    parts = np.hypot(*np.diff(line, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(parts)])
    count = max(1, int(np.ceil(along[-1] / (_STEP * grid.pixel_size))))
    moving = np.concatenate([[True], parts > 0])
    distance = (np.arange(count) + 0.5) * (along[-1] / count)
    points = np.column_stack([np.interp(distance, along[moving], line[moving, axis]) for axis in (0, 1)])
    return points, float(along[-1] / count)


def _cuts(is_clear: NDArray[np.bool_], apart: float, count: int) -> list[int]:
    """Return the numbers of points at which a line is cut: the ends, and clear points about so many apart."""
    cuts, clear = [0], np.flatnonzero(is_clear)
    while count - 1 - cuts[-1] > 1.5 * apart:
        wanted = cuts[-1] + apart
        ahead = clear[clear > cuts[-1] + 0.5 * apart]
        if not len(ahead):
            break
        cut = int(ahead[np.abs(ahead - wanted).argmin()])
        if cut >= count - 1:
            break
        cuts.append(cut)
    return [*cuts, count - 1]


def _between(line: Floats, points: Floats, first: int, last: int, step: float) -> Floats:
    """Return the part of a line between two of its points; the ends of the line are points 0 and the last."""
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    start, stop = (0.0 if first == 0 else first * step), (along[-1] if last == len(points) - 1 else last * step)
    inner = line[(along > start) & (along < stop)]
    ends = [line[0] if first == 0 else points[first], line[-1] if last == len(points) - 1 else points[last]]
    return np.concatenate([ends[:1], inner, ends[1:]])


def _search(ground: CostGround, part: Floats) -> Floats | None:
    """Search a section on pixels; None if there is no way."""
    window = window_around(ground.site, part, _AROUND_TILES)
    start, goal = ((float(row), float(col)) for row, col in ground.in_window(part[[0, -1]], window))
    saving = LEAST_SAVING_M / ground.site.grid.pixel_size
    found = find_way(ground.with_room(ground.on_pixels(window)), start, goal, margin=PIXEL_MARGIN, least_saving=saving)
    if found is None:
        return None
    line = ground.on_grid(found.line, window)
    line[0], line[-1] = part[0], part[-1]
    return line
