"""Export a map: choose the area, make everything in memory, write it at once."""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from bumpymap.core import BadInputError, ExportFormat, ExportResolution, UsageError
from bumpymap.layers.export.area import (
    DATUM_NAME,
    EXPORT_FILES,
    ExportArea,
    ExportPoint,
    check_target,
    choose_area,
    export_folder,
    write_json,
)
from bumpymap.layers.export.cost import write_pixel_cost
from bumpymap.layers.export.graph import SQUARES, make_graph, write_graph
from bumpymap.layers.export.gridmap import make_layers, require_rosbags, write_gridmap
from bumpymap.layers.export.nav2 import make_grids, write_nav2
from bumpymap.layers.export.plan import make_mission, read_route_line, write_plan
from bumpymap.layers.placement import check_extent
from bumpymap.layers.route_map import RouteMap

__all__ = ["Export", "ExportSettings", "export_map"]

_FORMAT, _VERSION = "bumpymap-export", 1

_Writer = Callable[[Path], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class ExportSettings:
    """What to export, and how."""

    to: ExportFormat = "nav2"
    around: tuple[float, float] | None = None
    """Easting and northing on the grid, m: export the tiles within ``radius`` to each side of it; else all."""
    radius: float = 100.0
    """m."""
    datum: tuple[float, float] | None = None
    """Easting and northing of the local frame's origin, m; else a corner of a tile near the middle."""
    resolution: ExportResolution = "tile"
    """``pixel`` (0.2 m) shows obstacles; nav2 and gridmap."""
    comfort: float = 0.3
    """nav2: most pitch motion for the speed mask, rad/s."""
    dearest: float | None = None
    """nav2: cost per metre of the highest value; else that of the dearest passable tile of the area."""
    every: int | None = None
    """graph: side of the largest squares of tiles with one node each: 1, 3, 9 or 27; else by the size of the area."""
    route: Path | None = None
    """plan: folder that ``bumpymap route`` wrote, or GeoJSON file of a route; else the first folder of the map."""
    through_obstacles: bool = False
    """plan: take a route that touches obstacles too."""

    def __post_init__(self) -> None:
        for name, allowed in (("to", get_args(ExportFormat)), ("resolution", get_args(ExportResolution))):
            if getattr(self, name) not in allowed:
                raise UsageError(f"`{name}` is {getattr(self, name)!r}; it must be one of {', '.join(allowed)}")
        for name, least in (("radius", 0.0), ("comfort", 0.0), ("dearest", 1.0)):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > least):
                raise UsageError(f"`{name}` is {value}; it must be a number greater than {least:g}")
        if self.every is not None and self.every not in SQUARES:
            raise UsageError(f"`every` is {self.every}; it must be one of {', '.join(map(str, SQUARES))}")
        for name in ("around", "datum"):
            place = getattr(self, name)
            if place is not None and not np.isfinite(place).all():
                raise UsageError(f"`{name}` is {place}; it must be two numbers, easting and northing in metres")


@dataclass(frozen=True, slots=True)
class Export:
    """What was written."""

    files: tuple[Path, ...]
    record: dict[str, Any]
    """The content of datum.json."""


def export_map(
    route_map: RouteMap, out: str | os.PathLike[str], settings: ExportSettings, *, overwrite: bool = False
) -> Export:
    """Write a map for robots to a folder: all files, or none.

    Parameters
    ----------
    route_map : RouteMap
        From `open_map`.
    out : path
        A folder of its own.
    settings : ExportSettings
    overwrite : bool
        Replace an earlier export in the same format.

    Raises
    ------
    BadInputError
        The map or the route cannot be read, the area does not touch the map, is too large, or holds nothing passable.
    OutputError
        The folder holds something that must not be replaced, or cannot be written.
    UsageError
        The extra ``ros`` is needed and not installed.
    """
    folder = Path(out)
    area = choose_area(
        route_map, _split(route_map, settings), _point(settings.around), settings.radius, _point(settings.datum)
    )
    if settings.to != "plan":
        check_extent(route_map.grid, area.window, "Export a part of it with `around='X,Y'` and `radius=1000`. ")
    record = {"format": _FORMAT, "version": _VERSION, "to": settings.to, **area.describe(), **_sources(route_map)}
    # The faults of what was given come first, but for those that take long to find.
    write = _plan(area, settings) if settings.to == "plan" else None
    check_target(folder, settings.to, overwrite=overwrite)
    write = write or _MAKERS[settings.to](area, settings)
    with export_folder(folder, settings.to, overwrite=overwrite) as staged:
        record |= write(staged)
        write_json(staged / DATUM_NAME, record)
    return Export(tuple(folder / name for name in EXPORT_FILES[settings.to]), record)


def _point(place: tuple[float, float] | None) -> ExportPoint | None:
    return None if place is None else ExportPoint(*map(float, place))


def _split(route_map: RouteMap, settings: ExportSettings) -> int:
    by_pixels = settings.resolution == "pixel" and settings.to in {"nav2", "gridmap"}
    return route_map.grid.pixels if by_pixels or settings.to == "cost" else 1


def _sources(route_map: RouteMap) -> dict[str, Any]:
    vehicle = route_map.vehicle
    return {
        "layers": [sheet.folder.resolve().name for sheet in route_map.sheets],
        "calibration": route_map.calibration_id,
        "vehicle": {"name": vehicle.name, "width_m": vehicle.width_m, "speed_m_per_s": vehicle.speed_mps},
    }


def _nav2(area: ExportArea, settings: ExportSettings) -> _Writer:
    grids = make_grids(area, settings.comfort, settings.dearest)
    return lambda folder: write_nav2(folder, area, grids)


def _gridmap(area: ExportArea, _: ExportSettings) -> _Writer:
    require_rosbags()
    layers = make_layers(area)
    return lambda folder: write_gridmap(folder, area, layers)


def _graph(area: ExportArea, settings: ExportSettings) -> _Writer:
    graph = make_graph(area, settings.every)
    return lambda folder: write_graph(folder, area, graph)


def _plan(area: ExportArea, settings: ExportSettings) -> _Writer:
    route = settings.route or area.route_map.sheets[0].folder
    path = route / "route.geojson" if route.is_dir() else route
    if not path.exists():
        raise BadInputError(
            f"there is no {path}. Plan a route first: `bumpymap route`, then pass the folder that it wrote with `route`"
        )
    line, touched = read_route_line(path, through_obstacles=settings.through_obstacles)
    mission = replace(make_mission(area.route_map, line), obstacle_m=touched)
    return lambda folder: write_plan(folder, mission)


_MAKERS: dict[str, Callable[[ExportArea, ExportSettings], _Writer]] = {
    "nav2": _nav2,
    "gridmap": _gridmap,
    "graph": _graph,
    "plan": _plan,
    "cost": lambda area, _: lambda folder: write_pixel_cost(folder, area),
}
