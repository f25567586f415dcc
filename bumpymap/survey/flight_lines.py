"""Flight lines of a survey: how far their heights differ where they overlap, and what ``align="on"`` takes off each."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Align, BadInputError, MapConfig, Progress, Stopwatch
from bumpymap.readers import LineCorrection, LineSums, ReadOptions, file_changed, reopen_survey
from bumpymap.survey.inputs import SurveyInputs, read_options
from bumpymap.survey.line_heights import (
    Adjustment,
    CellSteps,
    LineCells,
    adjust_lines,
    steps_between_lines,
    weighted_median,
)

__all__ = ["AlignedInputs", "FlightLines", "LinePair", "compare_lines", "describe_lines", "describe_pairs"]

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

Floats = NDArray[np.float64]


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
    corrections: tuple[LineCorrection, ...] = ()
    """Correction that was taken off each line; empty without ``align="on"``."""
    before: tuple[LinePair, ...] = ()
    """The pairs before that; empty without ``align="on"``."""

    @property
    def smallest(self) -> float:
        """Smallest step between two lines that overlap, m."""
        return min((pair.largest for pair in self.pairs), default=0.0)

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


def compare_lines(sums: LineSums, *, adjust: bool = False) -> tuple[FlightLines, Adjustment]:
    """Compare the lines of a survey.

    Parameters
    ----------
    sums : LineSums
        Of all its points.
    adjust : bool
        Whether to find what makes them agree in any case; otherwise only if a step matters.

    Returns
    -------
    FlightLines
        Without corrections.
    Adjustment
        What makes them agree.
    """
    cells = LineCells.of(sums)
    lines, nothing = len(np.unique(cells.line)), Adjustment("none", ())
    if lines < 2:
        return FlightLines(lines), nothing
    steps = steps_between_lines(cells)
    codes = steps.first << 16 | steps.second
    bounds = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)]
    spans = [slice(*span) for span in pairwise(bounds) if span[1] - span[0] >= _LEAST_CELLS]
    found = FlightLines(lines, tuple(_pair(steps, span) for span in spans))
    if not adjust and found.largest < MATTERS:
        return found, nothing
    adjustment = adjust_lines(cells, steps)
    return FlightLines(lines, found.pairs, adjustment.method), adjustment


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
    text = (
        f"Flight lines: heights of {_both(worst)} differ by {worst.largest * 100:.1f} cm where they overlap, which "
        "reads as roughness"
    )
    return f"{text}. {_remedy(found)}"


def describe_pairs(found: FlightLines) -> str:
    """Return what is known of the lines of a file; empty for one line."""
    if found.lines < 2:
        return ""
    if not found.pairs:
        return f"{found.lines}, of which no two share enough ground to be compared"
    low, high = found.smallest * 100, found.largest * 100
    worst = max(found.pairs, key=lambda pair: pair.largest)
    if not high:
        return f"{found.lines}; where two overlap, no difference between their heights is certain"
    span = f"{high:.1f} cm" if low == high else f"{low:.1f} to {high:.1f} cm"
    text = f"{found.lines}; heights differ by {span} where two overlap, most between {_both(worst)}"
    return f"{text}. {_remedy(found)}" if found.largest >= MATTERS else text


def _both(pair: LinePair) -> str:
    return f"{pair.lines[0]} and {pair.lines[1]}"


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


class AlignedInputs:
    """The inputs of a run, with the corrections of their flight lines.

    Parameters
    ----------
    inputs : SurveyInputs
    options : ReadOptions
        The settings that these were opened with.
    before : FlightLines or None
        The lines before any correction, with what is taken off; None without ``align="on"``.
    """

    def __init__(self, inputs: SurveyInputs, options: ReadOptions, before: FlightLines | None) -> None:
        self.inputs, self.options, self._before = inputs, options, before

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
            found, adjustment = compare_lines(_sums(inputs, progress), adjust=True)
        found = replace(found, corrections=adjustment.corrections)
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
        before = self._before
        if before is None:
            return compare_lines(sums)[0]
        pairs = compare_lines(sums)[0].pairs if before.corrections else before.pairs
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
