"""The plane of a tile: RANSAC, then least squares on its inliers."""

import math

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_PLANE, Plane, best_candidate
from bumpymap.patches.kernels.lanes import LANES
from bumpytiles import helper

__all__ = ["SAMPLE", "SUMS", "fit_plane", "is_plane", "ransac_plane"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

SUMS = 10
"""Sums that a plane fit needs at once."""
SAMPLE = 256
"""Points that RANSAC draws from and scores candidates on; the random order makes the first ones a fair sample."""
_MOST_CANDIDATES = 400


@helper
def _inlier_sums(x: Floats, y: Floats, z: Floats, plane: Plane, threshold: float, lanes: Floats) -> None:
    """Sum 1, x, y, z, xx, xy, xz, yy, yz, zz over the points within ``threshold`` of a plane: ten rows of lanes."""
    a, b, c, d = plane
    n = len(x)
    for k in range(SUMS * LANES):
        lanes[k] = 0.0
    for start in range(0, n, LANES):
        stop = min(n, start + LANES)
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        for k in range(stop - start):
            px, py, pz = bx[k], by[k], bz[k]
            w = 1.0 if abs(a * px + b * py + c * pz + d) <= threshold else 0.0
            wx, wy, wz = w * px, w * py, w * pz
            lanes[k] += w
            lanes[LANES + k] += wx
            lanes[2 * LANES + k] += wy
            lanes[3 * LANES + k] += wz
            lanes[4 * LANES + k] += wx * px
            lanes[5 * LANES + k] += wx * py
            lanes[6 * LANES + k] += wx * pz
            lanes[7 * LANES + k] += wy * py
            lanes[8 * LANES + k] += wy * pz
            lanes[9 * LANES + k] += wz * pz


@helper
def fit_plane(
    x: Floats, y: Floats, z: Floats, near: Plane, threshold: float, lanes: Floats
) -> tuple[float, float, float, float]:
    """Least-squares plane through the points within ``threshold`` of the plane ``near``, its normal upward.

    Regression along the axis whose 2 x 2 minor of the scatter matrix is the largest, so that steep planes are fitted
    as well as level ones. Coordinates must be centred near zero. Returns zeros where fewer than three points are near
    or they lie on a line.
    """
    _inlier_sums(x, y, z, near, threshold, lanes)
    n = sx = sy = sz = xx = xy = xz = yy = yz = zz = 0.0
    for k in range(LANES):
        n += lanes[k]
        sx += lanes[LANES + k]
        sy += lanes[2 * LANES + k]
        sz += lanes[3 * LANES + k]
        xx += lanes[4 * LANES + k]
        xy += lanes[5 * LANES + k]
        xz += lanes[6 * LANES + k]
        yy += lanes[7 * LANES + k]
        yz += lanes[8 * LANES + k]
        zz += lanes[9 * LANES + k]
    if n < 3.0:
        return NO_PLANE
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, xz = xx - sx * mx, xy - sx * my, xz - sx * mz
    yy, yz, zz = yy - sy * my, yz - sy * mz, zz - sz * mz
    minor_z = xx * yy - xy * xy
    minor_y = xx * zz - xz * xz
    minor_x = yy * zz - yz * yz
    if minor_z >= minor_y and minor_z >= minor_x:
        a, b, c = xy * yz - xz * yy, xy * xz - yz * xx, minor_z
    elif minor_y >= minor_x:
        a, b, c = xz * yz - xy * zz, minor_y, xy * xz - yz * xx
    else:
        a, b, c = minor_x, xz * yz - xy * zz, xy * yz - xz * yy
    length = math.sqrt(a * a + b * b + c * c)
    scatter = xx + yy + zz
    if length <= 1e-12 * scatter * scatter:
        return NO_PLANE
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * mx + b * my + c * mz)


@helper
def is_plane(plane: Plane) -> bool:
    """Whether it is one."""
    return plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0


@helper
def ransac_plane(
    x: Floats, y: Floats, z: Floats, threshold: float, seed: np.uint64, sample: Singles, lanes: Floats
) -> Plane:
    """Plane of a tile by RANSAC (Fischler and Bolles 1981), then twice a least-squares fit to its inliers.

    Candidates are drawn from a random sample with a generator seeded by the tile, and scored on it. Coordinates are
    centred. Returns zeros where the points span no plane.
    """
    n = min(len(x), SAMPLE)
    for i in range(n):
        sample[0, i], sample[1, i], sample[2, i] = x[i], y[i], z[i]
    plane = best_candidate(x[:n], y[:n], z[:n], sample, threshold, seed, _MOST_CANDIDATES, False)
    if not is_plane(plane):
        return fit_plane(x, y, z, plane, np.inf, lanes)
    for _ in range(2):
        fitted = fit_plane(x, y, z, plane, threshold, lanes)
        if not is_plane(fitted):
            return plane
        plane = fitted
    return plane
