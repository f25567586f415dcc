"""How well a map and drives agree."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import rankdata

from bumpymap.core import DrivenStretches, MapAgreement

__all__ = ["agreement_by_class", "agreement_of", "spearman"]

Floats = NDArray[np.float64]

_LEAST_STRETCHES = 5
"""With fewer, no rank correlation is given."""
_END_80 = float(ndtri(0.9))


def spearman(first: Floats, second: Floats) -> float:
    """Return the rank correlation of two series; NaN where one is constant, or with fewer than five values."""
    if len(first) < _LEAST_STRETCHES:
        return float("nan")
    ranks = rankdata(first), rankdata(second)
    one, two = (rank - rank.mean() for rank in ranks)
    power = float(np.sqrt((one @ one) * (two @ two)))
    return float(one @ two) / power if power > 0.0 else float("nan")


def agreement_of(stretches: DrivenStretches, chosen: NDArray[np.bool_] | None = None) -> MapAgreement:
    """Return how well map and drives agree over stretches that are on the map.

    ``inside`` counts a stretch whose measured C_r lies in the map's interval after its ends have been moved outwards,
    in quadrature, by the error of the measurement and by what the error of the positions makes of the map.

    Parameters
    ----------
    stretches : DrivenStretches
    chosen : bool array (n,), optional
        Stretches to look at; None: all on the map.
    """
    on = np.isfinite(stretches.c_r) & (stretches.measured > 0.0)
    on &= np.ones_like(on) if chosen is None else chosen
    predicted, measured = stretches.c_r[on], stretches.measured[on]
    if not len(measured):
        nothing = float("nan")
        return MapAgreement(0, 0.0, nothing, nothing, nothing, nothing, nothing)
    ratio = predicted / measured
    error = _END_80 * np.hypot(stretches.measured_sd[on], stretches.place_sd[on])
    below = np.hypot(predicted - stretches.c_r_low[on], error)
    above = np.hypot(stretches.c_r_high[on] - predicted, error)
    inside = (measured >= predicted - below) & (measured <= predicted + above)
    return MapAgreement(
        stretches=int(on.sum()),
        way_m=float(stretches.way_m[on].sum()),
        spearman=spearman(predicted, measured),
        median_ratio=float(np.median(ratio)),
        median_error=float(np.median(np.abs(ratio - 1.0))),
        inside=float(inside.mean()),
        same_class=float((stretches.class_id[on] == stretches.measured_class[on]).mean()),
    )


def agreement_by_class(stretches: DrivenStretches) -> dict[int, MapAgreement]:
    """Return the agreement over the stretches of each class of the map that was driven."""
    on = np.isfinite(stretches.c_r) & (stretches.measured > 0.0)
    return {
        int(number): agreement_of(stretches, stretches.class_id == number)
        for number in np.unique(stretches.class_id[on])
    }
