"""Checks that every reader makes: decoders that fail, points that are nowhere, headers that lie.

A header's extent and point count can only be judged when all points were seen. ``PointWatch`` sees every chunk as it
passes; the first bad one stops the flow of points, and the rest is read for the message alone.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.errors import BadInputError, BumpymapError
from bumpytiles import Bounds

__all__ = ["PointWatch", "RawPoints", "decoding", "refuse_count", "refuse_header_bounds"]

_OUTSIDE = 1.0
"""How far a point may lie outside the header's box, m: headers are rounded."""
_FAR_TOO_LARGE, _FAR_TOO_LARGE_RATIO = 10_000.0, 10.0
"""A box longer than this, m, and than so many times the points' own extent was not made from the points."""
_NOWHERE = 3e9
"""Coordinates beyond this, m, are no place on Earth (40,000 km around) by any datum or unit."""
_TRUST = "--trust-points goes on with the points' own extent"


@dataclass(frozen=True, slots=True)
class RawPoints:
    """Points as a file holds them, before any is left out; metres."""

    easting: NDArray[np.float64]
    northing: NDArray[np.float64]
    upward: NDArray[np.float64]
    klass: NDArray[np.number] | None = None
    """LAS class codes, of any number type; None where the file has none."""
    withheld: NDArray[np.bool_] | None = None


@contextmanager
def decoding(path: Path, what: str) -> Iterator[None]:
    """Turn whatever a parser throws at a damaged file into a BadInputError.

    Decoders written in Rust panic with an exception that is not an ``Exception``.
    """
    try:
        yield
    except (BumpymapError, KeyboardInterrupt, SystemExit, GeneratorExit, MemoryError):
        raise
    except BaseException as error:
        reason = str(error).strip().split("\n")[0] or type(error).__name__
        raise BadInputError(
            f"cannot read {what} of {path}: {reason}. The file is damaged or truncated; copy or download it again"
        ) from error


def refuse_count(path: Path, promised: int, held: int, unit: str = "points") -> None:
    """Raise BadInputError where a file holds fewer points than its header promises."""
    if held < promised:
        raise BadInputError(
            f"{path} promises {promised:,} {unit} and holds {held:,}: truncated? Copy or download it again"
        )


def refuse_header_bounds(path: Path, bounds: Bounds) -> None:
    """Raise BadInputError where a header's box cannot be one."""
    sides = (bounds.west, bounds.south, bounds.east, bounds.north)
    if not np.isfinite(sides).all() or bounds.west > bounds.east or bounds.south > bounds.north:
        raise BadInputError(f"the header of {path} gives an extent that cannot be: {_box(bounds)}. {_TRUST}")


class PointWatch:
    """Sees every point of a file and holds it to what the header said.

    Parameters
    ----------
    path : Path
    promised : int
        Points that the header promises.
    bounds : Bounds or None
        The header's box, m; None: no header to hold the points to.
    nan_is_no_return : bool
        Rows with NaN stand for "no return" (PCD) and are no fault.
    """

    def __init__(self, path: Path, promised: int, bounds: Bounds | None, *, nan_is_no_return: bool = False) -> None:
        self._path = path
        self._promised = promised
        self._bounds = bounds
        self._nan_is_no_return = nan_is_no_return
        self._seen = 0
        self._outside = 0
        self._not_finite = 0
        self._first_not_finite = 0
        self._low = np.full(2, np.inf)
        self._high = np.full(2, -np.inf)
        self._highest = 0.0

    def see(self, raw: RawPoints) -> bool:
        """Take note of a chunk; False once any chunk was bad."""
        self._see_finite(raw)
        x, y = raw.easting, raw.northing
        if x.size:
            low = np.array([np.fmin.reduce(x), np.fmin.reduce(y)])
            high = np.array([np.fmax.reduce(x), np.fmax.reduce(y)])
            self._low, self._high = np.fmin(self._low, low), np.fmax(self._high, high)
            self._see_outside(x, y, low, high)
            self._highest = max(self._highest, float(np.fmax.reduce(np.abs(raw.upward))))
        self._seen += x.size
        return not (self._not_finite or self._outside or self._nowhere() or self._highest > _NOWHERE)

    def finish(self) -> None:
        """Judge all points. Raises BadInputError."""
        if self._not_finite:
            raise BadInputError(
                f"{self._path} holds {self._not_finite:,} points whose coordinates are not a number or infinite; "
                f"the first is point {self._first_not_finite:,} (counted from 0). Remove them, such as with: "
                "pdal translate IN OUT.laz range --filters.range.limits='X[-1e9:1e9],Y[-1e9:1e9],Z[-1e9:1e9]'"
            )
        refuse_count(self._path, self._promised, self._seen)
        if self._nowhere():
            raise BadInputError(
                f"the points of {self._path} lie in {self._own()}, which is no place on Earth: are scale, offset and "
                "CRS of the file right?"
            )
        if self._highest > _NOWHERE:
            raise BadInputError(
                f"{self._path} holds heights of up to {self._highest:g} m from zero, which is no place on Earth: a "
                "value that stands for 'no data', or a wrong scale? Remove such points, such as with: "
                "pdal translate IN OUT.laz range --filters.range.limits='Z[-1e4:1e4]'"
            )
        if self._bounds is None or not self._seen:
            return
        if self._outside or self._box_far_too_large(self._bounds):
            count = f"; {self._outside:,} of {self._seen:,} points are outside" if self._outside else ""
            raise BadInputError(
                f"the header of {self._path} says that the points lie in {_box(self._bounds)}, but they lie in "
                f"{self._own()}{count}. Is the file damaged, or was it cut from another without a new header? {_TRUST}"
            )

    def _see_finite(self, raw: RawPoints) -> None:
        axes = (raw.easting, raw.northing, raw.upward)
        if all(np.isfinite(axis.sum()) for axis in axes):
            return
        bad = ~np.isfinite(np.column_stack(axes)).all(axis=1)
        if self._nan_is_no_return:
            bad &= ~np.isnan(np.column_stack(axes)).any(axis=1)
        if bad.any() and not self._not_finite:
            self._first_not_finite = self._seen + int(bad.argmax())
        self._not_finite += int(bad.sum())

    def _see_outside(
        self, x: NDArray[np.float64], y: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
    ) -> None:
        box = self._bounds
        if box is None:
            return
        west, south, east, north = box.west - _OUTSIDE, box.south - _OUTSIDE, box.east + _OUTSIDE, box.north + _OUTSIDE
        if low[0] < west or low[1] < south or high[0] > east or high[1] > north:
            self._outside += int(((x < west) | (x > east) | (y < south) | (y > north)).sum())

    def _nowhere(self) -> bool:
        return self._seen > 0 and bool(max(-self._low.min(), self._high.max()) > _NOWHERE)

    def _own(self) -> str:
        return _box(Bounds(*self._low, *self._high))

    def _box_far_too_large(self, box: Bounds) -> bool:
        claimed = np.array([box.east - box.west, box.north - box.south])
        own = self._high - self._low
        return bool(((claimed > _FAR_TOO_LARGE) & (claimed > _FAR_TOO_LARGE_RATIO * own)).any())


def _box(bounds: Bounds) -> str:
    return f"easting {bounds.west:,.2f} to {bounds.east:,.2f} m, northing {bounds.south:,.2f} to {bounds.north:,.2f} m"
