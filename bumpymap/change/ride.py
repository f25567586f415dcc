"""How far two ride costs differ, in units of what their intervals leave open."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

__all__ = ["ride_z"]

_INTERVAL = 2.0 * float(ndtri(0.9))
"""Width of an 80 % interval, in standard deviations."""

Bands = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]


def ride_z(before: Bands, after: Bands) -> NDArray[np.float64]:
    """Return the difference of ln c_r over its combined spread; the spreads are those of the 80 % intervals of ln c_r.

    Parameters
    ----------
    before, after : three arrays each, of one shape
        ``c_r``, ``c_r_low`` and ``c_r_high``, rad/m.

    Returns
    -------
    float64 array of that shape
        NaN where one of the two is unknown or not positive.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        (first, low, high), (second, lower, higher) = (
            tuple(np.log(band.astype(np.float64)) for band in bands) for bands in (before, after)
        )
        z = (second - first) / (np.hypot(high - low, higher - lower) / _INTERVAL)
    return np.where(np.isfinite(z), z, np.nan)
