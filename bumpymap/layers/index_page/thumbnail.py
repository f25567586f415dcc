"""A small picture of a map: the class of its tiles over the relief, unknown ground grey."""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bumpymap.core import NO_CLASS, Barred
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS
from bumpymap.layers.remote_folder import RemoteFolder, open_raster

__all__ = ["read_thumbnail"]

_SIDES = ((96, 48), (96, 24), (64, 24), (48, 16), (32, 12))
"""Pixels of the longer side and colours: the first that fits is taken."""
_LIGHT = (-0.5, 0.5, 0.7071)
"""Towards the sun in the north-west, 45 degrees high: east, north, up."""
_DARKEST, _BRIGHTEST = 0.45, 1.2


def read_thumbnail(folder: Path | RemoteFolder, most_bytes: int) -> bytes:
    """Return a PNG of a complete map; empty if none is small enough.

    It is made from the overviews, so that memory and time do not grow with the map.

    Parameters
    ----------
    folder : Path or RemoteFolder
    most_bytes : int
        Largest size of the PNG.

    Raises
    ------
    BadInputError
        A layer is missing or damaged.
    """
    picture: Image.Image | None = None
    for side, colours in _SIDES:
        if picture is None:
            picture = Image.fromarray(_paint(folder, side))
        small = picture.copy()
        small.thumbnail((side, side), Image.Resampling.NEAREST)
        packed = io.BytesIO()
        small.quantize(colours, dither=Image.Dither.NONE).save(packed, "PNG", optimize=True)
        if packed.tell() <= most_bytes:
            return packed.getvalue()
    return b""


def _paint(folder: Path | RemoteFolder, side: int) -> NDArray[np.uint8]:
    """Return the colours of a map on white, (rows, cols, 3) with ``side`` pixels along the longer side."""
    with open_raster(folder, "class.tif") as raster:
        scale = side / max(raster.height, raster.width)
        shape = max(1, round(raster.height * scale)), max(1, round(raster.width * scale))
        pixel = (
            (raster.bounds.top - raster.bounds.bottom) / shape[0],
            (raster.bounds.right - raster.bounds.left) / (shape[1]),
        )
        class_id = raster.read(1, out_shape=shape)
    with open_raster(folder, "barred.tif") as raster:
        barred = raster.read(1, out_shape=shape)
    table = np.full((256, 3), 255, np.uint8)
    for value, colour in CLASS_COLOURS.items():
        if value != NO_CLASS:
            table[value] = colour[:3]
    colours = table[class_id]
    # A pixel of an overview has the class of most tiles that have one, even where more are unknown; barred.tif counts
    # those too.
    colours[(barred == Barred.UNKNOWN) | ((class_id == NO_CLASS) & (barred != NO_CLASS))] = BARRED_COLOURS[
        Barred.UNKNOWN
    ][:3]
    colours[barred == NO_CLASS] = 255
    shaded = colours * _shade(_heights(folder, shape), pixel)[:, :, None]
    return np.where((barred == NO_CLASS)[:, :, None], 255, np.clip(shaded, 0, 255)).astype(np.uint8)


def _heights(folder: Path | RemoteFolder, shape: tuple[int, int]) -> NDArray[np.float64]:
    from rasterio.enums import Resampling

    with open_raster(folder, "heightmap.tif") as raster:
        heights: NDArray[np.float64] = raster.read(1, out_shape=shape, resampling=Resampling.average)
    return heights


def _shade(heights: NDArray[np.float64], pixel: tuple[float, float]) -> NDArray[np.float64]:
    """Return the brightness of the relief, 1 where it is level or not known."""
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    down, east = np.gradient(heights, *pixel)
    light = (_LIGHT[0] * -east + _LIGHT[1] * down + _LIGHT[2]) / np.sqrt(1.0 + east**2 + down**2)
    shade = np.clip(light / _LIGHT[2], _DARKEST, _BRIGHTEST)
    return np.where(np.isnan(shade), 1.0, shade)
