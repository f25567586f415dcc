"""Write profile.csv: what lies along routes, one row for each point of a profile."""

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Route, write_csv
from bumpymap.layers.route.coordinates import RouteCoordinates

__all__ = ["PROFILE_COLUMNS", "write_profile"]

PROFILE_COLUMNS = (
    *("route", "distance_m", "lon", "lat", "x", "y"),
    *("z_m", "slope_deg", "c_r", "c_r_low", "c_r_high", "p_fail", "cost_m"),
)
"""Columns of profile.csv; ``x`` and ``y`` are in units of the survey's CRS."""
_FORMATS = ("%.3f", "%.7f", "%.7f", "%.3f", "%.3f", "%.3f", "%.3f", "%.6f", "%.6f", "%.6f", "%.6f", "%.3f")


def write_profile(routes: Sequence[Route], path: Path) -> None:
    """Write the profiles of routes as CSV (RFC 4180, UTF-8); what is unknown is empty.

    Parameters
    ----------
    routes : sequence of Route
        At least one, all on one grid; the column ``route`` holds their names.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    place = RouteCoordinates.of(routes)
    write_csv(path, PROFILE_COLUMNS, (row for route in routes for row in _rows(route, place)))


def _rows(route: Route, place: RouteCoordinates) -> Iterator[tuple[str, ...]]:
    profile = route.profile
    grid_m = np.column_stack([profile.easting, profile.northing])
    degrees = place.in_file(grid_m) if place.has_degrees else np.full_like(grid_m, np.nan)
    columns = (
        *(profile.distance, *degrees.T, *place.in_crs(grid_m).T),
        *(profile.z, profile.slope, profile.c_r, profile.c_r_low, profile.c_r_high, profile.p_fail, profile.cost),
    )
    texts = [_texts(values, form) for values, form in zip(columns, _FORMATS, strict=True)]
    return zip([route.name] * len(profile.distance), *texts, strict=True)


def _texts(values: NDArray[np.float64], form: str) -> list[str]:
    return ["" if text in {"nan", "inf", "-inf"} else text for text in (form % value for value in values.tolist())]
