"""Compiled kernel: the points over the ground of tiles in, the state of each pixel out.

A tile is taken by itself: its ground surface (known pixels, a plane and filled holes), the heights of the other points
above it, and the rules of `bumpymap.patches.features` for what of that is an obstacle.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CANOPY,
    EMPTY,
    FREE,
    LONE,
    LOW_SOLID,
    MAYBE_SOLID,
    OBSTACLE,
    POINT_BUILDING,
    POINT_GROUND,
    POINT_PLANT,
    SEEN,
    SOLID,
    UNDECIDED,
    UNSEEN,
)
from bumpymap.patches._measure_kernels import PointsByTile
from bumpymap.patches._solid_kernels import THIN, is_overhead
from bumpymap.patches._strip_kernels import (
    BENEATH,
    StripScratch,
    add_point,
    forget_points,
    hides_ground,
    outweighs,
    strip_half,
)
from bumpytiles import helper, kernel, pixels_from

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]
Bytes = NDArray[np.uint8]

_LEAST_GROUND = 3
"""Pixels with ground that make a surface."""
_FEW = 4.0
"""With fewer points on 3 x 3 pixels on average, canopy is looked for on 5 x 5."""
_HIDING = 6.0
"""Points by which what is overhead must outweigh the ground beneath it to hide it, see
`bumpymap.patches._strip_kernels`."""
_MOST_OF_PIXEL = 2.0
"""Points overhead of a pixel that count in strips, over those that a pixel has on average; two at least."""
_MAYBE, _MAYBE_SHARE = 2.0, 0.5
"""As ``_HIDING``, and as a share of the points overhead: of the end of a wall in the corner of a tile, which hides the
ground if what it continues does. By `tests/benchmarks/ring_book.py`."""
_LEAFY, _LEAVES = 1.0, 13.0
"""Plants so far above the vehicle, m, are crowns: where leaves are dense, more points reach no ground by chance."""
_LOW = 3.0
"""Height above the vehicle, m, below which something that hides the ground is a car, a wall or a hedge and no crown."""
_SHRUB = 1.0
"""As ``_HIDING``, in a thin survey, for plants that end lower than crowns: a hedge."""
_THINNER = 6.0
"""Points/m2 below which that holds for all that ends low: a car that lies in two tiles has too few points in each."""
_RIDGE = 1.0
"""Pixels^2 added to the spread of the known pixels: a few close together say little about the slope."""


class ObjectLimits(NamedTuple):
    """Heights, and how many points it takes."""

    tile_size: float
    """m."""
    low: float
    """Height above ground from which a point is part of an obstacle, m."""
    high: float
    """Height above which it hangs over the vehicle, m."""
    share: float
    """Points that make an obstacle, as a share of those that the tile has on 3 x 3 pixels on average; two at least."""


class TileObjects(NamedTuple):
    """Arrays that are read and filled."""

    kind: Annotated[Bytes, 1]
    """(points,) kind of each point."""
    heights: Annotated[NDArray[np.float32], 3]
    """(tiles, pixels, pixels) mean height of the ground, m; NaN where none is known."""
    seen: Annotated[Integers, 3]
    """The same shape: points of the ground."""
    state: Annotated[Bytes, 3]
    """The same shape, filled: states of `bumpymap.core.ObjectStack`."""
    scalars: Annotated[Floats, 2]
    """(tiles, 4) filled: obstacle, obstacle_height, clearance, canopy."""


class TilePlane(NamedTuple):
    """The known ground of a tile as a plane over rows and columns of pixels."""

    known: int
    """Pixels with ground; with too few there is no plane."""
    east: float
    """Rise per column, m."""
    south: float
    """Rise per row, m."""
    origin: float
    """Height at the north-western pixel, m."""


class ObjectScratch(NamedTuple):
    """Scratch, see `object_scratch`."""

    surface: Annotated[Floats, 2]
    """(pixels, pixels) ground, m."""
    top: Annotated[Floats, 2]
    """The same shape: highest point of an obstacle above the ground, m."""
    least: Annotated[Floats, 2]
    """The same shape: lowest point overhead, m above the ground."""
    body: Annotated[Integers, 2]
    """The same shape: points between ``low`` and ``high``; then these and those above, those above, those under, those
    high above, those that count in strips, those of leaves above, and those of lower plants above."""
    company: Annotated[Integers, 2]
    above: Annotated[Integers, 2]
    under: Annotated[Integers, 2]
    tall: Annotated[Integers, 2]
    listed: Annotated[Integers, 2]
    leaves: Annotated[Integers, 2]
    shrubs: Annotated[Integers, 2]
    places: Annotated[Integers, 1]
    """(pixels^2,) pixels with ground, row by row, and the height of each above the plane, m."""
    rests: Annotated[Floats, 1]


def object_scratch(pixels: int) -> ObjectScratch:
    """Make scratch for tiles of so many pixels along a side."""
    maps: list[Any] = [np.empty((pixels, pixels)) for _ in range(3)]
    maps += [np.empty((pixels, pixels), np.int32) for _ in range(8)]
    maps += [np.empty(pixels * pixels, np.int32), np.empty(pixels * pixels)]
    return ObjectScratch(*maps)


@helper
def _fit_plane(heights: NDArray[np.float32], scratch: ObjectScratch) -> TilePlane:
    """Fit a plane through the known heights, and keep what each of them is above it."""
    surface = scratch.surface
    size, middle = surface.shape[0], 0.5 * (surface.shape[0] - 1)
    n, base = 0, 0.0
    sx = sy = sz = xx = xy = yy = xz = yz = 0.0
    for r in range(size):
        for c in range(size):
            h = float(heights[r, c])
            surface[r, c] = h
            if math.isnan(h):
                continue
            if n == 0:
                base = h
            scratch.places[n] = r * size + c
            x, y, z = c - middle, r - middle, h - base
            n += 1
            sx, sy, sz = sx + x, sy + y, sz + z
            xx, xy, yy, xz, yz = xx + x * x, xy + x * y, yy + y * y, xz + x * z, yz + y * z
    if n < _LEAST_GROUND:
        return TilePlane(n, 0.0, 0.0, 0.0)
    mx, my, mz = sx / n, sy / n, sz / n
    xx, xy, yy = xx - sx * mx + n * _RIDGE, xy - sx * my, yy - sy * my + n * _RIDGE
    xz, yz = xz - mx * sz, yz - my * sz
    det = xx * yy - xy * xy
    a, b = (xz * yy - yz * xy) / det, (yz * xx - xz * xy) / det
    origin = base + mz - a * (middle + mx) - b * (middle + my)
    for k in range(n):
        r, c = scratch.places[k] // size, scratch.places[k] % size
        scratch.rests[k] = surface[r, c] - origin - a * c - b * r
    return TilePlane(n, a, b, origin)


@helper
def _continue_ground(plane: TilePlane, r: int, c: int, scratch: ObjectScratch) -> float:
    """Height of the ground in a pixel where none was seen: the plane, and what the nearest heights are above it."""
    size = scratch.surface.shape[0]
    total, weights = 0.0, 0.0
    for k in range(plane.known):
        down, right = scratch.places[k] // size - r, scratch.places[k] % size - c
        square = float(down * down + right * right)
        weight = 1.0 / (square * square)
        weights += weight
        total += weight * scratch.rests[k]
    return plane.origin + plane.east * c + plane.south * r + total / weights


@helper
def _count_points(
    t: int,
    plane: TilePlane,
    points: PointsByTile,
    limits: ObjectLimits,
    kind: NDArray[np.uint8],
    scratch: ObjectScratch,
) -> bool:
    """Count the points of each pixel that are no ground by their height above it; returns whether any is overhead."""
    size, side, overhead = scratch.surface.shape[0], limits.tile_size, False
    west, south = points.col[t] * side, points.row[t] * side
    for i in range(points.starts[t], points.starts[t + 1]):
        if kind[i] == POINT_GROUND:
            continue
        c = min(size - 1, int(pixels_from(west, points.easting[i], side, size)))
        r = size - 1 - min(size - 1, int(pixels_from(south, points.northing[i], side, size)))
        if math.isnan(scratch.surface[r, c]) and plane.known >= _LEAST_GROUND:
            scratch.surface[r, c] = _continue_ground(plane, r, c, scratch)
        h = points.upward[i] - scratch.surface[r, c]
        if kind[i] == POINT_BUILDING:
            h = min(h, limits.high)
        if h > limits.high:
            overhead = True
            scratch.above[r, c] += 1
            scratch.company[r, c] += 1
            scratch.least[r, c] = min(scratch.least[r, c], h)
            scratch.tall[r, c] += h > limits.high + _LOW
            scratch.leaves[r, c] += kind[i] == POINT_PLANT and h > limits.high + _LEAFY
            scratch.shrubs[r, c] += kind[i] == POINT_PLANT and h <= limits.high + _LEAFY
        elif h >= limits.low:
            scratch.body[r, c] += 1
            scratch.company[r, c] += 1
            scratch.top[r, c] = max(scratch.top[r, c], h)
        else:
            scratch.under[r, c] += 1
    return overhead


@helper
def _list_points(
    t: int,
    points: PointsByTile,
    limits: ObjectLimits,
    kind: NDArray[np.uint8],
    scratch: ObjectScratch,
    strips: StripScratch,
) -> None:
    """List the points of each pixel: those of what stands or hangs there, and those beneath."""
    size, side, first = scratch.surface.shape[0], limits.tile_size, points.starts[t]
    west, south = points.col[t] * side, points.row[t] * side
    forget_points(strips)
    # A side that returns points too would have more than its share.
    most = max(2, math.ceil(_MOST_OF_PIXEL * (points.starts[t + 1] - first) / (size * size)))
    for i in range(first, points.starts[t + 1]):
        x, y = pixels_from(west, points.easting[i], side, size), pixels_from(south, points.northing[i], side, size)
        r, c = size - 1 - min(size - 1, int(y)), min(size - 1, int(x))
        is_over = kind[i] != POINT_GROUND and points.upward[i] - scratch.surface[r, c] >= limits.low
        if is_over and scratch.listed[r, c] >= most:
            continue
        scratch.listed[r, c] += is_over
        add_point(i - first, (r, c), x, size - y, 1 if is_over else -BENEATH, strips)


@helper
def _clear(scratch: ObjectScratch) -> None:
    """Forget the points of the tile before."""
    for r in range(scratch.body.shape[0]):
        for c in range(scratch.body.shape[0]):
            scratch.body[r, c] = scratch.company[r, c] = scratch.above[r, c] = 0
            scratch.under[r, c] = scratch.tall[r, c] = scratch.listed[r, c] = 0
            scratch.leaves[r, c] = scratch.shrubs[r, c] = 0
            scratch.top[r, c], scratch.least[r, c] = 0.0, np.inf


@helper
def _box_sum(counts: Integers, r: int, c: int, half: int) -> int:
    """Sum of a square around one pixel."""
    total = 0
    for row in range(max(0, r - half), min(counts.shape[0], r + half + 1)):
        for column in range(max(0, c - half), min(counts.shape[1], c + half + 1)):
            total += counts[row, column]
    return total


@helper
def _first_states(need: int, reach: int, seen: Integers, state: Bytes, scratch: ObjectScratch) -> None:
    """States from the points of the 3 x 3 pixels around each; for canopy from those within ``reach``."""
    size = state.shape[0]
    for r in range(size):
        for c in range(size):
            state[r, c] = FREE if seen[r, c] > 0 or scratch.under[r, c] > 0 else EMPTY
            if scratch.body[r, c] > 0:
                if _box_sum(scratch.company, r, c, 1) >= need:
                    state[r, c] = OBSTACLE
                elif r == 0 or c == 0 or r == size - 1 or c == size - 1:
                    state[r, c] = UNDECIDED
                else:
                    state[r, c] = LONE
            elif scratch.above[r, c] > 0 and _box_sum(scratch.above, r, c, reach) >= need:
                state[r, c] = CANOPY
            if seen[r, c] > 0:
                state[r, c] += SEEN


@helper
def _fills_square(seen: Integers, r: int, c: int, least: float, scratch: ObjectScratch) -> bool:
    """Return whether what is overhead fills a square around a pixel, and little ground is seen in it."""
    for half in range(1, 4):
        over = _box_sum(scratch.company, r, c, half)
        if over >= least and outweighs(over, _box_sum(seen, r, c, half) + _box_sum(scratch.under, r, c, half), least):
            return True
    return False


@helper
def _mark_solid(
    limits: ObjectLimits, density: float, seen: Integers, state: Bytes, scratch: ObjectScratch, strips: StripScratch
) -> None:
    """Mark canopy that hides the ground."""
    size = state.shape[0]
    pixel = limits.tile_size / size
    half, thin = strip_half(density, pixel), pixel * pixel * density < THIN
    thinner = density < _THINNER
    for r in range(size):
        for c in range(size):
            if state[r, c] % SEEN == CANOPY:
                least = _LEAVES if scratch.leaves[r, c] > 0 else _HIDING
                is_low = _box_sum(scratch.tall, r, c, 2) == 0
                if (thin and scratch.leaves[r, c] == 0 and scratch.shrubs[r, c] > 0) or (thinner and is_low):
                    least = _SHRUB
                hides = _fills_square(seen, r, c, least, scratch)
                if hides or hides_ground(r, c, half, (least, 0.0), is_low, pixel, strips):
                    state[r, c] += (LOW_SOLID if is_low else SOLID) - CANOPY
                elif is_low and hides_ground(r, c, half, (_MAYBE, _MAYBE_SHARE), True, pixel, strips):
                    state[r, c] += MAYBE_SOLID - CANOPY


@helper
def _without_ground(state: Bytes, scalars: Floats, scratch: ObjectScratch) -> None:
    """States of a tile whose ground is unknown: what is seen there is an obstacle, whatever its height."""
    size, seen = state.shape[0], 0
    for r in range(size):
        for c in range(size):
            # Heights above an unknown ground are NaN, and so all its points count as under.
            found = scratch.under[r, c] > 0 and _box_sum(scratch.under, r, c, 1) > 1
            state[r, c] = OBSTACLE if found else UNSEEN
            seen += found
    scalars[0] = seen / (size * size) if seen > 0 else np.nan
    scalars[1] = scalars[2] = scalars[3] = np.nan


@helper
def _summarise(state: Bytes, scalars: Floats, scratch: ObjectScratch) -> None:
    """Fill the scalars of a tile with ground."""
    size, obstacles, canopy = state.shape[0], 0, 0
    top, least = 0.0, np.inf
    for r in range(size):
        for c in range(size):
            if state[r, c] % SEEN == OBSTACLE:
                obstacles += 1
                top = max(top, scratch.top[r, c])
            overhead = is_overhead(state[r, c])
            canopy += overhead or (state[r, c] % SEEN == OBSTACLE and scratch.above[r, c] > 0)
            if overhead:
                least = min(least, scratch.least[r, c])
    scalars[0], scalars[3] = obstacles / (size * size), canopy / (size * size)
    scalars[1] = top
    scalars[2] = least if least < np.inf else np.nan


@kernel
def find_in_tiles(
    points: PointsByTile, limits: ObjectLimits, tiles: TileObjects, scratch: ObjectScratch, strips: StripScratch
) -> None:
    """Fill state and scalars of every tile; all of them have points."""
    size = scratch.surface.shape[0]
    area, pixel = limits.tile_size * limits.tile_size, limits.tile_size / size
    for t in range(len(points.col)):
        heights, state, scalars = tiles.heights[t], tiles.state[t], tiles.scalars[t]
        begin, end = points.starts[t], points.starts[t + 1]
        ground = 0
        for i in range(begin, end):
            ground += tiles.kind[i] == POINT_GROUND
        _clear(scratch)
        plane, overhead = _fit_plane(heights, scratch), False
        if ground < end - begin:
            overhead = _count_points(t, plane, points, limits, tiles.kind, scratch)
        if plane.known < _LEAST_GROUND:
            _without_ground(state, scalars, scratch)
            continue
        density = (end - begin) / area
        need = max(2, math.ceil(limits.share * 9.0 * pixel * pixel * density))
        reach = 1 if 9.0 * pixel * pixel * density >= _FEW else 2
        _first_states(need, reach, tiles.seen[t], state, scratch)
        if overhead:
            _list_points(t, points, limits, tiles.kind, scratch, strips)
            _mark_solid(limits, density, tiles.seen[t], state, scratch, strips)
        _summarise(state, scalars, scratch)
