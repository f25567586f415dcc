"""Settings of a route run: frozen dataclasses with defaults, validated when they are created."""

import math
from dataclasses import dataclass, field
from pathlib import Path

from bumpymap.core import UsageError, memory_limit

__all__ = ["CostSettings", "RouteConfig"]


@dataclass(frozen=True, slots=True)
class CostSettings:
    """What makes ground dear, and what may be crossed."""

    risk: float | None = None
    """m: the detour that one certain failure is worth; None: the ``fail_weight`` of the vehicle profile."""
    robust: bool = False
    """Plan on ``c_r_high``, the upper end of the interval, instead of ``c_r``."""
    unknown: float | None = None
    """Cost per metre of unknown ground; None: it is not crossed."""
    avoid: Path | None = None
    """File of polygons that are not entered."""
    only: Path | None = None
    """File of polygons that are not left."""
    allow_outside: bool = False
    """It is no error that a polygon of ``avoid`` or ``only`` lies off the map."""

    through_obstacles: bool = False
    """Where there is no other way, touch obstacles: for those that the map takes for solid and the driver does not."""

    def __post_init__(self) -> None:
        _number("risk", self.risk, 0.0, _MOST_COST)
        _number("unknown", self.unknown, 1.0, _MOST_COST)


@dataclass(frozen=True, slots=True)
class RouteConfig:
    """All settings of a ``route`` run."""

    layers: tuple[Path, ...]
    """Folders that ``bumpymap map`` wrote; several are sheets of one map."""
    start: str | None = None
    """``lon,lat``, or ``x,y`` in the survey's CRS."""
    goal: str | None = None
    """The same; None: what can be reached from the start."""
    via: tuple[str, ...] = ()
    """Points to pass on the way, in order."""
    points: Path | None = None
    """File of points (GeoJSON, GPX, CSV), instead of the three above: start, points to pass, goal."""
    visit: bool = False
    """Pass the points in the best order instead of the given one; start and goal keep their
    places (on a round trip, only the start)."""
    round_trip: bool = False
    """Return to the start at the end."""
    alternatives: int = 1
    """Number of ways to propose."""
    compare: tuple[Path, ...] = ()
    """Maps of the same site for other vehicles: each plans its own way between the same points."""
    snap: float = 0.0
    """A start, goal or point to pass on ground that cannot be used is moved by this much at most, m."""
    isochrones: tuple[float, ...] = ()
    """Minutes of driving: outlines of what can be reached in this time."""
    isocosts: tuple[float, ...] = ()
    """Costs, m: outlines of what can be reached at this cost."""
    out: Path | None = None
    """Folder, or file of a format that its suffix names; None: only the summary."""
    overwrite: bool = False
    """Replace files of an earlier run."""
    memory: str = "auto"
    """Memory that the search may use, such as ``1GB``; ``auto``: a quarter of what is free, 512 MB to 8 GB."""
    cost: CostSettings = field(default_factory=CostSettings)

    def __post_init__(self) -> None:
        if not self.layers:
            raise UsageError("no layers given: name the folder that `bumpymap map` wrote")
        if (self.start is None) == (self.points is None):
            raise UsageError("give either the `start` or a file of `points`")
        if self.points is not None and (self.goal is not None or self.via):
            raise UsageError("the file of points holds start, points to pass and goal: leave out `goal` and `via`")
        if not 1 <= self.alternatives <= _MOST_ALTERNATIVES:
            raise UsageError(
                f"`alternatives` is {self.alternatives}; it must be a number from 1 to {_MOST_ALTERNATIVES}"
            )
        _number("snap", self.snap, 0.0)
        memory_limit(self.memory)
        for name, values in (("isochrones", self.isochrones), ("isocosts", self.isocosts)):
            if any(not (math.isfinite(value) and value > 0.0) for value in values):
                given = ", ".join(map(repr, values))
                raise UsageError(f"`{name}` is {given}; it must be a number above 0, or several")
        if self.is_reach and (self.visit or self.round_trip or self.alternatives > 1 or self.compare):
            raise UsageError(
                "without a goal the run maps what can be reached from the start; `visit`, `round_trip`, `alternatives` "
                "and `compare` belong to a way: add `goal`, `via` or `points`"
            )
        if self.isochrones and self.isocosts:
            raise UsageError("`isochrones` and `isocosts` are outlines of one run each: give one of them")
        if not self.is_reach and (self.isochrones or self.isocosts):
            raise UsageError(
                "`isochrones` and `isocosts` are those of a start without a goal: leave out `goal` and `via`"
            )

    @property
    def is_reach(self) -> bool:
        """Whether there is a start only, so that the run maps what can be reached from it."""
        return self.points is None and self.goal is None and not self.via


_MOST_ALTERNATIVES = 10


_MOST_COST = 1e9
"""Weights beyond all ground, with which costs can still be added up."""


def _number(name: str, value: float | None, least: float, most: float = math.inf) -> None:
    if value is not None and not (math.isfinite(value) and least <= value <= most):
        limit = "" if math.isinf(most) else f" and at most {most:g}"
        raise UsageError(f"`{name}` is {value!r}; it must be a finite number of at least {least:g}{limit}")
