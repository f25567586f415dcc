"""Checks shared by all readers: failing parsers, and headers that contradict the file."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bumpymap.core import BadInputError, BumpymapError, free_memory, missing_resource, refused_write
from bumpymap.readers.source import Location
from bumpytiles import Bounds

__all__ = ["TRUST", "asks_too_much", "box_text", "decoding", "refuse_count", "refuse_header_bounds"]

_NEEDED, _NEEDED_PER_BYTE = 512 << 20, 20
"""Memory that reading a log or bag may need, and for each byte of it."""
TRUST = "`trust_points=True` continues with the extent of the points"


@contextmanager
def decoding(path: Location, what: str) -> Iterator[None]:
    """Turn any exception of a parser into a BadInputError: the file is damaged.

    A panic of a decoder written in Rust is a ``BaseException``, not an ``Exception``.
    """
    try:
        yield
    except (BumpymapError, KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        if missing_resource(error) or refused_write(error):  # out of memory or the like: not the file's fault
            raise
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise BadInputError(
            f"cannot read {what} of {path}: {reason}. The file is damaged or truncated; copy or download it again"
        ) from error


def asks_too_much(error: BaseException, paths: Iterable[Path]) -> bool:
    """Return whether memory ran out that files of their size, intact, would not need: a length in them is wrong."""
    if missing_resource(error) != "memory":
        return False
    files = (file for path in paths for file in (path.iterdir() if path.is_dir() else (path,)))
    return (free_memory() or 0) >= _NEEDED + _NEEDED_PER_BYTE * sum(file.stat().st_size for file in files)


def refuse_count(path: Location, declared: int, held: int, unit: str = "points") -> None:
    """Raise BadInputError if a file holds fewer points, or other units, than its header declares."""
    if held < declared:
        raise BadInputError(
            f"{path} declares {declared:,} {unit} but holds {held:,}: truncated? Copy or download it again"
        )


def refuse_header_bounds(path: Location, bounds: Bounds) -> None:
    """Raise BadInputError if the bounds in a header are not finite or inverted."""
    sides = (bounds.west, bounds.south, bounds.east, bounds.north)
    if not np.isfinite(sides).all() or bounds.west > bounds.east or bounds.south > bounds.north:
        raise BadInputError(f"the header of {path} gives an impossible extent: {box_text(bounds)}. {TRUST}")


def box_text(bounds: Bounds) -> str:
    """Return bounds as text for messages."""
    return f"easting {bounds.west:,.2f} to {bounds.east:,.2f} m, northing {bounds.south:,.2f} to {bounds.north:,.2f} m"
