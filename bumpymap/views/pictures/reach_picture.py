"""Write reach.png: what can be reached from a start, in steps of minutes or of cost, on the shaded relief."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import atomic
from bumpymap.layers import MapSource, ReachField
from bumpymap.views.pictures.drawing import (
    FAINT,
    INK,
    Colour,
    MapView,
    Pen,
    draw_closed,
    draw_north,
    draw_scale,
    paint_ground,
    ticks,
)

__all__ = ["write_reach_picture"]

_COLOURS: tuple[Colour, ...] = (
    *((253, 231, 37), (122, 209, 81), (34, 168, 132)),
    *((42, 120, 142), (65, 68, 135), (68, 1, 84)),
)
"""Of the steps, from the start outwards."""
_WIDTH, _EDGE, _PANEL, _HEIGHTS, _TITLE = 1600, 24, 1200, (520, 1100), 56
_STRENGTH = 0.55
"""Of the colours over the ground."""
_UNITS = {"cost": "m of cost", "minutes": "min"}


def write_reach_picture(
    reach: ReachField, source: MapSource, start: NDArray[np.float64], path: Path, *, levels: Sequence[float], by: str
) -> None:
    """Draw what can be reached and write the picture as PNG, 1600 pixels wide.

    Parameters
    ----------
    reach : ReachField
    source : MapSource
        The map under it.
    start : array (2,)
        Easting and northing, m.
    path : Path
        The file, which appears only when it is complete.
    levels : sequence of float
        Upper ends of the steps, minutes or m of cost; none: round ones are chosen.
    by : str
        ``cost`` or ``minutes``.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The layers cannot be read.
    """
    values = reach.minutes if by == "minutes" and reach.minutes is not None else reach.cost
    highest = float(np.nanmax(values, initial=0.0))
    steps = sorted(set(levels)) or [step for step in ticks(0.0, max(highest, 1.0), len(_COLOURS) - 1)[0] if step > 0.0]
    row, col = np.nonzero(values <= steps[-1]) if (values <= steps[-1]).any() else np.nonzero(np.isfinite(values))
    size, window = reach.grid.tile_size, reach.window
    corners = np.column_stack([window.col + col + 0.5, window.row + window.rows - row - 0.5]) * size
    view = MapView.around(reach.grid, np.concatenate([corners, start[None]]), _PANEL, _HEIGHTS)
    ground, _ = paint_ground(source, view)
    at_row = window.row + window.rows - 1 - reach.grid.index(view.northings)
    at_col = reach.grid.index(view.eastings) - window.col
    inside = np.ix_((at_row >= 0) & (at_row < window.rows), (at_col >= 0) & (at_col < window.cols))
    shown = np.full(ground.shape[:2], np.nan)
    shown[inside] = values[np.ix_(at_row[inside[0][:, 0]], at_col[inside[1][0]])]
    step = np.searchsorted(steps, shown)  # NaN comes after all
    palette = np.array([_COLOURS[round(n * (len(_COLOURS) - 1) / max(len(steps) - 1, 1))] for n in range(len(steps))])
    reached = step < len(steps)
    ground[:] = ground.mean(axis=-1, keepdims=True)
    ground[reached] = (1.0 - _STRENGTH) * ground[reached] + _STRENGTH * palette[step[reached]]
    pen = Pen(_WIDTH, _TITLE + view.height + _EDGE)
    pen.text((_EDGE, _TITLE / 2 + 2), "what can be reached from the start", INK, size=24)
    pen.paste(_EDGE, _TITLE, ground)
    x, y = (view.pixels(start[None])[0] + (_EDGE, _TITLE)).tolist()
    pen.disc((x, y), 13, (255, 255, 255), (0, 0, 0))
    pen.text((x, y), "S", (0, 0, 0), size=15, anchor="mm")
    draw_scale(pen, view, _EDGE, _TITLE)
    draw_north(pen, (_EDGE + view.width - 36, _TITLE + 44))
    pen.rectangle((_EDGE, _TITLE, _EDGE + view.width, _TITLE + view.height), None, FAINT)
    left, top = _EDGE + _PANEL + 24, _TITLE + 12
    for number, (upper, colour) in enumerate(zip(steps, palette, strict=True)):
        inside_m2 = float((values <= upper).sum()) * size**2
        place = top + 40 * number
        pen.paste(left, place, np.broadcast_to(colour.astype(np.uint8), (24, 40, 3)).copy())
        pen.rectangle((left, place, left + 40, place + 24), None, FAINT)
        pen.text((left + 54, place + 5), f"within {upper:g} {_UNITS[by]}", INK, size=16)
        pen.text((left + 54, place + 23), f"{inside_m2 / 1e4:,.2f} ha", FAINT, size=14)
    draw_closed(pen, left, top + 40 * len(steps) + 12)
    with atomic(path) as temporary:
        pen.finished().save(temporary, "PNG", compress_level=4)
