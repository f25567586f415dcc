"""Flight lines of a survey: how far their heights differ where they overlap, and what ``align="on"`` takes off each."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Align, BadInputError, MapConfig, Progress, Stopwatch
from bumpymap.readers import (
    CELL,
    QUANTA,
    LineCorrection,
    LineSums,
    ReadOptions,
    cell_indices,
    file_changed,
    reopen_survey,
)
from bumpymap.survey.inputs import SurveyInputs, read_options

Floats = NDArray[np.float64]


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

    def pairs(self, least: int) -> Iterator[slice]:
        """Yield the steps of each pair of lines that has so many at least; they must be in the order of the lines."""
        bounds = np.flatnonzero(np.diff(self.first << 16 | self.second, prepend=-1, append=-1))
        yield from (slice(start, end) for start, end in pairwise(bounds.tolist()) if end - start >= least)


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

    Returns the middle of the points from the corner of the cell (2, n), m; the step from the first to the second and
    its standard error, (n,) each, m; and whether the points determine a slope, (n,).
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
_LEAST_COMMON = 20
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


Corrections = tuple[LineCorrection, ...]


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


def adjust_lines(cells: LineCells, steps: CellSteps) -> tuple[str, Corrections]:
    """Choose a model, see `FlightLines.method`; return it and its corrections, to 0.1 mm and 0.1 mm in 100 m."""
    lines, shared = np.unique(np.concatenate([steps.first, steps.second]), return_counts=True)
    lines = lines[shared >= _LEAST_COMMON]
    steps = steps.where(np.isin(steps.first, lines) & np.isin(steps.second, lines))
    best: tuple[str, Corrections] = "none", ()
    if not len(steps.step) or len(lines) > _MOST_LINES:
        return best
    middle, tilted = _support(cells, steps, lines)
    before = steps.step
    for method, wanted in (("offset", np.zeros_like(tilted)), ("tilt", tilted & (len(lines) <= _MOST_TILTED))):
        if method == "tilt" and not wanted.any():
            break
        design = _Design(lines, middle, wanted)
        left = _left_in_other_half(design, steps)
        corrections = _solved(design, steps)
        plausible = max(abs(own.offset) for own in corrections) <= _LARGEST
        if plausible and _is_better(steps, left, before):
            best, before = (method, corrections), left
    return best


def left_after(steps: CellSteps, corrections: Corrections) -> Floats:
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
    for pair in steps.pairs(_LEAST_COMMON):
        old, new = (weighted_median(np.abs(held[pair]), weights[pair]) for held in (before, left))
        if new > max(_WORSE[0] * old, old + _WORSE[1]):
            return False
    return True


def _solved(design: _Design, steps: CellSteps) -> Corrections:
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
    """The lines of a survey, and what was done about them."""

    lines: int = 0
    """Number of lines; 1 where the files name none."""
    pairs: tuple[LinePair, ...] = ()
    """As the layers have them."""
    method: str = "none"
    """Correction that makes the lines agree: ``none``, ``offset``, or ``tilt`` for an offset and a tilt of each line.
    It was taken off with ``align="on"``."""
    corrections: Corrections = ()
    """Correction that was taken off each line; empty without ``align="on"``."""
    before: tuple[LinePair, ...] = ()
    """The pairs before that; empty without ``align="on"``."""

    @property
    def largest(self) -> float:
        """Largest step between two lines, m."""
        return max((pair.largest for pair in self.pairs), default=0.0)

    def to_record(self) -> dict[str, Any]:
        """Return a dict for JSON."""
        return asdict(self) | {"corrections": [own._asdict() for own in self.corrections]}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Self:
        """Restore the dict of ``to_record``."""
        pairs, before = (
            tuple(
                LinePair(**pair | {"lines": tuple(pair["lines"]), "tilt": tuple(pair["tilt"])}) for pair in record[key]
            )
            for key in ("pairs", "before")
        )
        corrections = tuple(LineCorrection(**own) for own in record["corrections"])
        return cls(record["lines"], pairs, record["method"], corrections, before)


def compare_lines(sums: LineSums, *, adjust: bool = False) -> FlightLines:
    """Compare the lines of a survey.

    Parameters
    ----------
    sums : LineSums
        Of all its points.
    adjust : bool
        Whether to find what makes them agree in any case, and to return the corrections; otherwise it is found, and
        named, only if a step matters.
    """
    cells = LineCells.of(sums)
    lines = len(np.unique(cells.line))
    if lines < 2:
        return FlightLines(lines)
    steps = steps_between_lines(cells)
    found = FlightLines(lines, tuple(_pair(steps, span) for span in steps.pairs(_LEAST_CELLS)))
    if not adjust and found.largest < MATTERS:
        return found
    method, corrections = adjust_lines(cells, steps)
    return replace(found, method=method, corrections=corrections if adjust else ())


def describe_lines(found: FlightLines, align: Align) -> str:
    """Return a sentence about the steps between lines; empty if there is nothing to say."""
    if align == "on" and found.corrections:
        what = {"offset": "an offset", "tilt": "an offset and a tilt"}[found.method]
        was = max((pair.largest for pair in found.before), default=0.0)
        now = f"differ by up to {found.largest * 100:.1f} cm" if found.largest else "no difference is certain"
        return (
            f"Flight lines: {what} of each line was taken off. Heights of two lines differed by up to {was * 100:.1f} "
            f"cm where they overlap; {now} now"
        )
    if found.largest < MATTERS:
        return ""
    worst = max(found.pairs, key=lambda pair: pair.largest)
    one, two = worst.lines
    text = f"heights of {one} and {two} differ by {worst.largest * 100:.1f} cm where they overlap"
    return f"Flight lines: {text}, which reads as roughness. {_remedy(found)}"


def _remedy(found: FlightLines) -> str:
    if found.method == "none":
        return "Neither an offset nor a tilt of each line explains it"
    return f"`align='on'` takes {'an offset' if found.method == 'offset' else 'an offset and a tilt'} of each line off"


def _pair(steps: CellSteps, span: slice) -> LinePair:
    step, weights = steps.step[span], 1 / steps.error[span] ** 2
    middle = weighted_median(step, weights)
    spread = 1.4826 * weighted_median(np.abs(step - middle), weights)
    tilt, fitted = _tilt(steps, span, middle, spread)
    sure = any(tilt) or abs(middle) > _SURE * 1.2533 * spread / len(step) ** 0.5
    return LinePair(
        lines=(int(steps.first[span][0]), int(steps.second[span][0])),
        cells=len(step),
        step=round(middle, 5),
        spread=round(spread, 5),
        tilt=tilt,
        largest=round(float(np.quantile(np.abs(fitted), 0.9)), 5) if sure else 0.0,
    )


def _tilt(steps: CellSteps, span: slice, middle: float, spread: float) -> tuple[tuple[float, float], Floats]:
    """Return the growth of the step to the east and north, and the step at each cell, m."""
    step, level = steps.step[span], np.full(len(steps.step[span]), middle)
    held = np.abs(step - middle) <= max(_OUTER * spread, 1e-6)
    if np.count_nonzero(held) < _LEAST_FOR_TILT:
        return (0.0, 0.0), level
    root = 1 / steps.error[span]
    east, north = (axis - axis.mean() for axis in (steps.easting[span], steps.northing[span]))
    design = np.column_stack([np.ones_like(east), east, north]) * root[:, None]
    fit = np.linalg.lstsq(design[held], (step * root)[held], rcond=None)[0]
    left = ((step * root - design @ fit)[held] ** 2).sum()
    if left > (1 - _EXPLAINED) * (((step - middle) * root)[held] ** 2).sum():
        return (0.0, 0.0), level
    return (round(float(fit[1]), 6), round(float(fit[2]), 6)), design @ fit / root


@dataclass(frozen=True, slots=True)
class AlignedInputs:
    """The inputs of a run, with the corrections of their flight lines."""

    inputs: SurveyInputs
    options: ReadOptions
    """The settings that these were opened with."""
    before: FlightLines | None
    """The lines before any correction, with what is taken off; None without ``align="on"``."""

    @classmethod
    def of(cls, config: MapConfig, inputs: SurveyInputs, progress: Progress, clock: Stopwatch) -> "AlignedInputs":
        """Read all points once more if the settings ask for it, and open the files again with what is to be taken off.

        Raises
        ------
        BadInputError
            A file is bad and may not be skipped, or has changed.
        """
        options = read_options(config)
        if config.align != "on":
            return cls(inputs, options, None)
        with clock.stage("align"):
            found = compare_lines(_sums(inputs, progress), adjust=True)
        if not found.corrections:
            return cls(inputs, options, found)
        options = replace(options, corrections=found.corrections)
        readers = [reopen_survey(reader.info.path, options) for reader in inputs.readers]
        for old, new in zip(inputs.readers, readers, strict=True):
            if old.info.version != new.info.version:
                raise file_changed(old.info.path, "it was written again after its flight lines were compared")
        return cls(replace(inputs, readers=readers), options, found)

    def outcome(self, sums: LineSums) -> FlightLines:
        """Return the lines as they are in the layers, by the sums of the points that were mapped."""
        before = self.before
        if before is None:
            return compare_lines(sums)
        pairs = compare_lines(sums).pairs if before.corrections else before.pairs
        return replace(before, pairs=pairs, before=before.pairs)


def _sums(inputs: SurveyInputs, progress: Progress) -> LineSums:
    """Return the sums of all files; a bad file that may be skipped has none here, and is skipped when it is mapped."""
    progress.start("comparing flight lines", sum(reader.info.point_count for reader in inputs.readers))
    sums = LineSums()
    for reader in inputs.readers:
        try:
            for cloud in reader.clouds():
                progress.advance(cloud.easting.size)
        except BadInputError:
            if not inputs.skip_bad:
                raise
            continue
        sums = sums.merge(reader.lines)
    return sums
