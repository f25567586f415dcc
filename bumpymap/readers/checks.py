"""Checks that every reader makes before points are read: decoders that fail, headers that lie."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from bumpymap.core import BadInputError, BumpymapError, missing_resource
from bumpymap.readers.source import Location
from bumpytiles import Bounds

__all__ = ["TRUST", "box_text", "decoding", "refuse_count", "refuse_header_bounds"]

TRUST = "`trust_points=True` goes on with the points' own extent"


@contextmanager
def decoding(path: Location, what: str) -> Iterator[None]:
    """Turn whatever a parser throws at a damaged file into a BadInputError.

    Decoders written in Rust panic with an exception that is not an ``Exception``.
    """
    try:
        yield
    except (BumpymapError, KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        if missing_resource(error):  # nothing is wrong with the file
            raise
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise BadInputError(
            f"cannot read {what} of {path}: {reason}. The file is damaged or truncated; copy or download it again"
        ) from error


def refuse_count(path: Location, promised: int, held: int, unit: str = "points") -> None:
    """Raise BadInputError where a file holds fewer points than its header promises."""
    if held < promised:
        raise BadInputError(
            f"{path} declares {promised:,} {unit} but holds {held:,}: truncated? Copy or download it again"
        )


def refuse_header_bounds(path: Location, bounds: Bounds) -> None:
    """Raise BadInputError where a header's box cannot be one."""
    sides = (bounds.west, bounds.south, bounds.east, bounds.north)
    if not np.isfinite(sides).all() or bounds.west > bounds.east or bounds.south > bounds.north:
        raise BadInputError(f"the header of {path} gives an extent that cannot be: {box_text(bounds)}. {TRUST}")


def box_text(bounds: Bounds) -> str:
    """Spell a box for people."""
    return f"easting {bounds.west:,.2f} to {bounds.east:,.2f} m, northing {bounds.south:,.2f} to {bounds.north:,.2f} m"
