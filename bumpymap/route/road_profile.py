"""Figures of road practice along the two wheel paths of a line: IRI, ISO 8608 class, grade, crossfall, RMS of heights.

IRI is the motion of the suspension of a reference quarter car at 80 km/h over the length of the way (Sayers, World Bank
Technical Paper 46; ASTM E1926). The class of ISO 8608 follows from the power of the heights at 0.1 cycles per metre, of
a spectrum that falls with the square of the wave number.

A survey's noise adds to both. Heights of ground fall off with the wave number, noise does not: the power near the
shortest waves that pixels hold, over that of waves of one to two metres, tells how much of the latter is noise.
"""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Resolution, RoadFigures, UsageError, loops

Floats = NDArray[np.float64]

_CAR = np.array([[0, 1, 0, 0], [-63.3, -6.0, 63.3, 6.0], [0, 0, 0, 1], [422.0, 40.0, -(653 + 63.3) / 0.15, -40.0]])
"""Golden car (k1 653, k2 63.3, mu 0.15 and c 6), 1/s and 1/s2: body and wheel, their slopes and the rates of these."""
_ROAD = np.array([0, 0, 0, 653 / 0.15])
"""Push of the road's slope on these, 1/s2: k1 over mu."""
_CAR_MPS = 80 / 3.6
"""Speed of the car, m/s: 80 km/h (ASTM E1926)."""
_BASE_M, _BEGIN_M = 0.25, 11.0
"""Length that a tyre averages over; the car begins at rest on the mean slope of the first metres, m (ASTM E1926)."""
_REFERENCE = 0.1
"""Wave number that classes are stated at, cycles per metre (ISO 8608)."""
_WAVES = (0.05, 1.0)
"""Wave numbers that the power is taken from, cycles per metre: those that a map of 0.2 m pixels holds."""
_PIXEL_M = 0.2
"""Side of usual pixels, m."""
_SHORT, _FELT = (1.25, 2.0), (0.4, 1.0)
"""Wave numbers of the shortest waves that pixels of 0.2 m hold, and of those that the wheels of the car feel most; with
larger pixels both are as many pixels long."""
_SHORT_OVER_FELT = (0.08, 0.55)
"""Power of the first over that of the second, of pixels read bilinearly: of a spectrum that falls with the square, and
of noise."""
_NOISE = (0.3, 0.7)
"""Shares of noise in the power: below the first, figures are resolved, above the second they are not resolvable."""
_RESOLUTIONS: tuple[Resolution, ...] = ("resolved", "limited by noise", "not resolvable", "unknown")
SHORTEST_ROAD_M = 10.0
"""Length of the shortest stretch that has figures, m (chosen)."""
_LEAST_KNOWN = 0.9
"""Least share of known heights of a stretch that has figures (chosen)."""


def quarter_car(heights: Floats, spacing: float) -> Floats:
    """Return what the reference quarter car's suspension moves at each sample of a profile.

    ``heights`` (n,): m, without holes, ``spacing`` apart, m. Returns (n,) m per km; its mean over a stretch is the IRI
    there.
    """
    from scipy.linalg import expm
    from scipy.ndimage import uniform_filter1d

    step = expm(_CAR * (spacing / _CAR_MPS))
    push = np.linalg.solve(_CAR, (step - np.eye(4)) @ _ROAD)
    tyre = round(_BASE_M / spacing)
    even = uniform_filter1d(heights, tyre, mode="nearest") if tyre > 1 else heights
    slope = np.diff(even, prepend=even[:1]) / spacing
    begin = min(max(round(_BEGIN_M / spacing), 1), len(heights) - 1)
    slope -= (even[begin] - even[0]) / (begin * spacing)
    slope[0] = 0.0
    travel = np.empty(len(slope))
    loops.drive_quarter_car(slope, step, push, travel)
    return np.abs(1000.0 * travel)


def iso_8608(heights: Floats, spacing: float, pixel: float = _PIXEL_M) -> tuple[Floats, Floats]:
    """Return the power of profiles at 0.1 cycles per metre, and the share of noise in waves of two to five pixels.

    ``heights`` (..., n): m, without holes, ``spacing`` apart, m; ``pixel``: side of the pixels that they were read
    from, m. Returns the power, (...) m3, of a spectrum that falls with the square of the wave number, NaN for less than
    40 m; and the share, (...) 0..1.
    """
    count = heights.shape[-1]
    window, wave = np.hanning(count), np.fft.rfftfreq(count, spacing)
    power = 2 * spacing * np.abs(np.fft.rfft(_less_line(heights, spacing)[0] * window)) ** 2 / (window**2).sum()
    coarse = max(pixel / _PIXEL_M, 1.0)
    short, felt = (
        power[..., (wave >= low / coarse) & (wave < high / coarse)].mean(axis=-1) for low, high in (_SHORT, _FELT)
    )
    least, most = _SHORT_OVER_FELT
    noise = np.clip((short / np.maximum(felt, 1e-30) - least) / (most - least), 0.0, 1.0)
    if count * spacing < 2 / _WAVES[0]:
        return np.full(noise.shape, np.nan), noise
    used = (wave >= _WAVES[0]) & (wave <= _WAVES[1] / coarse)
    starts = np.flatnonzero(np.diff(np.floor(np.log2(wave[used] / _WAVES[0])), prepend=-1.0))
    bins = np.diff(starts, append=np.count_nonzero(used))
    octaves = np.add.reduceat(power[..., used] * (wave[used] / _REFERENCE) ** 2, starts, axis=-1) / bins
    # The logarithm of a mean lies low by half its relative variance: under this window, that of 1.94 bins is 1.
    return np.exp((np.log(np.maximum(octaves, 1e-30)) + 0.97 / bins).mean(axis=-1)), noise


def road_figures(
    heights: Floats, spacing: float, track: float, length: float, pixel: float = _PIXEL_M
) -> tuple[RoadFigures, ...]:
    """Return the figures of each stretch of a line; a last one of less than half the length belongs to that before.

    ``heights`` (2, n): ground under the left and the right wheels, m, ``spacing`` apart along the line, m; NaN where
    unknown; ``track``: distance between the wheel paths, m; ``length``: of a stretch, 10 m or more; infinite for one of
    the whole line; ``pixel`` as of `iso_8608`. Raises UsageError: the stretches, or the line, are shorter than 10 m.
    """
    count = heights.shape[1]
    if not min(length, count * spacing) >= SHORTEST_ROAD_M:
        raise UsageError(f"figures of roads need stretches of 10 m or more, not {min(length, count * spacing):g} m")
    every = min(length, count * spacing)
    firsts = np.rint(np.arange(max(round(count * spacing / every), 1)) * (every / spacing)).astype(np.int64)
    filled = bridged(heights)
    motion = np.stack([quarter_car(path, spacing) for path in filled])
    # All are as long as the first, but the last.
    groups = (firsts[:-1, None] + np.arange(round(every / spacing)), np.arange(firsts[-1], count)[None])
    found: list[RoadFigures] = []
    for at in filter(len, groups):
        power, noise = np.mean([iso_8608(path[at], spacing, pixel) for path in filled], axis=0)
        unknown = np.isfinite(heights)[:, at].mean(axis=2).min(axis=0) < _LEAST_KNOWN
        stretch = filled[:, at]
        (rest, grade), (left, right) = _less_line(stretch.mean(axis=0), spacing), stretch.mean(axis=2)
        rms = np.sqrt((rest**2).mean(axis=-1))
        columns = np.stack([motion[:, at].mean(axis=(0, 2)), power, rms, grade, (left - right) / track])
        columns[:, unknown] = np.nan
        ends = (np.stack([at[:, 0], at[:, -1] + 1]) * spacing).T.tolist()
        marks = np.where(unknown, len(_RESOLUTIONS) - 1, np.searchsorted(_NOISE, noise, side="right")).tolist()
        found += [
            RoadFigures(every, first, last, iri, iso_power, _RESOLUTIONS[mark], height_rms, *grades)
            for (first, last), mark, (iri, iso_power, height_rms, *grades) in zip(
                ends, marks, columns.T.tolist(), strict=True
            )
        ]
    return tuple(found)


def _less_line(heights: Floats, spacing: float) -> tuple[Floats, Floats]:
    """Return heights, (..., n), without their line of least squares, and its grade, (...)."""
    count = heights.shape[-1]
    along = spacing * (np.arange(count) - (count - 1) / 2)
    level = heights - heights.mean(axis=-1, keepdims=True)
    grade = (level * along).sum(axis=-1) / (along**2).sum()
    return level - grade[..., None] * along, grade


def bridged(lines: Floats) -> Floats:
    """Interpolate over the unknown samples of each line, (k, n); 0 if none is known."""
    at, found = np.arange(lines.shape[1]), np.zeros_like(lines)
    for line, values in zip(found, lines, strict=True):
        known = np.isfinite(values)
        if known.any():
            line[:] = np.interp(at, at[known], values[known])
    return found
