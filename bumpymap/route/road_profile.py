"""Figures of road practice along the two wheel paths of a line: IRI, ISO 8608 class, grade, crossfall, RMS of heights.

IRI is the motion of the suspension of a reference quarter car at 80 km/h over the length of the way (Sayers, World Bank
Technical Paper 46; ASTM E1926). The class of ISO 8608 follows from the power of the heights at 0.1 cycles per metre, of
a spectrum that falls with the square of the wave number.

A survey's noise adds to both. Heights of ground fall off with the wave number, noise does not: the power near the
shortest waves that pixels hold, over that of waves of one to two metres, tells how much of the latter is noise.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError

__all__ = ["Resolution", "RoadFigures", "bridged", "iso_8608", "quarter_car", "road_figures"]

Floats = NDArray[np.float64]
Resolution = Literal["resolved", "limited by noise", "not resolvable", "unknown"]

_CAR = np.array([[0, 1, 0, 0], [-63.3, -6.0, 63.3, 6.0], [0, 0, 0, 1], [422.0, 40.0, -(653 + 63.3) / 0.15, -40.0]])
"""Golden car (k1 653, k2 63.3, mu 0.15 and c 6), 1/s and 1/s2: body and wheel, their slopes and the rates of these."""
_ROAD = np.array([0, 0, 0, 653 / 0.15])
_CAR_MPS = 80 / 3.6
_BASE_M, _BEGIN_M = 0.25, 11.0
"""Length that a tyre averages over; the car begins at rest on the mean slope of the first metres."""
_REFERENCE = 0.1
"""Wave number that classes are stated at, cycles per metre."""
_WAVES = (0.05, 1.0)
"""Wave numbers that the power is taken from: those that a map of 0.2 m pixels holds."""
_CLASS_A = 32e-6
"""Upper limit of class A, m3; each class ends at four times the one before (ISO 8608, table C.1)."""
_SHORT, _FELT = (1.25, 2.0), (0.4, 1.0)
"""Wave numbers of the shortest waves that pixels of 0.2 m hold, and of those that the wheels of the car feel most."""
_SHORT_OVER_FELT = (0.08, 0.55)
"""Power of the first over that of the second, of pixels read bilinearly: of a spectrum that falls with the square, and
of noise."""
_NOISE = (0.3, 0.7)
"""Shares of noise in the power: below the first, figures are resolved, above the second they are not resolvable."""
_LEAST_KNOWN, _SHORTEST_M = 0.9, 10.0


@dataclass(frozen=True, slots=True)
class RoadFigures:
    """Figures of one stretch of a line; NaN where less than nine tenths of its ground are known."""

    first: float
    """m along the line; so is ``last``."""
    last: float
    iri: float
    """International Roughness Index, mean of both wheel paths (MRI), m/km."""
    iso_power: float
    """Power of the heights at 0.1 cycles per metre, m3; `iso_class` names it. NaN for less than 40 m."""
    resolution: Resolution
    """How far the survey's noise lets IRI and class be told; they are too high where it does not."""
    height_rms: float
    """Root mean square of the heights about the stretch's own line, m."""
    grade: float
    """Rise over length, m/m."""
    crossfall: float
    """Fall to the right over the width, m/m."""

    @property
    def iso_class(self) -> str:
        """ISO 8608 class, A (smoothest) to H; empty where unknown."""
        if not self.iso_power > 0.0:
            return ""
        return "ABCDEFGH"[int(np.clip(np.ceil(np.log(self.iso_power / _CLASS_A) / np.log(4.0)), 0, 7))]


def quarter_car(heights: Floats, spacing: float) -> Floats:
    """Return what the reference quarter car's suspension moves at each sample of a profile.

    Parameters
    ----------
    heights : array (n,)
        m, without holes.
    spacing : float
        Distance between heights, m.

    Returns
    -------
    array (n,)
        m per km; its mean over a stretch is the IRI there.
    """
    from scipy.linalg import expm
    from scipy.ndimage import uniform_filter1d
    from scipy.signal import lfilter, ss2tf

    step = expm(_CAR * (spacing / _CAR_MPS))
    push = np.linalg.solve(_CAR, (step - np.eye(4)) @ _ROAD)
    travel = np.array([[1.0, 0.0, -1.0, 0.0]])
    top, bottom = ss2tf(step, push[:, None], travel @ step, travel @ push[:, None])
    tyre = round(_BASE_M / spacing)
    even = uniform_filter1d(heights, tyre, mode="nearest") if tyre > 1 else heights
    slope = np.diff(even, prepend=even[:1]) / spacing
    begin = min(max(round(_BEGIN_M / spacing), 1), len(heights) - 1)
    slope -= (even[begin] - even[0]) / (begin * spacing)
    slope[0] = 0.0
    moved: Floats = 1000.0 * np.abs(lfilter(top[0], bottom, slope))
    return moved


def iso_8608(heights: Floats, spacing: float) -> tuple[float, float]:
    """Return the power of a profile at 0.1 cycles per metre, and the share of noise in waves of one to two metres.

    Parameters
    ----------
    heights : array (n,)
        m, without holes.
    spacing : float
        Distance between heights, m.

    Returns
    -------
    float
        m3, of a spectrum that falls with the square of the wave number; NaN for less than 40 m.
    float
        0..1.
    """
    from scipy.signal import detrend

    count = len(heights)
    window = np.hanning(count)
    power = 2 * spacing * np.abs(np.fft.rfft(detrend(heights) * window)) ** 2 / (window**2).sum()
    wave = np.fft.rfftfreq(count, spacing)
    short, felt = (power[(wave >= low) & (wave < high)].mean() for low, high in (_SHORT, _FELT))
    least, most = _SHORT_OVER_FELT
    noise = float(np.clip((short / max(felt, 1e-30) - least) / (most - least), 0.0, 1.0))
    if count * spacing < 2 / _WAVES[0]:
        return float("nan"), noise
    used = (wave >= _WAVES[0]) & (wave <= _WAVES[1])
    octave = np.floor(np.log2(wave[used] / _WAVES[0])).astype(np.int64)
    flat, bins = power[used] * (wave[used] / _REFERENCE) ** 2, np.bincount(octave)
    # The logarithm of a mean lies low by half its relative variance: under this window, that of 1.94 bins is 1.
    per_octave = np.log(np.maximum(np.bincount(octave, flat) / bins, 1e-30)) + 0.97 / bins
    return float(np.exp(per_octave.mean())), noise


def road_figures(heights: Floats, spacing: float, track: float, length: float) -> tuple[RoadFigures, ...]:
    """Return the figures of each stretch of a line; a last one of less than half the length belongs to that before.

    Parameters
    ----------
    heights : array (2, n)
        Ground under the left and the right wheels, m; NaN where unknown.
    spacing : float
        Distance between heights along the line, m.
    track : float
        Distance between the wheel paths, m.
    length : float
        Of a stretch, m; 10 or more.

    Raises
    ------
    UsageError
        The stretches, or the line, are shorter than 10 m.
    """
    total = heights.shape[1] * spacing
    if not min(length, total) >= _SHORTEST_M:
        raise UsageError(f"figures of roads need stretches of 10 m or more, not {min(length, total):g} m")
    ends = np.arange(max(round(total / length), 1) + 1) * length
    ends[-1] = total
    known = np.isfinite(heights)
    filled = bridged(heights)
    motion = np.stack([quarter_car(path, spacing) for path in filled])
    parts = [slice(round(first / spacing), round(last / spacing)) for first, last in pairwise(ends.tolist())]
    return tuple(_of_stretch(part, filled, motion, known, spacing, track) for part in parts)


def _of_stretch(
    part: slice, filled: Floats, motion: Floats, known: NDArray[np.bool_], spacing: float, track: float
) -> RoadFigures:
    first, last = part.start * spacing, part.stop * spacing
    if known[:, part].mean(axis=1).min() < _LEAST_KNOWN:
        nan = float("nan")
        return RoadFigures(first, last, nan, nan, "unknown", nan, nan, nan)
    power, noise = np.mean([iso_8608(path, spacing) for path in filled[:, part]], axis=0)
    middle = filled[:, part].mean(axis=0)
    at = spacing * np.arange(len(middle))
    grade, start = np.polyfit(at, middle, 1)
    left, right = filled[:, part].mean(axis=1)
    return RoadFigures(
        first=first,
        last=last,
        iri=float(motion[:, part].mean()),
        iso_power=float(power),
        resolution="resolved" if noise < _NOISE[0] else "limited by noise" if noise < _NOISE[1] else "not resolvable",
        height_rms=float(np.sqrt(np.mean((middle - start - grade * at) ** 2))),
        grade=float(grade),
        crossfall=float((left - right) / track),
    )


def bridged(lines: Floats) -> Floats:
    """Interpolate over the unknown samples of each line, (k, n); 0 if none is known."""
    at, found = np.arange(lines.shape[1]), np.zeros_like(lines)
    for line, values in zip(found, lines, strict=True):
        known = np.isfinite(values)
        if known.any():
            line[:] = np.interp(at, at[known], values[known])
    return found
