"""Compiled filter bank: the answers of Gabor filters to many small maps, and the stripes in them.

The maps lie side by side, ``LANES`` of them, so that a processor multiplies for all of them at once; every map's sums
run in the same order wherever it lies among others. A matrix product of a library would be as fast on a machine with
nothing else to do, and several times slower on one whose cores are taken: its threads wait for each other.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from bumpytiles import kernel

Singles = NDArray[np.float32]

LANES = 32
"""Maps side by side: smooth ones together need few of the filters."""
STEP = 8
"""Pixels that are added at once; maps are padded with zeros to a multiple."""


@kernel
def filter_maps(
    maps: Annotated[Singles, 2],
    bank: Annotated[Singles, 3],
    threshold: np.float32,
    sums: Annotated[Singles, 1],
    answers: Annotated[Singles, 2],
    stripes: Annotated[Singles, 2],
) -> None:
    """Count the stripes of maps.

    Parameters
    ----------
    maps : (groups, padded * ``LANES``) float32
        First pixel of every map of the group, second pixel, and so on.
    bank : (pixels^2, orientations, padded) float32
        Weights of the maps' pixels in the answer at each pixel.
    threshold : float32
        A stripe's least answer.
    sums : (``LANES``,) float32
        Scratch: one answer.
    answers : (pixels^2, ``LANES``) float32
        Scratch: the greatest answer at each pixel, or one that is a stripe's.
    stripes : (groups, ``LANES``) float32
        Zeros. Filled: stripes up the columns, summed over all columns.
    """
    pixels = int(np.sqrt(bank.shape[0]) + 0.5)
    for g in range(maps.shape[0]):
        these = maps[g]
        for p in range(bank.shape[0]):
            greatest = answers[p]
            for lane in range(LANES):
                greatest[lane] = -np.inf
            for o in range(bank.shape[1]):
                weights = bank[p, o]
                for lane in range(LANES):
                    sums[lane] = np.float32(0.0)
                for k in range(0, bank.shape[2], STEP):
                    w0, w1, w2, w3 = weights[k], weights[k + 1], weights[k + 2], weights[k + 3]
                    w4, w5, w6, w7 = weights[k + 4], weights[k + 5], weights[k + 6], weights[k + 7]
                    m = these[k * LANES : (k + STEP) * LANES]
                    for i in range(LANES):
                        low = (w0 * m[i] + w1 * m[LANES + i]) + (w2 * m[2 * LANES + i] + w3 * m[3 * LANES + i])
                        high = (w4 * m[4 * LANES + i] + w5 * m[5 * LANES + i]) + (
                            w6 * m[6 * LANES + i] + w7 * m[7 * LANES + i]
                        )
                        sums[i] += low + high
                least = np.float32(np.inf)
                for lane in range(LANES):
                    greatest[lane] = max(greatest[lane], sums[lane])
                    least = min(least, greatest[lane])
                if least >= threshold:  # a stripe in every map already, whatever the other filters say
                    break
        for p in range(bank.shape[0]):
            for lane in range(LANES):
                starts = answers[p, lane] >= threshold and (p < pixels or answers[p - pixels, lane] < threshold)
                stripes[g, lane] += np.float32(starts)
