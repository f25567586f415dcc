"""Choose the patches to drive: equally many of each roughness, and of the ground that is expected to fail."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["FAILING", "choose", "strata"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

BINS = 10
_QUANTILES = (0.02, 0.98)
FAILING = 0.5
"""Ground with this p_fail or more is a stratum of its own."""


def strata(c_r: Floats, p_fail: Floats) -> Ints:
    """Stratum of each tile: bins of equal ratio in C_r, and a last one for ground that is expected to fail.

    Parameters
    ----------
    c_r, p_fail : array (n,)
        Predicted; not NaN. The bins reach from the 2 % to the 98 % quantile of the ground that can be crossed; what
        lies beyond belongs to the first and the last bin.
    """
    fails = p_fail >= FAILING
    fine = c_r[~fails] if not fails.all() else c_r
    low, high = np.quantile(np.log(fine), _QUANTILES)
    place = np.floor(BINS * (np.log(c_r) - low) / max(high - low, 1e-9))
    return np.where(fails, BINS, np.clip(place, 0, BINS - 1)).astype(np.int64)


def choose(stratum: Ints, priority: Floats, count: int) -> Ints:
    """Choose equally many patches of each stratum, as long as it has some left.

    A tile of high priority stays chosen when predictions move a little, or when more patches are asked for: its drives
    need not be made again.

    Parameters
    ----------
    stratum : array (n,)
    priority : array (n,)
        Lower ones come first.
    count : int
        All tiles where there are fewer.

    Returns
    -------
    array (m,)
        Rows of the chosen tiles: stratum by stratum in turns.
    """
    order = np.lexsort((priority, stratum))
    first = np.searchsorted(stratum[order], stratum[order], side="left")
    turn = np.arange(len(order)) - first
    return order[np.lexsort((stratum[order], turn))][:count]
