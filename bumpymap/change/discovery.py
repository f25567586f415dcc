"""From z to what counts as found: probabilities, measured widening, and the share of false discoveries.

A z is a difference over its spread. Its tails are taken as those of Student's t with 30 degrees of freedom: two halves
of one survey, between which nothing has changed, give |z| > 3 a little more often than a normal distribution does.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

__all__ = ["hold_false_discoveries", "two_sided", "upper_sided", "widening"]

Floats = NDArray[np.float64]

_FREEDOM = 30.0
"""Degrees of freedom of the tails."""
_NORMAL_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def two_sided(z: Floats) -> Floats:
    """Return the probability of a value at least as far from 0, any shape; NaN stays NaN."""
    return np.asarray(2.0 * stdtr(_FREEDOM, -np.abs(z)), dtype=np.float64)


def upper_sided(z: Floats) -> Floats:
    """Return the probability of a value at least as large, any shape; NaN stays NaN."""
    return np.asarray(stdtr(_FREEDOM, -z), dtype=np.float64)


def widening(z: Floats) -> float:
    """Return by how much the spread behind z is too narrow, at least 1.

    Most ground of a site is as it was. If the middle half of all z is wider than that of a normal distribution, the
    surveys differ by more than their noise: flights that do not fit each other, plants that have grown.

    Parameters
    ----------
    z : array
        One value a tile; NaN is left out.
    """
    known = z[np.isfinite(z)]
    if not len(known):
        return 1.0
    return max(1.0, _NORMAL_MAD * float(np.median(np.abs(known - np.median(known)))))


def hold_false_discoveries(probability: Floats, share: float) -> NDArray[np.bool_]:
    """Choose what counts as found, so that on average at most ``share`` of it is chance.

    The step-up rule of Benjamini and Hochberg (1995, J. R. Stat. Soc. B 57): of n probabilities in rising order, the
    first k are found, k the last whose probability is at most share k / n. It holds for tests that are independent, and
    for neighbouring tiles, whose errors go together (Benjamini and Yekutieli 2001, Ann. Stat. 29).

    Parameters
    ----------
    probability : array
        Of each test, if nothing has changed; NaN: not tested.
    share : float
        0..1.

    Returns
    -------
    bool array of the same shape
    """
    tested = np.isfinite(probability)
    rising = np.sort(probability[tested])
    below = np.flatnonzero(rising <= share * np.arange(1, len(rising) + 1) / max(len(rising), 1))
    limit = rising[below[-1]] if len(below) else -1.0
    return np.asarray(tested & (np.nan_to_num(probability, nan=2.0) <= limit))
