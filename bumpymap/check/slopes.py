"""Slopes of the mapped ground at the scale of a vehicle."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from bumpymap.layers import RouteMap
from bumpytiles import TileWindow

__all__ = ["SlopeMap", "window_around"]

Floats = NDArray[np.float64]

_PIXELS = 5
"""Along a tile: 0.6 m at the usual size, which is finer than a vehicle is long."""
_MOST_PIXELS = 4000
"""Along a side; larger windows are read coarser."""
_SPREAD_M = 0.6
"""Heights are smoothed by a Gaussian of this standard deviation: what four wheels average."""
_LEAST_KNOWN = 0.5


@dataclass(frozen=True, slots=True)
class SlopeMap:
    """Rise of the ground eastwards and northwards over a metre, in a window of a map."""

    west: float
    north: float
    pixel_m: float
    eastward: Floats
    """(rows, cols), north row first; NaN where unknown."""
    northward: Floats

    @classmethod
    def of(cls, site: RouteMap, window: TileWindow) -> "SlopeMap":
        """Read the heights of a window and take their slopes."""
        size = site.grid.tile_size
        each = min(_PIXELS, max(_MOST_PIXELS // max(window.rows, window.cols), 1))
        height = site.relief(window, (window.rows * each, window.cols * each)).astype(np.float64)
        pixel = size / each
        known = np.isfinite(height)
        middle = float(np.median(height[known])) if known.any() else 0.0
        sigma = _SPREAD_M / pixel
        weight = gaussian_filter(known.astype(np.float64), sigma)
        smooth = gaussian_filter(np.where(known, height - middle, 0.0), sigma) / np.maximum(weight, 1e-9)
        smooth[weight < _LEAST_KNOWN] = np.nan
        down, across = np.gradient(smooth, pixel) if min(smooth.shape) > 1 else (smooth * np.nan, smooth * np.nan)
        return cls(window.col * size, (window.row + window.rows) * size, pixel, across, -down)

    def slope_at(self, easting: Floats, northing: Floats, course: Floats) -> tuple[Floats, Floats]:
        """Return the rise ahead and to the left over a metre, (n,) each; NaN where it is not known.

        Parameters
        ----------
        easting, northing : float64 arrays (n,)
            m, on the grid.
        course : float64 array (n,)
            Heading, rad, east 0.
        """
        at = np.stack([(self.north - northing) / self.pixel_m - 0.5, (easting - self.west) / self.pixel_m - 0.5])
        east, north = (map_coordinates(slopes, at, order=1, cval=np.nan) for slopes in (self.eastward, self.northward))
        cosine, sine = np.cos(course), np.sin(course)
        return east * cosine + north * sine, north * cosine - east * sine


def window_around(site: RouteMap, easting: Floats, northing: Floats, margin_m: float) -> TileWindow:
    """Return the window of the map's tiles around some places, m; it does not extend beyond the map."""
    size, whole = site.grid.tile_size, site.window
    ends = []
    for values, first, count in ((easting, whole.col, whole.cols), (northing, whole.row, whole.rows)):
        least, most = np.floor(np.array([values.min() - margin_m, values.max() + margin_m]) / size)
        ends.append(np.clip(np.array([least, most]), first, first + count - 1).astype(np.int64))
    return TileWindow.around(*ends)
