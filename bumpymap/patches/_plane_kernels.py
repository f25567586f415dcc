"""Planes of tiles: the robust plane, which needs no draw, and that of RANSAC, which the paper measures from.

Both are weighted least-squares fits, repeated until they stand still. In single precision they are twice as fast, and
it is enough to approach a plane; the last steps are in double precision. Points are centred: nothing here depends on
where a tile lies. Nothing is drawn by chance either: candidates go through points that follow each other in the
canonical order, which is that of a hash. So a tile that is turned by 90 degrees or mirrored has the same candidates,
and one point more or less changes a few of them.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_PLANE, Plane
from bumpymap.patches._heightmap_kernels import LANES
from bumpytiles import helper

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

_SCALE = 0.1
"""Distance of a point whose weight for the robust plane is a quarter, m: of plants and stones, not of the ground."""
_SUMS = 11
"""Sums that a fit needs at once."""
_STEPS = 30
"""Double steps of the robust plane, and steps of a RANSAC plane, at most: half of the roughest tiles need ten."""
_STILL = 1e-5
"""A plane that moves less stands still: radians, m."""
_LONGEST = 4.0
"""Times that an extrapolated step is as long as a plain one, at most."""
_SAMPLE = 256
"""Points that candidates are compared on first."""
_MOST_CANDIDATES = 150
"""Planes that RANSAC draws at most."""
_MISS_PROBABILITY = 1e-4
"""Accepted probability that no candidate was drawn from inliers alone."""
_LEAST_AREA = 2e-3
"""Twice the least area that a candidate's three points must span, m^2."""
_DRAWN, _REFINED = 8, 2
"""Best candidates, which are fitted to all points; best of these, which are refined until they stand still."""
_WIDER = 1.5
"""Reach of the first fit to a candidate, in thresholds: its three points are noisy."""
_INNER, _INNER_POINTS = 12, 32
"""Inner samples, and points of each: its inliers are fitted, and there are several even of rough ground."""
_TRIAL, _HOPELESS = 3, 1.01
"""Steps after which a plane is given up whose loss is so many times the least."""
_LINE = 4096.0
"""Rounding errors: points whose spreads have a product of less, as a share of their squared sum, are on a line."""
_UNITS = np.float32(1024.0)
"""Of the loss of a point in whole numbers, whose sum does not depend on an order."""
_STRIP = 1 << 16
"""Points whose units are added up at once: their sum is no larger than a whole number may be."""


class TilePlaneScratch(NamedTuple):
    """Scratch, see `plane_scratch`."""

    singles: Annotated[Singles, 2]
    """(3, most points of a tile) centred coordinates in single precision."""
    lanes: Annotated[Floats, 1]
    """(``_SUMS * LANES``,) partial sums."""
    single_lanes: Annotated[Singles, 1]
    """The same in single precision."""
    drawn: Annotated[Floats, 2]
    """(``_DRAWN``, 5) loss and plane of the best candidates, in increasing order of loss."""
    refined: Annotated[Floats, 2]
    """(``_REFINED``, 5) the same of those that were fitted to all points."""


def plane_scratch(most_points: int) -> TilePlaneScratch:
    """Make scratch for tiles of at most so many points."""
    return TilePlaneScratch(
        singles=np.empty((3, most_points), np.float32),
        lanes=np.empty(_SUMS * LANES),
        single_lanes=np.empty(_SUMS * LANES, np.float32),
        drawn=np.empty((_DRAWN, 5)),
        refined=np.empty((_REFINED, 5)),
    )


@helper
def is_plane(plane: Plane) -> bool:
    """Return whether it is one."""
    return plane[0] != 0.0 or plane[1] != 0.0 or plane[2] != 0.0


@helper
def _add_up(x: Any, y: Any, z: Any, near: Plane, scale: float, soft: bool, lanes: Any) -> None:
    """Sum w, w x, w y, w z, w xx, w xy, w xz, w yy, w yz, w zz, and the loss min(1, (r / scale)^2) into ``lanes[:11]``.

    r are the distances from the plane ``near``. Weights are those of Geman and McClure (1987) where ``soft``, or 1
    within ``scale`` and 0 beyond.
    """
    kind = x.dtype.type
    one, zero = kind(1.0), kind(0.0)
    a, b, c, d = kind(near[0] / scale), kind(near[1] / scale), kind(near[2] / scale), kind(near[3] / scale)
    n = len(x)
    for k in range(_SUMS * LANES):
        lanes[k] = zero
    for start in range(0, n, LANES):
        stop = min(n, start + LANES)
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        for k in range(stop - start):
            px, py, pz = bx[k], by[k], bz[k]
            r = a * px + b * py + c * pz + d
            q = r * r
            if soft:
                w = one / (one + q)
                w *= w
            else:
                w = one if q <= one else zero
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
            lanes[10 * LANES + k] += min(one, q)
    for row in range(0, _SUMS * LANES, LANES):
        own = lanes[row : row + LANES]
        for k in range(LANES // 2):
            own[k] += own[k + LANES // 2]
        for k in range(LANES // 4):
            own[k] += own[k + LANES // 4]
        for k in range(LANES // 8):
            own[k] += own[k + LANES // 8]
        total = zero
        for k in range(LANES // 8):
            total += own[k]
        lanes[row // LANES] = total


@helper
def _solve(sums: Any, level: bool, error: float) -> Plane:
    """Least-squares plane of the sums of `_add_up`, its normal upward.

    Regression of heights where ``level``, else along the axis whose 2 x 2 minor of the scatter matrix is the largest,
    so that steep planes are fitted as well as level ones. Coordinates must be centred near zero. Returns zeros where
    there are no three points or they lie on a line, up to a relative ``error`` of the sums.
    """
    kind = np.float64
    n, sx, sy, sz, xx = kind(sums[0]), kind(sums[1]), kind(sums[2]), kind(sums[3]), kind(sums[4])
    xy, xz, yy, yz, zz = kind(sums[5]), kind(sums[6]), kind(sums[7]), kind(sums[8]), kind(sums[9])
    if n <= 0.0:
        return NO_PLANE
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, xz = xx - sx * mx, xy - sx * my, xz - sx * mz
    yy, yz, zz = yy - sy * my, yz - sy * mz, zz - sz * mz
    minor_z = xx * yy - xy * xy
    minor_y = xx * zz - xz * xz
    minor_x = yy * zz - yz * yz
    if level or (minor_z >= minor_y and minor_z >= minor_x):
        a, b, c = xy * yz - xz * yy, xy * xz - yz * xx, minor_z
    elif minor_y >= minor_x:
        a, b, c = xz * yz - xy * zz, minor_y, xy * xz - yz * xx
    else:
        a, b, c = minor_x, xz * yz - xy * zz, xy * yz - xz * yy
    length = math.sqrt(a * a + b * b + c * c)
    scatter = xx + yy + zz
    if length <= error * scatter * scatter:
        return NO_PLANE
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * mx + b * my + c * mz)


@helper
def _fit_plane(x: Any, y: Any, z: Any, near: Plane, scale: float, soft: bool, lanes: Any) -> tuple[Plane, float]:
    """Weighted least-squares plane, see `_add_up` and `_solve`, and the loss of the plane ``near``."""
    _add_up(x, y, z, near, scale, soft, lanes)
    return _solve(lanes, False, _LINE * np.finfo(x.dtype).eps), float(lanes[10])


@helper
def _extrapolate(first: Plane, second: Plane, third: Plane) -> tuple[Plane, float]:
    """Return where a plane that moves from the first to the third will stand still, and how far it moved at first.

    SQUAREM (Varadhan and Roland 2008): steps that hardly change are made longer.
    """
    (a, b, c, d), (e, f, g, h) = first, second
    u, v, w, t = e - a, f - b, g - c, h - d
    e, f, g, h = third[0] - e - u, third[1] - f - v, third[2] - g - w, third[3] - h - t
    step, change = math.sqrt(u * u + v * v + w * w + t * t), math.sqrt(e * e + f * f + g * g + h * h)
    way = min(max(step / change, 1.0), _LONGEST) if change > 0.0 else 1.0
    twice, square = 2.0 * way, way * way
    a, b, c, d = (
        a + twice * u + square * e,
        b + twice * v + square * f,
        c + twice * w + square * g,
        d + twice * t + square * h,
    )
    length = math.sqrt(a * a + b * b + c * c)
    if c < 0.0:
        length = -length
    return (a / length, b / length, c / length, d / length), step


@helper
def _quick_loss(x: Singles, y: Singles, z: Singles, plane: Plane, scale: float) -> float:
    """Sum of min(1, (r / scale)^2) of some points."""
    a, b, c, d = (
        np.float32(plane[0] / scale),
        np.float32(plane[1] / scale),
        np.float32(plane[2] / scale),
        np.float32(plane[3] / scale),
    )
    total = 0.0
    for start in range(0, len(x), _STRIP):
        stop = min(len(x), start + _STRIP)
        bx, by, bz = x[start:stop], y[start:stop], z[start:stop]
        units = np.int32(0)
        for i in range(stop - start):
            r = a * bx[i] + b * by[i] + c * bz[i] + d
            q = r * r
            q = min(np.float32(1.0), q)
            units = np.int32(units + np.int32(_UNITS * q))
        total += float(units / _UNITS)
    return total


@helper
def _quarter_sums(x: Floats, y: Floats, z: Floats, sums: Floats) -> None:
    """Sum what `_solve` takes over each quarter of the tile, ten numbers each, and over all of it behind them."""
    for k in range(50):
        sums[k] = 0.0
    for i in range(len(x)):
        px, py, pz = x[i], y[i], z[i]
        k = 10 * (int(px > 0.0) + 2 * int(py > 0.0))
        sums[k] += 1.0
        sums[k + 1] += px
        sums[k + 2] += py
        sums[k + 3] += pz
        sums[k + 4] += px * px
        sums[k + 5] += px * py
        sums[k + 6] += px * pz
        sums[k + 7] += py * py
        sums[k + 8] += py * pz
        sums[k + 9] += pz * pz
    for k in range(10):
        sums[40 + k] = (sums[k] + sums[30 + k]) + (sums[10 + k] + sums[20 + k])


@helper
def _first_plane(x: Floats, y: Floats, z: Floats, scratch: TilePlaneScratch) -> Plane:
    """Least-squares plane that explains most: of all points, or of a quarter of them, which may be free of objects.

    Where heights tell nothing, on a wall, it is one across them. Zeros where the points span no plane.
    """
    xs, ys, zs = scratch.singles[0, : len(x)], scratch.singles[1, : len(x)], scratch.singles[2, : len(x)]
    sums, error = scratch.lanes, _LINE * np.finfo(x.dtype).eps
    _quarter_sums(x, y, z, sums)
    best = _solve(sums[40:50], False, error)
    least = 2.0 * _quick_loss(xs, ys, zs, best, _SCALE) if is_plane(best) else np.inf
    for k in range(40, -10, -10):
        plane = _solve(sums[k : k + 10], True, error)
        loss = _quick_loss(xs, ys, zs, plane, _SCALE) if is_plane(plane) else np.inf
        if loss < least or (k == 40 and loss <= least):
            best, least = plane, loss
    return best


@helper
def robust_plane(x: Floats, y: Floats, z: Floats, scratch: TilePlaneScratch) -> Plane:
    """Plane of a tile by least squares, reweighted (Geman and McClure 1987) until it stands still.

    It starts from `_first_plane`: no draw decides it. Zeros where the points span no plane. The points in single
    precision stay in the scratch.
    """
    n = len(x)
    xs, ys, zs = scratch.singles[0, :n], scratch.singles[1, :n], scratch.singles[2, :n]
    for i in range(n):
        xs[i], ys[i], zs[i] = x[i], y[i], z[i]
    found = plane = _first_plane(x, y, z, scratch)
    step = np.inf if is_plane(plane) else 0.0
    for _ in range(_STEPS):
        if step <= _STILL:
            break
        second, _ = _fit_plane(xs, ys, zs, plane, _SCALE, True, scratch.single_lanes)
        third, _ = _fit_plane(xs, ys, zs, second, _SCALE, True, scratch.single_lanes)
        if not is_plane(second) or not is_plane(third):
            break
        found = third
        plane, step = _extrapolate(plane, second, third)
    fitted, _ = _fit_plane(x, y, z, found, _SCALE, True, scratch.lanes)
    return fitted if is_plane(found) and is_plane(fitted) else found


@helper
def _candidate(x: Floats, y: Floats, z: Floats, number: int) -> Plane:
    """Plane through three points that follow each other, then every second, third; zeros where they are on a line."""
    n = len(x)
    i, step = number % n, number // n + 1
    j, k = (i + step) % n, (i + 2 * step) % n
    ux, uy, uz = x[j] - x[i], y[j] - y[i], z[j] - z[i]
    vx, vy, vz = x[k] - x[i], y[k] - y[i], z[k] - z[i]
    a, b, c = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = math.sqrt(a * a + b * b + c * c)
    if length < _LEAST_AREA:
        return NO_PLANE
    if c < 0.0:
        length = -length
    a, b, c = a / length, b / length, c / length
    return a, b, c, -(a * x[i] + b * y[i] + c * z[i])


@helper
def _needed(loss: float) -> int:
    """Return the number of draws of which one likely has inliers alone, if a plane has this loss; or the most."""
    clean = min(max((1.0 - loss) ** 3, 1e-6), 1.0 - 1e-9)
    return min(_MOST_CANDIDATES, 1 + int(math.log(_MISS_PROBABILITY) / math.log(1.0 - clean)))


@helper
def _keep(plane: Plane, loss: float, best: Floats, kept: int) -> int:
    """Put a plane among the ``kept`` best, if it belongs there; returns their number."""
    if not loss < np.inf or (kept == len(best) and loss >= best[kept - 1, 0]):
        return kept
    k = min(kept, len(best) - 1)
    while k > 0 and loss < best[k - 1, 0]:
        for part in range(5):
            best[k, part] = best[k - 1, part]
        k -= 1
    row = best[k]
    row[0] = loss
    row[1], row[2], row[3], row[4] = plane
    return min(kept + 1, len(best))


@helper
def _draw(x: Floats, y: Floats, z: Floats, start: Plane, scale: float, scratch: TilePlaneScratch) -> int:
    """Keep the candidates with the least loss on a sample; returns their number.

    It stops when a better one than the best, or than the plane ``start``, has become improbable.
    """
    n = min(len(x), _SAMPLE)
    xs, ys, zs = scratch.singles[0, :n], scratch.singles[1, :n], scratch.singles[2, :n]
    best = _quick_loss(xs, ys, zs, start, scale)
    kept, i, needed = 0, 0, _needed(best / n)
    while i < needed:
        plane = _candidate(x, y, z, i)
        loss = _quick_loss(xs, ys, zs, plane, scale) if is_plane(plane) else np.inf
        if loss < best:
            best = loss
            needed = _needed(best / n)
        kept = _keep(plane, loss, scratch.drawn, kept)
        i += 1
    return kept


@helper
def _settle(plane: Plane, bound: float, scale: float, n: int, scratch: TilePlaneScratch) -> tuple[Plane, float]:
    """Refine a plane on its inliers until its loss does not fall, or is far above ``bound`` after a few steps.

    Returns it and its loss.
    """
    xs, ys, zs = scratch.singles[0, :n], scratch.singles[1, :n], scratch.singles[2, :n]
    best, least = plane, np.inf
    for step in range(_STEPS):
        fitted, loss = _fit_plane(xs, ys, zs, plane, scale, False, scratch.single_lanes)
        if not loss < least or (step >= _TRIAL and loss > _HOPELESS * bound):
            break
        best, least = plane, loss
        if not is_plane(fitted):
            break
        plane = fitted
    return best, least


@helper
def _settle_best(
    kept: int, plane: Plane, least: float, scale: float, n: int, scratch: TilePlaneScratch
) -> tuple[Plane, float]:
    """Refine the best planes until they stand still; returns the one with the least loss, or ``plane``."""
    for k in range(kept):
        row = scratch.refined[k]
        found, loss = _settle((row[1], row[2], row[3], row[4]), least, scale, n, scratch)
        if loss < least:
            plane, least = found, loss
    return plane, least


@helper
def ransac_plane(x: Floats, y: Floats, z: Floats, robust: Plane, scale: float, scratch: TilePlaneScratch) -> Plane:
    """Plane of a tile by RANSAC (Fischler and Bolles 1981), locally optimised (Chum, Matas and Kittler 2003).

    It has the least loss of MSAC (Torr and Zisserman 2000) over all points, squared distances cut off at ``scale``, of
    the candidates, of the robust plane, and of planes through inliers of the best of these: all are refined on their
    inliers. Follows `robust_plane`, whose scratch it takes.
    """
    n, lanes = len(x), scratch.single_lanes
    xs, ys, zs = scratch.singles[0, :n], scratch.singles[1, :n], scratch.singles[2, :n]
    plane, least = _settle(robust, np.inf, scale, n, scratch)
    kept = 0
    for k in range(_draw(x, y, z, plane, scale, scratch)):
        row = scratch.drawn[k]
        drawn = (row[1], row[2], row[3], row[4])
        fitted, _ = _fit_plane(xs, ys, zs, drawn, _WIDER * scale, False, lanes)
        loss = _quick_loss(xs, ys, zs, fitted, scale) if is_plane(fitted) else np.inf
        kept = _keep(fitted, loss, scratch.refined, kept)
    plane, least = _settle_best(kept, plane, least, scale, n, scratch)
    kept = 0
    step = max(min(n - _INNER_POINTS, _INNER * _INNER_POINTS) // _INNER, 1)
    for first in range(0, min(n - _INNER_POINTS, _INNER * step), step):
        end = first + _INNER_POINTS
        fitted, _ = _fit_plane(xs[first:end], ys[first:end], zs[first:end], plane, _WIDER * scale, False, lanes)
        loss = _quick_loss(xs, ys, zs, fitted, scale) if is_plane(fitted) else np.inf
        kept = _keep(fitted, loss, scratch.refined, kept)
    plane, _ = _settle_best(kept, plane, least, scale, n, scratch)
    for _ in range(2):
        fitted, _ = _fit_plane(x, y, z, plane, scale, False, scratch.lanes)
        if not is_plane(fitted):
            break
        plane = fitted
    return plane
