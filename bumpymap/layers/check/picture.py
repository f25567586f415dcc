"""Write check.png: the stretches on the map, coloured by how far it is off, and charts of map against drive."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bumpymap.core import CheckResult, atomic
from bumpymap.layers.check._plots import Box, draw_along, draw_disc, draw_scatter
from bumpymap.layers.check.ground import CheckGround
from bumpymap.layers.check.offset import NOT_COMPARED, OFF_KINDS, MapOffset
from bumpymap.layers.check.words import check_verdict, level_words, measured_mean, metres, percent
from bumpymap.layers.ride_scale import RideScale
from bumpymap.layers.route._chart import FAINT, INK
from bumpymap.layers.route._pen import Pen, tick_step
from bumpymap.layers.route._relief import MapView, paint_ground
from bumpymap.layers.route.frame import draw_north, draw_scale

__all__ = ["paint_check", "view_of", "write_check_picture"]

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
