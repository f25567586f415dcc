"""Compare the heightmaps of two surveys, strip by strip of tiles: first their offset, then what remains."""

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.change.ground import LEAST_CELLS, GroundChange, coarsen, compare_heights
from bumpymap.layers import SurveyPair
from bumpytiles import TileWindow

__all__ = ["cell_pixels", "ground_changes", "height_offset"]

_STRIP_PIXELS = 1 << 20
"""Most pixels that are compared at once."""
_SEEN = 0.5
"""Share of the cells of a tile that both surveys should have seen."""
_LEAST_SIDE = 5
"""Fewest cells along a tile."""


def cell_pixels(pair: SurveyPair, shared: NDArray[np.bool_], coverage: NDArray[np.floating]) -> int:
    """Return how many pixels make the side of a cell in which heights are compared.

    One, unless the surveys are so thin that few pixels hold points of both: then pixels are taken together, so that
    most cells do.

    Parameters
    ----------
    pair : SurveyPair
    shared : bool array (rows, cols)
        Tiles that both surveys have.
    coverage : array (rows, cols)
        Share of the pixels that hold points of both, if they fell at random: the product of both coverages.
    """
    pixels = pair.before.grid.pixels
    factors = [factor for factor in range(1, pixels // _LEAST_SIDE + 1) if pixels % factor == 0]
    seen = float(np.nanmedian(coverage[shared])) if shared.any() else 1.0
    return next((factor for factor in factors if 1.0 - (1.0 - seen) ** (factor**2) >= _SEEN), factors[-1])


def height_offset(pair: SurveyPair, cell: int) -> float:
    """Return the median, over the tiles, of the median height difference of a tile, m; NaN if none can be compared."""
    middles = []
    for _, difference in _differences(pair, cell):
        enough = np.isfinite(difference).sum(axis=(1, 2)) >= LEAST_CELLS
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # tiles without a value
            middles.append(np.nanmedian(difference[enough], axis=(1, 2)))
    found = np.concatenate(middles)
    return float(np.median(found)) if len(found) else float("nan")


def ground_changes(pair: SurveyPair, cell: int, offset: float) -> GroundChange:
    """Compare the heights of all tiles of the common window; arrays are (rows, cols), north row first."""
    window = pair.window
    out = [np.full((window.rows, window.cols), np.nan) for _ in range(3)]
    for rows, difference in _differences(pair, cell):
        found = compare_heights(difference - offset)
        parts: Any = (found.d_height, found.z_height, found.z_shape)
        for array, values in zip(out, parts, strict=True):
            array[rows] = values.reshape(-1, window.cols)
    return GroundChange(*out)


def _differences(pair: SurveyPair, cell: int) -> Iterator[tuple[slice, NDArray[np.float64]]]:
    """Yield rows of the common window, north first, and the difference of their heights, (tiles, cells, cells), m."""
    window, pixels = pair.window, pair.before.grid.pixels
    step = max(1, _STRIP_PIXELS // (window.cols * pixels**2))
    for top in range(0, window.rows, step):
        rows = slice(top, min(top + step, window.rows))
        south = window.row + window.rows - rows.stop
        strip = TileWindow(window.col, south, window.cols, rows.stop - rows.start)
        before, after = (coarsen(side.reshape(-1, pixels, pixels), cell) for side in pair.heights(strip))
        yield rows, after - before
