"""Compiled loops that find the ground of a scan: a plane for every cell of the polar grid, and which points lie on it.

Each cell's plane starts at the lowest points of its parts and is fitted again to the points near it. It must continue
the planes around it; where it does not, it starts again from theirs. A cell without a plane of its own passes theirs
on. Nothing here allocates: scratch arrays come from the caller. Sums run in the order of the scan's points.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.scan._place_kernels import CellPoints
from bumpytiles import helper, kernel

Floats = Annotated[NDArray[np.float64], 1]
Floats2 = Annotated[NDArray[np.float64], 2]
Singles = Annotated[NDArray[np.float32], 1]
Integers = Annotated[NDArray[np.int32], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Plane3 = tuple[float, float, float]

PARTS = 5
"""Parts of a cell along each side: outwards and around."""
NEIGHBOURS = 8
"""Most neighbours of a cell: three inwards, two beside it, three outwards."""
CARRIED, FOUND, GUESSED = 1, 2, 3
"""Kinds of planes: passed on by a neighbour; fitted to the cell's own points; passed on before the second round, for
where nothing better is known. 0: none."""
THINGS_HEIGHT = 2.0
"""Things on the ground are drawn up to this multiple of the vehicle's height."""
TAIL = 32
"""Lowest points that may be reflections below the ground."""
_GAP = 0.3
"""A gap in height, m, below which the few lowest points are reflections."""
_START_REACH, _WIDEST_REACH, _NARROWEST_REACH, _REACH_OF_SPREAD = 0.15, 0.3, 0.1, 2.5
"""Before the noise of the scan is known, points within this distance of a plane are its ground, m: first, most, least,
and as a multiple of their root mean square."""
_ABOVE_LOWEST, _FAR_BELOW = 0.15, -1.0
"""The lowest points of parts within these heights of the plane through them are its start, m."""
_RIDGE = 0.02
"""Weight of the expected slope against the points', m^2 per root of their number: it decides if they lie on a line."""
_FIRST_PASSES, _PASSES = 2, 4
"""How often a plane is fitted again to the points near it, in the first round and in the second."""
_STEEPEST = math.tan(math.radians(38.0))
_LEAST_POINTS = 8
"""Fewest points of a plane."""
_MOST_FITTED = 512
"""A plane is fitted to every second, third ... point of a cell that has this many points twice, three times ..."""
_STEP, _STEP_PER_METRE, _FARTHEST = 0.25, 0.15, 8.0
"""How far a plane may pass from what its neighbours expect, m: at their own points, for each metre from there, and the
greatest distance that counts."""
_RISE, _GUESSED_RISE = 0.06, 0.04
"""How much farther than at their points a plane may pass above what its neighbours expect, for each metre from there;
and above a guess. Below them it may pass at ``_STEP_PER_METRE``: a step up is a thing more often than ground."""
_OWN_SLOPE = 0.85
"""Weight of a plane's own slope against that of the whole ground, where it is followed to its neighbours."""
_ROUGH, _ROUGH_M = 2.5, 0.06
"""A plane whose points spread by more than this multiple of the noise, and by more than this, m, links nothing."""
_BELOW = 0.5
"""Points further below a plane than this are reflections, m."""
_PART_POINTS, _PART_SPREAD, _PART_LOWEST, _PART_HIGHEST, _PART_STEP, _PART_REACH = 3, 0.12, -0.6, 1.2, 0.2, 0.2
"""A part beside the plane is ground too if it has so many points, spread less than this, at a height between these, and
passes a neighbouring part of the ground at less than this; its ground points are so near to their mean, m."""
_BESIDE_M, _BESIDE, _TOGETHER = 0.03, 0.04, 3.0
"""Returns in pixels next to each other lie together if their heights are so near to each other, m, at the sensor, and
more for each metre from it; so many are a thing."""
_ROUNDS = 6
"""Rounds in which the ground spreads to parts beside it."""
_LAYER = 1.5
"""Points further from a plane than this do not belong to the layer of the ground, m."""
_PLANTS_ABOVE, _PLANTS_SHARE, _PLANTS_SPREAD, _PLANTS_LEAST = 0.8, 0.2, 1.8, 0.045
"""Plants stand in a part if so high above its ground at most, m, there are points, as a share of those on it, and those
on it spread by more than this multiple of the scan's noise and more than this, m."""


class CellGeometry(NamedTuple):
    """Where the cells of the grid lie; (cells,) where nothing else is said."""

    x: Floats
    """Centre, m."""
    y: Floats
    near: Annotated[NDArray[np.int32], 2]
    """(cells, NEIGHBOURS) neighbours: columns 0 to 2 inwards, 3 and 4 beside, 5 to 7 outwards; -1: none."""
    zone: Integers
    ring: Integers
    sector: Integers
    first: Integers
    """(zones,) number of the first cell."""
    rings: Integers
    """(zones,)"""
    sectors: Integers
    """(zones,)"""


class GroundPlanes(NamedTuple):
    """The planes of the cells."""

    plane: Floats2
    """(cells, 3) slope along x and y, height at the origin [m]."""
    centre: Floats2
    """(cells, 3) x and y of the mean of its points, distance that it was passed on [m]."""
    spread: Floats
    """(cells,) root mean square of its points about it, m."""
    kind: Integers
    """(cells,) 0, CARRIED, FOUND or GUESSED."""


class PlaneScratch(NamedTuple):
    """Scratch of `find_planes`."""

    tail: Floats
    """(TAIL,) lowest heights."""
    lowest: Floats2
    """(4, PARTS^2) height, x, y and z of the lowest point of each part."""
    low: Annotated[NDArray[np.float32], 2]
    """(3, PARTS^2) the same points, without gaps."""
    heights: Floats
    """(PARTS^2,) to sort."""
    cells: Integers
    """(NEIGHBOURS,) to sort."""


class SearchRule(NamedTuple):
    """How planes are searched for."""

    reach: Floats
    """(zones,) distance within which a point belongs to a plane, m; 0: by the spread of the points."""
    least_points: int
    """Cells with this many points or fewer take their neighbours' plane."""
    neighbours: int
    """How many columns of ``CellGeometry.near`` count: 0 in a first round, NEIGHBOURS after `keep_largest`."""
    slope: Floats
    """(2,) slope of the whole ground, which planes that are passed on approach."""


class GroundRule(NamedTuple):
    """Limits that tell ground from what stands on it."""

    reach: Floats
    """(zones,) distance from a plane within which a point is ground, m."""
    noise: Floats
    """(zones,) usual root mean square of ground points about their plane, m."""
    least_points: int
    """Cells with more points than this are judged by their own plane alone."""
    belly: float
    """Heights above the ground between which a point is an obstacle, m."""
    height: float


class GroundLabels(NamedTuple):
    """Results, filled by `label_points`."""

    height: Singles
    """(scan's points,) height above the ground, m; comes as NaN."""
    ground: Flags
    """(scan's points,) comes as False."""
    obstacles: Annotated[NDArray[np.int32], 1]
    """(cells,) points between belly and height that lie beside others; zeros."""
    overhead: Annotated[NDArray[np.int32], 1]
    """(cells,) points from ``height`` on; zeros."""
    airborne: Flags
    """(scan's points,) points of ``things`` that lie alone; comes as False."""
    top: Singles
    """(cells,) the highest obstacle point, m; comes as -inf."""
    clearance: Singles
    """(cells,) lowest point from ``height`` on, m; comes as inf."""
    things: Annotated[NDArray[np.float32], 3]
    """(cells, 2, pixels^2) of the points that are not ground, up to ``THINGS_HEIGHT`` times ``height``: the highest in
    each pixel above the ground, m, and their number. As the next, filled in cells with points."""
    lowest: Annotated[NDArray[np.float32], 3]
    """(cells, pixels^2, 2) z of the lowest ground point and of the lowest other one, m; inf without any."""
    kept: Flags
    """(points,) by cell: whether it is ground."""
    held: Annotated[NDArray[np.int32], 1]
    """(cells,) ground points; zeros."""


class LabelScratch(NamedTuple):
    """Scratch of `label_points`; by part: ``cell * PARTS^2 + part``."""

    heights: Singles
    """(points,) by cell."""
    mixed: Flags
    """(cells,) whether some points are not on the plane."""
    sums: Floats2
    """(parts, 4) number, sum and sum of squares of the heights of its points, and how many are ground."""
    level: Floats
    """(parts,) height of its ground above the plane, m; NaN where it has none."""
    lowest: Singles
    """(pixels^2,) lowest of the things in each pixel, m."""
    state: Integers
    """(parts,) 1 may continue the ground, 2 does, 3 is part of it; 4 plants."""


@helper
def _height(planes: GroundPlanes, cell: int, x: float, y: float) -> float:
    """Return the height of the plane of a cell at a place, m."""
    height: float = planes.plane[cell, 0] * x + planes.plane[cell, 1] * y + planes.plane[cell, 2]
    return height


@helper
def _expect(
    cell: int,
    last: int,
    at: tuple[float, float],
    geometry: CellGeometry,
    planes: GroundPlanes,
    scratch: PlaneScratch,
    slope: Floats,
) -> tuple[int, float, float, int]:
    """Return the neighbour whose plane has the median height at a place, that height, and the way to its points.

    Planes that were guessed count where there are no others: the last value is the kind of the worst that count.
    """
    x, y = at
    for worst in (FOUND, GUESSED):
        count = 0
        for s in range(last):
            other = geometry.near[cell, s]
            if other < 0 or planes.kind[other] == 0 or planes.kind[other] > worst:
                continue
            u, v = planes.centre[other, 0], planes.centre[other, 1]
            height = _height(planes, other, u + _OWN_SLOPE * (x - u), v + _OWN_SLOPE * (y - v))
            height += (1.0 - _OWN_SLOPE) * (slope[0] * (x - u) + slope[1] * (y - v))
            k = count
            while k > 0 and scratch.heights[k - 1] > height:
                scratch.heights[k], scratch.cells[k] = scratch.heights[k - 1], scratch.cells[k - 1]
                k -= 1
            scratch.heights[k], scratch.cells[k] = height, other
            count += 1
        if count > 0:
            middle = (count - 1) // 2
            other = int(scratch.cells[middle])
            dx, dy = x - planes.centre[other, 0], y - planes.centre[other, 1]
            return other, scratch.heights[middle], math.sqrt(dx * dx + dy * dy) + planes.centre[other, 2], worst
    return -1, 0.0, 0.0, GUESSED


@helper
def _refit(
    xyz: Annotated[NDArray[np.float32], 2],
    some: tuple[int, int, int],
    plane: Plane3,
    within: tuple[float, float, float],
    origin: tuple[float, float],
    slope: tuple[float, float],
) -> tuple[float, float, Plane3]:
    """Fit a plane to those of ``some`` points (first, end, step) between two heights above another plane.

    Returns their number, the root mean square of the heights of those nearer to the other plane than ``within[2]``, and
    the plane.
    """
    a, b, c = plane
    low, high, reach = within
    ox, oy = origin
    n = su = sv = sh = suu = suv = svv = suh = svh = near = square = 0.0
    first, last, step = some
    for i in range(first, last, step):
        x, y = np.float64(xyz[0, i]), np.float64(xyz[1, i])
        u, v = x - ox, y - oy
        h = xyz[2, i] - (a * x + b * y + c)
        if low < h < high:
            n += 1.0
            su += u
            sv += v
            sh += h
            suu += u * u
            suv += u * v
            svv += v * v
            suh += u * h
            svh += v * h
        if abs(h) < reach:
            near += 1.0
            square += h * h
    if n < 3.0:
        return n, 0.0, plane
    mu, mv, mh = su / n, sv / n, sh / n
    ridge = _RIDGE * math.sqrt(n)
    uu, vv, uv = suu - su * mu + ridge, svv - sv * mv + ridge, suv - su * mv
    uh, vh = suh - su * mh + ridge * (slope[0] - a), svh - sv * mh + ridge * (slope[1] - b)
    det = uu * vv - uv * uv
    da, db = (uh * vv - vh * uv) / det, (vh * uu - uh * uv) / det
    rise = mh - da * (mu + ox) - db * (mv + oy)
    return n, math.sqrt(square / max(near, 1.0)), (a + da, b + db, c + rise)


@helper
def _lowest(
    points: CellPoints, some: tuple[int, int, int], plane: Plane3, floor: float, scratch: PlaneScratch, most: int
) -> None:
    """Find the lowest point of each part that is not below ``floor``, and the lowest heights of all."""
    a, b, c = plane
    for k in range(PARTS * PARTS):
        scratch.lowest[0, k] = np.inf
    for k in range(most):
        scratch.tail[k] = np.inf
    first, last, step = some
    for i in range(first, last, step):
        x, y, z = np.float64(points.xyz[0, i]), np.float64(points.xyz[1, i]), np.float64(points.xyz[2, i])
        h = z - (a * x + b * y + c)
        if h < floor:
            continue
        part = points.part[i]
        if h < scratch.lowest[0, part]:
            scratch.lowest[0, part], scratch.lowest[1, part] = h, x
            scratch.lowest[2, part], scratch.lowest[3, part] = y, z
        if h < scratch.tail[most - 1]:
            k = most - 1
            while k > 0 and scratch.tail[k - 1] > h:
                scratch.tail[k] = scratch.tail[k - 1]
                k -= 1
            scratch.tail[k] = h


@helper
def _start(
    points: CellPoints,
    some: tuple[int, int, int],
    expected: Plane3,
    origin: tuple[float, float],
    scratch: PlaneScratch,
) -> tuple[bool, Plane3]:
    """Find a plane through the lowest points of the cell's parts; False if there are fewer than three."""
    a, b, c = expected
    first, last, step = some
    most = min(max((last - first) // (50 * step), 3), TAIL - 1) + 1
    _lowest(points, some, (a, b, c), -np.inf, scratch, most)
    floor = -np.inf
    for k in range(most - 1):
        if scratch.tail[k + 1] - scratch.tail[k] > _GAP:
            floor = scratch.tail[k + 1]
    if floor > -np.inf:
        _lowest(points, some, (a, b, c), floor, scratch, most)
    count = 0
    for k in range(PARTS * PARTS):
        h = scratch.lowest[0, k]
        if h == np.inf:
            continue
        for axis in range(3):
            scratch.low[axis, count] = np.float32(scratch.lowest[1 + axis, k])
        j = count
        while j > 0 and scratch.heights[j - 1] > h:
            scratch.heights[j] = scratch.heights[j - 1]
            j -= 1
        scratch.heights[j] = h
        count += 1
    if count < 3:
        return False, (a, b, c)
    median = 0.5 * (scratch.heights[(count - 1) // 2] + scratch.heights[count // 2])
    plane, within = (a, b, c), (-np.inf, median + 0.05, 0.0)
    for _ in range(3):
        held, _, plane = _refit(scratch.low, (0, count, 1), plane, within, origin, (a, b))
        if held < 3.0:
            return False, plane
        within = (_FAR_BELOW, _ABOVE_LOWEST, 0.0)
    return True, plane


@helper
def _settle(
    points: CellPoints,
    some: tuple[int, int, int],
    plane: Plane3,
    reach: float,
    passes: int,
    origin: tuple[float, float],
    slope: tuple[float, float],
) -> tuple[bool, float, Plane3]:
    """Fit a plane again and again to the points near it; returns whether enough are, the distance, and the plane.

    With a ``reach`` of zero the distance follows the spread of the points.
    """
    distance = reach if reach > 0.0 else _START_REACH
    for _ in range(passes):
        held, spread, plane = _refit(points.xyz, some, plane, (-2.0 * distance, distance, distance), origin, slope)
        if held < 5.0:
            return False, distance, plane
        if reach == 0.0:
            distance = min(max(_REACH_OF_SPREAD * spread, _NARROWEST_REACH), _WIDEST_REACH)
    return True, distance, plane


@helper
def _describe(
    points: CellPoints, some: tuple[int, int, int], plane: Plane3, reach: float
) -> tuple[float, float, float, float]:
    """Return number, mean x and y, spread in height of the points near a plane."""
    a, b, c = plane
    count = sx = sy = sh = square = 0.0
    first, last, step = some
    for i in range(first, last, step):
        x, y = points.xyz[0, i], points.xyz[1, i]
        h = points.xyz[2, i] - (a * x + b * y + c)
        if abs(h) < reach:
            count += 1.0
            sx += x
            sy += y
            sh += h
            square += h * h
    if count == 0.0:
        return 0.0, 0.0, 0.0, 0.0
    return count, sx / count, sy / count, math.sqrt(max(square / count - (sh / count) ** 2, 0.0))


@helper
def _accept(
    cell: int,
    last: int,
    plane: Plane3,
    found: tuple[float, float, float, float],
    geometry: CellGeometry,
    planes: GroundPlanes,
    scratch: PlaneScratch,
    slope: Floats,
) -> bool:
    """Keep a plane if it has enough points, is not too steep and continues its neighbours'; returns whether it was."""
    a, b, c = plane
    count, x, y, spread = found
    if count < _LEAST_POINTS or a * a + b * b > _STEEPEST * _STEEPEST:
        return False
    other, height, away, _ = _expect(cell, last, (x, y), geometry, planes, scratch, slope)
    if other >= 0:
        over, far = a * x + b * y + c - height, min(away, _FARTHEST)
        if over > _STEP + _RISE * far or -over > _STEP + _STEP_PER_METRE * far:
            return False
    if planes.kind[cell] == GUESSED:
        limit = _STEP + _GUESSED_RISE * min(planes.centre[cell, 2], _FARTHEST)
        if a * x + b * y + c - _height(planes, cell, x, y) > limit:
            return False
    planes.plane[cell, 0], planes.plane[cell, 1], planes.plane[cell, 2] = a, b, c
    planes.centre[cell, 0], planes.centre[cell, 1], planes.centre[cell, 2] = x, y, 0.0
    planes.spread[cell], planes.kind[cell] = spread, FOUND
    return True


@helper
def _carry(
    cell: int, other: int, away: float, kind: int, geometry: CellGeometry, slope: Floats, planes: GroundPlanes
) -> None:
    """Give a cell the plane of another one, ``away`` [m] from the points of that; -1: none."""
    planes.kind[cell] = kind if other >= 0 else 0
    if other < 0:
        return
    x, y, a, b = geometry.x[cell], geometry.y[cell], planes.plane[other, 0], planes.plane[other, 1]
    height = a * x + b * y + planes.plane[other, 2]
    if kind == GUESSED:
        u, v = planes.centre[other, 0], planes.centre[other, 1]
        height = _height(planes, other, u, v) + slope[0] * (x - u) + slope[1] * (y - v)
        a, b = slope[0], slope[1]
    a, b = 0.5 * (a + slope[0]), 0.5 * (b + slope[1])
    planes.plane[cell, 0], planes.plane[cell, 1], planes.plane[cell, 2] = a, b, height - a * x - b * y
    planes.centre[cell, 0], planes.centre[cell, 1], planes.centre[cell, 2] = x, y, away


@kernel
def find_planes(
    points: CellPoints,
    geometry: CellGeometry,
    rule: SearchRule,
    planes: GroundPlanes,
    scratch: PlaneScratch,
) -> None:
    """Find the plane of the ground in every cell, from the sensor outwards.

    ``planes``: filled.
    """
    neighbours, slope = rule.neighbours, rule.slope
    passes = _PASSES if neighbours else _FIRST_PASSES
    for k in range(len(geometry.x) if neighbours else 0):
        cell = len(geometry.x) - 1 - k
        if planes.kind[cell] == 0:
            origin = (geometry.x[cell], geometry.y[cell])
            other, _, away, _ = _expect(cell, neighbours, origin, geometry, planes, scratch, slope)
            _carry(cell, other, away, GUESSED, geometry, slope, planes)
    for cell in range(len(geometry.x)):
        first = points.starts[cell]
        n = points.starts[cell + 1] - first
        some = (first, first + n, max(n // _MOST_FITTED, 1))
        origin = (geometry.x[cell], geometry.y[cell])
        other, _, away, worst = _expect(cell, neighbours, origin, geometry, planes, scratch, slope)
        kind = CARRIED if worst == FOUND else GUESSED
        a, b, c = slope[0], slope[1], 0.0
        if other >= 0:
            a, b, c = planes.plane[other, 0], planes.plane[other, 1], planes.plane[other, 2]
        width = rule.reach[geometry.zone[cell]]
        done = False
        if n > rule.least_points:
            there, plane = _start(points, some, (a, b, c), origin, scratch)
            if there:
                there, near, plane = _settle(points, some, plane, width, passes, origin, (a, b))
                if there:
                    found = _describe(points, some, plane, near)
                    done = _accept(cell, neighbours, plane, found, geometry, planes, scratch, slope)
            if not done and other >= 0:
                there, near, plane = _settle(points, some, (a, b, c), _WIDEST_REACH, 1, origin, (a, b))
                if there:
                    there, near, plane = _settle(points, some, plane, width, _PASSES - 1, origin, (a, b))
                if there:
                    found = _describe(points, some, plane, near)
                    done = _accept(cell, neighbours, plane, found, geometry, planes, scratch, slope)
        if not done:
            _carry(cell, other, away, kind, geometry, slope, planes)


@helper
def _root(of: Integers, cell: int) -> int:
    """Return the cell that stands for all that are linked to a cell, and shorten the way to it."""
    while of[cell] != cell:
        of[cell] = of[of[cell]]
        cell = int(of[cell])
    return cell


@helper
def _continues(cell: int, other: int, planes: GroundPlanes) -> bool:
    """Return whether the planes of two cells pass each other's points within what is allowed."""
    dx = planes.centre[other, 0] - planes.centre[cell, 0]
    dy = planes.centre[other, 1] - planes.centre[cell, 1]
    limit = _STEP + _STEP_PER_METRE * min(math.sqrt(dx * dx + dy * dy), _FARTHEST)
    da, db = planes.plane[cell, 0] - planes.plane[other, 0], planes.plane[cell, 1] - planes.plane[other, 1]
    dc = planes.plane[cell, 2] - planes.plane[other, 2]
    here = abs(da * planes.centre[cell, 0] + db * planes.centre[cell, 1] + dc)
    there = abs(da * planes.centre[other, 0] + db * planes.centre[other, 1] + dc)
    return bool(max(here, there) <= limit)


@kernel
def keep_largest(
    geometry: CellGeometry,
    planes: GroundPlanes,
    noise: Floats,
    slope: Floats,
    of: Integers,
    weight: Floats,
    fit: Floats,
) -> None:
    """Keep the planes of the largest set of cells in which neighbours continue each other, and of sets as high as it.

    A cell counts for the inverse of its distance: what lies near the robot is what it stands on. A plane whose points
    spread by much more than the ``noise`` (zones,) [m] of the scan continues nothing: it leans from the road to a roof.
    Another set is kept if most of its cells are as high as the nearest one of the largest, along the ``slope`` (2,) of
    the whole ground.

    ``of``, ``weight``, ``fit`` (cells,): scratch.
    """
    cells = len(geometry.x)
    for cell in range(cells):
        of[cell], weight[cell], fit[cell] = cell, 0.0, 0.0
    for cell in range(cells):
        if planes.spread[cell] > max(_ROUGH * noise[geometry.zone[cell]], _ROUGH_M):
            planes.kind[cell] = 0
    for cell in range(cells):
        for k in range(geometry.near.shape[1]):
            other = geometry.near[cell, k]
            if other < 0 or planes.kind[cell] != FOUND or planes.kind[other] != FOUND:
                continue
            if _continues(cell, other, planes):
                one, two = _root(of, cell), _root(of, other)
                of[max(one, two)] = min(one, two)
    best = 0
    for cell in range(cells):
        if planes.kind[cell] == FOUND:
            root = _root(of, cell)
            weight[root] += 1.0 / math.sqrt(geometry.x[cell] ** 2 + geometry.y[cell] ** 2)
            if weight[root] > weight[best]:
                best = root
    last = 0
    for cell in range(cells):
        of[cell] = _root(of, cell)
        last = cell if of[cell] == best else last
    for cell in range(cells):
        if planes.kind[cell] != FOUND or of[cell] == best:
            continue
        x, y = planes.centre[cell, 0], planes.centre[cell, 1]
        nearest, over = np.inf, 0.0
        for other in range(best, last + 1):
            if of[other] != best:
                continue
            dx, dy = x - planes.centre[other, 0], y - planes.centre[other, 1]
            square = dx * dx + dy * dy
            if square < nearest:
                nearest, over = square, _height(planes, cell, x, y) - slope[0] * dx - slope[1] * dy
                over -= _height(planes, other, x - dx, y - dy)
        far = min(math.sqrt(nearest), _FARTHEST)
        fits = -_STEP - _STEP_PER_METRE * far < over < _STEP + _RISE * far
        fit[of[cell]] += 1.0 if fits else -1.0
    for cell in range(cells):
        if of[cell] != best and fit[of[cell]] <= 0.0:
            planes.kind[cell] = 0


@helper
def _measure_heights(
    points: CellPoints, planes: GroundPlanes, geometry: CellGeometry, rule: GroundRule, is_kept: Flags, s: LabelScratch
) -> None:
    """Find the height of every point above its cell's plane, and which lie on it; where not all do, sum by part."""
    for cell in range(len(geometry.x)):
        base = cell * PARTS * PARTS
        for part in range(base, base + PARTS * PARTS):
            s.level[part] = np.nan
        s.mixed[cell] = False
        if planes.kind[cell] == 0:
            continue
        a, b, c = planes.plane[cell, 0], planes.plane[cell, 1], planes.plane[cell, 2]
        first, last = points.starts[cell], points.starts[cell + 1]
        reach = rule.reach[geometry.zone[cell]]
        below = -_BELOW if planes.kind[cell] == FOUND else -reach
        if planes.kind[cell] != FOUND and last - first > rule.least_points:
            reach = -np.inf
        held = 0
        for i in range(first, last):
            h = points.xyz[2, i] - (a * points.xyz[0, i] + b * points.xyz[1, i] + c)
            s.heights[i] = h
            kept = below < h < reach
            is_kept[i] = kept
            held += kept
        s.mixed[cell] = held < last - first
        if held == last - first:
            for i in range(first, last):
                s.level[base + points.part[i]] = 0.0
            continue
        for part in range(base, base + PARTS * PARTS):
            s.state[part] = 0
            for k in range(s.sums.shape[1]):
                s.sums[part, k] = 0.0
        for i in range(first, last):
            part, h = base + points.part[i], s.heights[i]
            if abs(h) < _LAYER:
                s.sums[part, 0] += 1.0
                s.sums[part, 1] += h
                s.sums[part, 2] += h * h
                s.sums[part, 3] += is_kept[i]


@helper
def _beside(part: int, down: int, right: int, geometry: CellGeometry) -> int:
    """Return the number of a part next to another of the same zone; -1 beyond its border."""
    cell, inside = part // (PARTS * PARTS), part % (PARTS * PARTS)
    zone = geometry.zone[cell]
    rows, columns = geometry.rings[zone] * PARTS, geometry.sectors[zone] * PARTS
    row = geometry.ring[cell] * PARTS + inside // PARTS + down
    if row < 0 or row >= rows:
        return -1
    column = (geometry.sector[cell] * PARTS + inside % PARTS + right + columns) % columns
    home = geometry.first[zone] + (row // PARTS) * geometry.sectors[zone] + column // PARTS
    return int(home * PARTS * PARTS + (row % PARTS) * PARTS + column % PARTS)


@helper
def _grow(geometry: CellGeometry, s: LabelScratch) -> None:
    """Give a level to parts that are ground, and to thin ones that continue them: kerbs, banks, terraces."""
    inside = PARTS * PARTS
    for cell in range(len(geometry.x)):
        if not s.mixed[cell]:
            continue
        for part in range(cell * inside, (cell + 1) * inside):
            n = s.sums[part, 0]
            if s.sums[part, 3] > 0.0 and s.sums[part, 3] >= 0.5 * n:
                s.level[part] = 0.0
            elif n >= _PART_POINTS:
                mean = s.sums[part, 1] / n
                thin = s.sums[part, 2] / n - mean * mean < _PART_SPREAD * _PART_SPREAD
                s.state[part] = 1 if thin and _PART_LOWEST < mean < _PART_HIGHEST else 0
    for _ in range(_ROUNDS):
        grown = 0
        for cell in range(len(geometry.x)):
            if not s.mixed[cell]:
                continue
            for part in range(cell * inside, (cell + 1) * inside):
                if s.state[part] != 1:
                    continue
                mean = s.sums[part, 1] / s.sums[part, 0]
                for around in range(9):
                    other = _beside(part, around // 3 - 1, around % 3 - 1, geometry)
                    if other >= 0 and abs(s.level[other] - mean) < _PART_STEP:
                        s.state[part] = 2
                        grown += 1
                        break
        if grown == 0:
            break
        for cell in range(len(geometry.x)):
            if not s.mixed[cell]:
                continue
            for part in range(cell * inside, (cell + 1) * inside):
                if s.state[part] == 2:
                    s.level[part] = s.sums[part, 1] / s.sums[part, 0]
                    s.state[part] = 3


@helper
def _mark_plants(points: CellPoints, cell: int, limits: tuple[float, float], is_kept: Flags, s: LabelScratch) -> None:
    """Add the points of grown parts to the ground of a cell, and find the parts in which plants rise from it."""
    reach, least = limits
    base = cell * PARTS * PARTS
    for part in range(base, base + PARTS * PARTS):
        s.sums[part, 0] = s.sums[part, 1] = s.sums[part, 2] = 0.0
    for i in range(points.starts[cell], points.starts[cell + 1]):
        part, h = base + points.part[i], s.heights[i]
        if s.state[part] == 3:
            is_kept[i] = abs(h - s.level[part]) < _PART_REACH
        if is_kept[i]:
            s.sums[part, 0] += 1.0
            s.sums[part, 1] += h * h
        elif reach < h < reach + _PLANTS_ABOVE:
            s.sums[part, 2] += 1.0
    for part in range(base, base + PARTS * PARTS):
        low = s.sums[part, 0]
        rises = s.sums[part, 2] >= _PLANTS_SHARE * low
        s.state[part] = 4 if rises and s.sums[part, 1] > least * least * low else 0


@helper
def _leave_out_airborne(things: Annotated[NDArray[np.float32], 2], lowest: Singles, reach: float) -> None:
    """Take returns that lie alone from the things of a cell: fewer than three in a pixel and those next to it.

    The beams of a thing lie side by side, so that its returns do; those from rain, dust or an insect lie alone.
    """
    top, count = things[0], things[1]
    side = int(math.sqrt(len(lowest)) + 0.5)
    for place in range(len(lowest)):
        if not 0.0 < count[place] < _TOGETHER:
            continue
        low, high = lowest[place] - reach, top[place] + reach
        beside = count[place] if high - low < 3.0 * reach else np.float32(1.0)
        row, column = place // side, place % side
        for r in range(max(row - 1, 0), min(row + 2, side)):
            for k in range(r * side + max(column - 1, 0), r * side + min(column + 2, side)):
                if k != place and count[k] != 0.0 and lowest[k] < high and top[k] > low:
                    beside += abs(count[k])
        if beside < _TOGETHER:
            count[place] = -count[place]
    for place in range(len(lowest)):
        if count[place] < 0.0:
            top[place] = count[place] = np.float32(0.0)


@kernel
def label_points(
    points: CellPoints,
    geometry: CellGeometry,
    planes: GroundPlanes,
    rule: GroundRule,
    out: GroundLabels,
    scratch: LabelScratch,
) -> None:
    """Find which points are ground, and in each cell what stands on the ground and what hangs over it."""
    kept, low = out.kept, scratch.lowest
    _measure_heights(points, planes, geometry, rule, kept, scratch)
    _grow(geometry, scratch)
    for cell in range(len(geometry.x)):
        begin, end = points.starts[cell], points.starts[cell + 1]
        if begin == end:
            continue
        lowest, things = out.lowest[cell], out.things[cell]
        for k in range(len(low)):
            lowest[k, 0] = lowest[k, 1] = np.float32(np.inf)
            things[0, k] = things[1, k] = np.float32(0.0)
        if planes.kind[cell] == 0:
            for i in range(begin, end):
                place = points.pixel[i]
                lowest[place, 1] = min(lowest[place, 1], points.xyz[2, i])
                kept[i] = False
            continue
        zone, base, mixed = geometry.zone[cell], cell * PARTS * PARTS, scratch.mixed[cell]
        if mixed:
            least = max(_PLANTS_SPREAD * rule.noise[zone], _PLANTS_LEAST)
            _mark_plants(points, cell, (rule.reach[zone], least), kept, scratch)
        count = 0
        for i in range(begin, end):
            h, p, place, z = scratch.heights[i], points.order[i], points.pixel[i], points.xyz[2, i]
            out.height[p] = h
            if not mixed or (kept[i] and scratch.state[base + points.part[i]] != 4):
                out.ground[p] = True
                count += 1
                lowest[place, 0] = min(lowest[place, 0], z)
                continue
            kept[i] = False
            lowest[place, 1] = min(lowest[place, 1], z)
            if h >= rule.height:
                out.overhead[cell] += 1
                out.clearance[cell] = min(out.clearance[cell], h)
            if 0.0 < h < THINGS_HEIGHT * rule.height:
                first = things[1, place] == 0.0
                low[place] = h if first else min(low[place], h)
                things[0, place] = max(things[0, place], h)
                things[1, place] += np.float32(1.0)
        out.held[cell] = count
        if mixed:
            reach = _BESIDE_M + _BESIDE * math.sqrt(geometry.x[cell] ** 2 + geometry.y[cell] ** 2)
            _leave_out_airborne(things, low, reach)
            for i in range(begin, end):
                h = scratch.heights[i]
                if kept[i] or not 0.0 < h < THINGS_HEIGHT * rule.height:
                    continue
                if things[1, points.pixel[i]] == 0.0:
                    out.airborne[points.order[i]] = True
                elif rule.belly <= h < rule.height:
                    out.obstacles[cell] += 1
                    out.top[cell] = max(out.top[cell], h)
