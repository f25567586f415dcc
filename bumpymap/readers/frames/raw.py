"""What a file of a scan holds, before anything is dropped."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RawScan"]


@dataclass(frozen=True, slots=True)
class RawScan:
    """Every return of a file, in its order."""

    points: NDArray[np.float32]
    """(n, 3) m; (0, 0, 0) where a beam had no return, anything where a driver wrote it."""
    intensity: NDArray[np.float32] | None
    """(n,)"""
    label: NDArray[np.uint16] | None
    """(n,) semantic ids."""
