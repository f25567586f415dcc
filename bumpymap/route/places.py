"""Points that a user names: longitude and latitude, or coordinates of the survey's CRS, as points on the map."""

import math
import re
from collections.abc import Sequence
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, UsageError, describe_crs, unit_name
from bumpymap.layers import MapReader
from bumpytiles import Grid, TileWindow

System = Literal["lonlat", "crs"]
Place: TypeAlias = Sequence[float] | NDArray[np.float64]
"""Easting and northing, m."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_POINT = re.compile(rf"\s*(?:(lonlat|crs)\s*:)?\s*({_NUMBER})\s*[,;\s]\s*({_NUMBER})\s*", re.IGNORECASE)
_FORMS = (
    "Give LON,LAT such as 11.5,48.1, or X,Y in the survey's CRS such as 434100,5411200; lonlat:11.5,48.1 and "
    "crs:434100,5411200 say which of the two it is"
)
_NEAR_M = 5000.0
"""Distance from the map up to which two numbers are thought to be swapped, m (chosen)."""


class GridPoint(NamedTuple):
    """A point on the grid of tiles."""

    easting: float
    """m."""
    northing: float
    """m."""


def parse_point(text: str, route_map: MapReader, *, beyond_m: float = 0.0) -> GridPoint:
    """Read a point: ``LON,LAT``, or ``X,Y`` in the survey's CRS, whichever lies on the map.

    ``lonlat:`` or ``crs:`` before it says which of the two it is; ``beyond_m``: distance outside the rectangle of the
    map up to which a point is accepted, m. Raises UsageError: the text is not a point; for others see `place_point`.
    """
    found = _POINT.fullmatch(text)
    if found is None:
        raise UsageError(f"'{text}' is not a point. {_FORMS}")
    system, x, y = found.groups()
    known: System | None = None if system is None else "crs" if system.lower() == "crs" else "lonlat"
    return place_point(float(x), float(y), route_map, known, name=f"the point {text.strip()}", beyond_m=beyond_m)


def place_point(
    x: float, y: float, route_map: MapReader, system: System | None, *, name: str, beyond_m: float
) -> GridPoint:
    """Return the point on the grid of a coordinate pair.

    ``x``, ``y``: longitude and latitude [degrees], or coordinates in the survey's CRS; ``system``: which of the two;
    None: the one that lies on the map; ``name``: how a message calls the point; ``beyond_m`` as of `parse_point`.
    Raises BadInputError: the point lies outside the map, could be meant in both ways, or is longitude and latitude
    while the map has no CRS.
    """
    systems: tuple[System, ...] = ("lonlat", "crs") if system is None else (system,)
    meant = {each: point for each in systems if (point := _on_grid(x, y, route_map, each, forced=system is not None))}
    inside = {each: point for each, point in meant.items() if _outside_m(point, route_map) <= beyond_m}
    if len(inside) == 1:
        return next(iter(inside.values()))
    if inside:
        raise BadInputError(
            f"{name} lies on the map both as longitude and latitude and in its CRS. Write lonlat:{x:.10g},{y:.10g} or "
            f"crs:{x:.10g},{y:.10g}"
        )
    swapped = [_on_grid(y, x, route_map, each, forced=False) for each in systems]
    hint = ""
    if any(point is not None and _outside_m(point, route_map) <= _NEAR_M for point in swapped):
        hint = f"Longitude comes before latitude, x (east) before y (north): did you mean {y:.10g},{x:.10g}? "
    raise BadInputError(f"{name} lies outside the map, which spans {extent_text(route_map)}. {hint}{_FORMS}")


def place_in_window(point: Place, grid: Grid, window: TileWindow) -> tuple[float, float]:
    """Convert easting and northing [m] to field coordinates of a window: tiles from its north and from its west edge.

    A point on a border lies in the tile to the north or east of it, as everywhere on the grid. Rows of a window count
    southwards, so there it is the last number before the border.
    """
    col, row = grid.index(np.array([point[0], point[1]], np.float64)).tolist()
    top, left = window.row + window.rows - 1 - row, col - window.col
    r, c = window.row + window.rows - point[1] / grid.tile_size, point[0] / grid.tile_size - window.col
    row_of, col_of = (min(max(float(x), tile), math.nextafter(tile + 1.0, tile)) for x, tile in ((r, top), (c, left)))
    return row_of, col_of


def in_window(points: NDArray[np.float64], grid: Grid, window: TileWindow) -> NDArray[np.float64]:
    """Convert easting and northing [m], (n, 2), to field coordinates of a window, (n, 2) tiles."""
    tiles = points / grid.tile_size
    return np.column_stack([window.row + window.rows - tiles[:, 1], tiles[:, 0] - window.col])


def on_grid(places: NDArray[np.float64], grid: Grid, window: TileWindow) -> NDArray[np.float64]:
    """Convert field coordinates of a window, (n, 2) tiles, to easting and northing, (n, 2) m."""
    return np.column_stack([window.col + places[:, 1], window.row + window.rows - places[:, 0]]) * grid.tile_size


def window_within(whole: TileWindow, start: NDArray[np.float64], reach: float) -> TileWindow:
    """Return the part of a map within a distance of a place, tiles east and north of the grid's origin."""
    west = max(whole.col, math.floor(start[0] - reach))
    south = max(whole.row, math.floor(start[1] - reach))
    east = min(whole.col + whole.cols, math.ceil(start[0] + reach) + 1)
    north = min(whole.row + whole.rows, math.ceil(start[1] + reach) + 1)
    return TileWindow(west, south, max(east - west, 1), max(north - south, 1))


def _on_grid(x: float, y: float, route_map: MapReader, system: System, *, forced: bool) -> GridPoint | None:
    """Return the point if it is one in that system, else None; without a CRS there is no longitude unless forced."""
    if not (math.isfinite(x) and math.isfinite(y)):
        return None
    if system == "crs":
        return GridPoint(*route_map.to_grid(x, y))
    if not (forced or route_map.has_crs) or abs(x) > 180.0 or abs(y) > 90.0:
        return None
    easting, northing = route_map.from_lonlat(x, y)
    return GridPoint(easting, northing) if math.isfinite(easting) and math.isfinite(northing) else None


def _outside_m(point: GridPoint, route_map: MapReader) -> float:
    """Return the distance of a point to the rectangle of the map, m; 0 inside. Its east and north sides are outside."""
    bounds = route_map.grid.window_bounds(route_map.window)
    if bounds.west <= point.easting < bounds.east and bounds.south <= point.northing < bounds.north:
        return 0.0
    easting = min(max(point.easting, bounds.west), bounds.east)
    northing = min(max(point.northing, bounds.south), bounds.north)
    return max(math.hypot(point.easting - easting, point.northing - northing), np.finfo(float).tiny)


def extent_text(route_map: MapReader) -> str:
    """Say what a map spans, in its CRS and in longitude and latitude, for messages."""
    bounds = route_map.grid.window_bounds(route_map.window)
    crs, unit = route_map.georeference.crs, route_map.georeference.metres_per_unit
    west, south, east, north = (side / unit for side in (bounds.west, bounds.south, bounds.east, bounds.north))
    system = "in local coordinates" if crs is None else f"in {describe_crs(crs.to_2d())}"
    if unit != 1.0:
        system += f" (unit: {unit_name(unit)}; lengths in options are metres)"
    text = f"x {west:.2f} to {east:.2f}, y {south:.2f} to {north:.2f} {system}"
    if crs is None:
        return text
    eastings, northings = np.meshgrid(
        np.linspace(bounds.west, bounds.east, 5), np.linspace(bounds.south, bounds.north, 5)
    )
    longitude, latitude = route_map.to_lonlat(eastings.ravel(), northings.ravel())
    return (
        f"{text}, or longitude {longitude.min():.6f} to {longitude.max():.6f}, latitude {latitude.min():.6f} to "
        f"{latitude.max():.6f}"
    )
