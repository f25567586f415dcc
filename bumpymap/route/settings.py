"""Settings of a route run: frozen dataclasses, declared once, checked when they are created."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from bumpymap.core import MOST_COST, DirectionSettings, Setting, UsageError, check_settings, memory_limit

RouteBy = Literal["cost", "time"]


@dataclass(frozen=True, slots=True)
class CostSettings(DirectionSettings):
    """Settings of the cost of ground, and of the ground that may be crossed."""

    by: Annotated[RouteBy, Setting("What the way has least of: cost or time", "WHAT", group="Way")] = "cost"
    """``time``: at the speed made good; a metre costs as many as are driven at the top speed meanwhile."""
    risk: Annotated[
        float | None,
        Setting("Detour that one failure is worth", "M", 0.0, MOST_COST, "m", default="profile", group="Vehicle"),
    ] = None
    """m; None: the ``fail_weight`` of the vehicle profile, or 0 by time."""
    robust: Annotated[bool, Setting("Plan on the upper end of the interval of c_r", rare=True)] = False
    unknown: Annotated[
        float | None, Setting("Cross unknown ground at this cost per metre", "COST", 1.0, MOST_COST, group="Ground")
    ] = None
    seen_width: Annotated[
        float | None,
        Setting(
            "Refuse ground where objects of width M would not show", "M", 0.0, unit="m", group="Ground", exclusive=True
        ),
    ] = None
    """m; tiles whose ``smallest_object`` is more are closed, as are those of which that is not known; None: none is."""
    avoid: Annotated[Path | None, Setting("Polygons that are not entered (GeoJSON)", "FILE", group="Ground")] = None
    only: Annotated[Path | None, Setting("Polygons that are not left (GeoJSON)", "FILE", group="Ground")] = None
    allow_outside: Annotated[bool, Setting("It is no error if a polygon lies off the map", rare=True)] = False
    through_obstacles: Annotated[bool, Setting("Touch obstacles where there is no other way", group="Ground")] = False
    """For those that the map takes for solid and the driver does not."""

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True, slots=True)
class RouteConfig:
    """All settings of a ``route`` run."""

    layers: Path
    """The folder that ``bumpymap map`` wrote."""
    start: Annotated[
        str | None, Setting("Start: lon,lat or x,y in the survey's CRS", "POINT", option="from", group="Way")
    ] = None
    goal: Annotated[str | None, Setting("Goal", "POINT", option="to", group="Way")] = None
    via: Annotated[tuple[str, ...], Setting("Point to pass; may be given several times", "POINT", group="Way")] = ()
    points: Annotated[Path | None, Setting("Start, points and goal (GeoJSON, GPX, CSV)", "FILE", group="Way")] = None
    """Instead of the three above."""
    visit: Annotated[bool, Setting("Pass the points in the best order", group="Way")] = False
    """Start and goal keep their places (on a round trip, only the start)."""
    round_trip: Annotated[bool, Setting("Return to the start", option="return", group="Way")] = False
    snap: Annotated[float, Setting("Move points on closed ground by up to M", "M", 0.0, unit="m", group="Way")] = 0.0
    out: Annotated[Path | None, Setting("Folder, or a .geojson, .gpx or .csv file", "PATH", group="Output")] = None
    """Folder, or file of a format that its suffix names; None: only the summary."""
    overwrite: Annotated[bool, Setting("Replace the files of an earlier run", group="Output")] = False
    memory: Annotated[str, Setting("Memory of the search", "SIZE", default="a quarter of what is free", rare=True)] = (
        "auto"
    )
    """Such as ``1GB``; ``auto``: a quarter of what is free, 512 MB to 8 GB."""
    calibration: Annotated[Path | None, Setting("Calibration of the map, if it is not an included one", rare=True)] = (
        None
    )
    """For the ride of the line."""
    cost: CostSettings = field(default_factory=CostSettings)

    def __post_init__(self) -> None:
        check_settings(self)
        if not self.layers:
            raise UsageError("no layers given: name the folder that `bumpymap map` wrote")
        if (self.start is None) == (self.points is None):
            raise UsageError("give either the `start` or a file of `points`")
        if self.points is not None and (self.goal is not None or self.via):
            raise UsageError("the file of points holds start, points to pass and goal: leave out `goal` and `via`")
        memory_limit(self.memory)
        if self.points is None and self.goal is None and not self.via:
            raise UsageError("a way needs more than a start: add `goal`, `via` or a file of `points`")
