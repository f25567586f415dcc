"""Flight lines of a survey: how far their heights differ where they overlap."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats
from bumpymap.readers import CELL, QUANTA, LineSums, cell_indices

_LEAST_POINTS, _LEAST_OF_BOTH = 3, 8
"""Points in a cell: of each line, and of both."""
_NEIGHBOURS = 7
"""In a cell each line is compared with this many lines of higher number at most."""
_LARGEST_ERROR = 0.2
"""Cells with larger standard errors are left out, m: crowns and walls."""
_SMALLEST_ERROR = 0.003
"""Standard error of a step at least, m: points of a line share errors that do not average out."""
_CLASSIFIED_SHARE = 0.5
"""Only ground points are compared if more than this share of the cells holds some."""
_ILL_CONDITIONED = 1e-3
"""A cell whose points lie nearly on one straight line says nothing about its slope."""

Ints = NDArray[np.int64]


def _compared(sums: LineSums) -> tuple[Ints, Ints]:
    """Return cell << 16 | line of each line in each cell, rising, (n,), and its sums, (n, 10): of ground, or of all."""
    rows = sums.rows()
    lined, ground = rows[:, 0] >> 1, (rows[:, 0] & 1).astype(np.bool_)
    cells = lined >> 16
    if len(np.unique(cells[ground])) > _CLASSIFIED_SHARE * len(np.unique(cells)):
        return lined[ground], rows[ground, 1:]
    first = np.flatnonzero(np.diff(lined, prepend=-1))
    return lined[first], np.add.reduceat(rows[:, 1:], first, axis=0)


def steps_between_lines(lined: Ints, sums: Ints) -> tuple[Ints, Floats]:
    """Return pairs of lines, and the steps between them in all cells where they can be measured.

    ``lined`` (n,): key of the cell << 16 | line, rising; ``sums`` (n, 10): see `bumpymap.readers.LineSums`. Returns
    (n,): line with the smaller number << 16 | the other one, rising; and (4, n): easting and northing of the middle of
    the points; height of the second line above the first; its standard error; m.
    """
    cell, line = lined >> 16, lined & 0xFFFF
    pairs = [np.zeros((2, 0), np.int64)]
    for gap in range(1, _NEIGHBOURS + 1):
        left = np.flatnonzero(cell[gap:] == cell[:-gap])
        pairs.append(np.array([left, left + gap]))
    one, two = np.concatenate(pairs, axis=1)
    counts = sums[:, 0]
    enough = (np.minimum(counts[one], counts[two]) >= _LEAST_POINTS) & (counts[one] + counts[two] >= _LEAST_OF_BOTH)
    one, two = one[enough], two[enough]
    order = np.lexsort((cell[one], line[two], line[one]))
    one, two = one[order], two[order]
    place, step, error, known = _fit(sums[one], sums[two])
    col, row = cell_indices(cell[one])
    found = np.array([col * CELL + place[0], row * CELL + place[1], step, error])
    good = known & (error <= _LARGEST_ERROR)
    return (line[one] << 16 | line[two])[good], found[:, good]


def _fit(one: Ints, two: Ints) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Fit a common slope and two heights to the sums of two lines, (n, 10) each.

    Returns the middle of the points from the corner of the cell (2, n), m; the step from the first to the second and
    its standard error, (n,) each, m; and whether the points determine a slope, (n,).
    """
    # About the first line's height, in integers: squares of heights above sea would lose the millimetres.
    level = np.rint(one[:, 3] / one[:, 0]).astype(np.int64)
    (first, about_first), (second, about_second) = (_moments(sums, level) for sums in (one, two))
    xx, xy, yy, xz, yz, zz = about_first + about_second
    area = xx * yy - xy * xy
    known = area > _ILL_CONDITIONED * np.maximum(xx, yy) ** 2
    area = np.where(known, area, 1.0)
    east, north = (yy * xz - xy * yz) / area, (xx * yz - xy * xz) / area
    counts = one[:, 0] + two[:, 0]
    scatter = np.maximum(zz - east * xz - north * yz, 0.0) / np.maximum(counts - 4, 1)
    dx, dy, dz = second - first
    leverage = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / area
    variance = scatter * (1 / one[:, 0] + 1 / two[:, 0] + leverage)
    place = (one[:, 1:3] + two[:, 1:3]).T / np.maximum(counts, 1) / QUANTA
    step = (dz - east * dx - north * dy) / QUANTA
    return place, step, np.sqrt(variance / QUANTA**2 + _SMALLEST_ERROR**2), known


def _moments(sums: Ints, level: Ints) -> tuple[Floats, Floats]:
    """Return means of x, y and z, (3, n), and sums of products about them: x x, x y, y y, x z, y z, z z, (6, n)."""
    n, x, y, z, xx, xy, yy, xz, yz, zz = sums.T
    zz = zz - 2 * level * z + level * level * n  # wraps around, and back
    xz, yz, z = xz - level * x, yz - level * y, z - level * n
    mx, my, mz = (np.asarray(axis, np.float64) / n for axis in (x, y, z))
    products = [xx - mx * x, xy - mx * y, yy - my * y, xz - mx * z, yz - my * z, zz - mz * z]
    return np.array([mx, my, mz]), np.array(products)


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value with half of the weight below it; at least one value."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, below[-1] / 2)]])


MATTERS = 0.01
"""A step between two lines is worth a line of the summary from here on, m."""
_LEAST_CELLS = 8
"""Cells that two lines share at least, to be compared."""
_LEAST_FOR_TILT, _EXPLAINED = 20, 0.2
"""Cells that a tilt needs, and the share of the variance of the steps that it explains at least."""
_SURE = 3.0
"""A step counts from this many standard errors on."""
_OUTER = 2.5
"""Steps farther than this many spreads from the median do not determine a tilt."""


@dataclass(frozen=True, slots=True)
class LinePair:
    """Two lines that overlap."""

    lines: tuple[int, int]
    """Point source ids, the smaller first."""
    cells: int
    """Cells of 3 m in which both have points, of those in the sample."""
    step: float
    """Median height of the second line above the first, m."""
    spread: float
    """Robust standard deviation of the steps of single cells, m."""
    tilt: tuple[float, float]
    """Growth of the step to the east and north, m/m; 0 where the cells show none."""
    largest: float
    """Step that a tenth of the cells exceeds, as step and tilt have it, m; 0 where it is within its uncertainty."""


@dataclass(frozen=True, slots=True)
class FlightLines:
    """The lines of a survey."""

    lines: int = 0
    """Number of lines; 1 where the files name none."""
    pairs: tuple[LinePair, ...] = ()

    @property
    def largest(self) -> float:
        """Largest step between two lines, m."""
        return max((pair.largest for pair in self.pairs), default=0.0)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """Restore the dict that a manifest holds."""
        pairs = (pair | {"lines": tuple(pair["lines"]), "tilt": tuple(pair["tilt"])} for pair in record["pairs"])
        return cls(record["lines"], tuple(LinePair(**pair) for pair in pairs))


def compare_lines(sums: LineSums) -> FlightLines:
    """Compare the lines of a survey by the sums of all its points."""
    lined, own = _compared(sums)
    lines = len(np.unique(lined & 0xFFFF))
    if lines < 2:
        return FlightLines(lines)
    pairs, steps = steps_between_lines(lined, own)
    bounds = np.flatnonzero(np.diff(pairs, prepend=-1, append=-1)).tolist()
    spans = [slice(start, end) for start, end in pairwise(bounds) if end - start >= _LEAST_CELLS]
    return FlightLines(lines, tuple(_pair(int(pairs[span.start]), *steps[:, span]) for span in spans))


def describe_lines(found: FlightLines) -> str:
    """Return a sentence about the steps between lines; empty if there is nothing to say."""
    if found.largest < MATTERS:
        return ""
    worst = max(found.pairs, key=lambda pair: pair.largest)
    one, two = worst.lines
    return (
        f"Flight lines: heights of {one} and {two} differ by {worst.largest * 100:.1f} cm where they overlap, which "
        "reads as roughness. Have the producer do a strip adjustment"
    )


def _pair(lines: int, easting: Floats, northing: Floats, step: Floats, error: Floats) -> LinePair:
    root = 1 / error
    weights = 1 / error**2
    middle = weighted_median(step, weights)
    spread = 1.4826 * weighted_median(np.abs(step - middle), weights)
    held = np.abs(step - middle) <= max(_OUTER * spread, 1e-6)
    tilt, fitted = (0.0, 0.0), np.full(len(step), middle)
    if np.count_nonzero(held) >= _LEAST_FOR_TILT:
        design = np.column_stack([np.ones_like(easting), easting - easting.mean(), northing - northing.mean()])
        weighted = design * root[:, None]
        fit = np.linalg.lstsq(weighted[held], (step * root)[held], rcond=None)[0]
        left = ((step * root - weighted @ fit)[held] ** 2).sum()
        if left <= (1 - _EXPLAINED) * (((step - middle) * root)[held] ** 2).sum():
            tilt, fitted = (round(float(fit[1]), 6), round(float(fit[2]), 6)), weighted @ fit / root
    sure = any(tilt) or abs(middle) > _SURE * 1.2533 * spread / len(step) ** 0.5
    return LinePair(
        lines=(lines >> 16, lines & 0xFFFF),
        cells=len(step),
        step=round(middle, 5),
        spread=round(spread, 5),
        tilt=tilt,
        largest=round(float(np.quantile(np.abs(fitted), 0.9)), 5) if sure else 0.0,
    )
