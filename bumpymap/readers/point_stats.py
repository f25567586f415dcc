"""What is counted while points pass, and the verdict when all were seen.

A header's extent and point count can only be judged when all points were seen, and the pieces of a file may be read in
any order, by several machines. Each chunk gives a ``PointStats``; they are merged, and ``verify`` compares the sum with
what the header said.
"""

import math
from dataclasses import asdict, dataclass
from typing import Any, Self

from bumpymap.core import BadInputError
from bumpymap.readers.checks import TRUST, box_text, refuse_count
from bumpymap.readers.source import Location
from bumpytiles import Bounds

__all__ = ["EARTH_LIMIT", "OUTSIDE", "PointStats", "verify"]

_DROPPED = ("withheld", "noise", "not_a_number")
"""Reasons for which a point does not count: flagged withheld; class 7 or 18; PCD rows that stand for "no return"."""

OUTSIDE = 1.0
"""How far a point may lie outside the box of its file or its piece, m: headers are rounded."""
EARTH_LIMIT = 3e9
"""Coordinates beyond this, m, are not a location on Earth (40,000 km around) by any datum or unit."""
_FAR_TOO_LARGE, _FAR_TOO_LARGE_RATIO = 10_000.0, 10.0
"""A box longer than this, m, and than so many times the points' own extent was not made from the points."""
_REMOVE = "Remove them, such as with: pdal translate IN OUT.laz range --filters.range.limits="


@dataclass(frozen=True, slots=True)
class PointStats:
    """Counts of some points of one file. Plain numbers: it travels and is stored."""

    points: int = 0
    """Seen, whether they count or not."""
    withheld: int = 0
    noise: int = 0
    not_a_number: int = 0
    """Beams without return (PCD)."""
    outside: int = 0
    """More than ``OUTSIDE`` outside the header's box."""
    points_outside_node: int = 0
    """Inside the header's box, and more than ``OUTSIDE`` outside the bounds of their piece."""
    not_finite: int = 0
    """Coordinates not a number or infinite, where that is a fault."""
    first_not_finite: int = -1
    """Number of the first such point in the file; -1: none."""
    west: float = math.inf
    south: float = math.inf
    east: float = -math.inf
    north: float = -math.inf
    """Extent of the points, m; infinite the wrong way round while there are none."""
    highest: float = 0.0
    """Largest distance of a height from zero, m."""

    def merge(self, other: "PointStats") -> "PointStats":
        """Give the stats of both; the order does not matter."""
        firsts = [first for first in (self.first_not_finite, other.first_not_finite) if first >= 0]
        return PointStats(
            self.points + other.points,
            self.withheld + other.withheld,
            self.noise + other.noise,
            self.not_a_number + other.not_a_number,
            self.outside + other.outside,
            self.points_outside_node + other.points_outside_node,
            self.not_finite + other.not_finite,
            min(firsts, default=-1),
            min(self.west, other.west),
            min(self.south, other.south),
            max(self.east, other.east),
            max(self.north, other.north),
            max(self.highest, other.highest),
        )

    @property
    def dropped(self) -> dict[str, int]:
        """Points that do not count, by reason."""
        return {reason: getattr(self, reason) for reason in _DROPPED}

    @property
    def bad(self) -> bool:
        """Whether any point is such that the file cannot be mapped; ``verify`` will say why."""
        return bool(
            self.not_finite or self.outside or self.points_outside_node or self.off_earth or self.highest > EARTH_LIMIT
        )

    @property
    def off_earth(self) -> bool:
        """Whether a point lies at not a location on Earth."""
        return max(-self.west, -self.south, self.east, self.north) > EARTH_LIMIT

    @property
    def bounds(self) -> Bounds:
        """Extent of the points, m."""
        return Bounds(self.west, self.south, self.east, self.north)

    def to_record(self) -> dict[str, Any]:
        """Give what JSON can hold; what is infinite becomes text."""
        return {name: str(value) if math.isinf(value) else value for name, value in asdict(self).items()}

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> Self:
        """Take back what ``to_record`` gave."""
        numbers: dict[str, Any] = {name: float(v) if isinstance(v, str) else v for name, v in record.items()}
        return cls(**numbers)


def verify(stats: PointStats, path: Location, promised: int, bounds: Bounds | None) -> None:
    """Hold all points of a file to what its header said.

    Parameters
    ----------
    stats : PointStats
        Of every piece.
    path : Path or str
    promised : int
        Points that the header declares.
    bounds : Bounds or None
        The header's box, m; None: no header to hold the points to.

    Raises
    ------
    BadInputError
        The file cannot be mapped.
    """
    if stats.not_finite:
        raise BadInputError(
            f"{path} holds {stats.not_finite:,} points whose coordinates are not a number or infinite; the first is "
            f"point {stats.first_not_finite:,} (counted from 0). {_REMOVE}'X[-1e9:1e9],Y[-1e9:1e9],Z[-1e9:1e9]'"
        )
    refuse_count(path, promised, stats.points)
    if stats.off_earth:
        raise BadInputError(
            f"the points of {path} lie in {box_text(stats.bounds)}, which is not a location on Earth: are scale, "
            "offset and CRS of the file right?"
        )
    if stats.highest > EARTH_LIMIT:
        raise BadInputError(
            f"{path} holds heights of up to {stats.highest:g} m from zero, which is not a location on Earth: a nodata "
            f"value, or a wrong scale? {_REMOVE}'Z[-1e4:1e4]'"
        )
    if bounds is not None and stats.points:
        _judge_extent(stats, path, bounds)
    if stats.points_outside_node:
        raise BadInputError(
            f"{stats.points_outside_node:,} of {stats.points:,} points of {path} "
            f"lie outside the octree node that holds them: the file is damaged. "
            f"Build it anew, such as with: pdal translate IN OUT.copc.laz. {TRUST}"
        )


def _judge_extent(stats: PointStats, path: Location, box: Bounds) -> None:
    claimed = (box.east - box.west, box.north - box.south)
    own = (stats.east - stats.west, stats.north - stats.south)
    far_too_large = any(
        side > _FAR_TOO_LARGE and side > _FAR_TOO_LARGE_RATIO * length
        for side, length in zip(claimed, own, strict=True)
    )
    if stats.outside or far_too_large:
        count = f"; {stats.outside:,} of {stats.points:,} points are outside" if stats.outside else ""
        raise BadInputError(
            f"the header of {path} says that the points lie in {box_text(box)}, but they lie in "
            f"{box_text(stats.bounds)}{count}. Is the file damaged, or was it cut from another without a new header? "
            f"{TRUST}"
        )
