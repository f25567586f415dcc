"""The way of a drive in stretches: the C_r that was measured on each, and what the map says of it.

C_r of a stretch is the mean absolute pitch rate over the mean speed. What the sensor reads at standstill is taken off
in power: mean absolute values of independent noise add as root mean squares do, exactly so where both are normal.

A position is off by its error, so the drive may have been on the tile beside. Predictions are means over the places
where the vehicle may have been: a normal distribution, by 5 x 5 points of Gauss-Hermite quadrature for each step of the
way. The whole of a stretch is moved together, since errors of positions last longer than a stretch takes.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.inertial import pieces
from bumpymap.check.measure import COUNTS, LEFT_OUT, DriveMeasure
from bumpymap.check.places import window_around
from bumpymap.core import (
    LEAST_WINDOW_M,
    NO_CLASS,
    NO_TILE,
    NORMAL_80,
    Barred,
    DrivenStretches,
    Floats,
    TileField,
    interval_log_sd,
)
from bumpymap.layers import MapReader
from bumpymap.rating import less_floor
from bumpymap.route import LineRide, LineVehicle, points_along, ride_line

Integers = NDArray[np.int64]

_BRIDGE_M, _BRIDGE_S = 1.0, 3.0
"""Parts that do not count and are shorter, m and s, do not end a stretch (chosen)."""
_SCALE_SHARE = 0.013
"""Error of the scale of a gyroscope, of its alignment and of the band, as a share of C_r."""
_FLOOR_SHARE = 0.15
"""Error of the floor as a share of it (chosen): engine and sensor differ a little from stop to drive."""
_UNKNOWN_FLOOR_RADPS = 0.01
"""Error of the pitch rate without a standstill to measure the floor at, rad/s (chosen)."""


def cut_stretches(drive: DriveMeasure, window_m: float) -> tuple[Integers, DrivenStretches]:
    """Cut the parts that count into stretches of about ``window_m``, and measure each.

    ``window_m``: a part is cut evenly into the whole number of stretches whose length comes nearest to this. Returns
    (samples,) the number of the stretch of each, -1 where it belongs to none; and the stretches, on no map so far.
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

    length, seconds = total(way), total(np.full(len(label), step))
    raw = total(np.abs(drive.pitch_rate) * step) / length
    first = samples[np.searchsorted(number, np.arange(count))]
    last = samples[np.searchsorted(number, np.arange(count), side="right") - 1]
    start, end = drive.time[first], drive.time[last] + step
    measured = less_floor(raw, drive.floor * seconds / length)
    relative = drive.track.way_sd(start, end) / length
    nothing, no_class = np.full(count, np.nan), np.full(count, NO_CLASS, np.uint8)
    return label, DrivenStretches(
        drive=np.zeros(count, np.int64),
        start_s=start,
        end_s=end,
        way_m=length,
        speed_mps=length / seconds,
        measured=measured,
        measured_sd=np.hypot(reading_sd(drive, raw, measured, seconds, length), measured * relative),
        easting=total(drive.easting) / np.bincount(number, minlength=count),
        northing=total(drive.northing) / np.bincount(number, minlength=count),
        c_r=nothing,
        c_r_low=nothing,
        c_r_high=nothing,
        place_sd=nothing,
        class_id=no_class,
        measured_class=no_class,
    )


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
"""Length of the steps that a way is read in, m (chosen)."""
_SHARED = 0.5
"""Share of the variance of a tile's interval that its neighbours on the way have in common (chosen)."""
_LINE_SD = 0.22
"""ln c_r of one calibration drive over a tile scatters by this about the tile's: c_r is the mean over all lines and
headings. Median over the terrains of the Warthog's calibration; it falls with the root of the length."""
_LEAST_KNOWN = 0.5
"""Share of the places known below which a stretch has no prediction (chosen)."""


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


def read_along(drive: DriveMeasure, label: Integers, cut: DrivenStretches, field: TileField) -> DrivenStretches:
    """Add what the map says to stretches: means along the way over the places where the vehicle may have been."""
    count = len(cut.start_s)
    node, weights = np.polynomial.hermite_e.hermegauss(5)
    stretch, way, tile = _steps(drive, label, field, node)
    places = np.outer(weights, weights).ravel() / weights.sum() ** 2  # their probabilities
    c_r, low, high = (part.ravel().astype(np.float64) for part in (field.c_r, field.c_r_low, field.c_r_high))
    down, up = np.nan_to_num(interval_log_sd(c_r, low, high, field.rule.drive_log_sd))
    known = (tile >= 0) & np.isfinite(c_r[tile])
    passable = known & (field.barred.ravel()[tile] == Barred.NO)
    # The vehicle drove here, so it was not on barred ground beside; where the map bars all, it is wrong about that.
    use = np.where(passable.any(axis=1, keepdims=True), passable, known)
    nodes = len(places)
    group = stretch[:, None] * nodes + np.arange(nodes)
    sums, used_m, known_m = (
        np.asarray(np.bincount(group.ravel(), (way[:, None] * part).ravel(), count * nodes), np.float64).reshape(
            -1, nodes
        )
        for part in (np.where(use, c_r[tile], 0.0), use, known)
    )
    all_m = np.bincount(stretch, way, minlength=count)[:, None]
    total = (places * (known_m > _LEAST_KNOWN * all_m)).sum(axis=1)
    chance = places * (used_m > _LEAST_KNOWN * used_m.max(axis=1, keepdims=True))
    mean, spread = _over_places(chance, sums, used_m, 1)
    mean[total < _LEAST_KNOWN] = np.nan
    weight = (way[:, None] * places)[use]
    stretch, tile = np.broadcast_to(stretch[:, None], tile.shape)[use], tile[use]
    ridden = weight * c_r[tile]
    level = np.maximum(np.bincount(stretch, ridden, minlength=count), 1e-12)
    line = _LINE_SD * np.sqrt(field.rule.drive_m * np.bincount(stretch, ridden * c_r[tile], minlength=count)) / level
    mean_c_r = level / np.maximum(np.bincount(stretch, weight, minlength=count), 1e-12)
    below, above = (
        np.hypot(line, _joint(stretch, tile, weight, part[tile] * c_r[tile], count) / mean_c_r) for part in (down, up)
    )
    low, high = mean * np.exp(-NORMAL_80 * below), mean * np.exp(NORMAL_80 * above)
    return replace(cut, c_r=mean, c_r_low=low, c_r_high=high, place_sd=spread)


def _over_places(chance: Floats, sums: Floats, metres: Floats, axes: int | tuple[int, int]) -> tuple[Floats, Floats]:
    """Return the geometric mean over some axes of ``sums / metres`` by their ``chance``, and its standard deviation."""
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.where(chance > 0.0, np.log(sums / metres), 0.0)
        chance = chance / chance.sum(axis=axes, keepdims=True)
        log_mean = (chance * logs).sum(axis=axes, keepdims=True)
        mean = np.exp(log_mean)
        spread = mean * np.sqrt((chance * (logs - log_mean) ** 2).sum(axis=axes, keepdims=True))
    return mean.squeeze(axes), spread.squeeze(axes)


def _passage(site: MapReader, line: Floats, ride: LineRide) -> NDArray[np.bool_]:
    """Return where the middle of the vehicle can be at each place across a line, (k, n), metre by metre."""
    from_, to = (points_along(line, ride.distance[side]) for side in (slice(None, -1), slice(1, None)))
    ahead = (to - from_) @ (1, 1j)
    place = (from_ + to) @ (0.5, 0.5j) + 1j * ahead / np.maximum(np.abs(ahead), 1e-9) * ride.across[:, None]
    window = window_around(site, place.real.ravel(), place.imag.ravel(), 0.0)
    pixel = site.grid.pixel_size
    col = np.floor(place.real / pixel).astype(np.int64) - window.col * site.grid.pixels
    row = (window.row + window.rows) * site.grid.pixels - 1 - np.floor(place.imag / pixel).astype(np.int64)
    passage = site.passage(window)
    inside = (row >= 0) & (col >= 0) & (row < passage.shape[0]) & (col < passage.shape[1])
    return np.asarray(inside & passage[np.where(inside, row, 0), np.where(inside, col, 0)])


_AROUND_M = 5.0
"""Length of the line before the first stretch and behind the last, m (chosen)."""
_LEAST_SIGMA_M = 0.05
"""Least error of positions that the line is rolled with, m (chosen)."""


def read_line(
    drive: DriveMeasure, label: Integers, cut: DrivenStretches, site: MapReader, vehicle: LineVehicle
) -> DrivenStretches:
    """Add what the map says of the driven line of stretches itself: the vehicle rolled along it over the pixels.

    It is rolled at several places across, and each stretch is shifted along the line, as far as positions are off.
    """
    travelled, counts = np.cumsum(np.abs(drive.speed)) / drive.hertz, np.flatnonzero(label >= 0)
    first, last = travelled[counts[[0, -1]]] + (-_AROUND_M, _AROUND_M)
    at = np.arange(max(first, 0.0), min(last, travelled[-1]), _STEP_M)
    line = np.column_stack([np.interp(at, travelled, axis) for axis in (drive.easting, drive.northing)])
    sd = np.maximum(drive.track.place_sd(0.5 * (cut.start_s + cut.end_s)), _LEAST_SIGMA_M)
    ride = ride_line(site, line, vehicle, float(np.median(sd)))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(line, axis=0).T))])
    ends = [np.interp(np.interp(time, drive.time, travelled), at, along) for time in (cut.start_s, cut.end_s)]
    node, shares = np.polynomial.hermite_e.hermegauss(3)

    def total(values: Floats, shift: Floats) -> Floats:
        """Add up values of each metre over the stretches."""
        sums = np.concatenate([[0.0], np.cumsum(values * np.diff(ride.distance))])
        start, end = (np.interp(edge + shift, ride.distance, sums) for edge in ends)
        return np.asarray(end - start)

    # The vehicle drove here, so it was not where it cannot be; where the map bars all, it is wrong about that.
    can_be = _passage(site, line, ride)
    known = np.isfinite(ride.c_r_across) & (can_be | ~can_be.any(axis=0))
    shifts = node[:, None] * sd
    metres = np.array([total(part, shifts) for part in known.astype(np.float64)])
    sums = np.array([total(np.where(part, c_r, 0.0), shifts) for part, c_r in zip(known, ride.c_r_across, strict=True)])
    chance = ride.weights[:, None, None] * (shares / shares.sum())[:, None] * (metres > _LEAST_KNOWN * cut.way_m)
    mean, spread = _over_places(chance, sums, metres, (0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        c_r, log_sd = np.nan_to_num(ride.c_r), np.nan_to_num(ride.log_sd)
        level = total(c_r, np.zeros(1))
        by_tile = total((c_r * ride.log_sd_across) ** 2 * ~ride.by_line, np.zeros(1))
        off = np.exp(NORMAL_80 * np.hypot(total(c_r * log_sd, np.zeros(1)), np.sqrt(by_tile)) / level)
    return replace(cut, c_r=mean, c_r_low=mean / off, c_r_high=mean * off, place_sd=spread)


def _steps(drive: DriveMeasure, label: Integers, field: TileField, node: Floats) -> tuple[Integers, Floats, Integers]:
    """Cut the way into steps of a quarter of a metre or so: return their stretch, (s,), and length, (s,) m.

    Third, (s, 25), numbers of tiles, row by row in the window, at each place where the step may be: one standard
    deviation of the position times each pair of nodes beside the way; -1: outside.
    """
    counts = drive.reason == COUNTS
    usual = float(np.median(np.abs(drive.speed[counts]))) if counts.any() else 1.0
    every = max(round(_STEP_M * drive.hertz / max(usual, 0.05)), 1)
    first = np.arange(0, len(drive.time), every)
    way = np.add.reduceat(np.abs(drive.speed) * (counts / drive.hertz), first)
    middle = np.minimum(first + every // 2, len(drive.time) - 1)
    keep = (way > 0.0) & (label[middle] >= 0)
    middle = middle[keep]
    east, north = (part.ravel() for part in np.meshgrid(node, node))
    sd = drive.track.place_sd(drive.time[middle])[:, None]
    tile = tile_numbers(field, drive.easting[middle, None] + sd * east, drive.northing[middle, None] + sd * north)
    return label[middle], way[keep], tile


def _joint(stretch: Integers, tile: Integers, weight: Floats, sd: Floats, count: int) -> Floats:
    """Return the standard deviation of weighted means whose tiles have ``_SHARED`` of their variance in common."""
    total = np.maximum(np.bincount(stretch, weight, minlength=count), 1e-12)
    common = np.bincount(stretch, weight * sd, minlength=count) / total
    tiles = int(tile.max(initial=0)) + 1
    pair, place = np.unique(stretch * tiles + tile, return_inverse=True)
    own = np.bincount(place, weight * sd) ** 2
    alone = np.bincount(pair // tiles, own, minlength=count) / total**2
    return np.asarray(np.sqrt(_SHARED * common**2 + (1.0 - _SHARED) * alone))
