"""A made-up wood with known obstacles: trunks, crowns, bushes, boulders, posts, fences, a power line, gentle hills.

The wood is laid out over flat ground, in heights above it, and then lifted onto the hills: a thing that stands 1 m high
does so anywhere.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Solids", "Wood", "plant_wood"]

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
