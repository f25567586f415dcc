"""Height steps between flight lines, cell by cell, and the offsets and tilts that make the lines agree.

Both lines of a cell get one common slope and a mean height each; the step is the difference of the means at one place.
Its standard error follows from the scatter about the slope, so rough ground and bushes count for little. The lines are
then adjusted by robust least squares, and keep their common mean height and slope. Three models are compared with each
other: nothing, an offset for each line, an offset and a tilt. Each is fitted to one half of the cells and judged by the
steps that it leaves in the other half; a richer one is taken only where it leaves clearly less.
"""

from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers import CELL, QUANTA, LineCorrection, LineSums, cell_indices

__all__ = [
    "Adjustment",
    "CellSteps",
    "LineCells",
    "adjust_lines",
    "left_after",
    "steps_between_lines",
    "weighted_median",
]

_LEAST_POINTS, _LEAST_OF_BOTH = 3, 8
"""Points in a cell: of each line, and of both."""
_NEIGHBOURS = 7
"""In a cell each line is compared with this many lines of higher number at most."""
_LARGEST_ERROR = 0.2
"""Cells with larger standard errors are left out, m: crowns and walls."""
_SMALLEST_ERROR = 0.003
"""Standard error of a step at least, m: points of a line share errors that do not average out."""
_CLASSIFIED_SHARE = 0.5
"""Only ground points (class 2) are compared if more than this share of the cells holds some."""
_ILL_CONDITIONED = 1e-3
"""A cell whose points lie nearly on one straight line says nothing about its slope."""

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class LineCells:
    """Cells in which a line has points, one row each, line by line inside a cell."""

    cell: Ints
    """(n,) key of the cell."""
    line: Ints
    """(n,)."""
    easting: NDArray[np.floating]
    """(n,) south-west corner, m."""
    northing: NDArray[np.floating]
    sums: Ints
    """(n, 10) see `bumpymap.readers.LineSums`."""

    @classmethod
    def of(cls, sums: LineSums) -> "LineCells":
        """Choose the points that are compared, ground or all, and return their cells."""
        rows = sums.rows()
        lined, ground = rows[:, 0] >> 1, (rows[:, 0] & 1).astype(np.bool_)
        cells = lined >> 16
        if len(np.unique(cells[ground])) > _CLASSIFIED_SHARE * len(np.unique(cells)):
            lined, values = lined[ground], rows[ground, 1:]
        elif len(rows):
            first = np.flatnonzero(np.diff(lined, prepend=-1))
            lined, values = lined[first], np.add.reduceat(rows[:, 1:], first, axis=0)
        else:
            values = rows[:, 1:]
        col, row = cell_indices(lined >> 16)
        return cls(lined >> 16, lined & 0xFFFF, col * CELL, row * CELL, values)


@dataclass(frozen=True, slots=True)
class CellSteps:
    """Steps between two lines, one for each cell and pair of lines that share it."""

    first: Ints
    """(n,) line with the smaller number."""
    second: Ints
    """(n,) the other one."""
    easting: Floats
    """(n,) middle of the points, m."""
    northing: Floats
    step: Floats
    """(n,) height of the second line above the first, m."""
    error: Floats
    """(n,) standard error of the step, m."""
    fold: NDArray[np.bool_]
    """(n,) which half of the cells it is in, to test on one half what was fitted to the other."""

    def where(self, chosen: NDArray[np.bool_]) -> "CellSteps":
        """Return some of the steps."""
        return CellSteps(*(getattr(self, field.name)[chosen] for field in fields(self)))


def steps_between_lines(cells: LineCells) -> CellSteps:
    """Return the steps in all cells where they can be measured."""
    pairs = [np.zeros((2, 0), np.int64)]
    for gap in range(1, _NEIGHBOURS + 1):
        left = np.flatnonzero(cells.cell[gap:] == cells.cell[:-gap])
        pairs.append(np.array([left, left + gap]))
    one, two = np.concatenate(pairs, axis=1)
    counts = cells.sums[:, 0]
    enough = (np.minimum(counts[one], counts[two]) >= _LEAST_POINTS) & (counts[one] + counts[two] >= _LEAST_OF_BOTH)
    one, two = one[enough], two[enough]
    order = np.lexsort((cells.cell[one], cells.line[two], cells.line[one]))
    one, two = one[order], two[order]
    place, step, error, known = _fit(cells.sums[one], cells.sums[two])
    mixed = (cells.cell[one].astype(np.uint64) * np.uint64(0xC2B2AE3D27D4EB4F)) >> np.uint64(63)
    found = CellSteps(
        cells.line[one],
        cells.line[two],
        cells.easting[one] + place[0],
        cells.northing[one] + place[1],
        step,
        error,
        mixed.astype(np.bool_),
    )
    return found.where(known & (error <= _LARGEST_ERROR))


def _fit(one: Ints, two: Ints) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Fit a common slope and two heights to the sums of two lines, (n, 10) each.

    Returns
    -------
    (2, n) float64
        Middle of the points from the corner of the cell, m.
    (n,) float64
        Step from the first to the second, m.
    (n,) float64
        Its standard error, m.
    (n,) bool
        Whether the points determine a slope.
    """
    # About the first line's height, in integers: squares of heights above sea would lose the millimetres.
    level = np.rint(one[:, 3] / one[:, 0]).astype(np.int64) if len(one) else np.zeros(0, np.int64)
    means, moments = [], []
    for sums in (one, two):
        mean, moment = _moments(sums, level)
        means.append(mean)
        moments.append(moment)
    within = moments[0] + moments[1]
    xx, xy, yy, xz, yz, zz = within
    area = xx * yy - xy * xy
    known = area > _ILL_CONDITIONED * np.maximum(xx, yy) ** 2
    area = np.where(known, area, 1.0)
    east, north = (yy * xz - xy * yz) / area, (xx * yz - xy * xz) / area
    counts = one[:, 0] + two[:, 0]
    scatter = np.maximum(zz - east * xz - north * yz, 0.0) / np.maximum(counts - 4, 1)
    dx, dy, dz = means[1] - means[0]
    leverage = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / area
    variance = scatter * (1 / one[:, 0] + 1 / two[:, 0] + leverage) if len(one) else scatter
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


_ROUNDS = 25
_HUBER = 1.5
"""Residuals beyond this many standard errors count less."""
_OFFSET_SPREAD, _TILT_SPREAD = 1.0, 0.01
"""Standard deviations to which offsets [m] and tilts [m/m] are held where the overlaps do not determine them."""
_LEAST_CELLS = 20
"""Cells that a line shares with others at least, to be adjusted."""
_MOST_TILTED, _MOST_LINES = 150, 1500
"""Lines at most, for tilts and for offsets: the equations grow with their square."""
_SEEN = 0.16
"""A line's tilt needs overlaps that spread over this share of the variance of all its cells, in each direction."""
_GAIN, _LEAST_GAIN = 0.97, 0.001
"""A richer model must leave at most this share of the steps, and make them smaller by this much [m]."""
_LARGEST = 2.0
"""Offsets beyond this are no matter of alignment, m: nothing is adjusted."""
_WORSE = (1.1, 0.001)
"""No pair of lines may be left with steps larger by this factor, and by this much [m]."""


@dataclass(frozen=True, slots=True)
class Adjustment:
    """Correction that makes the lines agree."""

    method: str
    """``none``, ``offset`` or ``tilt``: an offset and a tilt."""
    corrections: tuple[LineCorrection, ...]


@dataclass(frozen=True, slots=True)
class _Design:
    """Unknowns of the equations: an offset for each line, and slopes to the east and north for tilted ones."""

    lines: NDArray[np.int64]
    middle: Floats
    """(lines, 2) where the offset applies, m."""
    tilted: NDArray[np.bool_]

    def factors(self, steps: CellSteps, side: NDArray[np.int64]) -> Floats:
        """Return what the unknowns of one side's line are multiplied by, (3, n)."""
        east, north = steps.easting - self.middle[side, 0], steps.northing - self.middle[side, 1]
        tilted = self.tilted[side]
        return np.array([np.ones(len(side)), np.where(tilted, east, 0.0), np.where(tilted, north, 0.0)])


def adjust_lines(cells: LineCells, steps: CellSteps) -> Adjustment:
    """Choose a model and return its corrections, rounded to 0.1 mm and 0.1 mm in 100 m."""
    lines, shared = np.unique(np.concatenate([steps.first, steps.second]), return_counts=True)
    lines = lines[shared >= _LEAST_CELLS]
    steps = steps.where(np.isin(steps.first, lines) & np.isin(steps.second, lines))
    none = Adjustment("none", ())
    if not len(steps.step) or len(lines) > _MOST_LINES:
        return none
    middle, tilted = _support(cells, steps, lines)
    best = none
    tests: dict[str, Floats] = {"none": steps.step}
    for method, wanted in (("offset", np.zeros_like(tilted)), ("tilt", tilted & (len(lines) <= _MOST_TILTED))):
        if method == "tilt" and not wanted.any():
            break
        design = _Design(lines, middle, wanted)
        left = _left_in_other_half(design, steps)
        corrections = _solved(design, steps)
        plausible = max(abs(own.offset) for own in corrections) <= _LARGEST
        if plausible and _is_better(steps, left, tests[best.method]):
            best, tests[method] = Adjustment(method, corrections), left
    return best


def left_after(steps: CellSteps, corrections: tuple[LineCorrection, ...]) -> Floats:
    """Return the steps that are left after corrections, (n,) m."""
    left = steps.step.copy()
    for own in corrections:
        shift = (
            own.offset + own.slope_east * (steps.easting - own.east) + own.slope_north * (steps.northing - own.north)
        )
        left -= np.where(steps.second == own.line, shift, 0.0) - np.where(steps.first == own.line, shift, 0.0)
    return left


def weighted_median(values: Floats, weights: Floats) -> float:
    """Return the value with half of the weight below it; at least one value."""
    order = np.argsort(values, kind="stable")
    below = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(below, below[-1] / 2)]])


def _support(cells: LineCells, steps: CellSteps, lines: NDArray[np.int64]) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the middle of each line, (lines, 2), and whether its overlaps are wide enough to tell its tilt."""
    middle, wide = np.zeros((len(lines), 2)), np.zeros(len(lines), np.bool_)
    for number, line in enumerate(lines.tolist()):
        mine, overlaps = cells.line == line, (steps.first == line) | (steps.second == line)
        whole = np.array([cells.easting[mine], cells.northing[mine]])
        part = np.array([steps.easting[overlaps], steps.northing[overlaps]])
        middle[number] = np.round(whole.mean(axis=1))
        shares = np.linalg.eigvals(np.linalg.solve(np.cov(whole) + np.eye(2), np.cov(part)))
        wide[number] = shares.real.min() >= _SEEN
    return middle, wide


def _left_in_other_half(design: _Design, steps: CellSteps) -> Floats:
    """Return the steps that are left in each half of the cells by what was fitted to the other half."""
    left = np.empty_like(steps.step)
    for half in (False, True):
        fitted = steps.where(steps.fold != half)
        left[steps.fold == half] = left_after(steps.where(steps.fold == half), _solved(design, fitted))
    return left


def _is_better(steps: CellSteps, left: Floats, before: Floats) -> bool:
    """Return whether steps are clearly smaller in all cells, and larger for no pair of lines."""
    weights = 1 / steps.error**2
    old, new = (weighted_median(np.abs(held), weights) for held in (before, left))
    if new > min(_GAIN * old, old - _LEAST_GAIN):
        return False
    pairs = steps.first << 16 | steps.second
    bounds = [0, *(np.flatnonzero(np.diff(pairs)) + 1).tolist(), len(pairs)]
    for start, end in pairwise(bounds):
        if end - start < _LEAST_CELLS:
            continue
        old, new = (weighted_median(np.abs(held[start:end]), weights[start:end]) for held in (before, left))
        if new > max(_WORSE[0] * old, old + _WORSE[1]):
            return False
    return True


def _solved(design: _Design, steps: CellSteps) -> tuple[LineCorrection, ...]:
    """Solve the equations with Huber's weights."""
    size = len(design.lines)
    sides = [np.searchsorted(design.lines, own) for own in (steps.first, steps.second)]
    columns = np.concatenate([[side, size + 2 * side, size + 2 * side + 1] for side in sides])
    factors = np.concatenate([-design.factors(steps, sides[0]), design.factors(steps, sides[1])])
    spreads = np.concatenate([np.full(size, _OFFSET_SPREAD), np.full(2 * size, _TILT_SPREAD)])
    unknowns = size + 2 * size * bool(design.tilted.any())
    used = 6 if unknowns > size else 2
    if used == 2:
        columns, factors = columns[[0, 3]], factors[[0, 3]]
    solution = np.zeros(unknowns)
    weights = 1 / steps.error**2
    for _ in range(_ROUNDS):
        residual = steps.step - (factors * solution[columns]).sum(axis=0)
        standard = np.abs(residual) / steps.error
        scale = max(1.4826 * float(np.median(standard)), 1e-6)
        held = weights * np.minimum(1.0, _HUBER * scale / np.maximum(standard, 1e-12)) / scale**2
        matrix, right = np.diag(1 / spreads[:unknowns] ** 2), np.zeros(unknowns)
        for a in range(used):
            right += np.bincount(columns[a], held * factors[a] * steps.step, unknowns)
            for b in range(used):
                places = columns[a] * unknowns + columns[b]
                matrix += np.bincount(places, held * factors[a] * factors[b], unknowns**2).reshape(matrix.shape)
        solution[:] = np.linalg.solve(matrix, right)
    slopes = solution[size:].reshape(-1, 2) if unknowns > size else np.zeros((size, 2))
    return tuple(
        LineCorrection(int(line), round(offset, 4), east, north, round(slope[0], 6), round(slope[1], 6))
        for line, offset, (east, north), slope in zip(
            design.lines, solution[:size].tolist(), design.middle.tolist(), slopes.tolist(), strict=True
        )
    )
