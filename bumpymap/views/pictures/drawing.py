"""Drawing of pictures of routes: smooth lines, shaded ground under them, the profile, scale and north arrow.

Edges are smooth because everything is drawn at twice its size and averaged at the end.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from bumpymap.core import CROSSING_UNKNOWN, NO_TILE, OBSTACLE, OPEN_THROUGH
from bumpymap.layers import (
    CLOSED_COLOUR,
    MID_GREY,
    OBJECT_COLOURS,
    STEP_LINE,
    UNKNOWN_COLOUR,
    RideScale,
    box_sum,
    first_island,
    on_islands,
)
from bumpytiles import Grid, TileWindow

if TYPE_CHECKING:
    from bumpymap.core import RouteProfile
    from bumpymap.layers import MapReader

Colour = tuple[int, int, int]
_TWICE = 2
"""Pixels that are drawn along each pixel of the finished picture."""


@lru_cache(maxsize=16)
def font(size: int) -> ImageFont.FreeTypeFont:
    """Return Pillow's own font with Pillow's own layout engine, so that pixels are the same on every machine."""
    found = ImageFont.load_default(size)
    if not isinstance(found, ImageFont.FreeTypeFont):
        raise TypeError("this Pillow was built without FreeType")
    return found.font_variant(layout_engine=ImageFont.Layout.BASIC)


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
        self, place: tuple[float, float], text: str, colour: Colour, *, size: int = 16, anchor: str = "lm"
    ) -> None:
        """Write one line; ``anchor`` as Pillow names it."""
        self._draw.text((place[0] * _TWICE, place[1] * _TWICE), text, colour, font(size * _TWICE), anchor)

    def upright_text(self, place: tuple[float, float], text: str, colour: Colour, size: int) -> None:
        """Write one line from bottom to top, its middle at a point."""
        left, top, right, bottom = font(size * _TWICE).getbbox(text)
        lying = Image.new("L", (math.ceil(right - left) + 4, math.ceil(bottom - top) + 4))
        ImageDraw.Draw(lying).text((2 - left, 2 - top), text, 255, font(size * _TWICE))
        upright = lying.transpose(Image.Transpose.ROTATE_90)
        corner = (round(place[0] * _TWICE - upright.width / 2), round(place[1] * _TWICE - upright.height / 2))
        self._sheet.paste(colour, corner, upright)


def shortened(name: str, most: int) -> str:
    """Return a name, cut to at most ``most`` characters."""
    return name if len(name) <= most else f"{name[: most - 3]}..."


def bar_length(most: float) -> float:
    """Return the largest of 1, 2 and 5 times a power of ten that is not above ``most``."""
    power = 10.0 ** math.floor(math.log10(most))
    return next(step for step in (10 * power, 5 * power, 2 * power, power) if step <= most * (1 + 1e-9))


def ticks(low: float, high: float, most: int) -> tuple[list[float], int]:
    """Return round numbers from low to high (low < high), and the decimals that tell them apart.

    They are multiples of 1, 2 or 5 times a power of ten, with at most ``most`` steps.
    """
    least = (high - low) / most
    power = 10.0 ** math.floor(math.log10(least))
    step = next(step for step in (power, 2 * power, 5 * power, 10 * power) if step >= least * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)], max(0, -math.floor(math.log10(step) + 1e-9))


Pixels = NDArray[np.uint8]
NO_DATA = (255, 255, 255)
"""Colour of ground without points."""
_STRIP_TILES = 4_000_000
"""Most tiles to read at a time."""
_TYPICAL_GRADIENT = 0.35
"""Gradient that the steepest tenth of the relief is brought to: chosen, hills of 19 degrees."""
_EXAGGERATION = (0.5, 6.0)
"""Least and largest factor on the gradients: chosen."""
DETAIL = 0.7
"""Opacity of photo and relief in hard light over the colours of a map: chosen."""
_GAIN = (0.6, 2.0)
"""Least and largest factor on the brightness of a photo, so that dark and pale ones are levelled alike: chosen."""
SATURATION = 0.75
"""Share of its colours that a photo keeps: chosen."""
CONTRAST = 0.7
"""Share of its contrast that a photo keeps: bright ground must not look unknown, nor dark ground black. Chosen."""
LEVEL = math.sqrt(0.5)
"""Brightness of level ground; see `light_of`."""
_GAPS = (1, 3, 7)
"""Half widths of the boxes from which holes in the relief are filled, pixels."""


@dataclass(frozen=True, slots=True)
class MapView:
    """The part of the grid that a panel shows."""

    grid: Grid
    west: float
    """Easting of the left edge, m."""
    north: float
    """Northing of the top edge, m."""
    metres: float
    """Side of a pixel, m."""
    width: int
    """Pixels."""
    height: int
    """Pixels."""

    @classmethod
    def around(cls, grid: Grid, points: NDArray[np.float64], width: int, heights: tuple[int, int]) -> "MapView":
        """Return the view around points, (n, 2) in metres, with a margin of an eighth and of 5 tiles.

        The panel is ``width`` pixels wide; its height, between the two ``heights``, fits the points.
        """
        low, high = points.min(axis=0), points.max(axis=0)
        size = high - low
        size = size + 2 * np.maximum(size.max() / 8, 5 * grid.tile_size)
        height = int(np.clip(round(width * size[1] / size[0]), *heights))
        metres = float(max(size[0] / width, size[1] / height))
        middle = (low + high) / 2
        west, north = middle[0] - metres * width / 2, middle[1] + metres * height / 2
        return cls(grid, float(west), float(north), metres, width, height)

    def pixels(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points, (n, 2) in metres, lie: (n, 2) pixels right and down."""
        return np.column_stack([points[:, 0] - self.west, self.north - points[:, 1]]) / self.metres

    @property
    def eastings(self) -> NDArray[np.float64]:
        """(width,) middles of the columns, m."""
        return np.asarray(self.west + self.metres * (np.arange(self.width) + 0.5), dtype=np.float64)

    @property
    def northings(self) -> NDArray[np.float64]:
        """(height,) middles of the rows, m."""
        return np.asarray(self.north - self.metres * (np.arange(self.height) + 0.5), dtype=np.float64)

    def window(self, rows: slice = slice(None)) -> TileWindow:
        """Return the tiles under some rows of pixels."""
        cols, lines = self.grid.index(self.eastings[[0, -1]]), self.grid.index(self.northings[rows][[0, -1]])
        return TileWindow.around(cols, lines)


def levelled(photo: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return a photo with its median brightness at ``MID_GREY``, paler; (rows, cols, 3) from 0 to 255, NaN as given."""
    paler = gain_of(photo) * (SATURATION * photo + (1 - SATURATION) * grey_of(photo))
    return np.clip(MID_GREY + CONTRAST * (paler - MID_GREY), 0, 255)


def gain_of(photo: NDArray[np.floating]) -> float:
    """Return the factor on a photo, (..., 3), that brings its median brightness to ``MID_GREY``; NaN does not count."""
    grey = grey_of(photo)
    known = np.isfinite(grey)
    brightness = float(np.median(grey[known])) if known.any() else float(MID_GREY)
    return float(np.clip(MID_GREY / max(brightness, 1.0), *_GAIN))


def grey_of(colours: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return the brightness of colours, (..., 3), as (..., 1): ITU-R BT.601."""
    red, green, blue = np.moveaxis(colours, -1, 0)
    return np.asarray(0.299 * red + 0.587 * green + 0.114 * blue)[..., None]


def hard_light(colours: NDArray[np.floating], light: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return colours, (..., 3) from 0 to 255, in the light of a photo or relief at ``DETAIL`` opacity.

    Where the light is ``MID_GREY`` the colours stay. W3C, Compositing and Blending Level 1, "hard-light"; so do QGIS
    and browsers.
    """
    below, above = colours / 255.0, np.nan_to_num(light, nan=float(MID_GREY)) / 255.0
    mixed = np.where(above <= 0.5, 2 * below * above, 1 - 2 * (1 - below) * (1 - above))
    return np.asarray(255.0 * (below + DETAIL * (mixed - below)))


def paint_ground(source: "MapReader", view: MapView) -> tuple[Pixels, RideScale]:
    """Paint the ground: what can be driven in the colours of the ride cost, the rest muted.

    Returns uint8 (height, width, 3); the scale of the colours.
    """
    barred, c_r, island = _sample(source, view)
    shape, place = _finest(view)
    window, tile = view.window(), view.grid.tile_size
    fits = source.passage(window, shape)[place]
    passable = np.isin(barred, OPEN_THROUGH) & np.isfinite(c_r) & fits
    unknown = ~passable & np.isin(barred, CROSSING_UNKNOWN)
    obstacle = np.isin(source.objects(window, shape)[place], (OBSTACLE, STEP_LINE)) & ~unknown
    scale = RideScale.of(source.manifest)
    colour = scale.colours(np.where(passable, c_r, 0.0))
    colour[island] = on_islands(colour[island])
    colour[~passable] = CLOSED_COLOUR[:3]
    colour[unknown] = UNKNOWN_COLOUR[:3]
    colour[obstacle] = OBJECT_COLOURS[OBSTACLE][:3]
    heights = fill_gaps(source.relief(window, shape).astype(np.float64))
    # rows and columns may differ a little in size, since both are whole numbers
    shade = light_of(heights, (window.rows * tile / shape[0], window.cols * tile / shape[1]))[place][..., None] / LEVEL
    light = MID_GREY * shade
    if (photo := source.photo(window, shape)) is not None:
        seen = levelled(photo[place])
        seen = np.where((passable & ~obstacle & ~island)[..., None], seen, grey_of(seen))
        light = np.where(np.isfinite(seen), seen * (1 - _SHADE + _SHADE * shade), light)
    colour = hard_light(colour, np.clip(light, 0, 255))
    colour[barred == NO_TILE] = NO_DATA
    return np.rint(np.clip(colour, 0, 255)).astype(np.uint8), scale


_SHADE = 0.35
"""Share of the relief in the light of a photo: chosen."""


def _finest(view: MapView) -> tuple[tuple[int, int], tuple[NDArray[np.int64], ...]]:
    """Return rows and columns in which a window is read for a view, and the place in them of each of its pixels."""
    window, grid = view.window(), view.grid
    step = max(view.metres, grid.pixel_size)
    rows, cols = (max(1, round(tiles * grid.tile_size / step)) for tiles in (window.rows, window.cols))
    bounds = grid.window_bounds(window)
    row = (bounds.north - view.northings) / (bounds.north - bounds.south) * rows
    column = (view.eastings - bounds.west) / (bounds.east - bounds.west) * cols
    place = np.ix_(*(np.clip(at.astype(np.int64), 0, n - 1) for at, n in ((row, rows), (column, cols))))
    return (rows, cols), place


def _sample(source: "MapReader", view: MapView) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.bool_]]:
    """Return what bars the tile in the middle of each pixel, its ride cost, and if it is an island: (height, width)."""
    barred = np.empty((view.height, view.width), np.uint8)
    c_r, island = np.empty(barred.shape, np.float32), np.zeros(barred.shape, np.bool_)
    first = first_island(source.manifest)
    whole = view.window()
    strips = max(1, -(-whole.cols * whole.rows // _STRIP_TILES))
    edges = np.linspace(0, view.height, min(strips, view.height) + 1).astype(int)
    col = view.grid.index(view.eastings)
    for start, stop in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        rows = slice(start, stop)
        window = view.window(rows)
        field = source.read(window, ("c_r",))
        line = window.row + window.rows - 1 - view.grid.index(view.northings[rows])
        place = np.ix_(line, col - window.col)
        barred[rows], c_r[rows] = field.barred[place], field.c_r[place]
        if first is not None:
            island[rows] = source.values(window, ("zone",))["zone"][place] >= first
    return barred, c_r, island


def light_of(heights: NDArray[np.floating], pixel: tuple[float, float]) -> NDArray[np.float64]:
    """Return how bright the light from the north-west, 45 degrees up, leaves the ground.

    ``heights`` float (rows, cols): m, north row first; NaN where unknown. Slopes are exaggerated until the steepest
    tenth looks like hills. ``pixel``: sides of a pixel down and to the right, m. Returns float64 (rows, cols): 0 to 1;
    ``LEVEL`` where the ground is level or not known.
    """
    down, east = (
        np.gradient(heights, axis=axis) / side if heights.shape[axis] > 1 else heights * 0.0
        for axis, side in enumerate(pixel)
    )
    north = -down
    steepness = np.hypot(east, north)
    known = steepness[np.isfinite(steepness)]
    typical = float(np.quantile(known, 0.9)) if len(known) else _TYPICAL_GRADIENT
    factor = np.clip(_TYPICAL_GRADIENT / max(typical, 1e-6), *_EXAGGERATION)
    east, north = east * factor, north * factor
    # Normal (-east, -north, 1) on the light (-1, 1, sqrt(2)) / 2; flat ground: 0.71.
    light = (east - north + np.sqrt(2.0)) / 2 / np.sqrt(1 + east**2 + north**2)
    return np.asarray(np.where(np.isfinite(light), np.clip(light, 0.0, 1.0), LEVEL), dtype=np.float64)


def fill_gaps(heights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fill holes with the mean of the heights around them; NaN stays where nothing is near."""
    for half in _GAPS:
        known = np.isfinite(heights)
        if known.all() or not known.any():
            break
        base = float(heights[known].mean())  # sums of small numbers lose no digits
        count = box_sum(known.astype(np.float64), half)
        total = box_sum(np.where(known, heights - base, 0.0), half)
        near = ~known & (count > 0.5)
        heights = heights.copy()
        heights[near] = total[near] / count[near] + base
    return heights


INK, FAINT, GRID, INTERVAL = (28, 30, 34), (92, 96, 104), (226, 228, 232), (196, 200, 208)
"""Colours of texts, of quieter ones and frames, of the lines of a chart, and of an interval."""
_LEAST_RELIEF_M = 2.0
"""Least span of the height axis, m: a level way must not look like mountains."""
_LEAST_LENGTH_M = 1.0
"""Least length of the axis of distance, m: a way of length 0 has none."""
_FILL = 0.75
"""Opacity of the colours under the profile: chosen."""


@dataclass(frozen=True, slots=True)
class _Axes:
    """A rectangle of the picture, pixels, and the values at its sides."""

    left: int
    top: int
    width: int
    height: int
    far: float
    """Distance at the right side, m."""
    low: float
    """Value at the lower side."""
    high: float
    """Value at the upper side."""

    def points(self, distance: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points of a curve lie, (n, 2) pixels right and down."""
        return np.column_stack([self.left + distance / self.far * self.width, self.rows(values)])

    @property
    def distances(self) -> NDArray[np.float64]:
        """(width,) distance in the middle of each column of pixels, m."""
        return (np.arange(self.width) + 0.5) / self.width * self.far

    def rows(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return pixels down the picture of values."""
        share = np.clip((values - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.asarray(self.top + (1.0 - share) * self.height, dtype=np.float64)


def draw_profile(pen: Pen, profile: "RouteProfile", box: tuple[int, int, int, int], scale: RideScale) -> None:
    """Draw height over distance, filled with the colours of the ride cost, and the ride cost with its interval.

    ``box``: left, top, width and height of the drawing without its labels, pixels; they need 80 to the left, 50 below;
    ``scale``: the colours of the ride cost.
    """
    left, top, width, height = box
    split = round(height * 0.6)
    far = max(float(profile.distance[-1]), _LEAST_LENGTH_M)
    known = profile.z[np.isfinite(profile.z)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, _LEAST_RELIEF_M)
    room = max(high - low, _LEAST_RELIEF_M) * 0.12
    middle, half = (low + high) / 2, max(high - low, _LEAST_RELIEF_M) / 2
    ground = _Axes(left, top, width, split, far, middle - half - room, middle + half + room)
    ends = profile.c_r_high[np.isfinite(profile.c_r_high)]
    most = max(scale.end, float(np.quantile(ends, 0.98))) if len(ends) else scale.end
    ride = _Axes(left, top + split + 14, width, height - split - 14, far, 0.0, most * 1.05)
    _fill_ground(pen, ground, profile, scale)
    _frame(pen, ground, "height [m]", 4)
    _curve(pen, ground, profile.distance, profile.z)
    nearest = _nearest(profile, ride)
    upper, lower = (ride.rows(side[nearest]) - ride.top for side in (profile.c_r_high, profile.c_r_low))
    line = np.arange(ride.height)[:, None] + 0.5
    canvas: Pixels = np.full((ride.height, ride.width, 3), 255, np.uint8)
    canvas[(line >= upper[None, :]) & (line <= lower[None, :])] = INTERVAL
    pen.paste(ride.left, ride.top, canvas)
    _frame(pen, ride, "ride cost [rad/m]", 3)
    _curve(pen, ride, ride.distances, profile.c_r[nearest])
    _distances(pen, ride)
    if not len(known):
        pen.text((left + width / 2, top + split / 2), "heights along the way are not known", FAINT, anchor="mm")


def _frame(pen: Pen, axes: _Axes, label: str, most: int) -> None:
    right, bottom = axes.left + axes.width, axes.top + axes.height
    values, decimals = ticks(axes.low, axes.high, most)
    for value, row in zip(values, axes.rows(np.array(values)).tolist(), strict=True):
        pen.line(np.array([[axes.left, row], [right, row]]), GRID)
        pen.text((axes.left - 8, row), f"{value:,.{decimals}f}", FAINT, size=14, anchor="rm")
    pen.rectangle((axes.left, axes.top, right, bottom), None, FAINT)
    pen.upright_text((axes.left - 68, axes.top + axes.height / 2), label, INK, 15)


def _distances(pen: Pen, axes: _Axes) -> None:
    bottom = axes.top + axes.height
    unit, name = (1000.0, "km") if axes.far >= 5000.0 else (1.0, "m")
    values, decimals = ticks(0.0, axes.far / unit, 10)
    for value in values:
        place = axes.left + value * unit / axes.far * axes.width
        pen.line(np.array([[place, bottom], [place, bottom + 6]]), FAINT)
        pen.text((place, bottom + 17), f"{value:,.{decimals}f}", FAINT, size=14, anchor="mm")
    pen.text((axes.left + axes.width / 2, bottom + 40), f"distance along the way [{name}]", INK, size=15, anchor="mm")


def _fill_ground(pen: Pen, axes: _Axes, profile: "RouteProfile", scale: RideScale) -> None:
    """Fill the ground under the curve of the heights, each column in the colour of its ride cost."""
    # NaN on either side makes what lies between unknown too
    row = axes.rows(np.interp(axes.distances, profile.distance, profile.z)) - axes.top
    c_r = profile.c_r[_nearest(profile, axes)]
    colour = scale.colours(c_r)
    colour[np.isnan(c_r)] = UNKNOWN_COLOUR[:3]
    colour = 255.0 + _FILL * (colour - 255.0)
    canvas: Pixels = np.full((axes.height, axes.width, 3), 255, np.uint8)
    under = np.arange(axes.height)[:, None] + 0.5 >= row[None, :]  # False where the height is unknown
    canvas[under] = np.broadcast_to(colour.astype(np.uint8), canvas.shape)[under]
    pen.paste(axes.left, axes.top, canvas)


def _curve(pen: Pen, axes: _Axes, distance: NDArray[np.float64], values: NDArray[np.float64]) -> None:
    """Draw a curve, with gaps where values are NaN."""
    known = np.flatnonzero(np.isfinite(values))
    for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        if len(run) > 1:
            pen.line(axes.points(distance[run], values[run]), INK, 1.5)


def _nearest(profile: "RouteProfile", axes: _Axes) -> NDArray[np.int64]:
    """Return the point of a profile that is nearest to each column of pixels; points are evenly apart."""
    number = np.arange(len(profile.distance))
    return np.rint(np.interp(axes.distances, profile.distance, number)).astype(np.int64)


WHITE = (255, 255, 255)
"""Red, green and blue."""


def draw_swatch(pen: Pen, left: int, row: int, colour: Colour | Pixels) -> None:
    """Draw the colour of an entry of a legend, 40 x 24 pixels, with its frame."""
    pen.paste(left, row, np.broadcast_to(np.array(colour, np.uint8), (24, 40, 3)).copy())
    pen.rectangle((left, row, left + 40, row + 24), None, FAINT)


def draw_closed(pen: Pen, left: int, row: int) -> int:
    """Draw what a legend says about ground that ways do not use; return the row, pixels, below it."""
    swatches = (
        (CLOSED_COLOUR[:3], "cannot be crossed, or no room"),
        (OBJECT_COLOURS[OBSTACLE][:3], "obstacle"),
        (UNKNOWN_COLOUR[:3], "not known"),
        (NO_DATA, "no points"),
    )
    for colour, text in swatches:
        draw_swatch(pen, left, row, colour)
        pen.text((left + 54, row + 12), text, INK, size=16)
        row += 34
    return row


def draw_frame(pen: Pen, view: MapView, left: float, top: float) -> None:
    """Draw what a panel with a map has: scale bar, a fifth of it at most; an arrow to the north, which is up; frame."""
    metres = bar_length(view.width * view.metres / 5)
    length, start, bottom = metres / view.metres, left + 20.0, top + view.height - 22.0
    pen.rectangle((start - 10, bottom - 34, start + length + 10, bottom + 12), WHITE, FAINT)
    for part, fill in ((0, INK), (1, WHITE)):
        side = start + part * length / 2
        pen.rectangle((side, bottom - 6, side + length / 2, bottom + 2), fill, INK)
    text = f"{metres:g} m" if metres < 1000 else f"{metres / 1000:g} km"
    pen.text((start + length / 2, bottom - 20), text, INK, size=16, anchor="mm")
    x, y = left + view.width - 36, top + 44
    pen.disc((x, y), 27, WHITE, FAINT)
    pen.polygon([(x, y - 22), (x + 9, y + 6), (x, y), (x - 9, y + 6)], INK)
    pen.text((x, y + 15), "N", INK, size=15, anchor="mm")
    pen.rectangle((left, top, left + view.width, top + view.height), None, FAINT)
