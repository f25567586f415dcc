"""The charts of a check: map against drive, and both along the way."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DrivenStretches
from bumpymap.layers.check.log_axis import LogAxis
from bumpymap.layers.check.offset import MapOffset
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.route._chart import FAINT, GRID, INK, INTERVAL
from bumpymap.layers.route._pen import Colour, Pen, ticks

__all__ = ["Box", "draw_along", "draw_disc", "draw_scatter"]

NORMAL_80 = 1.2816
"""Half width of the 80 % interval of a normal variable, in standard deviations."""
_BARS = (128, 132, 140)
_MARK, _LEAST_SIZE = 14.0, 0.35
"""Marks closer than these pixels are drawn smaller, down to that size."""
_FACTOR = 1.5
"""Thin lines: map and drive differ by this factor."""


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle of the picture, pixels."""

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Right side."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Lower side."""
        return self.top + self.height


def draw_disc(pen: Pen, place: tuple[float, float], kind: int, *, off: bool, size: float = 1.0) -> None:
    """Draw the mark of a stretch: larger, with a thick outline, where errors do not explain how far the map is off."""
    colour = OFF_COLOURS[kind][:3]
    for radius, fill in ((9.5, INK), (7.0, colour)) if off else ((6.0, INK), (4.9, colour)):
        pen.disc(place, size * radius, fill, fill)


def draw_scatter(pen: Pen, box: Box, stretches: DrivenStretches, limits: tuple[float, ...]) -> None:
    """Draw measured over predicted C_r on logarithmic axes, with the 80 % intervals of both and the class limits."""
    offset = MapOffset.of(stretches)
    shown = np.flatnonzero(np.isfinite(offset.ratio))
    if not len(shown):
        pen.text((box.left + box.width / 2, box.top + box.height / 2), "nothing to compare", FAINT, anchor="mm")
        return
    axis = LogAxis.around(np.concatenate([stretches.c_r[shown], stretches.measured[shown]]))

    def across(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(box.left + box.width * axis.part(values), dtype=np.float64)

    def up(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(box.bottom - box.height * axis.part(values), dtype=np.float64)

    _grid(pen, box, axis, limits)
    for factor, colour, width in ((1 / _FACTOR, FAINT, 1.0), (1.0, INK, 1.6), (_FACTOR, FAINT, 1.0)):
        ends = np.array([max(axis.low, axis.low / factor), min(axis.high, axis.high / factor)])
        pen.line(np.column_stack([across(ends), up(ends * factor)]), colour, width)
    half = NORMAL_80 * np.nan_to_num(stretches.measured_sd)
    for at in shown.tolist():
        x, y = across(stretches.c_r[[at]]), up(stretches.measured[[at]])
        wide = across(np.nan_to_num(np.array([stretches.c_r_low[at], stretches.c_r_high[at]]), nan=stretches.c_r[at]))
        tall = up(np.array([stretches.measured[at] - half[at], stretches.measured[at] + half[at]]))
        pen.line(np.column_stack([wide, np.repeat(y, 2)]), _BARS)
        pen.line(np.column_stack([np.repeat(x, 2), tall]), _BARS)
    for at in shown[np.argsort(offset.beyond[shown], kind="stable")].tolist():
        place = (float(across(stretches.c_r[[at]])[0]), float(up(stretches.measured[[at]])[0]))
        draw_disc(pen, place, int(offset.kind[at]), off=bool(offset.is_off[at]))
    pen.rectangle((box.left, box.top, box.right, box.bottom), None, FAINT)
    pen.text((box.left + box.width / 2, box.bottom + 38), "ride cost of the map [rad/m]", INK, size=15, anchor="mm")
    pen.upright_text((box.left - 58, box.top + box.height / 2), "measured by the drive [rad/m]", INK, 15)


def draw_along(pen: Pen, box: Box, stretches: DrivenStretches) -> None:
    """Draw the map's interval and value, and what was measured with its 80 % error, one stretch after another."""
    offset = MapOffset.of(stretches)
    far = float(np.sum(stretches.way_m))
    ends = np.concatenate([[0.0], np.cumsum(stretches.way_m)])
    values = np.concatenate([stretches.measured, stretches.c_r, stretches.c_r_high])
    known = values[np.isfinite(values)]
    if far <= 0.0 or not len(known):
        pen.text((box.left + box.width / 2, box.top + box.height / 2), "nothing was measured", FAINT, anchor="mm")
        return
    most = max(float(np.quantile(known, 0.99)), float(np.nanmax(stretches.measured, initial=0.0))) * 1.08
    most = most if most > 0.0 else 0.1

    def across(way: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(box.left + way / far * box.width, dtype=np.float64)

    def up(c_r: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(box.bottom - np.clip(c_r / most, 0.0, 1.0) * box.height, dtype=np.float64)

    _way_grid(pen, box, far, most)
    sides = across(ends)
    for at in np.flatnonzero(np.isfinite(stretches.c_r)).tolist():
        left, right = sides[at], sides[at + 1]
        low, high, middle = up(np.array([stretches.c_r_low[at], stretches.c_r_high[at], stretches.c_r[at]])).tolist()
        if np.isfinite(low) and np.isfinite(high):
            pen.rectangle((left, high, max(right, left + 1.0), max(low, high + 1.0)), INTERVAL, None)
        pen.line(np.array([[left, middle], [right, middle]]), INK, 2.0)
    for at in (np.flatnonzero(np.diff(stretches.drive) != 0) + 1).tolist():
        pen.line(np.array([[sides[at], box.top], [sides[at], box.bottom]]), FAINT, 1.5)
    half = NORMAL_80 * np.nan_to_num(stretches.measured_sd)
    size = float(np.clip(np.median(np.diff(sides)) / _MARK, _LEAST_SIZE, 1.0))
    for at in np.flatnonzero(np.isfinite(stretches.measured)).tolist():
        x = float(sides[at] + sides[at + 1]) / 2
        ys = up(stretches.measured[at] + half[at] * np.array([-1.0, 1.0, 0.0])).tolist()
        pen.line(np.array([[x, ys[0]], [x, ys[1]]]), _BARS)
        draw_disc(pen, (x, ys[2]), int(offset.kind[at]), off=bool(offset.is_off[at]), size=size)
    pen.rectangle((box.left, box.top, box.right, box.bottom), None, FAINT)


def _way_grid(pen: Pen, box: Box, far: float, most: float) -> None:
    values, decimals = ticks(0.0, most, 5)
    for value in values:
        y = box.bottom - value / most * box.height
        pen.line(np.array([[box.left, y], [box.right, y]]), GRID)
        pen.text((box.left - 8, y), f"{value:.{decimals}f}", FAINT, size=14, anchor="rm")
    pen.upright_text((box.left - 58, box.top + box.height / 2), "ride cost [rad/m]", INK, 15)
    for value in ticks(0.0, far, 10)[0]:
        x = box.left + value / far * box.width
        pen.line(np.array([[x, box.bottom], [x, box.bottom + 6]]), FAINT)
        pen.text((x, box.bottom + 17), f"{value:,.0f}", FAINT, size=14, anchor="mm")
    text = "length of the stretches, one after another [m]"
    pen.text((box.left + box.width / 2, box.bottom + 40), text, INK, size=15, anchor="mm")


def _grid(pen: Pen, box: Box, axis: LogAxis, limits: tuple[float, ...]) -> None:
    """Draw lines at 1, 2 and 5 times powers of ten, and at the limits of the classes."""
    for value in axis.ticks:
        part = float(axis.part(np.array([value]))[0])
        x, y = box.left + box.width * part, box.bottom - box.height * part
        _cross(pen, box, x, y, GRID)
        pen.text((x, box.bottom + 16), f"{value:g}", FAINT, size=14, anchor="mm")
        pen.text((box.left - 8, y), f"{value:g}", FAINT, size=14, anchor="rm")
    for limit in limits:
        if axis.low < limit < axis.high:
            part = float(axis.part(np.array([limit]))[0])
            _cross(pen, box, box.left + box.width * part, box.bottom - box.height * part, (196, 150, 120))


def _cross(pen: Pen, box: Box, x: float, y: float, colour: Colour) -> None:
    pen.line(np.array([[x, box.top], [x, box.bottom]]), colour)
    pen.line(np.array([[box.left, y], [box.right, y]]), colour)
