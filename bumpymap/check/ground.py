"""What a map says of the way of a drive, seen through the error of the positions.

A position is off by its error, so the drive may have been on the tile beside. Predictions are means over the places
where the vehicle may have been: a normal distribution, by 5 x 5 points of Gauss-Hermite quadrature for each step of the
way. The whole of a stretch is moved together, since errors of positions last longer than a stretch takes.
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
_LINE_SD = 0.22
"""ln c_r of one calibration drive over a tile scatters by this about the tile's: c_r is the mean over all lines and
headings. Median over the terrains of the Warthog's calibration; it falls with the root of the length."""
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
    """(25,) probability of each of these places."""


@dataclass(frozen=True, slots=True)
class MapReading:
    """What the map says of stretches, (n,) each; NaN where it says nothing."""

    c_r: Floats
    low: Floats
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
    return DriveSteps(cut.label[middle], way[keep], turned[keep], seconds[keep], tile, chance)


def read_along(steps: DriveSteps, stretches: int, field: TileField) -> MapReading:
    """Return what the map says of stretches: means along the way over the places where the vehicle may have been."""
    on = steps.label >= 0
    label, way, tile = steps.label[on], steps.way_m[on], steps.tile[on]
    c_r, down, up = _spreads(field)
    known = (tile >= 0) & np.isfinite(c_r[tile])
    passable = known & (field.barred.ravel()[tile] == Barred.NO)
    # The vehicle drove here, so it was not on barred ground beside; where the map bars all, it is wrong about that.
    use = np.where(passable.any(axis=1, keepdims=True), passable, known)
    nodes = len(steps.chance)
    group = label[:, None] * nodes + np.arange(nodes)
    sums, used_m, known_m = (
        np.bincount(group.ravel(), (way[:, None] * part).ravel(), minlength=stretches * nodes).reshape(-1, nodes)
        for part in (np.where(use, c_r[tile], 0.0), use, known)
    )
    all_m = np.bincount(label, way, minlength=stretches)[:, None]
    total = (steps.chance * (known_m > _LEAST_KNOWN * all_m)).sum(axis=1)
    chance = steps.chance * (used_m > _LEAST_KNOWN * used_m.max(axis=1, keepdims=True))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(chance > 0.0, np.log(sums / used_m), 0.0)
        chance = chance / chance.sum(axis=1, keepdims=True)
        log_mean = (chance * logs).sum(axis=1)
        mean = np.exp(log_mean)
        spread = mean * np.sqrt((chance * (logs - log_mean[:, None]) ** 2).sum(axis=1))
    mean[total < _LEAST_KNOWN] = np.nan
    weight = (way[:, None] * steps.chance)[use]
    stretch, tile = np.broadcast_to(label[:, None], tile.shape)[use], tile[use]
    ridden = weight * c_r[tile]
    level = np.maximum(np.bincount(stretch, ridden, minlength=stretches), 1e-12)
    line = (
        _LINE_SD * np.sqrt(field.rule.drive_m * np.bincount(stretch, ridden * c_r[tile], minlength=stretches)) / level
    )
    below, above = (
        np.hypot(
            line, _joint(stretch, tile, weight, part[tile] * c_r[tile], stretches) / _share(level, stretch, weight)
        )
        for part in (down, up)
    )
    return MapReading(mean, mean * np.exp(-_END_80 * below), mean * np.exp(_END_80 * above), spread)


def _share(level: Floats, stretch: Integers, weight: Floats) -> Floats:
    """Return the mean c_r of stretches from its weighted sums."""
    return np.asarray(level / np.maximum(np.bincount(stretch, weight, minlength=len(level)), 1e-12))


def _spreads(field: TileField) -> tuple[Floats, Floats, Floats]:
    """Return c_r of all tiles and the standard deviations of ln c_r downwards and upwards, by their intervals."""
    c_r, low, high = (part.ravel().astype(np.float64) for part in (field.c_r, field.c_r_low, field.c_r_high))
    with np.errstate(divide="ignore", invalid="ignore"):
        down, up = np.log(c_r / low) / _END_80, np.log(high / c_r) / _END_80
    down, up = (np.where(np.isfinite(part), np.maximum(part, 0.0), 0.0) for part in (down, up))
    return c_r, down, up


def _joint(stretch: Integers, tile: Integers, weight: Floats, sd: Floats, count: int) -> Floats:
    """Return the standard deviation of weighted means whose tiles have ``_SHARED`` of their variance in common."""
    total = np.maximum(np.bincount(stretch, weight, minlength=count), 1e-12)
    common = np.bincount(stretch, weight * sd, minlength=count) / total
    tiles = int(tile.max(initial=0)) + 1
    pair, place = np.unique(stretch * tiles + tile, return_inverse=True)
    own = np.bincount(place, weight * sd) ** 2
    alone = np.bincount(pair // tiles, own, minlength=count) / total**2
    return np.asarray(np.sqrt(_SHARED * common**2 + (1.0 - _SHARED) * alone))
