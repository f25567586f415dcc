"""Random numbers by key (a tile, a point of a tile), independent of other draws."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["uniform_by_key"]

_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


def uniform_by_key(seed: int, *keys: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return uniform random numbers in [0, 1) for integer keys (splitmix64).

    Parameters
    ----------
    seed : int
    keys : arrays (n,)
        Components of each key; the same key gives the same number.
    """
    state = np.full(len(keys[0]), seed, np.uint64)
    for key in keys:
        state = _mixed(state + key.astype(np.int64).view(np.uint64) * _STEP + _STEP)
    return (state >> np.uint64(11)).astype(np.float64) / float(1 << 53)


def _mixed(state: NDArray[np.uint64]) -> NDArray[np.uint64]:
    state = (state ^ (state >> np.uint64(30))) * _MIX[0]
    state = (state ^ (state >> np.uint64(27))) * _MIX[1]
    mixed: NDArray[np.uint64] = state ^ (state >> np.uint64(31))
    return mixed
