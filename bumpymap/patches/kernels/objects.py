"""Compiled kernel: the points over the ground of tiles in, the state of each pixel out.

A tile is taken by itself: its ground surface (known pixels, a plane and filled holes), the heights of the other points
above it, and the rules of `bumpymap.patches.objects` for what of that is an obstacle.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CANOPY, FREE, OBSTACLE, UNDECIDED, UNSEEN, squared_distances
from bumpymap.patches.kernels.measure import PointsByTile
from bumpytiles import helper, kernel

__all__ = ["ObjectLimits", "ObjectScratch", "TileObjects", "find_in_tiles", "object_scratch"]

Floats = NDArray[np.float64]
Integers = NDArray[np.int32]
Bytes = NDArray[np.uint8]
Flags = NDArray[np.bool_]

_LEAST_GROUND = 3
"""Pixels with ground that make a surface."""
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
    hole: float
    """Distance from all points beyond which a pixel is unseen, m; more where the tile has few points."""
    hole_points: float
    """Points that a disc of that radius holds on average, at least."""
    roof: float
    """Radius of a disc without ground under which a thing overhead stands on the ground, m; more with few points."""
    roof_points: float
    """Points that such a disc holds on average, at least."""
    roof_ground: float
    """Ground points that such a disc would hold on average, at least, if the tile's were spread evenly."""


class TileObjects(NamedTuple):
    """What is read and filled."""

    ground: Annotated[Flags, 1]
    """(points,) which points are ground."""
    heights: Annotated[NDArray[np.float32], 3]
    """(tiles, pixels, pixels) mean height of the ground, m; NaN where none is known."""
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
    far: Annotated[Floats, 2]
    """The same shape: squared distances, px^2; ``near`` those along a column."""
    near: Annotated[Floats, 2]
    body: Annotated[Integers, 2]
    """The same shape: points between ``low`` and ``high``; then these and those
    above, those above, those under, and a mask."""
    company: Annotated[Integers, 2]
    above: Annotated[Integers, 2]
    under: Annotated[Integers, 2]
    mask: Annotated[Bytes, 2]
    places: Annotated[Integers, 1]
    """(pixels^2,) pixels with ground, row by row, and the height of each above the plane, m."""
    rests: Annotated[Floats, 1]


def object_scratch(pixels: int) -> ObjectScratch:
    """Make scratch for tiles of so many pixels along a side."""
    floats = [np.empty((pixels, pixels)) for _ in range(5)]
    whole = [np.empty((pixels, pixels), np.int32) for _ in range(4)]
    return ObjectScratch(
        surface=floats[0],
        top=floats[1],
        least=floats[2],
        far=floats[3],
        near=floats[4],
        body=whole[0],
        company=whole[1],
        above=whole[2],
        under=whole[3],
        mask=np.empty((pixels, pixels), np.uint8),
        places=np.empty(pixels * pixels, np.int32),
        rests=np.empty(pixels * pixels),
    )


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
    t: int, plane: TilePlane, points: PointsByTile, limits: ObjectLimits, ground: Flags, scratch: ObjectScratch
) -> None:
    """Count the points of each pixel that are no ground by their height above it."""
    size, side = scratch.surface.shape[0], limits.tile_size
    west, south = points.col[t] * side, points.row[t] * side
    for i in range(points.starts[t], points.starts[t + 1]):
        if ground[i]:
            continue
        c = min(size - 1, int(size * (points.easting[i] - west) / side))
        r = size - 1 - min(size - 1, int(size * (points.northing[i] - south) / side))
        if math.isnan(scratch.surface[r, c]) and plane.known >= _LEAST_GROUND:
            scratch.surface[r, c] = _continue_ground(plane, r, c, scratch)
        h = points.upward[i] - scratch.surface[r, c]
        if h > limits.high:
            scratch.above[r, c] += 1
            scratch.company[r, c] += 1
            scratch.least[r, c] = min(scratch.least[r, c], h)
        elif h >= limits.low:
            scratch.body[r, c] += 1
            scratch.company[r, c] += 1
            scratch.top[r, c] = max(scratch.top[r, c], h)
        else:
            scratch.under[r, c] += 1


@helper
def _clear(scratch: ObjectScratch) -> None:
    """Forget the points of the tile before."""
    for r in range(scratch.body.shape[0]):
        for c in range(scratch.body.shape[0]):
            scratch.body[r, c] = scratch.company[r, c] = scratch.above[r, c] = scratch.under[r, c] = 0
            scratch.top[r, c], scratch.least[r, c] = 0.0, np.inf


@helper
def _around(counts: Integers, r: int, c: int) -> int:
    """Sum of the 3 x 3 pixels around one."""
    total = 0
    for row in range(max(0, r - 1), min(counts.shape[0], r + 2)):
        for column in range(max(0, c - 1), min(counts.shape[1], c + 2)):
            total += counts[row, column]
    return total


@helper
def _first_states(need: int, state: Bytes, scratch: ObjectScratch) -> int:
    """States from the points of the 3 x 3 pixels around each; returns the number of pixels with canopy alone."""
    size, canopy = state.shape[0], 0
    for r in range(size):
        for c in range(size):
            state[r, c] = FREE
            if scratch.body[r, c] > 0:
                if _around(scratch.company, r, c) >= need:
                    state[r, c] = OBSTACLE
                elif r == 0 or c == 0 or r == size - 1 or c == size - 1:
                    state[r, c] = UNDECIDED
            if state[r, c] == FREE and scratch.above[r, c] > 0 and _around(scratch.above, r, c) >= need:
                state[r, c] = CANOPY
                canopy += 1
    return canopy


@helper
def _close_roofs(heights: NDArray[np.float32], radius: float, state: Bytes, scratch: ObjectScratch) -> None:
    """Make canopy an obstacle that lies in a disc of ``radius`` [px] without any ground."""
    size = state.shape[0]
    for r in range(size):
        for c in range(size):
            scratch.mask[r, c] = not math.isnan(heights[r, c])
    squared_distances(scratch.mask, min(size, math.ceil(radius)), scratch.near, scratch.far)
    cores = 0
    for r in range(size):
        for c in range(size):
            core = scratch.far[r, c] > radius * radius
            scratch.mask[r, c] = core
            cores += core
    if cores == 0:
        return
    squared_distances(scratch.mask, min(size, math.ceil(radius)), scratch.near, scratch.far)
    for r in range(size):
        for c in range(size):
            if state[r, c] == CANOPY and scratch.far[r, c] <= radius * radius:
                state[r, c] = OBSTACLE


@helper
def _all_near(side: int, mask: Bytes) -> bool:
    """Whether every square of ``side`` pixels, the last of a row or column less, holds one that is marked."""
    size = mask.shape[0]
    count = (size + side - 1) // side
    for square in range(count * count):
        top, left, found = square // count * side, square % count * side, False
        for r in range(top, min(size, top + side)):
            for c in range(left, min(size, left + side)):
                found = found or mask[r, c] != 0
        if not found:
            return False
    return True


@helper
def _mark_unseen(heights: NDArray[np.float32], radius: float, state: Bytes, scratch: ObjectScratch) -> None:
    """Mark the free pixels that are farther than ``radius`` [px] from every point."""
    size = state.shape[0]
    for r in range(size):
        for c in range(size):
            others = scratch.body[r, c] + scratch.above[r, c] + scratch.under[r, c]
            scratch.mask[r, c] = others > 0 or not math.isnan(heights[r, c])
    # The corners of such a square are not farther from each other than the radius.
    if _all_near(1 + int(radius / math.sqrt(2.0)), scratch.mask):
        return
    squared_distances(scratch.mask, min(size, math.ceil(radius)), scratch.near, scratch.far)
    for r in range(size):
        for c in range(size):
            if scratch.far[r, c] > radius * radius and state[r, c] == FREE:
                state[r, c] = UNSEEN


@helper
def _without_ground(state: Bytes, scalars: Floats, scratch: ObjectScratch) -> None:
    """States of a tile whose ground is unknown: what is seen there is an obstacle, whatever its height."""
    size, seen = state.shape[0], 0
    for r in range(size):
        for c in range(size):
            # Heights above an unknown ground are NaN, and so all its points count as under.
            found = scratch.under[r, c] > 0 and _around(scratch.under, r, c) > 1
            state[r, c] = OBSTACLE if found else UNSEEN
            seen += found
    scalars[0] = seen / (size * size) if seen > 0 else np.nan
    scalars[1] = scalars[2] = scalars[3] = np.nan


@helper
def _summarise(state: Bytes, scalars: Floats, scratch: ObjectScratch) -> None:
    """Fill the scalars of a tile with ground."""
    size, obstacles, canopy = state.shape[0], 0, 0
    top, least, known = 0.0, np.inf, True
    for r in range(size):
        for c in range(size):
            if state[r, c] == OBSTACLE:
                obstacles += 1
                known = known and scratch.body[r, c] > 0
                top = max(top, scratch.top[r, c])
            over = state[r, c] == CANOPY or (state[r, c] == OBSTACLE and scratch.above[r, c] > 0)
            canopy += over
            if state[r, c] == CANOPY:
                least = min(least, scratch.least[r, c])
    scalars[0], scalars[3] = obstacles / (size * size), canopy / (size * size)
    scalars[1] = top if top > 0.0 or known else np.nan
    scalars[2] = least if least < np.inf else np.nan


@kernel
def find_in_tiles(points: PointsByTile, limits: ObjectLimits, tiles: TileObjects, scratch: ObjectScratch) -> None:
    """Fill state and scalars of every tile; all of them have points."""
    size = scratch.surface.shape[0]
    area, pixel = limits.tile_size * limits.tile_size, limits.tile_size / size
    for t in range(len(points.col)):
        heights, state, scalars = tiles.heights[t], tiles.state[t], tiles.scalars[t]
        begin, end = points.starts[t], points.starts[t + 1]
        ground = 0
        for i in range(begin, end):
            ground += tiles.ground[i]
        _clear(scratch)
        plane = _fit_plane(heights, scratch)
        if ground < end - begin:
            _count_points(t, plane, points, limits, tiles.ground, scratch)
        if plane.known < _LEAST_GROUND:
            _without_ground(state, scalars, scratch)
            continue
        density = (end - begin) / area
        need = max(2, math.ceil(limits.share * 9.0 * pixel * pixel * density))
        canopy = _first_states(need, state, scratch)
        if canopy > 0:
            least = max(limits.roof_points / density, limits.roof_ground * area / ground)
            _close_roofs(heights, max(limits.roof, math.sqrt(least / math.pi)) / pixel, state, scratch)
        if plane.known < size * size:
            hole = max(limits.hole, math.sqrt(limits.hole_points / (math.pi * density)))
            _mark_unseen(heights, hole / pixel, state, scratch)
        _summarise(state, scalars, scratch)
