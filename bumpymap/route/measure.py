"""The cost of a way: the exact integral over its tiles, and a profile of points at even distances.

A way may be long and its window large, so it is measured in stretches, each with a small window of its own.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Barred, RouteFigures, RouteProfile, TileField, TracedLine
from bumpymap.layers import MapReader
from bumpymap.route.ground import points_along, stretches, window_around
from bumpymap.route.places import in_window
from bumpymap.route.straighten import trace

__all__ = ["MeasuredWay", "measure_way", "way_cost"]

Floats = NDArray[np.float64]

_STRETCH_TILES = 128
"""Longest stretch, tiles."""
_SAMPLES_A_TILE = 3


@dataclass(frozen=True, slots=True)
class MeasuredWay:
    """Figures and profile of a way, and the tiles that it crosses."""

    figures: RouteFigures
    profile: RouteProfile
    tiles: NDArray[np.int64]
    """(n, 2) column and row of each tile in order, on the grid; a tile that is crossed twice is there twice."""


@dataclass(frozen=True, slots=True)
class _Pieces:
    """The pieces of a way inside single tiles; (n,) each."""

    col: NDArray[np.int64]
    row: NDArray[np.int64]
    length: Floats
    """m."""
    cost: Floats
    """Per metre."""
    c_r: Floats
    c_r_low: Floats
    c_r_high: Floats
    hazard: Floats
    """Per metre; 0 if unknown."""
    p_fail: Floats
    unknown: NDArray[np.bool_]


def measure_way(
    site: MapReader,
    line: Floats,
    stops: Floats,
    cost_of: Callable[[TileField], NDArray[np.float32]],
    *,
    obstacle_m: float = 0.0,
    tight_turns_deg: float = 0.0,
) -> MeasuredWay:
    """Measure a way over a map.

    Parameters
    ----------
    site : MapReader
        The map.
    line : array (m, 2)
        Easting and northing of the corners, m, on the grid.
    stops : array (k, 2)
        Easting and northing of start, stops and goal, m.
    cost_of : callable
        Returns the cost per metre of each tile of a window, inf where closed.
    obstacle_m : float
        Length on which the vehicle does not fit, m.
    tight_turns_deg : float
        Sum of the angles of turns beside obstacles, degrees.
    """
    pieces = _all_pieces(site, line, cost_of)
    profile = _profile(site, line, pieces)
    figures = replace(_figures(pieces, profile, stops, site), obstacle_m=obstacle_m, tight_turns_deg=tight_turns_deg)
    return MeasuredWay(figures, profile, np.column_stack([pieces.col, pieces.row]))


def way_cost(site: MapReader, line: Floats, cost_of: Callable[[TileField], NDArray[np.float32]]) -> float:
    """Return the cost of a way alone, m: ``figures.cost_m`` of `measure_way`."""
    pieces = _all_pieces(site, line, cost_of)
    return float((pieces.length * pieces.cost).sum())


def _all_pieces(site: MapReader, line: Floats, cost_of: Callable[[TileField], NDArray[np.float32]]) -> _Pieces:
    """Cut a way into pieces inside single tiles, stretch by stretch."""
    parts = [_pieces(site, part, cost_of) for part in stretches(line, site.grid.tile_size * _STRETCH_TILES)]
    return _Pieces(*(np.concatenate([getattr(part, name) for part in parts]) for name in _Pieces.__slots__))


def _pieces(site: MapReader, line: Floats, cost_of: Callable[[TileField], NDArray[np.float32]]) -> _Pieces:
    window = window_around(site, line, 1)
    tiles = site.read(window)
    cost = cost_of(tiles)
    place = in_window(line, site.grid, window)
    found = trace(cost, place)
    if not len(found.length):  # a way of no length lies in one tile
        row, col = np.floor(place[:1]).astype(np.int64).T
        found = TracedLine(row, col, np.zeros(1))
    at = found.row, found.col
    unknown = tiles.barred[at] == Barred.UNKNOWN
    hazard = tiles.rule.hazard(tiles.p_fail[at])
    return _Pieces(
        col=window.col + found.col,
        row=window.row + window.rows - 1 - found.row,
        length=found.length * site.grid.tile_size,
        cost=cost[at].astype(np.float64),
        c_r=np.where(unknown, np.nan, tiles.c_r[at]),
        c_r_low=np.where(unknown, np.nan, tiles.c_r_low[at]),
        c_r_high=np.where(unknown, np.nan, tiles.c_r_high[at]),
        hazard=np.where(unknown | np.isnan(hazard), 0.0, hazard),
        p_fail=np.where(unknown, np.nan, tiles.p_fail[at]),
        unknown=unknown,
    )


def _figures(pieces: _Pieces, profile: RouteProfile, stops: Floats, site: MapReader) -> RouteFigures:
    known = np.isfinite(pieces.c_r)
    weight = pieces.length * known
    total = float(weight.sum())

    def mean(values: Floats) -> float:
        return float((weight * np.nan_to_num(values)).sum() / total) if total > 0 else math.nan

    worst = int(np.argmax(np.where(known, pieces.c_r, -1.0))) if known.any() else None
    at_worst = (
        [math.nan] * 3 if worst is None else [float(x[worst]) for x in (pieces.c_r, pieces.c_r_low, pieces.c_r_high)]
    )
    length = float(pieces.length.sum())
    climb, descent = _climb(profile, site.grid.tile_size)
    return RouteFigures(
        length_m=length,
        straight_m=float(np.hypot(*np.diff(stops, axis=0).T).sum()),
        cost_m=float((pieces.length * pieces.cost).sum()),
        c_r_mean=mean(pieces.c_r),
        c_r_mean_low=mean(pieces.c_r_low),
        c_r_mean_high=mean(pieces.c_r_high),
        c_r_max=at_worst[0],
        c_r_max_low=at_worst[1],
        c_r_max_high=at_worst[2],
        hazard=float((pieces.length * pieces.hazard).sum()),
        p_fail_max=float(np.nanmax(pieces.p_fail)) if np.isfinite(pieces.p_fail).any() else math.nan,
        unknown_m=float(pieces.length[pieces.unknown].sum()),
        obstacle_m=0.0,
        tight_turns_deg=0.0,
        climb_m=climb,
        descent_m=descent,
        seconds=length / site.vehicle.speed_mps,
    )


def _climb(profile: RouteProfile, tile_size: float) -> tuple[float, float]:
    """Return metres up and metres down between points a tile apart; heights of gaps are interpolated."""
    known = np.isfinite(profile.z)
    if known.sum() < 2:
        return 0.0, 0.0
    length = float(profile.distance[-1])
    apart = np.linspace(0.0, length, max(2, round(length / tile_size) + 1))
    rise = np.diff(np.interp(apart, profile.distance[known], profile.z[known]))
    return float(rise[rise > 0].sum()), float(np.abs(rise[rise < 0]).sum())


def _profile(site: MapReader, line: Floats, pieces: _Pieces) -> RouteProfile:
    """Return points at even distances along a way."""
    length, size = np.cumsum(np.hypot(*np.diff(line, axis=0).T))[-1], site.grid.tile_size
    count = max(2, math.ceil(length / size * _SAMPLES_A_TILE) + 1)
    distance = np.linspace(0.0, length, count)
    points = points_along(line, distance)
    ends = np.cumsum(pieces.length)
    piece = np.minimum(np.searchsorted(ends, distance, side="left"), len(ends) - 1)
    spent = np.concatenate([[0.0], np.cumsum(pieces.length * pieces.cost)])
    z = _heights(site, points)
    return RouteProfile(
        distance=distance,
        easting=points[:, 0],
        northing=points[:, 1],
        z=z,
        slope=_slope(distance, z, size),
        c_r=pieces.c_r[piece],
        c_r_low=pieces.c_r_low[piece],
        c_r_high=pieces.c_r_high[piece],
        p_fail=pieces.p_fail[piece],
        cost=np.interp(distance, np.concatenate([[0.0], ends]), spent),
        obstacle=np.zeros(count, np.bool_),
    )


def _heights(site: MapReader, points: Floats) -> Floats:
    """Return the mean height of the pixels within half a metre of each point, or of its pixel alone; NaN if unknown."""
    out = np.full(len(points), np.nan)
    pixels = site.grid.pixels
    reach = pixels // (2 * _SAMPLES_A_TILE)
    around = np.arange(-reach, reach + 1)
    for some in np.array_split(np.arange(len(points)), max(1, len(points) // (_STRETCH_TILES * _SAMPLES_A_TILE))):
        window = window_around(site, points[some], 1)
        heights = site.heights(window)
        place = np.floor(in_window(points[some], site.grid, window) * pixels).astype(np.int64)
        rows = place[:, 0, None, None] + around[:, None]
        cols = place[:, 1, None, None] + around
        z = heights[rows, cols].reshape(len(some), -1).astype(np.float64)
        known = np.isfinite(z)
        count = known.sum(axis=1)
        out[some] = np.where(count > 0, np.nansum(z, axis=1) / np.maximum(count, 1), np.nan)
    return out


def _slope(distance: Floats, z: Floats, span: float) -> Floats:
    """Return the slope along the way over ``span`` metres, degrees, positive uphill; NaN next to unknown heights."""
    if distance[-1] <= 0:
        return np.full(len(z), np.nan)
    low = np.maximum(distance - span / 2, 0.0)
    high = np.minimum(distance + span / 2, distance[-1])
    rise = np.interp(high, distance, z) - np.interp(low, distance, z)
    return np.asarray(np.degrees(np.arctan2(rise, high - low)))
