"""Persons, vehicles, fences, barriers, fields of stones and of blocks."""

from collections.abc import Callable

import numpy as np

from bumpymap.lab.worlds.scans._fields import Floats, log_uniform
from bumpymap.lab.worlds.scans._solids import Triangles, boxes, ribbon, stones, tube

__all__ = [
    "Height",
    "barrier",
    "block_field",
    "fence",
    "fence_along",
    "guard_rail",
    "person",
    "pole",
    "stone_field",
    "vehicle",
    "wall",
]

Height = Callable[[Floats, Floats], Floats]
"""Function of eastings and northings (n,) [m] that returns heights of the ground (n,) [m]."""


def person(rng: np.random.Generator, base: Floats) -> Triangles:
    """Make a standing or walking person: legs, body, arms, head."""
    tall, turn, stride = rng.uniform(1.5, 1.95), rng.uniform(0, 2 * np.pi), rng.uniform(0, 0.3)
    ahead = np.array([np.cos(turn), np.sin(turn), 0.0])
    side = np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, tall])
    hip, shoulder = base + 0.5 * up, base + 0.82 * up
    parts = [tube(hip - 0.05 * up, shoulder, 0.17, 0.2, 10)]
    for way in (-1.0, 1.0):
        foot = base + way * (0.1 * side + stride * ahead)
        parts.append(tube(foot, hip + 0.09 * way * side, 0.07, 0.1, 8))
        hand = base + 0.48 * up + way * (0.28 * side - 0.6 * stride * ahead)
        parts.append(tube(shoulder + 0.2 * way * side, hand, 0.06, 0.04, 6))
    parts.append(stones(rng, (base + 0.93 * up)[None], np.array([[0.1, 0.1, 0.13]])))
    return np.concatenate(parts)


_MOST_BLOCKS = 8000
_MODELS = np.array(
    [  # length, width, height; cabin from, to (shares of the length), height of the body (share), clearance [m]
        [4.4, 1.8, 1.5, 0.2, 0.85, 0.55, 0.18],
        [4.8, 1.9, 1.8, 0.05, 0.8, 0.6, 0.22],
        [5.4, 2.0, 1.9, 0.4, 0.75, 0.55, 0.28],
        [5.6, 2.1, 2.4, 0.0, 0.85, 0.5, 0.2],
        [7.5, 2.4, 3.0, 0.0, 1.0, 0.4, 0.45],
        [2.6, 1.4, 1.8, 0.2, 0.7, 0.45, 0.3],
    ]
)


def vehicle(rng: np.random.Generator, base: Floats, heading: float | None = None) -> Triangles:
    """Make a car, jeep, pickup, van, truck or buggy on four wheels; at a random heading [rad] if None is given."""
    long, wide, tall, back, front, body, clear = _MODELS[rng.integers(len(_MODELS))] * rng.uniform(0.93, 1.07, 7)
    turn = rng.uniform(0, 2 * np.pi) if heading is None else heading
    ahead, side = np.array([np.cos(turn), np.sin(turn), 0.0]), np.array([-np.sin(turn), np.cos(turn), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    low = base + clear * up
    cabin = low + 0.98 * (body * tall - clear) * up + ((back + front) / 2 - 0.5) * long * ahead
    sizes = np.array(
        [[long, wide, body * tall - clear], [(front - back) * long, 0.9 * wide, (1 - body) * tall]],
    )
    parts = [boxes(sizes, np.stack([low, cabin]), np.full(2, turn))]
    radius = max(0.3, 0.8 * clear + 0.1)
    for along in (-0.3, 0.3):
        for way in (-1.0, 1.0):
            middle = base + radius * up + along * long * ahead + 0.5 * way * wide * side
            parts.append(tube(middle - 0.12 * side, middle + 0.12 * side, radius, radius, 12))
            hub = np.array([[1.2 * radius, 0.2, 1.2 * radius]])
            parts.append(boxes(hub, (middle - 0.6 * radius * up)[None], np.array([turn])))
    return np.concatenate(parts)


def _line(rng: np.random.Generator, middle: Floats, length_m: float, step_m: float) -> Floats:
    """Return points (n, 2) along a slightly bent line through ``middle`` (2,)."""
    count = max(3, int(length_m / step_m) + 1)
    bearing = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.03, count - 1))
    steps = step_m * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    places: Floats = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    moved: Floats = places - places[count // 2] + middle
    return moved


def fence(rng: np.random.Generator, middle: Floats, height: Height) -> Triangles:
    """Make a fence: posts with boards, pickets or wire between them, 8 to 40 m long."""
    return fence_along(rng, _line(rng, middle, rng.uniform(8, 40), rng.uniform(1.8, 3.0)), height)


def fence_along(rng: np.random.Generator, places: Floats, height: Height) -> Triangles:
    """Make a fence with posts at ``places`` (n, 2)."""
    feet = np.column_stack([places, height(places[:, 0], places[:, 1])])
    tall, thick = rng.uniform(0.9, 2.0), rng.uniform(0.03, 0.07)
    up = np.array([0.0, 0.0, 1.0])
    parts = [tube(foot - 0.1 * up, foot + tall * up, thick, thick, 6) for foot in feet]
    style = rng.integers(3)
    if style == 0:  # boards along it
        band = rng.uniform(0.08, 0.18)
        parts += [ribbon(feet + low * up, band) for low in np.arange(0.2, tall - band, rng.uniform(0.25, 0.45))]
        return np.concatenate(parts)
    gap, width = (rng.uniform(0.11, 0.2), rng.uniform(0.06, 0.1)) if style == 1 else (0.06, 0.012)
    share = np.arange(0, len(feet) - 1, gap / np.linalg.norm(places[1] - places[0]))
    first = np.minimum(share.astype(np.int64), len(feet) - 2)
    at = feet[first] + (share - first)[:, None] * (feet[first + 1] - feet[first])
    along = feet[first + 1] - feet[first]
    turn = np.arctan2(along[:, 1], along[:, 0])
    low = 0.05 if style == 1 else 0.02
    size = np.broadcast_to([width, 0.015, tall - low - 0.05], (len(at), 3))
    parts.append(boxes(np.asarray(size), at + low * up, turn))
    band, apart = (0.06, 0.4) if style == 1 else (0.015, 0.12)
    parts += [ribbon(feet + z * up, band) for z in np.arange(0.15, tall, apart)]
    return np.concatenate(parts)


def barrier(rng: np.random.Generator, middle: Floats, height: Height) -> Triangles:
    """Make a row of low concrete blocks with a wide base, or a crash rail on posts, 6 to 30 m long."""
    step = rng.uniform(1.5, 3.5)
    places = _line(rng, middle, rng.uniform(6, 30), step)
    feet = np.column_stack([places, height(places[:, 0], places[:, 1])])
    along = np.diff(places, axis=0)
    turn = np.arctan2(along[:, 1], along[:, 0])
    base = (feet[:-1] + feet[1:]) / 2
    up = np.array([0.0, 0.0, 1.0])
    count = len(base)
    if rng.uniform() < 0.25:
        return guard_rail(feet)
    tall, wide, gap = rng.uniform(0.7, 1.1), rng.uniform(0.5, 0.9), rng.uniform(0.0, 0.4)
    parts = [
        boxes(np.tile([step - gap, wide, 0.3 * tall], (count, 1)), base - 0.05 * up, turn),
        boxes(np.tile([step - gap, 0.6 * wide, 0.35 * tall], (count, 1)), base + 0.24 * tall * up, turn),
        boxes(np.tile([step - gap, 0.35 * wide, 0.45 * tall], (count, 1)), base + 0.55 * tall * up, turn),
    ]
    return np.concatenate(parts)


def guard_rail(feet: Floats) -> Triangles:
    """Make a crash rail on posts at ``feet`` (n, 3)."""
    along = np.diff(feet, axis=0)
    base = (feet[:-1] + feet[1:]) / 2
    parts = [boxes(np.tile([0.12, 0.12, 0.8], (len(base), 1)), base, np.arctan2(along[:, 1], along[:, 0]))]
    parts += [ribbon(feet + low * np.array([0.0, 0.0, 1.0]), 0.15) for low in (0.45, 0.62)]
    return np.concatenate(parts)


def pole(rng: np.random.Generator, base: Floats, heading: float) -> Triangles:
    """Make a lamp post, or a traffic sign whose face looks along the road."""
    up = np.array([0.0, 0.0, 1.0])
    if rng.uniform() < 0.5:
        tall, thick = rng.uniform(4.0, 9.0), rng.uniform(0.06, 0.12)
        return tube(base - 0.1 * up, base + tall * up, thick, 0.6 * thick, 8)
    tall, wide = rng.uniform(1.8, 3.2), rng.uniform(0.5, 1.2)
    face = boxes(np.array([[0.03, wide, wide * rng.uniform(0.6, 1.3)]]), (base + tall * up)[None], np.array([heading]))
    return np.concatenate([tube(base - 0.1 * up, base + (tall + 0.2) * up, 0.04, 0.04, 8), face])


def wall(rng: np.random.Generator, feet: Floats) -> Triangles:
    """Make the wall of a house or garden along ``feet`` (n, 3)."""
    tall = rng.uniform(3.0, 10.0) if rng.uniform() < 0.7 else rng.uniform(0.6, 2.2)
    top = float(feet[:, 2].max()) + tall
    low = feet - np.array([0.0, 0.0, 0.5])
    return np.concatenate([ribbon(low[k : k + 2], top - float(low[k : k + 2, 2].max())) for k in range(len(low) - 1)])


def stone_field(rng: np.random.Generator, places: Floats, height: Height) -> Triangles:
    """Make partly buried stones at ``places`` (n, 2): many small ones, few large ones."""
    largest = log_uniform(rng, 0.3, 0.8)
    size = largest * np.clip(rng.pareto(2.0, len(places)) * 0.25 + 0.25, 0.0, 1.0)
    radii = size[:, None] * rng.uniform([0.6, 0.6, 0.4], [1.2, 1.2, 0.9], (len(places), 3))
    z = height(places[:, 0], places[:, 1]) + rng.uniform(-0.1, 0.6, len(places)) * radii[:, 2]
    return stones(rng, np.column_stack([places, z]), radii)


def block_field(rng: np.random.Generator, places: Floats, height: Height) -> Triangles:
    """Make rubble like that of a demolished wall: adjacent blocks of one width of 0.2 to 0.8 m and random heights."""
    if not len(places):
        return np.empty((0, 3, 3), np.float32)
    low, high = places.min(axis=0), places.max(axis=0)
    wide = max(log_uniform(rng, 0.2, 0.8), float(np.sqrt(np.prod(high - low) / _MOST_BLOCKS)))
    cells = np.unique(np.floor(places / wide), axis=0)  # occupied cells only, so that gaps remain
    middle = (cells + 0.5) * wide + rng.uniform(-0.1, 0.1, cells.shape) * wide
    sizes = np.full((len(cells), 3), 1.05 * wide)
    sizes[:, 2] = rng.uniform(0.0, log_uniform(rng, 0.25, 0.9), len(cells)) + 0.1
    z = height(middle[:, 0], middle[:, 1]) - 0.1
    return boxes(sizes, np.column_stack([middle, z]), rng.uniform(-0.3, 0.3, len(cells)))
