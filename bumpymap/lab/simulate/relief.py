"""The ground of a survey for a drive along a way: the heights of a window of the map, and the mesh of a corridor.

Coordinates are metres east and north of the window's south-west corner: easting and northing themselves do not fit the
single precision of a mesh.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.lab.simulate.terrain import cell_triangles, fit_plane

__all__ = ["ReliefGround", "corridor_triangles", "fill_gaps"]

_Floats = NDArray[np.float64]
_RINGS = 15
"""Pixels from the rim of a hole inwards."""
_SLOPE_PIXELS = 15
"""Side of the square whose plane gives the slope at a place."""


def fill_gaps(heights: NDArray[np.floating]) -> _Floats:
    """Fill NaN pixels as the map does: with the mean of their known 8 neighbours, from the rim of a hole inwards.

    What lies more than 15 pixels inside, such as all that is beyond the survey, gets the nearest height.

    Parameters
    ----------
    heights : array (rows, cols)
        m; some are known.

    Returns
    -------
    array (rows, cols) float64

    Raises
    ------
    BadInputError
        No height is known.
    """
    from scipy.ndimage import convolve, distance_transform_edt

    filled = heights.astype(np.float64)
    missing = np.isnan(filled)
    if missing.all():
        raise BadInputError("no height is known in this window of the map, so there is no ground to drive over")
    ring = np.ones((3, 3))
    for _ in range(_RINGS):
        if not missing.any():
            return filled
        total = convolve(np.where(missing, 0.0, filled), ring, mode="constant")
        known = convolve((~missing).astype(np.float64), ring, mode="constant")
        rim = missing & (known > 0.5)
        filled[rim] = total[rim] / known[rim]
        missing = missing & ~rim
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(filled[tuple(nearest)], np.float64)


@dataclass(frozen=True, slots=True)
class ReliefGround:
    """Heights of a window of the map, bilinear between pixel centres and constant beyond the outermost ones."""

    heights: _Floats
    """(rows, cols) m, south row first, without NaN."""
    pixel_size: float
    """m."""
    gradient: tuple[float, float] = (0.0, 0.0)
    """Slope to the east and to the north where the vehicle starts, m/m."""

    @classmethod
    def from_heightmap(cls, heights: NDArray[np.floating], pixel_size: float) -> "ReliefGround":
        """Make the ground of heights (rows, cols) in m, north row first; NaN are filled by `fill_gaps`."""
        return cls(np.ascontiguousarray(fill_gaps(heights)[::-1]), pixel_size)

    @property
    def extent(self) -> float:
        """Shorter side of the window, m."""
        return float(self.pixel_size * min(self.heights.shape))

    @property
    def spacing(self) -> float:
        """Half a pixel, m: pixel centres become vertices, as in the drives of a calibration."""
        return self.pixel_size / 2

    def sloped_at(self, easting: float, northing: float) -> "ReliefGround":
        """Return the same ground with the slope of the plane through the pixels around a place."""
        rows, cols = self.heights.shape
        side = min(_SLOPE_PIXELS, rows, cols)
        row, col = (
            int(min(max(place / self.pixel_size - side / 2, 0), size - side))
            for place, size in ((northing, rows), (easting, cols))
        )
        _, (east, north) = fit_plane(self.heights[row : row + side, col : col + side][::-1])
        return replace(self, gradient=(east / self.pixel_size, north / self.pixel_size))

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Return the heights of points, m."""
        rows, cols = self.heights.shape
        col = np.clip(easting / self.pixel_size - 0.5, 0, cols - 1)
        row = np.clip(northing / self.pixel_size - 0.5, 0, rows - 1)
        west, south = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
        east, north = np.minimum(west + 1, cols - 1), np.minimum(south + 1, rows - 1)
        right, up = col - west, row - south
        below = self.heights[south, west] * (1 - right) + self.heights[south, east] * right
        above = self.heights[north, west] * (1 - right) + self.heights[north, east] * right
        bilinear: _Floats = below * (1 - up) + above * up
        return bilinear


def corridor_triangles(ground: ReliefGround, points: _Floats, half_width: float) -> NDArray[np.float32]:
    """Triangulate the ground within ``half_width`` of a line.

    Parameters
    ----------
    ground : ReliefGround
    points : array (n, 2)
        Points close together along the line, m.
    half_width : float
        m.

    Returns
    -------
    array (m, 3, 3) float32
        As from `strip_triangles`; cells have half the size of a pixel.
    """
    from scipy.ndimage import distance_transform_edt

    step = ground.spacing
    first = np.floor((points.min(axis=0) - half_width) / step).astype(np.int64) - 1
    last = np.ceil((points.max(axis=0) + half_width) / step).astype(np.int64) + 1
    easting, northing = np.meshgrid(*(np.arange(a, b + 1) * step for a, b in zip(first, last, strict=True)))
    vertices = np.stack([easting, northing, ground.height(easting, northing)], axis=-1).astype(np.float32)
    cells = (easting.shape[0] - 1, easting.shape[1] - 1)
    apart = np.ones(cells, np.bool_)
    col, row = (np.floor(points / step).astype(np.int64) - first).T
    apart[row, col] = False
    return cell_triangles(vertices, distance_transform_edt(apart) * step <= half_width + step)
