"""Convert columns of a PLY or PCD table to points in metres, and warn of large coordinates in float32."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Georeference
from bumpymap.readers.conversion import RawPoints
from bumpymap.readers.source import OpenFile
from bumpytiles import DECIMALS

__all__ = ["CLASS_COLUMNS", "metres", "precision_note", "read_rows"]

CLASS_COLUMNS = ("classification", "scalar_classification", "class")
"""Names, in lower case, of columns that hold LAS class codes."""
_LARGE = 1e5
"""From here on the resolution of float32 is 1 cm or coarser, in the file's unit."""


def metres(rows: Any, columns: tuple[str, str, str], class_column: str | None, place: Georeference) -> RawPoints:
    """Convert table rows to points.

    Parameters
    ----------
    rows : structured array (n,)
    columns : (str, str, str)
        Names of x, y and z.
    class_column : str or None
    place : Georeference
        Its units are used.

    Returns
    -------
    RawPoints
    """
    # Rounded like LAS coordinates, so that a point is identical in a LAS and a PLY file.
    units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
    x, y, z = (_coordinate(rows[name], unit) for name, unit in zip(columns, units, strict=True))
    return RawPoints(x, y, z, None if class_column is None else np.asarray(rows[class_column]))


def read_rows(file: OpenFile, data_at: int, dtype: np.dtype[np.void], first: int, count: int) -> NDArray[np.void]:
    """Read ``count`` rows of a binary table from row ``first``; fewer at the end of the file."""
    data = file.read(data_at + first * dtype.itemsize, count * dtype.itemsize)
    return data[: data.size // dtype.itemsize * dtype.itemsize].view(dtype)


def _coordinate(column: Any, unit: float) -> NDArray[np.float64]:
    # Overflow becomes infinity; infinity and NaN are rejected later.
    with np.errstate(over="ignore", invalid="ignore"):
        value: NDArray[np.float64] = np.asarray(column, np.float64).round(DECIMALS)
        return value if unit == 1.0 else value * unit


def precision_note(first: tuple[float, float, float] | None, types: Sequence[Any]) -> tuple[str, ...]:
    """Return a note if float32 is too coarse for the coordinates: for UTM, the error is centimetres to half a metre.

    Parameters
    ----------
    first : (float, float, float) or None
        The first point, in the file's unit.
    types : sequence of 3 dtypes
        Types of x, y and z.
    """
    if first is None:
        return ()
    lost = [
        float(np.spacing(np.float32(abs(value))))
        for value, kind in zip(first, types, strict=True)
        if np.dtype(kind) == np.dtype(np.float32) and abs(value) > _LARGE
    ]
    if not lost:
        return ()
    note = (
        f"its coordinates are stored as float32 and are so large that they lie on steps of {max(lost):g} units: fine "
        "relief is lost. Export it with double coordinates, or as LAS"
    )
    return (note,)
