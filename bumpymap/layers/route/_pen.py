"""Draw with smooth edges: everything is drawn at twice its size and averaged at the end."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from bumpymap.layers._font import font

__all__ = ["Colour", "Pen", "bar_length", "tick_step", "ticks"]

Colour = tuple[int, int, int]
_TWICE = 2


class Pen:
    """Draws on a white sheet. Coordinates are pixels of the finished picture, to the right and down."""

    def __init__(self, width: int, height: int) -> None:
        self._sheet = Image.new("RGB", (width * _TWICE, height * _TWICE), "white")
        self._draw = ImageDraw.Draw(self._sheet)

    def finished(self) -> Image.Image:
        """Return the picture."""
        return self._sheet.reduce(_TWICE)

    def paste(self, left: int, top: int, pixels: NDArray[np.uint8]) -> None:
        """Paint an array (rows, columns, 3) with its top left corner at a point."""
        size = (pixels.shape[1] * _TWICE, pixels.shape[0] * _TWICE)
        whole = Image.fromarray(pixels).resize(size, Image.Resampling.NEAREST)
        self._sheet.paste(whole, (left * _TWICE, top * _TWICE))

    def line(self, points: NDArray[np.float64], colour: Colour, width: float = 1.0) -> None:
        """Draw a line through points, (n, 2)."""
        xy = [tuple(point) for point in (points * _TWICE).tolist()]
        thick = max(1, round(width * _TWICE))
        self._draw.line(xy, colour, thick, joint="curve")
        if thick > 3:  # round ends
            for x, y in (xy[0], xy[-1]):
                self._draw.ellipse((x - thick / 2, y - thick / 2, x + thick / 2, y + thick / 2), colour)

    def polygon(self, points: Sequence[tuple[float, float]], fill: Colour, outline: Colour | None = None) -> None:
        """Fill a polygon."""
        self._draw.polygon([(x * _TWICE, y * _TWICE) for x, y in points], fill, outline, width=_TWICE)

    def rectangle(self, box: tuple[float, float, float, float], fill: Colour | None, outline: Colour | None) -> None:
        """Draw a rectangle: left, top, right, bottom."""
        left, top, right, bottom = (round(side * _TWICE) for side in box)
        self._draw.rectangle((left, top, right - 1, bottom - 1), fill, outline, width=_TWICE)

    def disc(self, centre: tuple[float, float], radius: float, fill: Colour, outline: Colour) -> None:
        """Draw a disc with an outline of 2 pixels."""
        x, y = centre[0] * _TWICE, centre[1] * _TWICE
        r = radius * _TWICE
        self._draw.ellipse((x - r, y - r, x + r, y + r), fill, outline, width=2 * _TWICE)

    def text(
        self,
        place: tuple[float, float],
        text: str,
        colour: Colour,
        *,
        size: int = 16,
        anchor: str = "lm",
        halo: Colour | None = None,
    ) -> None:
        """Write one line; ``anchor`` as Pillow names it, ``halo`` the colour of an outline of 2 pixels."""
        self._draw.text(
            (place[0] * _TWICE, place[1] * _TWICE),
            text,
            colour,
            font(size * _TWICE),
            anchor,
            stroke_width=2 * _TWICE if halo else 0,
            stroke_fill=halo,
        )

    def upright_text(self, place: tuple[float, float], text: str, colour: Colour, size: int = 16) -> None:
        """Write one line from bottom to top, its middle at a point."""
        left, top, right, bottom = font(size * _TWICE).getbbox(text)
        lying = Image.new("L", (math.ceil(right - left) + 4, math.ceil(bottom - top) + 4))
        ImageDraw.Draw(lying).text((2 - left, 2 - top), text, 255, font(size * _TWICE))
        upright = lying.transpose(Image.Transpose.ROTATE_90)
        corner = (round(place[0] * _TWICE - upright.width / 2), round(place[1] * _TWICE - upright.height / 2))
        self._sheet.paste(colour, corner, upright)


def tick_step(span: float, most: int) -> float:
    """Return the smallest of 1, 2 and 5 times a power of ten that divides a span into at most ``most`` steps."""
    least = span / most
    power = 10.0 ** math.floor(math.log10(least))
    return next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= least * (1 - 1e-9))


def bar_length(most: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above ``most``."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(step for step in (10 * power, 5 * power, 2 * power, power) if step <= most * (1 + 1e-9))


def ticks(low: float, high: float, most: int) -> tuple[list[float], int]:
    """Return round numbers from low to high (low < high), and the decimals that tell them apart."""
    step = tick_step(high - low, most)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)], max(0, -math.floor(math.log10(step) + 1e-9))
