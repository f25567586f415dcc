"""The ground of a drive: unbounded height functions, and the strip that becomes a mesh for the physics engine.

A patch is 3 m wide and a drive 10 m long, so the patch is continued beyond its edges: its least-squares plane is
unbounded, and the residual is mirrored at the edges (half-sample: the edge pixel comes twice). Mirroring the heights
themselves would fold every slope into a ridge. Heights are at pixel centres, with bilinear interpolation between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError

_Floats = NDArray[np.float64]


class DrivenGround(Protocol):
    """Unbounded ground, as a height function."""

    @property
    def extent(self) -> float:
        """Starts are drawn from a square of this side at the origin, m."""

    @property
    def spacing(self) -> float:
        """Vertex spacing of a mesh that resolves this ground, m."""

    @property
    def gradient(self) -> tuple[float, float]:
        """Mean slope to the east and to the north, m/m; sets the initial attitude of a vehicle."""

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Return the heights of points, m; all arrays have the same shape."""


def fit_plane(heights: _Floats) -> tuple[_Floats, tuple[float, float]]:
    """Fit a least-squares plane to a square heightmap (pixels, pixels) [m], north row first.

    Returns
    -------
    array (pixels, pixels) float64
        The plane at the pixel centres, m.
    (float, float)
        Its slope to the east and to the north, m per pixel.
    """
    pixels = heights.shape[0]
    axis = np.arange(pixels) - (pixels - 1) / 2
    norm = pixels * float(axis @ axis) or 1.0
    east = float(heights.sum(axis=0) @ axis) / norm
    north = -float(heights.sum(axis=1) @ axis) / norm
    plane = heights.mean() + east * axis[None, :] - north * axis[:, None]
    return plane, (east, north)


def relief_and_slope(tiles: Sequence[_Floats], tile_size: float) -> tuple[NDArray[np.float32], _Floats]:
    """Return relief maps (n, pixels, pixels) [m] above the planes of heightmaps, and the slopes of these (n,) [deg]."""
    relief, slope = [], []
    for heights in tiles:
        plane, gradient = fit_plane(heights)
        relief.append((heights - plane).astype(np.float32))
        slope.append(np.degrees(np.arctan(np.hypot(*gradient) * len(heights) / tile_size)))
    return np.stack(relief), np.array(slope)


@dataclass(frozen=True, slots=True)
class PatchGround:
    """A patch continued without bounds: its plane plus its mirrored residual."""

    residual: _Floats
    """(pixels, pixels) heights above the plane, m; south row first."""
    tile_size: float
    """Side of the patch, m."""
    mean: float
    """Height of the plane in the middle of the patch, m."""
    gradient: tuple[float, float]
    """Slope of the plane to the east and to the north, m/m."""

    @classmethod
    def from_heights(cls, heights: NDArray[np.floating], tile_size: float) -> "PatchGround":
        """Make the ground of a heightmap (pixels, pixels) [m], north row first, without NaN."""
        values = np.asarray(heights, dtype=np.float64)
        if values.ndim != 2 or values.shape[0] != values.shape[1] or values.shape[0] < 2:
            raise BadInputError(f"a patch has shape {values.shape}; it must be square, 2 x 2 pixels or more")
        if not np.isfinite(values).all():
            raise BadInputError(
                f"a patch has {int((~np.isfinite(values)).sum())} pixels that are NaN or infinite; fill holes first"
            )
        plane, (east, north) = fit_plane(values)
        per_metre = values.shape[0] / tile_size
        residual = np.ascontiguousarray((values - plane)[::-1])
        return cls(residual, tile_size, float(values.mean()), (east * per_metre, north * per_metre))

    @property
    def extent(self) -> float:
        """Period of the mirrored residual, two patches, m."""
        return 2 * self.tile_size

    @property
    def spacing(self) -> float:
        """Half a pixel, m: pixel centres become vertices, so the mesh keeps the peaks of the bilinear ground."""
        return self.tile_size / len(self.residual) / 2

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Return the heights of points, m; the patch itself lies between 0 and ``tile_size`` on both axes."""
        pixels = len(self.residual)
        scale = pixels / self.tile_size
        col, row = easting * scale - 0.5, northing * scale - 0.5
        col_0, row_0 = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
        right, up = col - col_0, row - row_0
        west, east = _mirrored(col_0, pixels), _mirrored(col_0 + 1, pixels)
        south, north = _mirrored(row_0, pixels), _mirrored(row_0 + 1, pixels)
        below = self.residual[south, west] * (1 - right) + self.residual[south, east] * right
        above = self.residual[north, west] * (1 - right) + self.residual[north, east] * right
        middle = self.tile_size / 2
        plane = self.mean + self.gradient[0] * (easting - middle) + self.gradient[1] * (northing - middle)
        return plane + below * (1 - up) + above * up


@dataclass(frozen=True, slots=True)
class Strip:
    """The ground within ``half_width`` of a straight path, extended by ``half_width`` at both ends; m and radians."""

    easting: float
    northing: float
    heading: float
    """Direction of the path, from east to north."""
    length: float
    half_width: float


def strip_triangles(ground: DrivenGround, strip: Strip) -> NDArray[np.float32]:
    """Triangulate a strip of ground.

    The vertices lie on a grid anchored at the ground's origin, not at the path, so the pixel centres of a patch are
    vertices at any heading.

    Returns
    -------
    array (n, 3, 3) float32
        Triangle, corner, (easting, northing, upward) in m. Corners run counter-clockwise seen from above: ODE's
        meshes have one side.
    """
    forward = np.array([np.cos(strip.heading), np.sin(strip.heading)])
    start = np.array([strip.easting, strip.northing])
    ends = np.stack([start - strip.half_width * forward, start + (strip.length + strip.half_width) * forward])
    step = ground.spacing
    first = np.floor((ends.min(axis=0) - strip.half_width) / step).astype(np.int64)
    last = np.ceil((ends.max(axis=0) + strip.half_width) / step).astype(np.int64)
    easting, northing = np.meshgrid(*(np.arange(a, b + 1) * step for a, b in zip(first, last, strict=True)))
    vertices = np.stack([easting, northing, ground.height(easting, northing)], axis=-1).astype(np.float32)
    middle = np.stack([easting[:-1, :-1], northing[:-1, :-1]], axis=-1) + step / 2 - start
    along, across = middle @ forward, middle @ np.array([-forward[1], forward[0]])
    reach = strip.half_width + step
    keep = (along >= -reach) & (along <= strip.length + reach) & (np.abs(across) <= reach)
    return cell_triangles(vertices, keep)


def cell_triangles(vertices: NDArray[np.float32], keep: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Triangulate the cells ``keep`` (rows, cols) of a grid, south row first, as `strip_triangles` does.

    ``vertices`` (rows + 1, cols + 1, 3) float32 are easting, northing and upward, m.
    """
    south_west, south_east = vertices[:-1, :-1][keep], vertices[:-1, 1:][keep]
    north_west, north_east = vertices[1:, :-1][keep], vertices[1:, 1:][keep]
    lower = np.stack([south_west, south_east, north_east], axis=1)
    upper = np.stack([south_west, north_east, north_west], axis=1)
    return np.concatenate([lower, upper])


def _mirrored(index: NDArray[np.int64], pixels: int) -> NDArray[np.int64]:
    """Mirror indices by half a sample: ... 1 0 | 0 1 ... n-1 | n-1 n-2 ..."""
    wrapped = index % (2 * pixels)
    return np.minimum(wrapped, 2 * pixels - 1 - wrapped)
