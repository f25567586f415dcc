"""Write route.png: ways on the shaded relief, and the profile of the first; and reach.png: what can be reached."""

import math
from collections.abc import Sequence
from pathlib import Path
from textwrap import wrap

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Route, atomic, chance_text
from bumpymap.layers import ROUTE_COLOUR, MapReader, ReachField, RideScale, reach_colours, stop_roles
from bumpymap.views.pictures.drawing import (
    FAINT,
    INK,
    WHITE,
    MapView,
    Pen,
    draw_closed,
    draw_frame,
    draw_profile,
    draw_swatch,
    paint_ground,
    shortened,
    ticks,
)
from bumpymap.views.words import metres

WIDTH = 1600
"""Width of the picture, pixels."""
_PANEL, _PANEL_HEIGHTS = 1200, (520, 900)
"""Width of the map, and its least and largest height, pixels."""
_EDGE, _TITLE, _CHART, _CHART_LEFT, _BELOW = 24, 56, 300, 104, 70
"""Space left of the map, height of the title, height of the profile, space left of it and below it, pixels."""
_BAR = 250
"""Length of the bar of colours, pixels."""
_LETTERS = 38
"""Most letters of a line of figures in the legend."""


def write_route_picture(route: Route, source: MapReader, path: Path) -> None:
    """Draw a route on the map, the legend to its right, the profile below; write PNG, 1600 pixels wide.

    ``route``: on the grid of ``source``. Raises OutputError: the file cannot be written; BadInputError: the layers
    cannot be read.
    """
    view = MapView.around(route.grid, np.concatenate([route.line, route.stops]), _PANEL, _PANEL_HEIGHTS)
    ground, scale = paint_ground(source, view)
    pen = Pen(WIDTH, _TITLE + view.height + 40 + _CHART + _BELOW)
    title = f"{shortened(route.name, 80)}: {metres(route.figures.length_m)} for {route.vehicle.name}"
    pen.text((_EDGE, _TITLE / 2 + 2), title, INK, size=24)
    pen.paste(_EDGE, _TITLE, ground)
    corner = np.array([_EDGE, _TITLE], np.float64)
    _draw_way(pen, view.pixels(route.line) + corner)
    # S at the start, G at the goal, numbers between; where start and goal are one place, the start is on top
    marks = list(enumerate(zip(stop_roles(len(route.stops)), view.pixels(route.stops) + corner, strict=True)))
    for number, (role, (x, y)) in reversed(marks):
        _draw_stop(pen, (float(x), float(y)), role, number)
    draw_frame(pen, view, _EDGE, _TITLE)
    _draw_legend(pen, route, scale)
    top = _TITLE + view.height + 40
    draw_profile(pen, route.profile, (_CHART_LEFT, top, _EDGE + _PANEL - _CHART_LEFT, _CHART), scale)
    _draw_chart_notes(pen, route, top)
    _save(pen, path)


def _save(pen: Pen, path: Path) -> None:
    with atomic(path) as temporary:
        pen.finished().save(temporary, "PNG", compress_level=4)


def _draw_way(pen: Pen, points: NDArray[np.float64]) -> None:
    if len(points) > 1:
        pen.line(points, WHITE, 7)
        pen.line(points, ROUTE_COLOUR, 3.5)


def _draw_stop(pen: Pen, place: tuple[float, float], role: str, number: int = 1) -> None:
    fill = {"start": WHITE, "via": (255, 236, 170), "goal": (0, 0, 0)}[role]
    ink = WHITE if role == "goal" else (0, 0, 0)
    pen.disc(place, 13, fill, ink)
    label = str(number) if role == "via" else role[0].upper()
    pen.text(place, label, ink, size=15, anchor="mm")


def _draw_legend(pen: Pen, route: Route, scale: RideScale) -> None:
    left, row = _EDGE + _PANEL + 24, _TITLE
    pen.text((left, row + 8), "ride cost of the ground [rad/m]", INK, size=16)
    bar = np.broadcast_to(scale.colours(np.linspace(0.0, scale.end, _BAR)), (22, _BAR, 3)).astype(np.uint8)
    pen.paste(left, row + 24, bar)
    pen.rectangle((left, row + 24, left + _BAR, row + 46), None, FAINT)
    pen.text((left + _BAR + 8, row + 35), "and more", FAINT, size=14)
    values, decimals = ticks(0.0, scale.end, 5)
    for value in values:
        place = left + _BAR * value / scale.end
        pen.line(np.array([[place, row + 46.0], [place, row + 51.0]]), FAINT)
        pen.text((place, row + 60), f"{value:.{decimals}f}", FAINT, size=14, anchor="mm")
    row = draw_closed(pen, left, row + 92)
    row += 12
    # Where start and goal are one place, the mark of the goal lies under that of the start.
    is_round = (route.stops[0] == route.stops[-1]).all()
    marks = {"start": "start and goal"} if is_round else {"start": "start", "goal": "goal"}
    if len(route.stops) > 2:
        marks["via"] = "via"
    for role in ("start", "via", "goal"):
        if role in marks:
            _draw_stop(pen, (left + 20, row + 12), role)
            pen.text((left + 54, row + 12), marks[role], INK, size=16)
            row += 34
    _draw_figures(pen, route, left, row + 12)


def _draw_figures(pen: Pen, route: Route, left: int, row: int) -> None:
    figures = route.figures
    _draw_way(pen, np.array([[left + 3.0, row + 12.0], [left + 37.0, row + 12.0]]))
    pen.text((left + 54, row + 12), shortened(route.name, 32), INK, size=16)
    # on unknown ground, and over no length, the ride cost is not known
    ride = {"tiles": figures.c_r_mean, "line": figures.c_r_line, "most": figures.c_r_max}.items()
    known = ", ".join(f"{name} {value:.3f}" for name, value in ride if math.isfinite(value))
    lines = (
        f"{metres(figures.length_m)}, cost {figures.cost_m:,.0f} m",
        f"{known} rad/m" if known else "ride cost not known",
        *wrap(f"arrives {chance_text(figures.p_arrives)} {figures.seen.condition} (an estimate)", _LETTERS),
        *([f"touches obstacles on {figures.obstacle_m:.1f} m"] if figures.obstacle_m > 0.0 else []),
    )
    for place, text in enumerate(lines):
        pen.text((left + 54, row + 34 + 20 * place), text, FAINT, size=14)


def _draw_chart_notes(pen: Pen, route: Route, top: int) -> None:
    left = _EDGE + _PANEL + 24
    figures = route.figures
    lines = [
        ("height of the ground", INK),
        (f"climb {figures.climb_m:,.0f} m, descent {figures.descent_m:,.0f} m", FAINT),
        ("filled with the colour of the ride cost", FAINT),
    ]
    for number, (text, colour) in enumerate(lines):
        pen.text((left, top + 12 + 22 * number), text, colour, size=15)
    below = top + round(_CHART * 0.6) + 14
    pen.text((left, below + 12), "ride cost, with the 80 % interval", INK, size=15)
    pen.text((left, below + 34), "of each tile in grey", FAINT, size=15)


_STEPS = 5
"""Most colours of what can be reached, if no levels are given: chosen."""
_REACH_HEIGHTS, _REACH_STRENGTH = (520, 1100), 0.55
"""Heights of the panel, pixels, and strength of the colours over the ground."""


def write_reach_picture(
    reach: ReachField, source: MapReader, start: NDArray[np.float64], path: Path, *, levels: Sequence[float]
) -> None:
    """Draw what can be reached and write the picture as PNG, 1600 pixels wide.

    ``start`` (2,): easting and northing, m; ``levels``: upper ends of the steps, minutes; none: round ones are chosen.
    Raises OutputError: the file cannot be written; BadInputError: the layers cannot be read.
    """
    values = reach.minutes
    highest = float(np.nanmax(values, initial=0.0))
    steps = sorted(set(levels)) or [step for step in ticks(0.0, max(highest, 1.0), _STEPS)[0] if step > 0.0]
    row, col = np.nonzero(values <= steps[-1]) if (values <= steps[-1]).any() else np.nonzero(np.isfinite(values))
    grid, window = reach.placement.grid, reach.placement.window
    corners = np.column_stack([window.col + col + 0.5, window.row + window.rows - row - 0.5]) * grid.tile_size
    view = MapView.around(grid, np.concatenate([corners, start[None]]), _PANEL, _REACH_HEIGHTS)
    ground, _ = paint_ground(source, view)
    at_row = window.row + window.rows - 1 - grid.index(view.northings)
    at_col = grid.index(view.eastings) - window.col
    inside = np.ix_((at_row >= 0) & (at_row < window.rows), (at_col >= 0) & (at_col < window.cols))
    shown = np.full(ground.shape[:2], np.nan)
    shown[inside] = values[np.ix_(at_row[inside[0][:, 0]], at_col[inside[1][0]])]
    step = np.searchsorted(steps, shown)  # NaN comes after all
    palette = np.array(reach_colours(len(steps)))
    reached = step < len(steps)
    ground[:] = ground.mean(axis=-1, keepdims=True)
    ground[reached] = (1.0 - _REACH_STRENGTH) * ground[reached] + _REACH_STRENGTH * palette[step[reached]]
    pen = Pen(WIDTH, _TITLE + view.height + _EDGE)
    pen.text((_EDGE, _TITLE / 2 + 2), "what can be reached from the start", INK, size=24)
    pen.paste(_EDGE, _TITLE, ground)
    x, y = (view.pixels(start[None])[0] + (_EDGE, _TITLE)).tolist()
    _draw_stop(pen, (x, y), "start")
    draw_frame(pen, view, _EDGE, _TITLE)
    left, top = _EDGE + _PANEL + 24, _TITLE + 12
    for number, (upper, colour) in enumerate(zip(steps, palette, strict=True)):
        inside_m2 = float((values <= upper).sum()) * grid.tile_size**2
        place = top + 40 * number
        draw_swatch(pen, left, place, colour)
        pen.text((left + 54, place + 5), f"within {upper:g} min", INK, size=16)
        pen.text((left + 54, place + 23), f"{inside_m2 / 1e4:,.2f} ha", FAINT, size=14)
    draw_closed(pen, left, top + 40 * len(steps) + 12)
    _save(pen, path)
