"""Find the classes of a vehicle: the limits of C_r between them, and the mean C_r of each.

The limits are the natural breaks (one-dimensional k-means, four groups, solved exactly) of the C_r of terrains. They
minimise the squared error of replacing C_r by a value per class; as the planner's cost is linear in C_r, they also
minimise the error of a planner that knows only the class. Terrains on which half of the drives fail are left out: they
are class 3 whatever their C_r, in a map too.

The C_r is that of the ride model, on libraries that are the same for every calibration; the roughest twentieth counts
as its least, and the limits are the mean of the breaks of each library. A few terrains that the vehicle just crosses
have a C_r that would move the breaks of one library, driven as it is, by 8 to 15 % (standard deviation), by which of
them a seed draws.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, FAIL_SHARE, BumpymapError, Floats
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import library_terrain, six_digits
from bumpymap.lab.simulate.model import relief_and_slope
from bumpymap.lab.simulate.ride_fit import MANY_POINTS
from bumpymap.lab.terrains import KINDS
from bumpymap.rating import Calibration, Correction, RideOperator, roll_over

_LIBRARIES, _TERRAINS = 25, 24
"""Libraries, with the seeds from 1, and terrains of each kind in one. Chosen: it takes 45 s; the standard deviation of
the breaks of one library, 8 to 11 %, becomes about 2 %."""
_ROUGHEST = 0.05
"""Share of the terrains whose C_r counts as the least among them. Chosen: by halves of the drives (12 times) the
standard error of the limits is 1.9 to 2.4 % of the Warthog and 3.7 % at most of the others; 4 to 10 % without it; with
a tenth 3.3 % at most, and the limits of the Warthog fall by another sixth."""
_LEAST_STEP = 0.001
"""Width of a class, rad/m. Chosen: classes closer together say nothing about the ground."""
_RULE = (
    f"natural breaks (exact one-dimensional k-means, 4 groups), mean of {_LIBRARIES} libraries of {_TERRAINS} terrains "
    f"of each kind, of the C_r that the ride model predicts where its p_fail is under {FAIL_SHARE:g}; the roughest "
    f"{100 * _ROUGHEST:g} % count as the least of them; heights uniform in their logarithm, half of the slopes up to 8 "
    "degrees and half up to 1.2 times the vehicle's limit; limits rounded to three digits"
)
LIMITS_OF = "those of the calibration "
"""How the rule of limits begins that are taken from a calibration for tiles of another size."""


def fit_classes(
    settings: CalibrationSettings, ride: Correction, parts: Sequence[Correction], like: Calibration | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return limits and mean C_r of the classes, as fields of a calibration, and entries of its ``settings``.

    ``parts``: ride models without a share of the drives each, see `fit_ride`; from their spread come the relative
    standard errors (jackknife) of the limits and of C_r, its median over the terrains. ``like``: a calibration for
    tiles of another size, whose limits are taken.

    Raises BumpymapError if the vehicle can cross too few terrains, or hardly pitches on any.
    """
    libraries = _LIBRARIES if like is None else 1
    tiles = [
        library_terrain(replace(settings, seed=1 + library), kind, index).heights
        for library in range(libraries)
        for kind in KINDS
        for index in range(_TERRAINS)
    ]
    relief, slope = relief_and_slope(tiles, settings.tile_size)
    rides = roll_over(relief, RideOperator.of(settings.profile, settings.tile_size, settings.pixels))
    none = np.zeros(len(slope))

    def predicted(model: Correction) -> tuple[Floats, Floats]:
        found = model.predict(rides, slope, none, none + MANY_POINTS)
        return np.exp(found.log_c_r).reshape(libraries, -1), found.p_fail.reshape(libraries, -1)

    c_r, p_fail = predicted(ride)
    limits = class_limits(c_r, p_fail) if like is None else like.class_limits
    crossed = c_r[p_fail < FAIL_SHARE]
    class_id = np.searchsorted(limits, crossed, side="right")
    others = [predicted(part) for part in parts]
    errors: dict[str, Any] = {"c_r": _rounded(np.median(_jackknife(np.log([each for each, _ in others]))))}
    if like is None:
        errors |= {"class_limits": [_rounded(x) for x in _jackknife([class_limits(*each) for each in others]) / limits]}
    means = tuple(six_digits(crossed[class_id == k].mean()) for k in range(len(CLASS_NAMES)))
    rule = _RULE if like is None else f"{LIMITS_OF}{like.id}, for tiles of {like.tile_size:g} m"
    return {"class_limits": limits, "class_c_r": means}, {"class_rule": rule, "relative_standard_errors": errors}


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _jackknife(values: Any) -> Floats:
    """Return the standard error of an estimate, (...), from its values (parts, ...) without a part of the data each."""
    values = np.asarray(values)
    return np.asarray(np.sqrt((len(values) - 1) * values.var(axis=0)))


def class_limits(c_r: Floats, p_fail: Floats) -> tuple[float, float, float]:
    """Return the three C_r limits between the classes, rad/m, from C_r [rad/m] and p_fail of terrains: (libraries, n).

    Raises BumpymapError if the vehicle can cross too few of a library, or hardly pitches on any.
    """
    crossed = [own[fails < FAIL_SHARE] for own, fails in zip(c_r, p_fail, strict=True)]
    fewest = min(crossed, key=len)
    if len(np.unique(fewest)) < len(CLASS_NAMES):
        raise BumpymapError(
            f"the vehicle crosses {len(fewest)} of {c_r.shape[1]} terrains of a library; classes need at least "
            f"{len(CLASS_NAMES)} with different C_r. Check its profile for a wrong number, such as a moment of inertia "
            "or a damping coefficient, or drive more terrains"
        )
    capped = (np.minimum(own, np.quantile(own, 1 - _ROUGHEST, method="lower")) for own in crossed)
    breaks = np.mean([natural_breaks(own, len(CLASS_NAMES)) for own in capped], axis=0)
    low, middle, high = (_rounded(limit) for limit in breaks)
    if min(low, middle - low, high - middle) < _LEAST_STEP:
        raise BumpymapError(
            f"the class limits are {low}, {middle}, {high} rad/m, too close together for four classes; "
            "the vehicle hardly pitches on this ground"
        )
    return low, middle, high


def natural_breaks(values: NDArray[np.float64], groups: int) -> list[float]:
    """Return the limits of the split of numbers into groups with the least sum of squared deviations from group means.

    They lie halfway between the means of neighbouring groups. Fisher's dynamic programming: the best split of the first
    i sorted numbers into k groups extends the best split of the first j into k - 1. It is exact and needs no random
    start. scikit-learn's KMeans with ten starts misses the best split of 33 in 200 drawn sets, and that of the car's
    driven terrains: 0.019, 0.040, 0.065 instead of 0.018, 0.040, 0.064.
    """
    values = np.sort(values)
    x, n = values - values.mean(), len(values)
    total, square = (np.concatenate(([0.0], np.cumsum(each))) for each in (x, x**2))
    first, end = np.arange(n + 1)[:, None], np.arange(n + 1)
    spread = square - square[:, None] - (total - total[:, None]) ** 2 / np.maximum(end - first, 1)
    spread = np.where(first < end, np.maximum(spread, 0.0), np.inf)  # of one group, from first to end
    best, cuts = spread[0], []
    for _ in range(groups - 1):
        each = best[:, None] + spread
        best = each.min(axis=0)
        cuts.append(each.argmin(axis=0))
    edges = [n]
    for cut in reversed(cuts):
        edges.append(int(cut[edges[-1]]))
    edges.append(0)
    centre = [float(values[a:b].mean()) for a, b in pairwise(edges[::-1])]
    return [(a + b) / 2 for a, b in pairwise(centre)]
