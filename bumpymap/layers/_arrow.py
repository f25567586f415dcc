"""Arrow arrays from values, without pandas.

pyarrow's own ``array`` imports pandas wherever that is installed, to see whether it was given something of it: a fifth
of a second of processor time. So arrays are made of buffers here.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

__all__ = ["lists", "numbers", "texts", "values"]


def numbers(given: NDArray[Any], kind: pa.DataType, known: NDArray[np.bool_] | None = None) -> pa.Array:
    """Give numbers or truth values (n,) as an array of a kind; those that are not known are null, by default NaN."""
    data = np.ascontiguousarray(given, kind.to_pandas_dtype())
    if known is None:
        known = ~np.isnan(data)
    stored = np.packbits(data, bitorder="little") if kind == pa.bool_() else data
    return pa.Array.from_buffers(kind, len(data), [*_nulls(known), pa.py_buffer(stored)])


def texts(given: Sequence[str | bytes | None], kind: pa.DataType) -> pa.Array:
    """Give strings, or bytes, as an array of a kind; None is null."""
    known = np.array([part is not None for part in given], dtype=np.bool_)
    parts = [part.encode() if isinstance(part, str) else part or b"" for part in given]
    ends = np.zeros(len(parts) + 1, dtype=np.int32)
    np.cumsum([len(part) for part in parts], out=ends[1:])
    buffers = [*_nulls(known), pa.py_buffer(ends), pa.py_buffer(b"".join(parts))]
    return pa.Array.from_buffers(kind, len(parts), buffers)


def lists(given: NDArray[Any], kind: pa.DataType) -> pa.Array:
    """Give numbers (n, size), all of them known, as an array of lists of one size."""
    each = np.ascontiguousarray(given, kind.value_type.to_pandas_dtype()).reshape(-1)
    child = pa.Array.from_buffers(kind.value_type, len(each), [None, pa.py_buffer(each)])
    return pa.Array.from_buffers(kind, len(given), [None], children=[child])


def values(given: Sequence[Any], kind: pa.DataType) -> pa.Array:
    """Give Python values as an array of a kind; None is null."""
    if kind in {pa.string(), pa.binary()}:
        return texts(given, kind)
    known = np.array([value is not None for value in given], dtype=np.bool_)
    return numbers(np.array([0 if value is None else value for value in given]), kind, known)


def _nulls(known: NDArray[np.bool_]) -> list[pa.Buffer | None]:
    """Give the buffer that says which rows are known; none where all are."""
    return [None if known.all() else pa.py_buffer(np.packbits(known, bitorder="little"))]
