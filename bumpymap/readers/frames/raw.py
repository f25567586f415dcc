"""The record of all returns in a scan file, before any are dropped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RawScan"]


@dataclass(frozen=True, slots=True)
class RawScan:
    """All returns of a scan file, in order."""

    points: NDArray[np.float32]
    """(n, 3) m; (0, 0, 0) for a beam without return; may hold NaN, infinity or any other value."""
    intensity: NDArray[np.float32] | None
    """(n,)"""
    label: NDArray[np.uint16] | None
    """(n,) semantic ids."""
    time: NDArray[np.float32] | None = None
    """(n,) s, see `bumpymap.core.Scan`; NaN if unknown."""
