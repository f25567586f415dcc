"""From the drives of all cells to the tables, class limits and class means of a calibration.

The class limits are the natural breaks (one-dimensional k-means, four groups, solved exactly) of the C_r of all driven
patches. The planner's cost is linear in C_r, and a class stands for one C_r, so the limits that make the squared error
of C_r least are the ones that cost a planner least when it knows no more than the class.
"""

import math
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.calibration import Calibration
from bumpymap.errors import BumpymapError
from bumpymap.types import CLASS_NAMES, TEXTURES
from bumpymap.vehicle.journal import Cell
from bumpymap.vehicle.plan import CalibrationSettings, PatchDrives

__all__ = ["natural_breaks", "summarise"]

_RULE = (
    "natural breaks (exact one-dimensional k-means, 4 groups) of the patch-mean C_r of all patches with a completed "
    "drive; terrain mix: the four textures alike, z range uniform in its logarithm; limits rounded to 0.001 rad/m"
)


def summarise(settings: CalibrationSettings, cells: dict[Cell, list[PatchDrives]], command: str = "") -> Calibration:
    """Sum up finished cells.

    Parameters
    ----------
    settings : CalibrationSettings
    cells : dict
        (texture, z range) indices -> drives of each patch; every cell of the settings.
    command : str
        Noted in the calibration.
    """
    table = [[cells[texture, z] for z in range(len(settings.z_range))] for texture in range(len(TEXTURES))]
    means = [[[patch.mean_c_r for patch in cell] for cell in line] for line in table]
    known = np.array([c for line in means for cell in line for c in cell if c is not None], dtype=np.float64)
    limits = _rounded_limits(natural_breaks(known, len(CLASS_NAMES)))
    klass = np.searchsorted(limits, known, side="right")
    record: dict[str, Any] = {"command": command, **settings.to_dict(), "class_rule": _RULE, "patch_c_r": means}
    return Calibration(
        vehicle=record.pop("vehicle"),
        tile_size=settings.tile_size,
        pixels=settings.pixels,
        textures=TEXTURES,
        z_range=settings.z_range,
        c_r=tuple(tuple(_mean(cell) for cell in line) for line in means),
        c_r_log_sd=tuple(tuple(_log_sd(cell) for cell in line) for line in means),
        p_fail=tuple(tuple(_failed(cell) for cell in line) for line in table),
        drives=tuple(tuple(sum(len(patch.outcome) for patch in cell) for cell in line) for line in table),
        class_limits=limits,
        class_c_r=_class_means(known, klass),
        settings=record,
    )


def natural_breaks(values: NDArray[np.float64], groups: int) -> list[float]:
    """Limits of the split of numbers into groups with the least sum of squared differences to the group means.

    Fisher's dynamic programme: the best split of the first i sorted numbers into k groups extends the best split of
    the first j into k - 1. Exact, so there is no random start.

    Parameters
    ----------
    values : array (n,)
    groups : int
        2 or more; n distinct numbers must be at least as many.

    Returns
    -------
    list of float, length groups - 1
        Half way between the means of neighbouring groups.
    """
    x = np.sort(values)
    if len(np.unique(x)) < groups:
        raise BumpymapError(
            f"{len(np.unique(x))} patches with a completed drive; classes need at least {groups}. "
            "Drive more patches, lower z ranges, or slower"
        )
    edges = _best_edges(x - x.mean(), groups)
    centre = [float(x[a:b].mean()) for a, b in pairwise(edges)]
    return [(a + b) / 2 for a, b in pairwise(centre)]


def _best_edges(x: NDArray[np.float64], groups: int) -> list[int]:
    """Where the groups of sorted numbers begin, and the end: groups + 1 indices."""
    n = len(x)
    total = np.concatenate([[0.0], np.cumsum(x)])
    square = np.concatenate([[0.0], np.cumsum(x**2)])
    best = np.full(n + 1, np.inf)
    best[0] = 0.0
    cut = np.zeros((groups, n + 1), dtype=np.int64)
    for group in range(groups):
        following = np.full(n + 1, np.inf)
        for i in range(group + 1, n + 1):
            j = np.arange(group, i)
            spread = square[i] - square[j] - (total[i] - total[j]) ** 2 / (i - j)
            cost = best[j] + np.maximum(spread, 0.0)
            cut[group, i] = j[np.argmin(cost)]
            following[i] = cost.min()
        best = following
    edges = [n]
    for group in reversed(range(groups)):
        edges.append(int(cut[group, edges[-1]]))
    return edges[::-1]


def _rounded_limits(limits: list[float]) -> tuple[float, float, float]:
    low, middle, high = (round(limit, 3) for limit in limits)
    if not 0 < low < middle < high:
        raise BumpymapError(
            f"the class limits come out as {low}, {middle}, {high} rad/m, too close together for four classes; "
            "the vehicle hardly pitches on these z ranges"
        )
    return low, middle, high


def _class_means(known: NDArray[np.float64], klass: NDArray[np.intp]) -> tuple[float, float, float, float]:
    a, b, c, d = (float(known[klass == k].mean()) for k in range(len(CLASS_NAMES)))
    return a, b, c, d


def _mean(cell: list[float | None]) -> float | None:
    known = [value for value in cell if value is not None]
    return math.fsum(known) / len(known) if known else None


def _log_sd(cell: list[float | None]) -> float | None:
    logs = [math.log(value) for value in cell if value is not None]
    return float(np.std(logs, ddof=1)) if len(logs) > 1 else None


def _failed(cell: list[PatchDrives]) -> float:
    return sum(patch.failed for patch in cell) / sum(len(patch.outcome) for patch in cell)
