"""Settings of an export for robots: declared once, checked when they are created."""

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, Literal

from bumpymap.core import Setting, UsageError, check_settings

ExportFormat = Literal["nav2", "gridmap", "plan", "cost"]
"""Maps and masks for Nav2; a grid_map message; a mission for QGroundControl; cost on pixels."""
ExportResolution = Literal["pixel", "tile"]
"""One cell a pixel of the heightmap, or one a tile, which is closed if anything stands in it."""


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """Settings of an export."""

    to: Annotated[ExportFormat, Setting("Format; see above", "FORMAT", default="", group="Output")] = "nav2"
    around: tuple[float, float] | None = None
    """Easting and northing on the grid, m: export the tiles within ``radius`` to each side of it; else all."""
    radius: Annotated[
        float, Setting("How far around, to each side, m", "M", 0.0, unit="m", exclusive=True, group="Input")
    ] = 100.0
    datum: tuple[float, float] | None = None
    """Easting and northing of the local frame's origin, m; else a corner of a tile near the middle."""
    resolution: Annotated[
        ExportResolution, Setting("nav2, gridmap: a cell is a pixel or a tile", "SIZE", group="Output")
    ] = "pixel"
    max_cost: Annotated[
        float | None,
        Setting(
            "nav2: cost per metre of the highest value",
            "COST",
            1.0,
            exclusive=True,
            default="very rough ground",
            rare=True,
        ),
    ] = None
    """nav2: cost per metre of the highest value; else that of very rough ground for the vehicle."""
    route: Annotated[
        Path | None, Setting("plan: folder or GeoJSON of a route", "PATH", default="LAYERS", group="Input")
    ] = None
    """plan: folder that ``bumpymap route`` wrote, or GeoJSON file of a route; else the first folder of the map."""
    through_obstacles: Annotated[bool, Setting("plan: take a route that touches obstacles too", group="Input")] = False

    def __post_init__(self) -> None:
        check_settings(self)
        for name, place in (("around", self.around), ("datum", self.datum)):
            if place is not None and not all(map(isfinite, place)):
                raise UsageError(f"`{name}` is {place}; it must be two numbers, easting and northing in metres")
