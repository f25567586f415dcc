"""The ground as pictures and pages show it: ride cost in the light of relief or photo; round numbers of scales."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

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
    from bumpymap.layers import MapReader


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


def paint_ground(source: "MapReader", view: MapView) -> tuple[NDArray[np.uint8], RideScale]:
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
