"""From the drives of all cells to the tables, class limits and class means of a calibration.

The class limits are the natural breaks (one-dimensional k-means, four groups, solved exactly) of patch C_r. The
planner's cost is linear in C_r, and a class stands for one C_r, so the limits that make the squared error of C_r least
are those that cost a planner least when it knows no more than the class. They are taken over ground that the vehicle
can cross: beyond it C_r is that of the survivors, and p_fail speaks for the ground.
"""

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.calibration import Calibration
from bumpymap.errors import BumpymapError
from bumpymap.types import CLASS_NAMES, TEXTURES
from bumpymap.vehicle.journal import Key
from bumpymap.vehicle.library import FitRide, driven_library, library_ground, library_record
from bumpymap.vehicle.patch import PatchDrives
from bumpymap.vehicle.plan import CalibrationSettings

__all__ = ["class_limits", "natural_breaks", "summarise"]

PatchMeans = Sequence[Sequence[Sequence[float | None]]]

_RULE = (
    "natural breaks (exact one-dimensional k-means, 4 groups) of the patch-mean C_r; terrain mix: the four textures "
    "alike, z range uniform in its logarithm from the lowest to the highest at which, and below which, at least 95 % "
    "of the drives over every texture were completed; limits rounded to 0.001 rad/m"
)
_CROSSABLE_P_FAIL = 0.05


def summarise(
    settings: CalibrationSettings, results: Mapping[Key, PatchDrives], command: str = "", fit: FitRide | None = None
) -> Calibration:
    """Sum up the drives of every job of the settings.

    Parameters
    ----------
    settings : CalibrationSettings
    results : mapping
        Key of a job -> its drives.
    command : str
        Noted in the calibration.
    fit : callable, optional
        Fits the ride model to the drives over the terrain library.
    """
    table = [
        [
            [results["table", texture, z, patch] for patch in range(settings.patches)]
            for z in range(len(settings.z_range))
        ]
        for texture in range(len(TEXTURES))
    ]
    driven = driven_library(settings, results)
    means = [[[patch.mean_c_r for patch in cell] for cell in line] for line in table]
    p_fail = tuple(tuple(_failed(cell) for cell in line) for line in table)
    limits = class_limits(means, p_fail)
    record: dict[str, Any] = {"command": command, **settings.to_dict(), "class_rule": _RULE, "patch_c_r": means}
    record["library"] = library_record(driven)
    return Calibration(
        vehicle=record.pop("vehicle"),
        tile_size=settings.tile_size,
        pixels=settings.pixels,
        textures=TEXTURES,
        z_range=settings.z_range,
        c_r=tuple(tuple(_mean(cell) for cell in line) for line in means),
        c_r_log_sd=tuple(tuple(_log_sd(cell) for cell in line) for line in means),
        p_fail=p_fail,
        drives=tuple(tuple(sum(len(patch.outcome) for patch in cell) for cell in line) for line in table),
        class_limits=limits,
        class_c_r=_class_means(_known(means), limits),
        ride=fit(settings.profile, library_ground(settings, driven), driven) if fit and driven else None,
        settings=record,
    )


def class_limits(means: PatchMeans, p_fail: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """C_r between the classes, rad/m.

    Parameters
    ----------
    means : nested sequence [texture][z_range][patch]
        C_r, rad/m; None where no drive over the patch was completed.
    p_fail : nested sequence [texture][z_range]
    """
    worst = np.max(p_fail, axis=0)
    crossable = int(np.argmax(worst > _CROSSABLE_P_FAIL)) if worst.max() > _CROSSABLE_P_FAIL else len(worst)
    if crossable == 0:
        raise BumpymapError(
            f"{100 * worst[0]:.0f} % of the drives fail at the lowest z range; this vehicle can cross none of the "
            "simulated ground. Look for a wrong number in its profile: bumpymap calibrate --check"
        )
    low, middle, high = (
        round(limit, 3) for limit in natural_breaks(_known([line[:crossable] for line in means]), len(CLASS_NAMES))
    )
    if not 0 < low < middle < high:
        raise BumpymapError(
            f"the class limits come out as {low}, {middle}, {high} rad/m, too close together for four classes; "
            "the vehicle hardly pitches on these z ranges"
        )
    return low, middle, high


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


def _known(means: PatchMeans) -> NDArray[np.float64]:
    """C_r of all patches that have one."""
    return np.array([c for line in means for cell in line for c in cell if c is not None], dtype=np.float64)


def _class_means(known: NDArray[np.float64], limits: tuple[float, float, float]) -> tuple[float, float, float, float]:
    klass = np.searchsorted(limits, known, side="right")
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
