"""The way of a drive in stretches, each with its C_r and the error of that.

C_r of a stretch is the mean absolute pitch rate over the mean speed. What the sensor reads at standstill is taken off
in power: mean absolute values of independent noise add as root mean squares do, exactly so where both are normal.
"""

import numpy as np
from numpy.typing import NDArray

from bumpymap.check.drive_measure import COUNTS, DriveMeasure, WayStretch
from bumpymap.check.settings import LEAST_WINDOW_M
from bumpymap.check.signals import pieces

__all__ = ["cut_stretches", "less_floor", "reading_sd"]

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

    Parameters
    ----------
    drive : DriveMeasure
    window_m : float
        A part is cut evenly into the whole number of stretches whose length comes nearest to this.
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

    Parameters
    ----------
    drive : DriveMeasure
    raw, measured : float64 arrays (n,)
        Before and after the floor was taken off, rad/m.
    seconds, way_m : float64 arrays (n,)
        Time and length that they rest on.
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
