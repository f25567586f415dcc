"""Pull a way tight."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["straighten"]


def straighten(cost: NDArray[np.float32], line: NDArray[np.float64], margin: float = 0.0) -> NDArray[np.float64]:
    return line
