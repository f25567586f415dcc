"""Coordinates and figures of routes as their files hold them, and what the writers need of a map.

Coordinates are in the survey's CRS, and in WGS 84 longitude and latitude where that CRS is known.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import shapely
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Georeference, Route, RouteFigures, TileField
from bumpymap.layers.placement import Placement
from bumpymap.layers.vector import GeoJsonCoordinates
from bumpytiles import TileWindow

__all__ = [
    "P_ARRIVES_NOTE",
    "MapSource",
    "RouteCoordinates",
    "route_properties",
    "split_at_antimeridian",
    "window_around",
]

P_ARRIVES_NOTE = "errors of neighbouring tiles go together: an estimate"
_SMALL = 6
"""Decimals of shares, angles per metre and ratios; lengths and times have 3."""
_DECIMALS = {
    **dict.fromkeys(("length_m", "straight_m"), 3),
    "detour": _SMALL,
    "cost_m": 3,
    **dict.fromkeys(("c_r_mean", "c_r_mean_low", "c_r_mean_high", "c_r_max", "c_r_max_low", "c_r_max_high"), _SMALL),
    "p_arrives": _SMALL,
    "p_fail_max": _SMALL,
    **dict.fromkeys(("unknown_m", "obstacle_m", "climb_m", "descent_m", "seconds"), 3),
    "tight_turns_deg": 1,
}
"""Properties of `RouteFigures` and how many decimals of each are written."""


def route_properties(route: Route) -> dict[str, Any]:
    """Return name, vehicle and figures of a route; a number that is not known is None."""
    figures = {name: _number(route.figures, name, decimals) for name, decimals in _DECIMALS.items()}
    return {
        "name": route.name,
        "vehicle": route.vehicle.name,
        **figures,
        "p_arrives_note": P_ARRIVES_NOTE,
        "risk_m": round(route.risk_m, 3) if math.isfinite(route.risk_m) else None,
    }


def _number(figures: RouteFigures, name: str, decimals: int) -> float | None:
    value = float(getattr(figures, name))
    return round(value, decimals) if math.isfinite(value) else None


class MapSource(Protocol):
    """A map whose windows can be read."""

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders with its layers; none if it was made up."""
        ...

    @property
    def manifests(self) -> tuple[dict[str, Any], ...]:
        """The content of run.json in each folder."""
        ...

    def read(self, window: TileWindow, bands: Sequence[str] = ...) -> TileField:
        """Read the tiles of a window, which may extend beyond the map; bands that are not asked for are NaN."""
        ...

    def relief(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Read the heights of a window at the resolution of ``shape``, north row first, m; NaN where there is none."""
        ...


SEGMENT_M = 96.0
"""Longest straight segment of a line in longitude and latitude, m: its middle is then off by 1.2 mm at most, as for
the outlines of cost.geojson (see `lonlat`)."""
_DEGREE_DECIMALS = 7
_METRE_DECIMALS = 3


@dataclass(frozen=True, slots=True)
class RouteCoordinates:
    """Converts grid coordinates in metres to those that files hold."""

    georeference: Georeference
    files: GeoJsonCoordinates
    """Whether files hold longitude and latitude or the survey's own coordinates, and how the latter are declared."""

    @classmethod
    def of(cls, routes: Sequence[Route]) -> "RouteCoordinates":
        """Return the coordinates for files with these routes (at least one), which lie on one grid.

        A survey without a CRS, or with one that has no relation to longitude and latitude, keeps its own coordinates:
        it was mapped with ``local``.
        """
        first = routes[0]
        window = window_around(routes, 0.0)
        placement = Placement(first.georeference, first.grid, window)
        return cls(first.georeference, GeoJsonCoordinates.of(placement, local=True))

    @property
    def has_degrees(self) -> bool:
        """Whether longitude and latitude are known."""
        return self.files.to_degrees is not None

    def in_crs(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert (n, 2) easting and northing on the grid, m, to units of the survey's CRS."""
        return np.asarray(grid_m / self.georeference.metres_per_unit, dtype=np.float64)

    def in_file(self, grid_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert (n, 2) grid coordinates, m, to those of GeoJSON files.

        Returns
        -------
        array (n, 2)
            Longitude and latitude with 7 decimals (1 cm); units of the survey's CRS with 3 if those are not known.

        Raises
        ------
        BadInputError
            A point cannot be transformed to longitude and latitude.
        """
        own = self.in_crs(grid_m)
        if self.files.to_degrees is None:
            return own.round(_METRE_DECIMALS)
        degrees = np.column_stack(self.files.to_degrees.transform(own[:, 0], own[:, 1])).round(_DEGREE_DECIMALS)
        if not np.isfinite(degrees).all():
            raise BadInputError(
                "a route lies outside the area where the survey's CRS "
                f"({self.files.placement.horizontal_crs}) can be converted to longitude and latitude. Map the survey "
                "again with the right one, `force_crs='EPSG:CODE'`"
            )
        return degrees

    def line_in_file(self, grid_m: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Convert the corners of a line, (m, 2) on the grid in metres; a line that crosses the antimeridian is cut.

        Long segments get points in between, so that they stay straight on the ground.

        Returns
        -------
        list of array (n, 2)
            The parts of the line, n >= 2, in order.
        """
        if not self.has_degrees:
            return [self.in_file(grid_m)]
        if (grid_m == grid_m[0]).all():  # GEOS knows no line of length 0
            return [self.in_file(grid_m)]
        dense = shapely.get_coordinates(shapely.segmentize(shapely.linestrings(grid_m), SEGMENT_M))
        return split_at_antimeridian(self.in_file(dense))


def split_at_antimeridian(degrees: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Cut a line where it crosses the antimeridian (RFC 7946, 3.1.9).

    Parameters
    ----------
    degrees : array (n, 2)
        Longitude and latitude; a step of more than 180 degrees is a crossing.

    Returns
    -------
    list of array (m, 2)
        The parts in order, m >= 2; each crossing adds a point to both.
    """
    lon, lat = degrees.T
    before = np.flatnonzero(np.abs(np.diff(lon)) > 180.0)
    if not len(before):
        return [degrees]
    side = np.where(lon[before] > 0.0, 180.0, -180.0)
    to_border = side - lon[before]
    way = lon[before + 1] + 2.0 * side - lon[before]
    share = np.divide(to_border, way, out=np.zeros(len(before)), where=way != 0.0)
    crossing = (lat[before] + share * (lat[before + 1] - lat[before])).round(_DEGREE_DECIMALS)
    ends = np.column_stack([side, crossing])
    starts = np.column_stack([-side, crossing])
    cut = np.insert(degrees, np.repeat(before + 1, 2), np.stack([ends, starts], axis=1).reshape(-1, 2), axis=0)
    parts = np.split(cut, before + 2 + 2 * np.arange(len(before)))
    # A corner on the antimeridian itself gives a part of length 0, which is no line.
    return [part for part in parts if (part != part[0]).any()]


def window_around(routes: Sequence[Route], margin_m: float) -> TileWindow:
    """Return the tiles around lines and stops of routes, and ``margin_m`` metres around them."""
    points = np.concatenate([part for route in routes for part in (route.line, route.stops)])
    grid = routes[0].grid
    low, high = (grid.index(edge) for edge in (points.min(axis=0) - margin_m, points.max(axis=0) + margin_m))
    return TileWindow.around(np.array([low[0], high[0]]), np.array([low[1], high[1]]))
