"""A made-up wood with known obstacles, surveyed from the air: trunks, crowns, bushes, boulders, posts, a power line.

The wood is laid out over flat ground, in heights above it, and then lifted onto the hills: a thing that stands 1 m high
does so anywhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, label

Floats = NDArray[np.float64]

STRAND_RADIUS = 0.025
"""Radius within which a pulse returns from a wire, m: half the width of the beam's bright part, not of the wire."""


@dataclass(frozen=True, slots=True)
class Solids:
    """Round things that stand upright, one row each, m."""

    x: Floats
    y: Floats
    radius: Floats
    """The greatest, in plan."""
    middle: Floats
    """Height above ground of that greatest radius; ``half`` above and below it the thing ends."""
    half: Floats

    def __len__(self) -> int:
        """Return the number of things."""
        return len(self.x)


@dataclass(frozen=True, slots=True)
class Wood:
    """What stands in a square with its south-west corner at the origin, all lengths in m."""

    side: float
    hills: Floats
    """(waves, 4) amplitude, wave numbers east and north [1/m], phase."""
    poles: Solids
    """Upright cylinders from the ground: trunks and posts."""
    boulders: Solids
    """Upper halves of ellipsoids."""
    bushes: Solids
    """Ellipsoids that let some pulses through."""
    crowns: Solids
    wires: Floats
    """(n, 5) x, y of one end, x, y of the other, height above ground."""

    def ground(self, x: Floats, y: Floats) -> Floats:
        """Return the height of the ground at places (n,), m."""
        waves = [a * np.sin(east * x + north * y + phase) for a, east, north, phase in self.hills]
        return np.asarray(np.sum(waves, axis=0))

    def blocked(self, low: float, high: float, step: float) -> NDArray[np.bool_]:
        """Return where something is between two heights [m] above ground, in cells of ``step`` [m], north row first."""
        count = round(self.side / step)
        at = (np.arange(count) + 0.5) * step
        x, y = np.meshgrid(at, at[::-1])
        mask = np.zeros((count, count), np.bool_)
        for things, upright in ((self.poles, True), (self.boulders, False), (self.bushes, False)):
            for px, py, radius, middle, half in zip(
                things.x, things.y, things.radius, things.middle, things.half, strict=True
            ):
                if middle + half <= low:
                    continue
                away = min(max(middle, low), high) - middle
                reach = radius if upright else radius * np.sqrt(max(0.0, 1.0 - (away / half) ** 2))
                mask |= (x - px) ** 2 + (y - py) ** 2 <= reach**2
        for x0, y0, x1, y1, height in self.wires:
            if low <= height <= high:
                mask |= _distance(x, y, (x0, y0), (x1, y1)) <= max(STRAND_RADIUS, 0.5 * step)
        return mask


def _distance(x: Floats, y: Floats, start: tuple[float, float], end: tuple[float, float]) -> Floats:
    """Return the distance in plan from places to a line between two points, m."""
    (x0, y0), (dx, dy) = start, (end[0] - start[0], end[1] - start[1])
    share = np.clip(((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
    return np.asarray(np.hypot(x - x0 - share * dx, y - y0 - share * dy))


def plant_wood(seed: int, side: float = 48.0, trees: float = 0.03, things: float = 0.03) -> Wood:
    """Draw a wood; the same seed gives the same wood.

    Parameters
    ----------
    seed : int
    side : float
        Of the square, m.
    trees : float
        Per m2.
    things : float
        Posts (a quarter), boulders and bushes (three eighths each) per m2.
    """
    rng = np.random.default_rng((seed, 31))
    trunks, crowns = _trees(max(1, round(trees * side**2)), side, rng)
    posts, stones, bushes = (max(1, round(share * things * side**2)) for share in (0.25, 0.375, 0.375))
    top = rng.uniform(0.9, 1.3, posts) / 2
    wide = rng.uniform(0.3, 0.9, stones)
    high = rng.uniform(0.45, 1.2, bushes) / 2
    corners = rng.uniform(0.1, 0.9, (2, 2)) * side
    waves = [rng.uniform(0.2, 0.8, 4), *rng.uniform(-0.2, 0.2, (2, 4)), rng.uniform(0.0, 2 * np.pi, 4)]
    fence = [np.append(corners, height) for height in (0.5, 0.8, 1.1)]
    return Wood(
        side=side,
        hills=np.column_stack(waves),
        poles=_joined(trunks, _placed(np.full(posts, 0.15), top, top, side, rng)),
        boulders=_placed(wide, np.zeros(stones), wide * rng.uniform(0.8, 1.3, stones), side, rng),
        bushes=_placed(rng.uniform(0.4, 0.9, bushes), high, high, side, rng),
        crowns=crowns,
        wires=np.array([*fence, [0.0, 0.3 * side, side, 0.7 * side, 6.0]]),
    )


def _trees(count: int, side: float, rng: np.random.Generator) -> tuple[Solids, Solids]:
    """Draw trunks of 0.1 to 0.5 m, and crowns above 2.5 m on them."""
    bottom, depth = rng.uniform(2.5, 4.5, count), rng.uniform(3.0, 6.0, count)
    half = (bottom + 0.5 * depth) / 2
    trunks = _placed(rng.uniform(0.05, 0.25, count), half, half, side, rng)
    return trunks, Solids(trunks.x, trunks.y, rng.uniform(1.2, 2.6, count), bottom + depth / 2, depth / 2)


def _placed(radius: Floats, middle: Floats, half: Floats, side: float, rng: np.random.Generator) -> Solids:
    """Put things anywhere."""
    x, y = rng.uniform(0.0, side, (2, len(radius)))
    return Solids(x, y, radius, middle, half)


def _joined(one: Solids, other: Solids) -> Solids:
    """Return the things of two kinds, in order."""
    pairs = [
        (one.x, other.x),
        (one.y, other.y),
        (one.radius, other.radius),
        (one.middle, other.middle),
        (one.half, other.half),
    ]
    x, y, radius, middle, half = (np.concatenate(pair) for pair in pairs)
    return Solids(x, y, radius, middle, half)


_ANGLES = (-30.0, 30.0)
"""Scan angles, degrees from the vertical."""
_LINES = 4
"""Flight lines over each place, half of them east to west, half south to north."""
_CROWN_M, _BUSH_M = 2.0, 0.25
"""Mean way of a pulse through leaves before it returns, m."""
_GOES_ON = 0.4
"""Share of the pulses that return from a leaf and have light left for what is beneath."""
_NOISE_M = 0.02
"""Standard deviation of a point along each axis, m."""
GROUND, LOW, MEDIUM, HIGH, OTHER, WIRE = 2, 3, 4, 5, 1, 14


@dataclass(frozen=True, slots=True)
class WoodPoints:
    """Points (n,) of a survey, m."""

    easting: Floats
    northing: Floats
    upward: Floats
    classification: NDArray[np.uint8]
    """LAS classes: 1 unassigned (boulders, posts, birds), 2 ground, 3 to 5 plants, 14 wire."""


@dataclass(frozen=True, slots=True)
class _Pulses:
    """Where pulses would meet level ground, and how far they lean: x at height h is ``x + h * east``."""

    x: Floats
    y: Floats
    east: Floats
    north: Floats


def survey_wood(wood: Wood, density: float, seed: int, grass_m: float = 0.0) -> WoodPoints:
    """Fly over a wood; the same seed gives the same points.

    Parameters
    ----------
    wood : Wood
    density : float
        Pulses per m2: the points per m2 of open ground.
    seed : int
    grass_m : float
        Height of grass on a third of the ground, m; half of its pulses return from blades.
    """
    rng = np.random.default_rng((seed, 32))
    pulses = _fly(wood.side, density, rng)
    height, kind = _solid(wood, pulses)
    leaves = [_leaf(crown, pulses, _CROWN_M, rng) for crown in _each(wood.crowns)]
    leaves += [_leaf(bush, pulses, _BUSH_M, rng) for bush in _each(wood.bushes)]
    if grass_m > 0:
        leaves.append(_grass(wood.side, grass_m, pulses, rng))
    which = np.concatenate([np.empty(0, np.int64), *(place for place, _ in leaves)])
    leaf = np.concatenate([np.empty(0), *(found for _, found in leaves)])
    end = height.copy()
    stops = rng.random(len(leaf)) >= _GOES_ON
    np.maximum.at(end, which[stops], leaf[stops])
    seen = leaf >= end[which]
    reached = height >= end
    pulse = np.concatenate([np.flatnonzero(reached), which[seen]])
    high = np.concatenate([height[reached], leaf[seen]])
    plants = np.select([high < 0.5, high < 2.0], [LOW, MEDIUM], HIGH)
    classes = np.concatenate([kind[reached], plants[np.count_nonzero(reached) :]])
    classes = np.where(classes == HIGH, plants, classes)
    return _points(wood, pulses, pulse, high, classes, rng)


def _fly(side: float, density: float, rng: np.random.Generator) -> _Pulses:
    """Draw pulses: places at random, leaning across the flight line under a scan angle that varies slowly."""
    count = int(rng.poisson(density * side**2))
    x, y = rng.uniform(0.0, side, (2, count))
    line = rng.integers(0, _LINES, count)
    low, high = np.tan(np.radians(_ANGLES))
    across = np.where(line % 2 == 0, y, x) / side
    lean = low + (high - low) * ((across + line / _LINES + 0.37) % 1.0)
    return _Pulses(x, y, np.where(line % 2 == 0, 0.0, lean), np.where(line % 2 == 0, lean, 0.0))


def _each(things: Solids) -> list[tuple[float, ...]]:
    return list(zip(things.x, things.y, things.radius, things.middle, things.half, strict=True))


def _solid(wood: Wood, pulses: _Pulses) -> tuple[Floats, NDArray[np.int64]]:
    """Return the height at which each pulse meets the first solid thing, and its class."""
    height, kind = np.zeros(len(pulses.x)), np.full(len(pulses.x), GROUND)
    trunks = len(wood.crowns)
    for number, pole in enumerate(_each(wood.poles)):
        _meet(_pole(pole, pulses), HIGH if number < trunks else OTHER, height, kind)
    for boulder in _each(wood.boulders):
        _meet(_ellipsoid(boulder, pulses), OTHER, height, kind)
    for x0, y0, x1, y1, high in wood.wires:
        dx, dy = x1 - x0, y1 - y0
        length = np.hypot(dx, dy)
        x, y = pulses.x + high * pulses.east - x0, pulses.y + high * pulses.north - y0
        along, away = (x * dx + y * dy) / length, np.abs(x * dy - y * dx) / length
        hit = (away < STRAND_RADIUS) & (along > 0) & (along < length) & (high > height)
        height[hit], kind[hit] = high, WIRE
    return height, kind


def _meet(found: tuple[NDArray[np.int64], Floats, Floats], own: int, height: Floats, kind: NDArray[np.int64]) -> None:
    """Raise ``height`` where pulses meet a thing above what they met so far."""
    place, top, _ = found
    higher = top > height[place]
    height[place[higher]], kind[place[higher]] = top[higher], own


def _near(thing: tuple[float, ...], pulses: _Pulses) -> NDArray[np.int64]:
    """Return the pulses that may meet a thing."""
    x, y, radius, middle, half = thing
    reach = radius + (middle + half) * np.tan(np.radians(_ANGLES[1]))
    return np.flatnonzero((np.abs(pulses.x - x) < reach) & (np.abs(pulses.y - y) < reach))


def _pole(thing: tuple[float, ...], pulses: _Pulses) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return the pulses that meet a cylinder, and the heights at which they enter and leave it."""
    near = _near(thing, pulses)
    x, y, east, north = pulses.x[near] - thing[0], pulses.y[near] - thing[1], pulses.east[near], pulses.north[near]
    a, b, c = east**2 + north**2 + 1e-12, x * east + y * north, x**2 + y**2 - thing[2] ** 2
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    high, low = np.minimum((-b + root) / a, thing[3] + thing[4]), np.maximum((-b - root) / a, 0.0)
    hit = (b * b > a * c) & (high > low)
    return near[hit], high[hit], low[hit]


def _ellipsoid(thing: tuple[float, ...], pulses: _Pulses) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return the pulses that meet an ellipsoid above ground, and the heights at which they enter and leave it."""
    near = _near(thing, pulses)
    _, _, radius, middle, half = thing
    east, north = pulses.east[near], pulses.north[near]
    x, y = pulses.x[near] - thing[0] + middle * east, pulses.y[near] - thing[1] + middle * north
    a, b = (east**2 + north**2) / radius**2 + 1 / half**2, (x * east + y * north) / radius**2
    c = (x**2 + y**2) / radius**2 - 1
    root = np.sqrt(np.maximum(b * b - a * c, 0.0))
    high, low = middle + (-b + root) / a, np.maximum(middle + (-b - root) / a, 0.0)
    hit = (b * b > a * c) & (high > low)
    return near[hit], high[hit], low[hit]


def _leaf(
    thing: tuple[float, ...], pulses: _Pulses, free_m: float, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Floats]:
    """Return the pulses that a plant returns, and the heights of the leaves."""
    place, high, low = _ellipsoid(thing, pulses)
    height = high - rng.exponential(free_m, len(place))
    return place[height > low], height[height > low]


def _grass(side: float, grass_m: float, pulses: _Pulses, rng: np.random.Generator) -> tuple[NDArray[np.int64], Floats]:
    """Return the pulses that grass returns on the western third of the wood, and the heights of the blades."""
    place = np.flatnonzero((pulses.x < side / 3) & (rng.random(len(pulses.x)) < 0.5))
    return place, grass_m * rng.beta(2.0, 2.0, len(place))


def _points(
    wood: Wood, pulses: _Pulses, pulse: NDArray[np.int64], high: Floats, classes: NDArray[np.int64],
    rng: np.random.Generator,
) -> WoodPoints:  # fmt: skip
    """Lift returns onto the hills, add noise and a few birds, and keep those inside the wood."""
    x, y = pulses.x[pulse] + high * pulses.east[pulse], pulses.y[pulse] + high * pulses.north[pulse]
    birds = max(1, round(wood.side**2 / 100))
    x, y = (np.concatenate([axis, rng.uniform(0, wood.side, birds)]) for axis in (x, y))
    high = np.concatenate([high, rng.uniform(0.3, 12.0, birds)])
    classes = np.concatenate([classes, np.full(birds, OTHER)])
    z = wood.ground(x, y) + high
    x, y, z = (axis + _NOISE_M * rng.standard_normal(len(axis)) for axis in (x, y, z))
    kept = (x >= 0) & (x < wood.side) & (y >= 0) & (y < wood.side)
    return WoodPoints(x[kept], y[kept], z[kept], classes[kept].astype(np.uint8))


def true_pixels(wood: Wood, low: float, high: float, pixel: float, parts: int = 4) -> NDArray[np.bool_]:
    """Return which pixels of the wood hold anything between two heights above ground, north row first.

    Parameters
    ----------
    wood : Wood
    low, high : float
        m.
    pixel : float
        Side of a pixel, m.
    parts : int
        A pixel is looked at in so many rows and columns.
    """
    fine = wood.blocked(low, high, pixel / parts)
    rows = len(fine) // parts
    return np.asarray(fine.reshape(rows, parts, rows, parts).any(axis=(1, 3)))


def swept_tiles(
    wood: Wood, low: float, high: float, width: float, tile: float, step: float = 0.05
) -> NDArray[np.bool_]:
    """Return through which tiles a disc can be swept among the true obstacles, (tiles, tiles), north row first.

    Its middle gets from one side of the tile to another; in a tile without obstacles it is enough that it fits.

    Parameters
    ----------
    wood : Wood
    low, high : float
        Heights between which a thing is in the way, m.
    width : float
        Diameter of the disc, m.
    tile, step : float
        Side of a tile, and of the cells of the sweep, m.
    """
    blocked = wood.blocked(low, high, step)
    free = distance_transform_edt(~blocked) * step > 0.5 * width
    side = round(tile / step)
    count = len(free) // side
    out = np.zeros((count, count), np.bool_)
    for row in range(count):
        for col in range(count):
            cells = np.s_[row * side : (row + 1) * side, col * side : (col + 1) * side]
            parts, found = label(free[cells])
            sides = [set(edge) - {0} for edge in (parts[0], parts[-1], parts[:, 0], parts[:, -1])]
            met = [sum(number in edge for edge in sides) for number in range(1, found + 1)]
            out[row, col] = max(met, default=0) >= (2 if blocked[cells].any() else 1)
    return out
