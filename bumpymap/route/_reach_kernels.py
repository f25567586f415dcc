"""Compiled kernel: how long the ways of a search are."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from bumpytiles import kernel

__all__ = ["add_up_lengths"]


@kernel
def add_up_lengths(
    back: Annotated[NDArray[np.uint8], 2],
    moves: Annotated[NDArray[np.int64], 2],
    row: float,
    col: float,
    out: Annotated[NDArray[np.float64], 2],
) -> None:
    """Fill the length of the way to each tile, tiles; 0 where there is none.

    Every tile knows the one before it. A way is followed back to a tile whose length is known, and then once more, to
    set what lies between: each tile is visited twice at most, and nothing else has to be held.

    ``back`` is that of `bumpymap.route.search.spread` from the field coordinates (``row``, ``col``); ``out`` comes
    filled with NaN.
    """
    for i in range(back.shape[0]):
        for j in range(back.shape[1]):
            r, c, total = i, j, 0.0
            while math.isnan(out[r, c]):
                k = back[r, c]
                if k >= moves.shape[0]:
                    straight = math.sqrt((r + 0.5 - row) ** 2 + (c + 0.5 - col) ** 2)
                    out[r, c] = straight if k < 255 else 0.0
                    break
                total += math.sqrt(float(moves[k, 0] * moves[k, 0] + moves[k, 1] * moves[k, 1]))
                r -= moves[k, 0]
                c -= moves[k, 1]
            total += out[r, c]
            r, c = i, j
            while math.isnan(out[r, c]):
                k = back[r, c]
                out[r, c] = total
                total -= math.sqrt(float(moves[k, 0] * moves[k, 0] + moves[k, 1] * moves[k, 1]))
                r -= moves[k, 0]
                c -= moves[k, 1]
