"""The ground under a route in a picture: shaded relief, the ride cost in colour, barred and unknown tiles."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_TILE, Barred
from bumpymap.layers._box_sum import box_sum
from bumpymap.layers.ride_scale import RideScale
from bumpymap.layers.route.source import MapSource
from bumpytiles import Grid, TileWindow

__all__ = [
    "BARRED_SHADE",
    "HATCH",
    "NO_DATA",
    "UNKNOWN_SHADE",
    "MapView",
    "Pixels",
    "hatched",
    "paint_ground",
]

Pixels = NDArray[np.uint8]
BARRED_SHADE, HATCH, UNKNOWN_SHADE, NO_DATA = (222, 219, 213), (112, 108, 102), (168, 172, 184), (250, 250, 250)
"""Colours of barred ground and its hatching, of unknown ground, and where nothing was measured."""
_HATCH_PERIOD, _HATCH_WIDTH = 9, 1
_STRIP_TILES = 4_000_000
"""Most tiles to read at a time."""
_DARKEST = (0.45, 0.62)
"""Brightness of ground that faces away from the light: passable, and other ground, which stays in the background."""
_TYPICAL_GRADIENT = 0.35
_EXAGGERATION = (0.5, 6.0)
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


def paint_ground(source: MapSource, view: MapView) -> tuple[Pixels, RideScale]:
    """Paint the ground.

    Returns
    -------
    uint8 (height, width, 3)
    RideScale
        The scale of the colours of passable ground.
    """
    barred, c_r = _sample(source, view)
    passable = barred == Barred.NO
    scale = RideScale.of(next(iter(source.manifests), {}), c_r[passable])
    colour = scale.colours(np.where(passable, c_r, 0.0))
    colour[~passable] = BARRED_SHADE
    colour[barred == Barred.UNKNOWN] = UNKNOWN_SHADE
    darkest = np.where(passable, *_DARKEST)
    colour *= (darkest + (1 - darkest) * _shade(source, view))[:, :, None]
    colour[barred == NO_TILE] = NO_DATA
    closed = ~passable & (barred != Barred.UNKNOWN) & (barred != NO_TILE)
    colour[closed & hatched(view.height, view.width)] = HATCH
    return np.clip(colour, 0, 255).astype(np.uint8), scale


def hatched(height: int, width: int) -> NDArray[np.bool_]:
    """Return which pixels of a panel lie on the lines of the hatching, (height, width)."""
    across = np.arange(height)[:, None] + np.arange(width)[None, :]
    return np.asarray(across % _HATCH_PERIOD < _HATCH_WIDTH, dtype=np.bool_)


def _sample(source: MapSource, view: MapView) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Return what bars the tile in the middle of each pixel, and its ride cost, (height, width) each."""
    barred = np.empty((view.height, view.width), np.uint8)
    c_r = np.empty(barred.shape, np.float32)
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
    return barred, c_r


def _shade(source: MapSource, view: MapView) -> NDArray[np.float64]:
    """Return how bright the light from the north-west leaves each pixel, 0 to 1, (height, width)."""
    window, grid = view.window(), view.grid
    finest = grid.pixel_size
    step = max(view.metres, finest)
    shape = tuple(max(1, round(tiles * grid.tile_size / step)) for tiles in (window.rows, window.cols))
    heights = _fill(source.relief(window, (shape[0], shape[1])).astype(np.float64))
    down, right = (np.gradient(heights, axis=axis) if heights.shape[axis] > 1 else heights * 0.0 for axis in (0, 1))
    # m per m; rows and columns may differ a little in size, since both are whole numbers
    east = right / (window.cols * grid.tile_size / shape[1])
    north = -down / (window.rows * grid.tile_size / shape[0])
    steepness = np.hypot(east, north)
    known = steepness[np.isfinite(steepness)]
    typical = float(np.quantile(known, 0.9)) if len(known) else _TYPICAL_GRADIENT
    factor = np.clip(_TYPICAL_GRADIENT / max(typical, 1e-6), *_EXAGGERATION)
    east, north = east * factor, north * factor
    # Normal (-east, -north, 1) on the light (-1, 1, sqrt(2)) / 2 from the north-west, 45 degrees up; flat ground: 0.71.
    light = (east - north + np.sqrt(2.0)) / 2 / np.sqrt(1 + east**2 + north**2)
    light = np.where(np.isfinite(light), np.clip(light, 0.0, 1.0), np.sqrt(0.5))
    bounds = grid.window_bounds(window)
    row = (bounds.north - view.northings) / (bounds.north - bounds.south) * shape[0]
    column = (view.eastings - bounds.west) / (bounds.east - bounds.west) * shape[1]
    place = np.ix_(*(np.clip(at.astype(np.int64), 0, n - 1) for at, n in ((row, shape[0]), (column, shape[1]))))
    return np.asarray(light[place], dtype=np.float64)


def _fill(heights: NDArray[np.float64]) -> NDArray[np.float64]:
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
