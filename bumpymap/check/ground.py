"""What a map says of the way of a drive, seen through the error of the positions.

A position is off by its error, so the drive may have been on the tile beside. Predictions are means over the places where
the vehicle may have been: a normal distribution, by 5 x 5 points of Gauss-Hermite quadrature for each step of the way. The
whole of a stretch is moved together, since errors of positions last longer than a stretch takes. A vehicle that drove was
hardly on ground that the map bars: such places count less.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from bumpymap.check.drive_measure import COUNTS, LEFT_OUT, DriveMeasure, WayStretch
from bumpymap.core import NO_TILE, Barred, TileField

__all__ = ["DriveSteps", "MapReading", "drive_steps", "read_along", "with_ground"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_STEP_M = 0.25
_END_80 = float(ndtri(0.9))
"""An end of an 80 % interval, in standard deviations."""
_SHARED = 0.5
"""Share of the variance of a tile's interval that its neighbours on the way have in common."""
_BARRED_M = 2.0
"""A place counts e times less for each such length of a stretch that would lie on barred ground."""
_LEAST_CHANCE = 1e-4
_BARRED_WEIGHT = 0.02
"""Barred ground beside the way is often ten times as rough: what of it is left in a mean counts this much."""
_PASS_SPREAD = 0.4
"""One pass over one tile scatters about the mean of all passes over it by this much in ln c_r; longer ways by less."""
_LEAST_KNOWN = 0.5
"""With less of the places known, a stretch has no prediction."""


@dataclass(frozen=True, slots=True)
class DriveSteps:
    """The parts of a drive that count, in steps of a quarter of a metre or so, and the tiles that they may lie on."""

    label: Integers
    """(s,) stretch of each step; -1: none."""
    way_m: Floats
    """(s,) m."""
    turned: Floats
    """(s,) absolute pitch motion, rad."""
    seconds: Floats
    """(s,)"""
    tile: Integers
    """(s, 25) number of the tile, row by row in the window, for each place where the step may be; -1: outside."""
    chance: Floats
    """(s, 25) probability of each of these places."""
    open: Floats
    """(s, 25) 1 on ground that the map lets the vehicle on, ``_BARRED_WEIGHT`` elsewhere."""


@dataclass(frozen=True, slots=True)
class MapReading:
    """What the map says of stretches, (n,) each; NaN where it says nothing."""

    c_r: Floats
    low: Floats
    """Lower end of the 80 % interval of one pass: that of the map, and how one pass differs from the mean of all."""
    high: Floats
    place_sd: Floats
    """Standard deviation of ``c_r`` over the places where the vehicle may have been, rad/m."""


def tile_numbers(field: TileField, easting: Floats, northing: Floats) -> Integers:
    """Return the numbers of tiles, row by row in the window from the north-west, -1 outside of it; m on the grid."""
    size, window = field.grid.tile_size, field.window
    col = np.floor(easting / size).astype(np.int64) - window.col
    row = window.row + window.rows - 1 - np.floor(northing / size).astype(np.int64)
    inside = (col >= 0) & (col < window.cols) & (row >= 0) & (row < window.rows)
    return np.where(inside, row * window.cols + col, -1)


def with_ground(drive: DriveMeasure, field: TileField) -> DriveMeasure:
    """Leave out what lies off the map or on unknown ground."""
    tile = tile_numbers(field, drive.easting, drive.northing)
    reason = drive.reason.copy()
    counts = reason == COUNTS
    reason[counts & ~np.isfinite(field.c_r.ravel()[tile])] = LEFT_OUT.index("unknown ground")
    reason[counts & ((tile < 0) | (field.barred.ravel()[tile] == NO_TILE))] = LEFT_OUT.index("off the map")
    return replace(drive, reason=reason)


def drive_steps(drive: DriveMeasure, cut: WayStretch, field: TileField) -> DriveSteps:
    """Cut the way into short steps and find the tiles that each may lie on."""
    count = len(drive.time)
    usual = float(np.median(np.abs(drive.speed[drive.reason == COUNTS]))) if (drive.reason == COUNTS).any() else 1.0
    every = max(round(_STEP_M * drive.hertz / max(usual, 0.05)), 1)
    first = np.arange(0, count, every)
    middle = np.minimum(first + every // 2, count - 1)
    counts = (drive.reason == COUNTS) / drive.hertz
    way, turned, seconds = (
        np.add.reduceat(values * counts, first)
        for values in (np.abs(drive.speed), np.abs(drive.pitch_rate), np.ones(count))
    )
    keep = way > 0.0
    middle = middle[keep]
    node, weight = np.polynomial.hermite_e.hermegauss(5)
    east, north = (part.ravel() for part in np.meshgrid(node, node))
    chance = np.outer(weight, weight).ravel() / weight.sum() ** 2
    sd = drive.track.place_sd(drive.time[middle])
    tile = tile_numbers(
        field, drive.easting[middle, None] + sd[:, None] * east, drive.northing[middle, None] + sd[:, None] * north
    )
    label, way = cut.label[middle], way[keep]
    barred = (field.barred.ravel()[tile] != Barred.NO) | (tile < 0)
    likely = _likely(label, way, barred, len(cut.start_s)) * chance
    return DriveSteps(
        label=label,
        way_m=way,
        turned=turned[keep],
        seconds=seconds[keep],
        tile=tile,
        chance=likely / likely.sum(axis=1, keepdims=True),
        open=np.where(barred, _BARRED_WEIGHT, 1.0),
    )


def _likely(label: Integers, way: Floats, barred: NDArray[np.bool_], stretches: int) -> Floats:
    """Return how far the ground lets a step be at each of its places, (s, 25): by the barred length of its stretch."""
    nodes = barred.shape[1]
    group = np.maximum(label, 0)[:, None] * nodes + np.arange(nodes)
    length = np.bincount(group.ravel(), (barred * way[:, None] * (label >= 0)[:, None]).ravel(), stretches * nodes)
    factor = np.exp(-length / _BARRED_M).reshape(stretches, nodes) + _LEAST_CHANCE
    return np.where((label >= 0)[:, None], factor[np.maximum(label, 0)], 1.0)


def read_along(steps: DriveSteps, stretches: int, field: TileField) -> MapReading:
    """Return what the map says of stretches: means along the way over the places where the vehicle may have been."""
    on = steps.label >= 0
    label, way, tile = steps.label[on], steps.way_m[on], steps.tile[on]
    places = np.zeros((stretches, tile.shape[1]))
    places[label] = steps.chance[on]
    c_r, down, up = _spreads(field)
    known = (tile >= 0) & np.isfinite(c_r[tile])
    value = np.where(known, c_r[tile], 0.0)
    nodes = tile.shape[1]
    group = label[:, None] * nodes + np.arange(nodes)
    weight = way[:, None] * steps.open[on] * known
    sums, known_m = (
        np.bincount(group.ravel(), part.ravel(), minlength=stretches * nodes).reshape(stretches, nodes)
        for part in (weight * value, weight)
    )
    all_m = np.bincount(label, way, minlength=stretches)
    seen_m = np.bincount(group.ravel(), (way[:, None] * known).ravel(), minlength=stretches * nodes)
    chance = places * (seen_m.reshape(stretches, nodes) > _LEAST_KNOWN * all_m[:, None])
    total = chance.sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        each = np.where(chance > 0.0, sums / known_m, 0.0)
        mean = (chance * each).sum(axis=1) / total
        spread = np.sqrt((chance * (each - mean[:, None]) ** 2).sum(axis=1) / total)
    mean[total < _LEAST_KNOWN] = np.nan
    share = weight * steps.chance[on]
    stretch = np.broadcast_to(label[:, None], tile.shape)[known]
    one_pass = _PASS_SPREAD * np.sqrt(field.grid.tile_size / np.maximum(all_m, 1e-9))
    below, above = (
        np.hypot(
            _joint(stretch, tile[known], share[known], part[tile[known]] * value[known], stretches) / mean, one_pass
        )
        for part in (down, up)
    )
    return MapReading(mean, mean * np.exp(-_END_80 * below), mean * np.exp(_END_80 * above), spread)


def _spreads(field: TileField) -> tuple[Floats, Floats, Floats]:
    """Return c_r of all tiles and the standard deviations of ln c_r downwards and upwards, by their intervals."""
    c_r, low, high = (part.ravel().astype(np.float64) for part in (field.c_r, field.c_r_low, field.c_r_high))
    with np.errstate(divide="ignore", invalid="ignore"):
        down, up = np.log(c_r / low) / _END_80, np.log(high / c_r) / _END_80
    return c_r, *(np.where(np.isfinite(part), np.maximum(part, 0.0), 0.0) for part in (down, up))


def _joint(stretch: Integers, tile: Integers, weight: Floats, sd: Floats, count: int) -> Floats:
    """Return the standard deviation of weighted means whose tiles have ``_SHARED`` of their variance in common."""
    total = np.maximum(np.bincount(stretch, weight, minlength=count), 1e-12)
    common = np.bincount(stretch, weight * sd, minlength=count) / total
    tiles = int(tile.max(initial=0)) + 1
    pair, place = np.unique(stretch * tiles + tile, return_inverse=True)
    own = np.bincount(place, weight * sd) ** 2
    alone = np.bincount(pair // tiles, own, minlength=count) / total**2
    return np.sqrt(_SHARED * common**2 + (1.0 - _SHARED) * alone)
