"""The ground under the colours of a page: shaded relief, heights, and what stands on it."""

import base64
import io
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from PIL import Image
from rasterio.enums import Resampling
from rasterio.errors import RasterioError
from rasterio.windows import Window

from bumpymap.core import CANOPY, FREE, NO_CLASS, OBSTACLE, BadInputError
from bumpymap.layers.colours import UNKNOWN_OBJECT
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.report.tiles import PageTiles, Spot
from bumpymap.layers.sheets.folders import raster_in

__all__ = ["jpeg", "object_grid", "read_heights", "shade", "tile_heights"]

_STRIP_PIXELS = 16_000_000
"""Most pixels of obstacle.tif to read at a time."""
_NORTH_WEST = (-0.5, 0.5, 0.7071)
"""Where the light comes from: east, north, up."""
_TYPICAL = 0.35
"""Slope, m per m, that the steepest tenth of the ground is exaggerated to."""
_EXAGGERATION = (0.5, 6.0)
_FLAT = 0.84
"""Brightness where no height is known."""
_WORST = (FREE, CANOPY, UNKNOWN_OBJECT, OBSTACLE)
"""What wins in a pixel, each over those before it."""
_QUALITIES = (72, 55, 40, 25)
_AGAIN = "Map the survey again"


def finer(spot: Spot, side: int) -> int:
    """Return how many pixels a picture may have along each pixel of the page's grid, with at most ``side`` in all."""
    return 1 if spot.step > 1 else max(1, min(spot.pixels, side // max(spot.cols, spot.rows)))


def _halves(pixels: int) -> Iterator[int]:
    """Yield the pixels along a tile, half of them and so on to 1: what overviews hold, or a little less."""
    while pixels > 1:
        yield pixels
        pixels //= 2
    yield 1


def read_heights(folders: Sequence[Path], spot: Spot, side: int) -> NDArray[np.float32]:
    """Read heightmap.tif with at most ``side`` pixels along a side, or one for each pixel of the page's grid.

    GDAL averages its overviews. The rasters of sheets are read one by one, since between two that lie far apart a
    virtual raster has more pixels than can be averaged.

    Parameters
    ----------
    folders : sequence of Path
        The folder of the map, or those of its sheets.
    spot : Spot
        Where the whole map lies.
    side : int

    Returns
    -------
    float32
        Metres; NaN where there is no point.
    """
    factor = next(half for half in _halves(spot.pixels) if half <= finer(spot, side))
    shape = tuple(pixels * factor for pixels in spot.shape)
    total, weight = np.zeros(shape), np.zeros(shape)
    for folder in folders:
        path = folder / "heightmap.tif"
        try:
            with open_layer(path) as file:
                _add_heights(file, spot, factor, total, weight)
        except RasterioError as error:
            raise BadInputError(f"cannot read {path}: {error}. {_AGAIN}") from error
    return np.where(weight > 0, total / np.maximum(weight, 1.0), np.nan).astype(np.float32)


def _add_heights(
    file: rasterio.DatasetReader, spot: Spot, factor: int, total: NDArray[np.float64], weight: NDArray[np.float64]
) -> None:
    """Add mean heights times tiles to ``total``, and tiles to ``weight``, in the pixels that a raster covers."""
    left = round((file.transform.c * spot.unit - spot.west) / spot.tile_size)
    top = round((spot.north - file.transform.f * spot.unit) / spot.tile_size)
    for line, lines, rows in _spans(top, file.height // spot.pixels, spot.step):
        for column, columns, cols in _spans(left, file.width // spot.pixels, spot.step):
            size = cols * columns * spot.pixels, rows * lines * spot.pixels
            found = file.read(
                1,
                window=Window((column - left) * spot.pixels, (line - top) * spot.pixels, *size),
                out_shape=(lines * factor, columns * factor),
                resampling=Resampling.average,
            )
            row, col = line // spot.step * factor, column // spot.step * factor
            place = np.s_[row : row + lines * factor, col : col + columns * factor]
            known = np.isfinite(found)
            total[place] += np.where(known, found, np.float32(0)).astype(np.float64) * (rows * cols)
            weight[place] += known * (rows * cols)


def _spans(start: int, count: int, step: int) -> list[tuple[int, int, int]]:
    """Divide ``count`` tiles from ``start`` on, so that a part has whole pixels of ``step`` tiles, or lies in one.

    Returns
    -------
    list of tuple of int
        First tile, number of pixels, and tiles in each of them.
    """
    end = start + count
    whole = min(-(-start // step) * step, end), max(end // step * step, start)
    parts = []
    for first, last in pairwise(sorted({start, *whole, end})):
        pixels = max(1, (last - first) // step)
        parts.append((first, pixels, (last - first) // pixels))
    return parts


def tile_heights(heights: NDArray[np.float32], spot: Spot) -> NDArray[np.float32]:
    """Return mean heights on the page's grid, (rows, cols), NaN where there is none."""
    rows, cols = spot.shape
    blocks = heights.reshape(rows, heights.shape[0] // rows, cols, heights.shape[1] // cols)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, np.float32(0)).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def shade(heights: NDArray[np.float32], metres: float) -> NDArray[np.uint8]:
    """Return how bright the light from the north-west leaves each pixel of ``metres``, 0 to 255."""
    if min(heights.shape) < 2:
        return np.full(heights.shape, round(255 * _FLAT), np.uint8)
    down, east = (np.asarray(np.gradient(heights, metres, axis=axis), np.float32) for axis in (0, 1))
    steep: NDArray[np.float32] = np.hypot(east[::3, ::3], down[::3, ::3])
    few = steep[np.isfinite(steep)]
    typical = float(np.quantile(few, 0.9)) if len(few) else _TYPICAL
    factor = np.float32(np.clip(_TYPICAL / max(typical, 1e-6), *_EXAGGERATION))
    east *= factor
    down *= factor
    light = (-_NORTH_WEST[0] * east + _NORTH_WEST[1] * down + _NORTH_WEST[2]) / np.sqrt(1 + east * east + down * down)
    bright = np.nan_to_num(np.clip(light * (_FLAT / _NORTH_WEST[2]), 0.15, 1.0), nan=_FLAT)
    picture: NDArray[np.uint8] = np.rint(bright * 255).astype(np.uint8)
    return picture


def object_grid(folder: Path, tiles: PageTiles, side: int) -> NDArray[np.uint8]:
    """Return what stands on the ground: FREE, OBSTACLE, CANOPY or UNKNOWN_OBJECT, the worst in each pixel; else 255.

    It has at most ``side`` pixels along a side; on maps so large that each of them spans a tile or more, the tiles tell
    of obstacles alone.
    """
    spot = tiles.spot
    factor = finer(spot, side)
    if factor == 1:
        return tiles.objects
    rows, cols = spot.rows * factor, spot.cols * factor
    rank = np.zeros(256, np.uint8)
    rank[list(_WORST)] = np.arange(1, len(_WORST) + 1)
    canvas = np.empty((rows, cols), np.uint8)
    starts = np.arange(cols) * spot.pixels // factor
    lines = max(1, _STRIP_PIXELS // max(1, spot.cols * spot.pixels**2))  # tiles
    path = raster_in(folder, "obstacle.tif")
    try:
        with open_layer(path) as file:
            for top in range(0, spot.rows, lines):
                count = min(lines, spot.rows - top)
                window = Window(0, top * spot.pixels, file.width, count * spot.pixels)
                found = rank[file.read(1, window=window)]
                across = np.maximum.reduceat(found, starts, axis=1)
                down = np.arange(count * factor) * spot.pixels // factor
                canvas[top * factor : (top + count) * factor] = np.maximum.reduceat(across, down, axis=0)
    except RasterioError as error:
        raise BadInputError(f"cannot read {path}: {error}. {_AGAIN}") from error
    return np.array([NO_CLASS, *_WORST], np.uint8)[canvas]


def jpeg(picture: NDArray[np.uint8], most: int) -> tuple[str, tuple[int, int]]:
    """Return a picture as a data URI of at most ``most`` characters, and its width and height.

    It is stored more coarsely, then halved in size, until it fits.
    """
    image = Image.fromarray(picture)
    while True:
        for quality in _QUALITIES:
            buffer = io.BytesIO()
            image.save(buffer, "JPEG", quality=quality)
            text = "data:image/jpeg;base64," + base64.b64encode(buffer.getvalue()).decode()
            if len(text) <= most or max(image.size) <= 64:
                return text, image.size
        image = image.resize((max(1, image.width // 2), max(1, image.height // 2)))
