"""Compiled loops over the points of a scan: where each lies, where the ground drops, and what square cells say of it.

What lies behind an edge is not seen, and a plane that is fitted to both sides passes over it. Therefore the ground is
followed outwards: if what is seen next lies too far below where the ground should go on, there is an edge in between.
Nothing here allocates: scratch arrays come from the caller.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

Floats = Annotated[NDArray[np.float64], 1]
ScanPoints = Annotated[NDArray[np.float32], 2]
Integers = Annotated[NDArray[np.int32], 1]
Counts = Annotated[NDArray[np.int64], 1]
Singles = Annotated[NDArray[np.float32], 1]
Flags = Annotated[NDArray[np.bool_], 1]
Kinds = Annotated[NDArray[np.uint8], 1]

BLOCK = 512
"""Points whose distance and direction are found at once: they stay in the nearest cache."""
_EIGHTH = math.sqrt(2.0) - 1.0
"""Tangent of an eighth of a half turn."""


class ZoneGrid(NamedTuple):
    """The polar grid."""

    edges: Floats
    """(zones + 1,) where zones begin, and the last one ends, m; half-open."""
    sectors: Counts
    """(zones,) of each zone, as the next."""
    rings: Counts
    start: float
    """Where sector 0 starts, as a share of a turn."""
    pixels: int
    """Rows (outwards) and columns (counter-clockwise) of a sector."""


class CellPoints(NamedTuple):
    """The points by cell, side by side, in the scan's order inside each."""

    starts: Counts
    """(cells + 2,) cell c has those from ``starts[c]`` to ``starts[c + 1]``; zeros on entry; the last is scratch."""
    order: Integers
    """(points,) their numbers in the scan."""
    xyz: ScanPoints
    """(3, points) m."""
    pixel: Integers
    """(points,) ``row * pixels + column``."""
    part: Integers
    """(points,) part of the cell, as ``part_of_pixel`` says."""


@helper
def turn_of(x: float, y: float) -> float:
    """Angle from the x axis towards y as a share of a full turn, -0.5 to 0.5; 0 at the origin.

    The arctangent's own series, after the angle was folded into an eighth of a half turn: as exact as is asked for,
    without a call to a library whose last bit differs between machines, and without a branch that could be foreseen
    wrongly.
    """
    ax, ay = abs(x), abs(y)
    is_steep = ay > ax
    high, low = (ay, ax) if is_steep else (ax, ay)
    folded = low > _EIGHTH * high
    above, below = (low - high, low + high) if folded else (low, high)
    t = above / (below if below > 0.0 else 1.0)
    q = t * t
    s = 1 / 19 - q * (1 / 21)
    s = 1 / 11 - q * (1 / 13 - q * (1 / 15 - q * (1 / 17 - q * s)))
    s = 1 / 3 - q * (1 / 5 - q * (1 / 7 - q * (1 / 9 - q * s)))
    angle = t * (1.0 - q * s) * (0.5 / math.pi) + (0.125 if folded else 0.0)
    angle = 0.25 - angle if is_steep else angle
    angle = 0.5 - angle if x < 0.0 else angle
    return -angle if y < 0.0 else angle


@kernel
def place_points(
    points: ScanPoints,
    grid: ZoneGrid,
    part_of_pixel: Integers,
    cell: Integers,
    pixel: Integers,
    polar: Annotated[NDArray[np.float64], 2],
    out: CellPoints,
) -> None:
    """Find the cell and the pixel of every point, and list the points by cell.

    ``points`` (points, 3): m; ``cell`` (points,): filled: its number, by zone, ring, sector, -1 outside the grid;
    ``pixel`` (points,), ``polar`` (4, ``BLOCK``): scratch: x, y, distance and turn of so many points at a time.
    """
    edges, sectors, rings, pixels = grid.edges, grid.sectors, grid.rings, grid.pixels
    zones, start = len(sectors), grid.start
    starts, order, xyz = out.starts, out.order, out.xyz
    for begin in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - begin)
        for i in range(count):  # side by side, the next loop takes several at once
            polar[0, i], polar[1, i] = points[begin + i, 0], points[begin + i, 1]
        for i in range(count):
            x, y = polar[0, i], polar[1, i]
            polar[2, i] = math.sqrt(x * x + y * y)
            turn = turn_of(x, y) - start
            turn = turn + 1.0 if turn < 0.0 else turn
            polar[3, i] = turn + 1.0 if turn < 0.0 else turn
        for i in range(count):
            r, at = polar[2, i], begin + i
            if not edges[0] <= r < edges[zones]:
                cell[at] = -1
                continue
            zone, home = 0, 0
            while r >= edges[zone + 1]:
                home += sectors[zone] * rings[zone]
                zone += 1
            outward = (r - edges[zone]) / (edges[zone + 1] - edges[zone]) * rings[zone]
            ring = min(int(outward), rings[zone] - 1)
            around = polar[3, i] * sectors[zone]
            sector = min(int(around), sectors[zone] - 1)
            row = min(int((outward - ring) * pixels), pixels - 1)
            column = min(int((around - sector) * pixels), pixels - 1)
            home += ring * sectors[zone] + sector
            cell[at] = np.int32(home)
            pixel[at] = np.int32(row * pixels + column)
            starts[home + 2] += 1
    for c in range(2, len(starts)):
        starts[c] += starts[c - 1]
    for i in range(len(points)):
        home = cell[i]
        if home >= 0:
            order[starts[home + 1]] = np.int32(i)
            starts[home + 1] += 1
    for i in range(starts[len(starts) - 2]):
        p = order[i]
        xyz[0, i], xyz[1, i], xyz[2, i] = points[p, 0], points[p, 1], points[p, 2]
        out.pixel[i] = pixel[p]
        out.part[i] = part_of_pixel[pixel[p]]


class DropRule(NamedTuple):
    """Limits of a drop."""

    least: float
    """Less is none, m."""
    slope: float
    """A drop is steeper than this, against the slope of the ground before it."""
    below: float
    """The beam to what lies below passes the last ground before it above this, against that ground, m. If not, the
    ground goes on, and what is seen below is a reflection in it; -inf where the height of the sensor is not known."""
    slope_x: float
    """Of the whole ground, as the next: what lies below it by less than half of ``least`` is no drop, but a terrace."""
    slope_y: float
    directions: int
    """In which the ground is followed."""


@kernel
def find_drops(
    lowest: Annotated[NDArray[np.float32], 3],
    slope: Annotated[NDArray[np.float64], 2],
    starts: Counts,
    grid: ZoneGrid,
    rule: DropRule,
    drops: Integers,
) -> None:
    """Follow the ground outwards: count the drops in every cell.

    A drop counts for the last cell before it, and for the cell of what is seen below. ``lowest`` (cells, pixels^2, 2):
    z of the lowest ground point and of the lowest other one in each pixel, m; inf without any; unknown in cells without
    points; ``slope`` (cells, 2): of the ground along x and y; 0 where it is not known; ``starts``: as in `CellPoints`;
    ``drops`` (cells,): zeros; filled: in how many directions the ground drops in the cell.
    """
    pixels, zones = grid.pixels, len(grid.sectors)
    for direction in range(rule.directions):
        share = (direction + 0.5) / rule.directions
        turn = 2.0 * math.pi * (share + grid.start)
        cos, sin = math.cos(turn), math.sin(turn)
        level = rule.slope_x * cos + rule.slope_y * sin
        known, last_r, last_z, last_slope = False, 0.0, 0.0, 0.0
        last_cell, marked, first = -1, -1, 0
        for zone in range(zones):
            around = share * grid.sectors[zone]
            sector = int(around)
            column = int((around - sector) * pixels)
            step = (grid.edges[zone + 1] - grid.edges[zone]) / (grid.rings[zone] * pixels)
            for ring in range(grid.rings[zone]):
                cell = first + ring * grid.sectors[zone] + sector
                if starts[cell] == starts[cell + 1]:
                    continue
                for row in range(pixels):
                    k = row * pixels + column
                    on_ground = lowest[cell, k, 0] < np.inf
                    z = np.float64(lowest[cell, k, 0] if on_ground else lowest[cell, k, 1])
                    if z == np.inf:
                        continue
                    r = grid.edges[zone] + (ring * pixels + row + 0.5) * step
                    if known:
                        way = r - last_r
                        drop, beam = last_z + last_slope * way - z, z * last_r / r - last_z
                        is_lower = drop > max(rule.least, rule.slope * way) and beam > rule.below
                        if is_lower and last_z + level * way - z > 0.5 * rule.least:
                            drops[last_cell] += marked != last_cell
                            drops[cell] += cell not in (last_cell, marked)
                            marked = cell
                    if on_ground:
                        known, last_r, last_z, last_cell = True, r, z, cell
                        last_slope = slope[cell, 0] * cos + slope[cell, 1] * sin
            first += grid.sectors[zone] * grid.rings[zone]


RAYS = 180
"""Rays from the sensor through each side of a grid of square cells: at 30 m they are 0.33 m apart."""


class SquareCells(NamedTuple):
    """The square cells around a sensor, as a scan shows them; filled in place.

    Cells are numbered from the lowest y upwards, and in each row from the lowest x. Unknown heights are NaN.
    """

    kind: Kinds
    """(cells,) class of the ground; one more than the last where a vehicle cannot go, and one more where unknown."""
    sector: Integers
    """(cells,) row of the sector whose ground is known in the cell; -1 without any."""
    elevation: Singles
    """(cells,) mean z of the ground points, m."""
    step: Singles
    """(cells,) largest difference in elevation from a cell beside it, m."""
    top: Singles
    """(cells,) height above the ground of the highest point of an obstacle, m."""
    clearance: Singles
    """(cells,) height above the ground of the lowest point that a vehicle passes under, m."""
    tip: Singles
    """(cells,) z of that highest point, m."""


class ClassedPoints(NamedTuple):
    """A classified scan; arrays by sector have one row more, for points in none."""

    points: ScanPoints
    """(points, 3) m."""
    ground: Flags
    """(points,) whether it is ground."""
    airborne: Flags
    """(points,) whether it is left out."""
    height: Singles
    """(points,) above the ground of its sector, m; NaN where none is known."""
    sector: Integers
    """(points,) row of its sector; -1 if it is in none."""
    kind: Kinds
    """(sectors + 1,) of its ground, see `SquareCells`; the last one: unknown."""
    bare_kind: Kinds
    """(sectors + 1,) of its ground where all within ``CellRule.beside`` is ground or higher than the vehicle."""
    drops: Flags
    """(sectors + 1,) whether its ground drops."""
    slope: Annotated[NDArray[np.float64], 2]
    """(sectors + 1, 2) of its ground along x and y; the last one: of the whole ground."""


class CellRule(NamedTuple):
    """The cells, and what stops a vehicle."""

    resolution: float
    """Side of a cell, m."""
    half: int
    """Cells from the sensor to each side of the grid."""
    belly: float
    """Lower things and steps pass under a vehicle, m."""
    height: float
    """Things from here on pass over it, m."""
    beneath: int
    """So many cells behind a thing, ground that is seen beneath it is not known to be free."""
    beside: int
    """Things so many cells away are beside a cell."""


class CellScratch(NamedTuple):
    """Scratch. Rays go from the sensor, counter-clockwise; a ring holds the cells of one distance along x or y."""

    rays: Annotated[NDArray[np.int32], 2]
    """(cells, 3) given: the first and the last ray through the cell, and its ring."""
    cell: Integers
    """(points,) the cell of each; -1 outside."""
    block: Annotated[NDArray[np.float64], 2]
    """(2, BLOCK) x and y of so many points at a time, in cells."""
    slots: Integers
    """(BLOCK,) their rows of ``low``."""
    total: Annotated[NDArray[np.float64], 2]
    """(cells, 2) number of ground points, and the sum of their z, m."""
    things: Integers
    """(cells,) twice the points of obstacles, one more if some are lower; before, 1 if some are not ground."""
    level: Floats
    """(cells,) elevation of the ground in the cell, or the mean of those around it, m; NaN where neither is known."""
    low: Annotated[NDArray[np.float32], 2]
    """(4 RAYS half, 4) by `_slot`: z of the lowest ground, of the lowest and -z of the highest other point, m; inf
    without any; and, read with them, the row of the sector of the lowest ground."""
    seen: Annotated[NDArray[np.int32], 2]
    """(4 RAYS, half) row of the sector whose ground is seen, or goes on; or one of those below."""
    fell: Flags
    """(sectors + 1,) whether the ground drops somewhere in the sector."""


_UNSEEN, _BENEATH, _FALLS = -1, -2, -3
"""Nothing is known; the ground is seen beneath a thing that hides what stands on it; the ground drops."""


@helper
def _slot(ray: int, ring: int, half: int) -> int:
    """Return the row of a ray and a ring in ``CellScratch.low``: four rays side by side share a line of the cache."""
    return ((ray >> 2) * half + ring) * 4 + (ray & 3)


@helper
def _sort_into_cells(scan: ClassedPoints, rule: CellRule, out: SquareCells, s: CellScratch) -> None:
    """Find the cell of every point, and the lowest points by ray and ring; sum the ground by cell."""
    half, side, scale, belly = rule.half, 2 * rule.half, 1.0 / rule.resolution, rule.belly
    points, low, total = scan.points, s.low, s.total
    for begin in range(0, len(points), BLOCK):
        count = min(BLOCK, len(points) - begin)
        for i in range(count):
            s.block[0, i], s.block[1, i] = points[begin + i, 0] * scale, points[begin + i, 1] * scale
        for i in range(count):  # without a branch: several at once
            x, y, p = s.block[0, i], s.block[1, i], begin + i
            ahead = abs(x) >= abs(y)
            lead, beside = (x, y) if ahead else (y, -x)
            far = abs(lead)
            inside = (0.0 < far < half) & ((scan.sector[p] >= 0) | (scan.height[p] == scan.height[p]))
            inside &= not scan.airborne[p]
            row, column = min(int(np.int32(y + half)), side - 1), min(int(np.int32(x + half)), side - 1)
            turn = int(np.int32((beside / (lead if inside else 1.0) + 1.0) * (0.5 * RAYS)))
            quarter = (0 if lead > 0.0 else 2) + (0 if ahead else 1)
            s.cell[p] = np.int32(row * side + column if inside else -1)
            s.slots[i] = np.int32(_slot(quarter * RAYS + min(turn, RAYS - 1), int(np.int32(far)), half))
        for i in range(count):
            p = begin + i
            cell, slot, z, h = s.cell[p], s.slots[i], points[p, 2], scan.height[p]
            if cell < 0:
                continue
            is_ground = scan.ground[p]
            if is_ground:
                total[cell, 0] += 1.0
                total[cell, 1] += z
                if out.sector[cell] < 0:
                    out.sector[cell] = scan.sector[p]
            else:
                s.things[cell] = 1
            if is_ground or abs(h) < belly:
                if z < low[slot, 0]:
                    low[slot, 0], low[slot, 3] = z, np.float32(scan.sector[p])
            elif not h >= rule.height:
                low[slot, 1] = min(low[slot, 1], z)
                low[slot, 2] = min(low[slot, 2], -z)


@helper
def _level_cells(rule: CellRule, out: SquareCells, s: CellScratch) -> None:
    """Find the elevation of the ground in every cell, its steps, and the level from which things are measured."""
    side, total, elevation = 2 * rule.half, s.total, out.elevation
    for cell in range(side * side):
        s.level[cell] = elevation[cell] = np.nan
        if total[cell, 0] > 0.0:
            s.level[cell] = total[cell, 1] / total[cell, 0]
            elevation[cell] = s.level[cell]
    for row in range(side):
        for column in range(side):
            cell = row * side + column
            if total[cell, 0] > 0.0:
                out.step[cell] = 0.0
                for up, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                    other = cell + up * side + right
                    if 0 <= row + up < side and 0 <= column + right < side and total[other, 0] > 0.0:
                        out.step[cell] = max(out.step[cell], abs(elevation[other] - elevation[cell]))
            elif s.things[cell] > 0:
                height = count = 0.0
                for up in range(max(row - 1, 0), min(row + 2, side)):
                    for right in range(max(column - 1, 0), min(column + 2, side)):
                        if total[up * side + right, 0] > 0.0:
                            count += 1.0
                            height += elevation[up * side + right]
                s.level[cell] = height / count
            s.things[cell] = 0


@helper
def _stand_things(scan: ClassedPoints, rule: CellRule, out: SquareCells, s: CellScratch) -> None:
    """Find what stands on the ground of every cell, and what hangs over it.

    An obstacle is one above the ground in the cell, or above that of its sector.
    """
    for i in range(len(scan.points)):
        cell = s.cell[i]
        if cell < 0 or scan.ground[i]:
            continue
        h, near = np.float64(scan.height[i]), scan.points[i, 2] - s.level[cell]
        if not (math.isnan(near) or rule.belly <= h < rule.height):
            h = near
        if math.isnan(h):
            s.things[cell] += 2
        elif h >= rule.height:
            out.clearance[cell] = h if math.isnan(out.clearance[cell]) else min(out.clearance[cell], np.float32(h))
        elif h >= rule.belly:
            s.things[cell] += 2
            if not h <= out.top[cell]:
                out.top[cell], out.tip[cell] = h, scan.points[i, 2]
        else:
            s.things[cell] |= 1
            if h > -rule.belly and out.sector[cell] < 0:
                out.sector[cell] = scan.sector[i]


@helper
def _follow_ray(ray: int, slope_to: tuple[float, float], scan: ClassedPoints, rule: CellRule, s: CellScratch) -> None:
    """Follow the ground outwards along a ray: find where it goes on between returns, and where it drops.

    It goes on if the beam to the farther one passes the nearer one lower than the belly, so that no obstacle can hide
    there, and no obstacle before it hides what may stand on it. A return that is missing is that of a ray beside it.
    """
    (rays, half), (x, y) = s.seen.shape, slope_to
    low, seen, belly = s.low, s.seen, rule.belly
    before, after = (ray + rays - 1) % rays, (ray + 1) % rays
    last, level, home = -1, 0.0, -1
    thing, under, shadow = -half, np.inf, -np.inf
    for ring in range(half):
        at, slot = ray, _slot(ray, ring, half)
        if low[slot, 0] == np.inf and low[slot, 1] == np.inf:
            at, slot = before, _slot(before, ring, half)
            if not min(low[slot, 0], low[slot, 1]) < np.inf:
                at, slot = after, _slot(after, ring, half)
        for kind in range(2):
            z = np.float64(low[slot, kind])
            if z == np.inf:
                continue
            here, away = (int(low[slot, 3]) if kind == 0 else home), ring + 0.5
            if last >= 0:
                above = z - level - (scan.slope[home, 0] * x + scan.slope[home, 1] * y) * (ring - last)
                whole = (scan.slope[-1, 0] * x + scan.slope[-1, 1] * y) * (ring - last)
                if above < -belly and z - level - whole < -0.5 * belly:
                    if scan.drops[home] or scan.drops[here]:
                        s.fell[home] = s.fell[here] = True
                        for k in range(last, ring + kind):
                            seen[ray, k] = _FALLS
                elif (kind == 0 or above < rule.height) and z * (last + 0.5) / away - level < belly:
                    for k in range(last + 1, ring):
                        if shadow * (k + 0.5) - level < belly:
                            seen[ray, k] = home if 2 * k < last + ring else here
                if kind == 1 and belly <= above < rule.height:
                    shadow = max(shadow, -low[slot, 2] / away)
                    under = z / away if ring - thing > rule.beneath else min(under, z / away)
                    thing = ring
            if kind == 0:
                last, level, home = ring, z, here
                dark = shadow * away - level >= belly
                beneath = dark and ring - thing <= rule.beneath and z / away < under
                if seen[ray, ring] != _FALLS and (at == ray or not dark):
                    seen[ray, ring] = _BENEATH if beneath else here


@helper
def _is_bare(cell: int, rule: CellRule, things: Integers) -> bool:
    """Return whether nothing is beside a cell, or in it, that is lower than the vehicle and not ground."""
    side, wide = 2 * rule.half, rule.beside
    row, column = cell // side, cell % side
    for k in range(max(row - wide, 0), min(row + wide + 1, side)):
        for i in range(max(column - wide, 0), min(column + wide + 1, side)):
            if things[k * side + i] > 0:
                return False
    return True


@helper
def _judge_cell(cell: int, scan: ClassedPoints, rule: CellRule, out: SquareCells, s: CellScratch) -> None:
    """Find the kind of a cell, and the sector whose ground is known there."""
    first, last, ring = s.rays[cell, 0], s.rays[cell, 1], s.rays[cell, 2]
    seen, beneath, falls, home = 0, 0, False, -1
    for ray in range(first, last + 1):
        sector = s.seen[ray, ring]
        falls |= sector == _FALLS
        beneath += sector == _BENEATH
        if sector >= 0:
            seen += 1
            home = sector if home < 0 or 2 * ray <= first + last else home
    if out.sector[cell] < 0 and 2 * seen > last - first:
        out.sector[cell] = home
    if beneath > seen:
        out.sector[cell] = -1
    sector = out.sector[cell]
    falls |= scan.drops[sector] and not s.fell[sector]
    stops = s.things[cell] > 1 or falls or out.step[cell] > rule.belly
    kind = scan.kind[-1] - 1 if stops else scan.kind[sector]
    if kind == scan.kind[sector] != scan.bare_kind[sector] and _is_bare(cell, rule, s.things):
        kind = scan.bare_kind[sector]
    out.kind[cell] = kind


@kernel
def lay_cells(scan: ClassedPoints, rule: CellRule, out: SquareCells, scratch: CellScratch) -> None:
    """Say of every cell how high its ground is, what stands on it and hangs over it, and whether it is free.

    ``out`` and ``scratch`` come as they are without a point: heights NaN, rows -1, the lowest points inf, counts 0.
    """
    _sort_into_cells(scan, rule, out, scratch)
    _level_cells(rule, out, scratch)
    _stand_things(scan, rule, out, scratch)
    for ray in range(4 * RAYS):
        across = ((ray % RAYS) + 0.5) / (0.5 * RAYS) - 1.0
        ahead = rule.resolution if ray < 2 * RAYS else -rule.resolution
        way = (ahead, ahead * across) if ray // RAYS % 2 == 0 else (-ahead * across, ahead)
        _follow_ray(ray, way, scan, rule, scratch)
    for cell in range(len(out.kind)):
        _judge_cell(cell, scan, rule, out, scratch)
