"""Read heights at the resolution of a picture: memory and time do not grow with the map."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bumpymap.layers.route_sheet import RouteSheet, common_window
from bumpytiles import TileWindow

__all__ = ["read_relief"]


def read_relief(sheets: Sequence[RouteSheet], window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Read mean heights of the ground from the overviews of heightmap.tif.

    Parameters
    ----------
    sheets : sequence of RouteSheet
        Where they overlap, the higher value counts.
    window : TileWindow
        May extend beyond the sheets.
    shape : tuple
        Rows and columns of the result, which spans the window.

    Returns
    -------
    float32 of that shape
        m, north row first; NaN where there is none. A sheet is placed to the nearest pixel.

    Raises
    ------
    BadInputError
        A file is missing or damaged.
    """
    out = np.full(shape, np.nan, np.float32)
    for sheet in sheets:
        part = common_window(window, sheet.window)
        if part is None:
            continue
        above = window.row + window.rows - part.row - part.rows
        rows = np.rint(np.array([above, above + part.rows]) * (shape[0] / window.rows)).astype(int).tolist()
        west = part.col - window.col
        cols = np.rint(np.array([west, west + part.cols]) * (shape[1] / window.cols)).astype(int).tolist()
        if rows[1] > rows[0] and cols[1] > cols[0]:
            place = slice(*rows), slice(*cols)
            found = sheet.read_relief(part, (rows[1] - rows[0], cols[1] - cols[0]))
            out[place] = np.fmax(out[place], found)
    return out
