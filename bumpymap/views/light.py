"""The light of a photo or of the relief over the colours of a map, as pages, QGIS and the look in 3D have it."""

import math

import numpy as np
from numpy.typing import NDArray

from bumpymap.layers import MID_GREY

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
