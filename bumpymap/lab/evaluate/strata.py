"""Choose the patches to drive: equal numbers for each level of roughness and for ground with expected failures."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAILING", "choose_patches", "strata"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS = 10
_QUANTILES = (0.02, 0.98)
FAILING = 0.5
"""Ground with at least this p_fail is a separate stratum."""


def strata(c_r: Floats, p_fail: Floats) -> Ints:
    """Return the stratum of each tile: bins of equal ratio in C_r, and a last one for ground with expected failures.

    Parameters
    ----------
    c_r, p_fail : array (n,)
        Predicted; not NaN. The bins span the 2 % to the 98 % quantile of the ground that can be crossed; values
        beyond belong to the first and the last bin.
    """
    fails = p_fail >= FAILING
    fine = c_r[~fails] if not fails.all() else c_r
    low, high = np.quantile(np.log(fine), _QUANTILES)
    place = np.floor(BINS * (np.log(c_r) - low) / max(high - low, 1e-9))
    return np.where(fails, BINS, np.clip(place, 0, BINS - 1)).astype(np.int64)


def choose_patches(stratum: Ints, priority: Floats, count: int) -> Ints:
    """Choose the same number of patches from each stratum, as far as it has enough.

    Tiles of high priority remain chosen if predictions change a little or more patches are requested, so their drives
    can be reused.

    Parameters
    ----------
    stratum : array (n,)
    priority : array (n,)
        Tiles with lower values are chosen first.
    count : int
        Number of patches; if there are fewer tiles, all are chosen.

    Returns
    -------
    array (m,)
        Rows of the chosen tiles, alternating between the strata.
    """
    order = np.lexsort((priority, stratum))
    first = np.searchsorted(stratum[order], stratum[order], side="left")
    turn = np.arange(len(order)) - first
    return order[np.lexsort((stratum[order], turn))][:count]
