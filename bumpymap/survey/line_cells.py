"""Height steps between flight lines, cell by cell, from the sums that the readers keep.

Both lines of a cell get one common slope and a mean height each; the step is the difference of the means at one place.
Its standard error follows from the scatter about the slope, so rough ground and bushes count for little.
"""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers import CELL, QUANTA, LineSums, cell_indices

__all__ = ["CellSteps", "LineCells", "steps_between_lines"]

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
    """Return the steps in all cells where they can be told."""
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
