"""What stands in every map of a picture: the scale bar and the arrow to the north."""

from bumpymap.layers.route._chart import FAINT, INK
from bumpymap.layers.route._pen import Pen, bar_length
from bumpymap.layers.route._relief import MapView

__all__ = ["draw_north", "draw_scale"]

_WHITE = (255, 255, 255)


def draw_scale(pen: Pen, view: MapView, left_edge: float, top_edge: float) -> None:
    """Draw the scale bar at the lower left of a panel: a round length, a fifth of the panel at most."""
    metres = bar_length(view.width * view.metres / 5)
    length, left, bottom = metres / view.metres, left_edge + 20.0, top_edge + view.height - 22.0
    pen.rectangle((left - 10, bottom - 34, left + length + 10, bottom + 12), _WHITE, FAINT)
    for part, fill in ((0, INK), (1, _WHITE)):
        start = left + part * length / 2
        pen.rectangle((start, bottom - 6, start + length / 2, bottom + 2), fill, INK)
    text = f"{metres:g} m" if metres < 1000 else f"{metres / 1000:g} km"
    pen.text((left + length / 2, bottom - 20), text, INK, size=16, anchor="mm")


def draw_north(pen: Pen, place: tuple[float, float]) -> None:
    """Draw an arrow to the north of the grid, which is up."""
    x, y = place
    pen.disc((x, y), 27, _WHITE, FAINT)
    pen.polygon([(x, y - 22), (x + 9, y + 6), (x, y), (x - 9, y + 6)], INK)
    pen.text((x, y + 15), "N", INK, size=15, anchor="mm")
