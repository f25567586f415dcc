"""Write check.png: the stretches on the map, coloured by how far it is off, and charts of map against drive."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bumpymap.core import CheckResult, DrivenStretches, atomic
from bumpymap.layers.check.offset import NOT_COMPARED, OFF_KINDS, LogAxis, MapOffset
from bumpymap.layers.check.vectors import CheckGround
from bumpymap.layers.check.words import check_verdict, level_words, measured_mean, metres, percent
from bumpymap.layers.colours import OFF_COLOURS, RideScale
from bumpymap.layers.route.drawing import (
    FAINT,
    GRID,
    INK,
    INTERVAL,
    Colour,
    MapView,
    Pen,
    draw_north,
    draw_scale,
    paint_ground,
    tick_step,
    ticks,
)

__all__ = ["Box", "draw_along", "draw_disc", "draw_scatter", "paint_check", "view_of", "write_check_picture"]

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


WIDTH = 1600
"""Width of the picture, pixels."""
_EDGE, _TITLE = 24, 84
_PANEL = 980
"""Width of the map, pixels."""
_PANEL_HEIGHTS = (800, 1000)
_SCATTER = Box(_EDGE + _PANEL + 110, _TITLE, WIDTH - _EDGE - (_EDGE + _PANEL + 110), 440)
_ALONG = 250
_ALONG_LEFT = 104
_PALE = 0.45
"""Opacity of the map under the stretches."""


def write_check_picture(result: CheckResult, ground: CheckGround | None, path: Path) -> None:
    """Draw the findings and write the picture as PNG, 1600 pixels wide.

    Parameters
    ----------
    result : CheckResult
    ground : CheckGround or None
        The map under the stretches; None without one.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The layers cannot be read.
    """
    picture = paint_check(result, ground)
    with atomic(path) as temporary:
        picture.save(temporary, "PNG", compress_level=4)


def paint_check(result: CheckResult, ground: CheckGround | None) -> Image.Image:
    """Draw the map with the stretches, map against drive beside it, and both along the way below.

    Without a map, or without a position on it, only what was measured along the way is drawn.
    """
    points = np.column_stack([result.stretches.easting, result.stretches.northing])
    known = points[np.isfinite(points).all(axis=1)]
    with_map = ground is not None and len(known) > 0
    view = view_of(ground, known) if ground is not None and with_map else None
    top = _TITLE + 20 if view is None else _TITLE + view.height + 48
    pen = Pen(WIDTH, top + _ALONG + 70)
    _draw_title(pen, result)
    if ground is not None and view is not None:
        scale = _draw_map(pen, result, ground, view)
        limits = () if result.ground is None else result.ground.class_limits
        draw_scatter(pen, _SCATTER, result.stretches, limits)
        _draw_legend(pen, scale)
    words = "marks: the drive, with its 80 % error"
    if view is not None:
        words = f"line and grey: ride cost of the map, with its 80 % interval; {words}"
    pen.text((_ALONG_LEFT, top - 15), words, INK, size=15)
    draw_along(pen, Box(_ALONG_LEFT, top, WIDTH - _EDGE - _ALONG_LEFT, _ALONG), result.stretches)
    return pen.finished()


def view_of(ground: CheckGround, points: NDArray[np.float64]) -> MapView:
    """Return the view around points, (n, 2) in metres, moved so that it shows as much of the map as it can."""
    view = MapView.around(ground.grid, points, _PANEL, _PANEL_HEIGHTS)
    bounds, metres = ground.grid.window_bounds(ground.window), view.metres
    west = _moved(view.west, view.width * metres, (bounds.west, bounds.east))
    south = _moved(view.north - view.height * metres, view.height * metres, (bounds.south, bounds.north))
    moved = replace(view, west=west, north=south + view.height * metres)
    shown = moved.pixels(points)
    inside = (shown >= 0).all() and (shown <= [view.width, view.height]).all()
    return moved if inside else view


def _moved(start: float, length: float, ends: tuple[float, float]) -> float:
    """Return the start of a span, moved so that it lies within two ends, or around their middle if it is longer."""
    low, high = ends
    return (low + high - length) / 2 if length > high - low else min(max(start, low), high - length)


def _draw_title(pen: Pen, result: CheckResult) -> None:
    agreement = result.agreement
    if agreement is None or result.ground is None:
        way = float(np.sum(result.stretches.way_m))
        pen.text((_EDGE, 28), f"Ride cost measured over {metres(way)}", INK, size=24)
        mean = measured_mean(result.stretches)
        text = f"{mean:.3f} rad/m on average" if np.isfinite(mean) else "nothing was measured"
        pen.text((_EDGE, 58), text, FAINT, size=16)
        return
    name = _shortened(result.ground.name, 40)
    pen.text((_EDGE, 28), f"{name}: {check_verdict(result)}", INK, size=24)
    rank = f", Spearman {agreement.spearman:.2f}" if np.isfinite(agreement.spearman) else ""
    line = (
        f"{metres(agreement.way_m)} in {agreement.stretches} stretches: the map {level_words(agreement)} (median), "
        f"median error {percent(agreement.median_error)}{rank}, {percent(agreement.inside)} in its 80 % interval"
    )
    pen.text((_EDGE, 58), line, FAINT, size=16)


def _shortened(name: str, most: int) -> str:
    """Return a name in one line that can be drawn: bytes that are not text become escapes."""
    plain = " ".join(name.encode("utf-8", "backslashreplace").decode().split())
    return plain if len(plain) <= most else f"{plain[: most - 3]}..."


def _draw_map(pen: Pen, result: CheckResult, ground: CheckGround, view: MapView) -> RideScale:
    colours, scale = paint_ground(ground, view)
    pale = np.rint(255.0 + _PALE * (colours.astype(np.float64) - 255.0)).astype(np.uint8)
    pen.paste(_EDGE, _TITLE, pale)
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    corner = np.array([_EDGE, _TITLE], np.float64)
    points = view.pixels(np.column_stack([stretches.easting, stretches.northing])) + corner
    order = np.argsort(np.nan_to_num(offset.beyond, posinf=np.inf), kind="stable")  # what is off lies on top
    for at in order[np.isfinite(points[order]).all(axis=1)].tolist():
        place = (float(points[at, 0]), float(points[at, 1]))
        draw_disc(pen, place, int(offset.kind[at]), off=bool(offset.is_off[at]))
    draw_scale(pen, view, _EDGE, _TITLE)
    draw_north(pen, (_EDGE + view.width - 36, _TITLE + 44))
    pen.rectangle((_EDGE, _TITLE, _EDGE + view.width, _TITLE + view.height), None, FAINT)
    return scale


def _draw_legend(pen: Pen, scale: RideScale) -> None:
    left, row = _SCATTER.left - 60, _SCATTER.bottom + 78
    for kind, text in enumerate(OFF_KINDS):
        draw_disc(pen, (left + 10, row), kind, off=False)
        words = text if kind != NOT_COMPARED else "not compared: off the map, or under the sensor's floor"
        pen.text((left + 30, row), words, INK, size=15)
        row += 24
    draw_disc(pen, (left + 10, row + 4), 3, off=True)
    pen.text((left + 30, row + 4), "large: errors do not explain the difference", INK, size=15)
    row += 28
    pen.text((left + 30, row), "thin lines above: map and drive differ by a factor of 1.5", FAINT, size=14)
    row += 34
    pen.text((left, row), "under them: ride cost of the map [rad/m]", INK, size=15)
    bar = np.broadcast_to(scale.colours(np.linspace(0.0, scale.end, 260)), (16, 260, 3))
    pen.paste(round(left), round(row + 14), np.rint(255.0 + _PALE * (bar - 255.0)).astype(np.uint8))
    step = tick_step(scale.end, 5)
    for value in np.arange(0.0, scale.end * 1.001, step).tolist():
        pen.text((left + 260 * value / scale.end, row + 42), f"{value:g}", FAINT, size=14, anchor="mm")
    pen.text((left + 268, row + 22), "and more", FAINT, size=14)
