"""The way of a drive in stretches and tiles: the C_r that was measured on each, and what the map says of it.

C_r of a stretch is the mean absolute pitch rate over the mean speed. What the sensor reads at standstill is taken off
in power: mean absolute values of independent noise add as root mean squares do, exactly so where both are normal.

A position is off by its error, so the drive may have been on the tile beside. Predictions are means over the places
where the vehicle may have been: a normal distribution, by 5 x 5 points of Gauss-Hermite quadrature for each step of the
way. The whole of a stretch is moved together, since errors of positions last longer than a stretch takes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import ndtri

from bumpymap.check.measure import COUNTS, LEFT_OUT, DriveMeasure, WayStretch
from bumpymap.check.settings import LEAST_WINDOW_M
from bumpymap.check.signals import pieces
from bumpymap.core import NO_TILE, Barred, DrivenTiles, TileField

__all__ = [
    "DriveSteps",
    "MapReading",
    "cut_stretches",
    "drive_steps",
    "driven_tiles",
    "less_floor",
    "read_along",
    "reading_sd",
    "with_ground",
]

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

_BRIDGE_M = 1.0
"""Parts that do not count and are shorter do not end a stretch."""
_BRIDGE_S = 3.0
_SCALE_SHARE = 0.013
"""Error of the scale of a gyroscope, of its alignment and of the band, as a share of C_r."""
_FLOOR_SHARE = 0.15
"""Error of the floor: engine and sensor differ a little from stop to drive."""
_UNKNOWN_FLOOR_RADPS = 0.01
"""Error of the pitch rate where no standstill tells the floor."""


def cut_stretches(drive: DriveMeasure, window_m: float) -> WayStretch:
    """Cut the parts that count into stretches of about ``window_m``, and measure each.

    ``window_m``: a part is cut evenly into the whole number of stretches whose length comes nearest to this.
    """
    step = 1.0 / drive.hertz
    counts = drive.reason == COUNTS
    way = np.where(counts, np.abs(drive.speed) * step, 0.0)
    label = _labels(drive, way, counts, window_m)
    count = int(label.max(initial=-1)) + 1
    inside = label >= 0
    number, samples = label[inside], np.flatnonzero(inside)

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(number, values[inside], minlength=count), np.float64)

    if not count:
        nothing = np.zeros(0)
        return WayStretch(label, *[nothing] * 8)
    length, seconds = total(way), total(np.full(len(label), step))
    raw = total(np.abs(drive.pitch_rate) * step) / length
    first = samples[np.searchsorted(number, np.arange(count))]
    last = samples[np.searchsorted(number, np.arange(count), side="right") - 1]
    start, end = drive.time[first], drive.time[last] + step
    measured = less_floor(raw, drive.floor * seconds / length)
    relative = drive.track.way_sd(start, end) / length
    return WayStretch(
        label=label,
        start_s=start,
        end_s=end,
        way_m=length,
        speed_mps=length / seconds,
        measured=measured,
        measured_sd=np.hypot(reading_sd(drive, raw, measured, seconds, length), measured * relative),
        easting=total(drive.easting) / np.bincount(number, minlength=count),
        northing=total(drive.northing) / np.bincount(number, minlength=count),
    )


def less_floor(raw: Floats, floor: Floats) -> Floats:
    """Take a floor off in power; both rad/m."""
    return np.asarray(np.sqrt(np.maximum(raw**2 - floor**2, 0.0)))


def reading_sd(drive: DriveMeasure, raw: Floats, measured: Floats, seconds: Floats, way_m: Floats) -> Floats:
    """Return the standard error of C_r that the sensor leaves: its noise, its floor, its scale; rad/m.

    ``raw``, ``measured`` (n,): before and after the floor was taken off, rad/m; ``seconds``, ``way_m`` (n,): time and
    length that they rest on.
    """
    per_metre = drive.floor * seconds / way_m
    # noise of a normal distribution: its standard deviation is 1.25 times its mean absolute value
    noise = 1.2533 * drive.floor * np.sqrt(seconds / (2.0 * drive.band_hz)) / way_m
    sharp = np.maximum(measured, 0.3 * per_metre + 1e-6)
    off = _FLOOR_SHARE * per_metre**2 / sharp
    if np.isnan(drive.floor_radps):
        unknown = _UNKNOWN_FLOOR_RADPS * seconds / way_m
        off = 0.5 * unknown**2 / np.maximum(measured, unknown)
    return np.asarray(np.sqrt(noise**2 * (raw / sharp) ** 2 + off**2 + (_SCALE_SHARE * measured) ** 2))


def _labels(drive: DriveMeasure, way: Floats, counts: NDArray[np.bool_], window_m: float) -> Integers:
    """Return the number of the stretch of each sample, -1 where it belongs to none."""
    label = np.full(len(way), -1, np.int64)
    total = np.concatenate([[0.0], np.cumsum(way)])
    number = 0
    for part in _joined(drive, counts):
        length = total[part.stop] - total[part.start]
        cuts = max(round(length / window_m), 1)
        if length / cuts < LEAST_WINDOW_M:
            continue
        share = (total[part.start : part.stop] - total[part.start]) / length
        own = number + np.minimum((share * cuts).astype(np.int64), cuts - 1)
        label[part] = np.where(counts[part], own, -1)
        number += cuts
    return label


def _joined(drive: DriveMeasure, counts: NDArray[np.bool_]) -> list[slice]:
    """Return the parts that count, joined across short ones that do not."""
    parts = pieces(counts)
    if not parts:
        return []
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(drive.speed))]) / drive.hertz
    start = np.array([part.start for part in parts])
    stop = np.array([part.stop for part in parts])
    between = travelled[start[1:]] - travelled[stop[:-1]]
    apart = (between > _BRIDGE_M) | ((start[1:] - stop[:-1]) > _BRIDGE_S * drive.hertz)
    first = np.concatenate([[True], apart])
    last = np.concatenate([apart, [True]])
    return [slice(a, b) for a, b in zip(start[first].tolist(), stop[last].tolist(), strict=True)]


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
    """Values of the map over stretches, (n,) each; NaN where it has none."""

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
    mean_c_r = level / np.maximum(np.bincount(stretch, weight, minlength=stretches), 1e-12)
    below, above = (
        np.hypot(line, _joint(stretch, tile, weight, part[tile] * c_r[tile], stretches) / mean_c_r)
        for part in (down, up)
    )
    return MapReading(mean, mean * np.exp(-_END_80 * below), mean * np.exp(_END_80 * above), spread)


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


_LEAST_WAY_M = 1.0
"""Tiles with less of the way are left out."""
_NEAR_STEPS = 12
"""Steps that make up the way over a tile: the scale on which its neighbours differ."""


def driven_tiles(
    drives: Sequence[tuple[DriveMeasure, DriveSteps, float]], field: TileField, limits: tuple[float, ...]
) -> DrivenTiles:
    """Return C_r of each tile of all drives together; of each drive, also the error of its lengths as a share.

    ``limits``: of the classes, rad/m.
    """
    count = field.barred.size
    sums, moments = np.zeros((4, count)), np.zeros((3, count))
    for drive, steps, length_share in drives:
        # Not on barred ground, unless all of it is.
        is_open = (steps.tile >= 0) & (field.barred.ravel()[steps.tile] == Barred.NO)
        likely = np.where(is_open.any(axis=1, keepdims=True), is_open, True) * steps.chance
        likely /= likely.sum(axis=1, keepdims=True)
        weight = likely * (steps.tile >= 0)
        turned, near_m, seconds = (
            uniform_filter1d(part, _NEAR_STEPS, mode="nearest") for part in (steps.turned, steps.way_m, steps.seconds)
        )
        near_m = np.maximum(near_m, 1e-9)
        near, pace = turned / near_m, seconds / near_m  # C_r over about the length of a tile, and seconds per metre
        sd = reading_sd(drive, near, less_floor(near, drive.floor * pace), pace, np.ones_like(near))
        variance = sd**2 + (length_share * near) ** 2
        whole = (steps.turned, steps.way_m, variance * steps.way_m, drive.floor * steps.seconds)
        sums += [_over_tiles(steps, values[:, None] * weight, count) for values in whole]
        way = steps.way_m[:, None] * weight
        parts = (near[:, None] * way, near[:, None] ** 2 * way, _certain(steps, likely) * way)
        moments += [_over_tiles(steps, part, count) for part in parts]
    found = np.flatnonzero((sums[1] >= _LEAST_WAY_M) & np.isfinite(field.c_r.ravel()))
    turned, way, variance, floor = sums[:, found]
    mean, square, certain = moments[:, found] / way
    mixed = (1.0 - np.clip(certain, 0.0, 1.0)) * np.maximum(square - mean**2, 0.0)
    measured = less_floor(turned / way, floor / way)
    row, col = np.divmod(found, field.window.cols)
    c_r, low, high = (part.ravel()[found].astype(np.float64) for part in (field.c_r, field.c_r_low, field.c_r_high))
    return DrivenTiles(
        col=col + field.window.col,
        row=field.window.row + field.window.rows - 1 - row,
        way_m=way,
        measured=measured,
        measured_sd=np.sqrt(variance / way + mixed),
        c_r=c_r,
        c_r_low=low,
        c_r_high=high,
        class_id=np.digitize(c_r, limits).astype(np.uint8),
    )


def _certain(steps: DriveSteps, likely: Floats) -> Floats:
    """Return the probability that a step lies on the tile of each of its places, (s, 25)."""
    order = np.argsort(steps.tile, axis=1, kind="stable")
    tile = np.take_along_axis(steps.tile, order, axis=1)
    chance = np.take_along_axis(likely, order, axis=1)
    new = np.concatenate([np.ones((len(tile), 1), np.bool_), tile[:, 1:] != tile[:, :-1]], axis=1)
    group = np.cumsum(new.ravel()) - 1
    each = np.bincount(group, chance.ravel())[group].reshape(tile.shape)
    out: Floats = np.empty(each.shape)
    np.put_along_axis(out, order, each, axis=1)
    return out


def _over_tiles(steps: DriveSteps, values: Floats, count: int) -> Floats:
    """Sum values (s, 25) by tile."""
    return np.asarray(np.bincount(np.maximum(steps.tile, 0).ravel(), values.ravel(), minlength=count), np.float64)
