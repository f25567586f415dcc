"""Labels of RELLIS-3D, random fields, the objects of a scene as triangles, and its ground: relief, labels, a mesh.

Fields are periodic: computed once on a small square, sampled anywhere, rotated so that periods do not align. Triangles
are arrays (m, 3, 3): triangle, corner, x y z [m]. The ``reach`` of a region is a normalised distance: below 1 inside,
1 on its margin, increasing outwards.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.terrains import log_uniform

Floats = NDArray[np.float64]


def smoothstep(t: Floats) -> Floats:
    """Rise from 0 to 1 for t from 0 to 1, with level ends."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@dataclass(frozen=True, slots=True)
class Field:
    """Self-affine noise of standard deviation 1."""

    values: NDArray[np.float32]
    """(n, n) one period; n is a power of two."""
    step_m: float
    """Distance between values, m."""
    turn: tuple[float, float]
    """Cosine and sine of the angle by which the square is rotated."""

    def at(self, x: Floats, y: Floats) -> Floats:
        """Return bilinear values at positions in metres."""
        last = len(self.values) - 1
        u = (self.turn[0] * x + self.turn[1] * y) / self.step_m
        v = (self.turn[0] * y - self.turn[1] * x) / self.step_m
        i, j = np.floor(u).astype(np.int32), np.floor(v).astype(np.int32)
        right, up = u - i, v - j
        i, j = i & last, j & last
        i_next, j_next = (i + 1) & last, (j + 1) & last
        low = self.values[j, i] * (1 - right) + self.values[j, i_next] * right
        high = self.values[j_next, i] * (1 - right) + self.values[j_next, i_next] * right
        return low * (1 - up) + high * up


def make_field(rng: np.random.Generator, size: int, step_m: float, hurst: float, waves_m: tuple[float, float]) -> Field:
    """Make a field of ``size`` x ``size`` values (a power of two), with waves between two lengths.

    Its power spectral density falls as k^-(2 hurst + 2); natural ground has a Hurst exponent of 0.3 to 0.9.
    """
    k = np.hypot(np.fft.fftfreq(size, step_m)[:, None], np.fft.rfftfreq(size, step_m)[None, :])
    inside = (k >= 1 / waves_m[1]) & (k <= 1 / waves_m[0])
    gain = np.where(inside, np.maximum(k, 1e-9) ** -(hurst + 1), 0.0)
    values = np.fft.irfft2(np.fft.rfft2(rng.standard_normal((size, size))) * gain, s=(size, size))
    angle = rng.uniform(0, 2 * np.pi)
    return Field((values / values.std()).astype(np.float32), step_m, (float(np.cos(angle)), float(np.sin(angle))))


class Label(IntEnum):
    """Ids of the ``.label`` files of the data set."""

    VOID = 0
    DIRT = 1
    GRASS = 3
    TREE = 4
    WATER = 6
    VEHICLE = 8
    ASPHALT = 10
    PERSON = 17
    FENCE = 18
    BUSH = 19
    CONCRETE = 23
    BARRIER = 27
    PUDDLE = 31
    MUD = 33
    RUBBLE = 34


REFLECTIONS = {
    Label.DIRT: ((0.2, 0.4), (0.0, 0.0)),
    Label.GRASS: ((0.3, 0.6), (0.0, 0.0)),
    Label.TREE: ((0.3, 0.6), (0.0, 0.0)),
    Label.WATER: ((0.05, 0.2), (0.75, 0.97)),
    Label.VEHICLE: ((0.2, 0.7), (0.05, 0.35)),
    Label.ASPHALT: ((0.1, 0.25), (0.0, 0.0)),
    Label.PERSON: ((0.2, 0.6), (0.0, 0.0)),
    Label.FENCE: ((0.2, 0.5), (0.0, 0.0)),
    Label.BUSH: ((0.3, 0.6), (0.0, 0.0)),
    Label.CONCRETE: ((0.25, 0.5), (0.0, 0.0)),
    Label.BARRIER: ((0.25, 0.5), (0.0, 0.0)),
    Label.PUDDLE: ((0.05, 0.25), (0.7, 0.95)),
    Label.MUD: ((0.1, 0.25), (0.05, 0.4)),
    Label.RUBBLE: ((0.2, 0.45), (0.0, 0.0)),
}
"""Label -> range of the reflectivity, and of the share of pulses that a smooth wet or painted surface reflects away;
each scene draws its own values. Open water returns little light at the low angles of a ground robot, wet mud less than
dry dirt."""


Triangles = NDArray[np.float32]
_UP = np.array([0.0, 0.0, 1.0])

_BOX = np.array(
    [
        [[0, 0, 0], [1, 1, 0], [1, 0, 0]], [[0, 0, 0], [0, 1, 0], [1, 1, 0]],
        [[0, 0, 1], [1, 0, 1], [1, 1, 1]], [[0, 0, 1], [1, 1, 1], [0, 1, 1]],
        [[0, 0, 0], [1, 0, 0], [1, 0, 1]], [[0, 0, 0], [1, 0, 1], [0, 0, 1]],
        [[0, 1, 0], [1, 1, 1], [1, 1, 0]], [[0, 1, 0], [0, 1, 1], [1, 1, 1]],
        [[0, 0, 0], [0, 0, 1], [0, 1, 1]], [[0, 0, 0], [0, 1, 1], [0, 1, 0]],
        [[1, 0, 0], [1, 1, 0], [1, 1, 1]], [[1, 0, 0], [1, 1, 1], [1, 0, 1]],
    ],
    float,
) - np.array([0.5, 0.5, 0.0])  # fmt: skip


def _icosahedron() -> Floats:
    """Return the 20 faces of an icosahedron inscribed in the unit sphere."""
    golden = (1 + np.sqrt(5)) / 2
    corners = np.array([[s, t * golden, 0] for s in (-1, 1) for t in (-1, 1)])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)]) / np.hypot(1, golden)
    side = 2 / np.hypot(1, golden)
    near = np.abs(np.linalg.norm(corners[:, None] - corners[None], axis=-1) - side) < 1e-6
    index = range(len(corners))
    faces = [
        (a, b, c)
        for a in index
        for b in index[a + 1 :]
        for c in index[b + 1 :]
        if near[a, b] and near[b, c] and near[a, c]
    ]
    return corners[np.array(faces)]


_BALL = _icosahedron()


def boxes(sizes: Floats, bases: Floats, turns: Floats) -> Triangles:
    """Make boxes of ``sizes`` (n, 3) standing on ``bases`` (n, 3), rotated about z by ``turns`` (n,)."""
    shaped = _BOX[None] * sizes[:, None, None, :]
    return (_turn(shaped, turns) + bases[:, None, None, :]).reshape(-1, 3, 3).astype(np.float32)


def _turn(shapes: Floats, turns: Floats) -> Floats:
    """Rotate shapes (n, ..., 3) about z by angles (n,)."""
    cos, sin = (part.reshape(-1, *[1] * (shapes.ndim - 2)) for part in (np.cos(turns), np.sin(turns)))
    x, y = shapes[..., 0], shapes[..., 1]
    return np.stack([cos * x - sin * y, sin * x + cos * y, shapes[..., 2]], axis=-1)


def tube(start: Floats, end: Floats, start_radius: float, end_radius: float, sides: int = 8) -> Triangles:
    """Make a round bar between two points (3,), open at its ends."""
    along = end - start
    across = np.cross(along, [1.0, 0.0, 0.0] if abs(along[0]) < 0.7 * np.linalg.norm(along) else [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(along, across)
    other /= np.linalg.norm(other)
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    circle = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * other
    low, high = start + start_radius * circle, end + end_radius * circle
    return _band(low, high)


def ribbon(points: Floats, height_m: float) -> Triangles:
    """Make an upright band along ``points`` (n, 3), which form its lower edge."""
    return _band(points, points + np.array([0.0, 0.0, height_m]))


def _band(low: Floats, high: Floats) -> Triangles:
    """Fill the band between two rows of points, (n, 3) each."""
    first = np.stack([low[:-1], low[1:], high[:-1]], axis=1)
    second = np.stack([low[1:], high[1:], high[:-1]], axis=1)
    return np.concatenate([first, second]).astype(np.float32)


def stones(rng: np.random.Generator, middles: Floats, radii: Floats) -> Triangles:
    """Make angular stones with centres ``middles`` (n, 3) and half axes ``radii`` (n, 3)."""
    count = len(middles)
    corners, face = np.unique(np.round(_BALL.reshape(-1, 3), 9), axis=0, return_inverse=True)
    shaken = corners[None] * rng.uniform(0.75, 1.25, (count, len(corners), 1))
    shapes = shaken[:, face.ravel()].reshape(count, len(_BALL), 3, 3) * radii[:, None, None, :]
    return (_turn(shapes, rng.uniform(0, 2 * np.pi, count)) + middles[:, None, None, :]).reshape(-1, 3, 3).astype("f4")


def leaves(rng: np.random.Generator, middle: Floats, radii: Floats, count: int, free_path_m: float) -> Triangles:
    """Scatter leaves, as separate triangles, in an ellipsoid, denser towards its surface.

    Their size gives beams a mean free path of ``free_path_m``. For randomly oriented flat triangles the mean free path
    is 1 / (number per cubic metre x half their area).
    """
    way = rng.standard_normal((count, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    place = middle + way * rng.uniform(0, 1, (count, 1)) ** 0.25 * radii
    area = 2 / (free_path_m * count / (4 / 3 * np.pi * float(np.prod(radii))))
    side = np.sqrt(area / 0.433)
    one = rng.standard_normal((count, 3))
    one /= np.linalg.norm(one, axis=1, keepdims=True)
    two = np.cross(one, rng.standard_normal((count, 3)))
    two /= np.linalg.norm(two, axis=1, keepdims=True)
    size = side * rng.uniform(0.6, 1.4, (count, 1))
    corners = [place + size * (np.cos(a) * one + np.sin(a) * two) / np.sqrt(3) for a in (0.0, 2.094, 4.189)]
    return np.stack(corners, axis=1).astype(np.float32)


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
    low = base + clear * _UP
    cabin = low + 0.98 * (body * tall - clear) * _UP + ((back + front) / 2 - 0.5) * long * ahead
    sizes = np.array([[long, wide, body * tall - clear], [(front - back) * long, 0.9 * wide, (1 - body) * tall]])
    parts = [boxes(sizes, np.stack([low, cabin]), np.full(2, turn))]
    radius = max(0.3, 0.8 * clear + 0.1)
    for along in (-0.3, 0.3):
        for way in (-1.0, 1.0):
            middle = base + radius * _UP + along * long * ahead + 0.5 * way * wide * side
            parts.append(tube(middle - 0.12 * side, middle + 0.12 * side, radius, radius, 12))
            hub = np.array([[1.2 * radius, 0.2, 1.2 * radius]])
            parts.append(boxes(hub, (middle - 0.6 * radius * _UP)[None], np.array([turn])))
    return np.concatenate(parts)


def _line(rng: np.random.Generator, middle: Floats, length_m: float, step_m: float) -> Floats:
    """Return points (n, 2) along a slightly bent line through ``middle`` (2,)."""
    count = max(3, int(length_m / step_m) + 1)
    bearing = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.03, count - 1))
    steps = step_m * np.stack([np.cos(bearing), np.sin(bearing)], axis=1)
    places: Floats = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    return places - places[count // 2] + middle


def fence(rng: np.random.Generator, middle: Floats, height: Height) -> Triangles:
    """Make a fence: posts with boards, pickets or wire between them, 8 to 40 m long."""
    return fence_along(rng, _line(rng, middle, rng.uniform(8, 40), rng.uniform(1.8, 3.0)), height)


def fence_along(rng: np.random.Generator, places: Floats, height: Height) -> Triangles:
    """Make a fence with posts at ``places`` (n, 2)."""
    feet = np.column_stack([places, height(places[:, 0], places[:, 1])])
    tall, thick = rng.uniform(0.9, 2.0), rng.uniform(0.03, 0.07)
    parts = [tube(foot - 0.1 * _UP, foot + tall * _UP, thick, thick, 6) for foot in feet]
    style = rng.integers(3)
    if style == 0:  # boards along it
        band = rng.uniform(0.08, 0.18)
        parts += [ribbon(feet + low * _UP, band) for low in np.arange(0.2, tall - band, rng.uniform(0.25, 0.45))]
        return np.concatenate(parts)
    gap, width = (rng.uniform(0.11, 0.2), rng.uniform(0.06, 0.1)) if style == 1 else (0.06, 0.012)
    share = np.arange(0, len(feet) - 1, gap / np.linalg.norm(places[1] - places[0]))
    first = np.minimum(share.astype(np.int64), len(feet) - 2)
    at = feet[first] + (share - first)[:, None] * (feet[first + 1] - feet[first])
    along = feet[first + 1] - feet[first]
    turn = np.arctan2(along[:, 1], along[:, 0])
    low = 0.05 if style == 1 else 0.02
    size = np.broadcast_to([width, 0.015, tall - low - 0.05], (len(at), 3))
    parts.append(boxes(np.asarray(size), at + low * _UP, turn))
    band, apart = (0.06, 0.4) if style == 1 else (0.015, 0.12)
    parts += [ribbon(feet + z * _UP, band) for z in np.arange(0.15, tall, apart)]
    return np.concatenate(parts)


def barrier(rng: np.random.Generator, middle: Floats, height: Height) -> Triangles:
    """Make a row of low concrete blocks with a wide base, or a crash rail on posts, 6 to 30 m long."""
    step = rng.uniform(1.5, 3.5)
    places = _line(rng, middle, rng.uniform(6, 30), step)
    feet = np.column_stack([places, height(places[:, 0], places[:, 1])])
    along = np.diff(places, axis=0)
    turn = np.arctan2(along[:, 1], along[:, 0])
    base = (feet[:-1] + feet[1:]) / 2
    count = len(base)
    if rng.uniform() < 0.25:
        return guard_rail(feet)
    tall, wide, gap = rng.uniform(0.7, 1.1), rng.uniform(0.5, 0.9), rng.uniform(0.0, 0.4)
    parts = [
        boxes(np.tile([step - gap, wide, 0.3 * tall], (count, 1)), base - 0.05 * _UP, turn),
        boxes(np.tile([step - gap, 0.6 * wide, 0.35 * tall], (count, 1)), base + 0.24 * tall * _UP, turn),
        boxes(np.tile([step - gap, 0.35 * wide, 0.45 * tall], (count, 1)), base + 0.55 * tall * _UP, turn),
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
    if rng.uniform() < 0.5:
        tall, thick = rng.uniform(4.0, 9.0), rng.uniform(0.06, 0.12)
        return tube(base - 0.1 * _UP, base + tall * _UP, thick, 0.6 * thick, 8)
    tall, wide = rng.uniform(1.8, 3.2), rng.uniform(0.5, 1.2)
    face = boxes(np.array([[0.03, wide, wide * rng.uniform(0.6, 1.3)]]), (base + tall * _UP)[None], np.array([heading]))
    return np.concatenate([tube(base - 0.1 * _UP, base + (tall + 0.2) * _UP, 0.04, 0.04, 8), face])


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


def _cloud(rng: np.random.Generator, middle: Floats, radii: Floats, base: Floats, free_path_m: float) -> Triangles:
    """Scatter leaves; fewer at distances at which the sensor cannot resolve them."""
    distance, volume = float(np.hypot(base[0], base[1])), 4 / 3 * np.pi * float(np.prod(radii))
    dense, most = (700.0, 7000) if distance < 15 else (150.0, 2500) if distance < 35 else (40.0, 900)
    return leaves(rng, middle, radii, int(np.clip(dense * volume, 60, most)), free_path_m)


def bush(rng: np.random.Generator, base: Floats, height_m: float) -> Triangles:
    """Make a bush on ``base`` (3,): a few lobes of leaves down to the ground, on thin stems."""
    width = height_m * rng.uniform(0.35, 0.75)
    path = log_uniform(rng, 0.12, 0.45)
    parts = []
    for _ in range(int(rng.integers(2, 6))):
        tall = height_m * rng.uniform(0.5, 1.0) / 2
        away, where = width * rng.uniform(0, 0.8), rng.uniform(0, 2 * np.pi)
        middle = base + np.array([away * np.cos(where), away * np.sin(where), tall * rng.uniform(0.75, 1.0)])
        wide = width * rng.uniform(0.5, 0.9)
        parts.append(_cloud(rng, middle, np.array([wide, wide, tall]), base, path))
        parts.append(tube(base, middle, 0.015, 0.008, 4))
    return np.concatenate(parts)


def herb(rng: np.random.Generator, base: Floats, height_m: float) -> Triangles:
    """Make a low plant on ``base`` (3,): a fern, a seedling, a tussock."""
    wide = height_m * rng.uniform(0.4, 1.0)
    middle = base + np.array([0.0, 0.0, 0.5 * height_m])
    return leaves(rng, middle, np.array([wide, wide, 0.5 * height_m]), 60, log_uniform(rng, 0.1, 0.5))


def hedge(rng: np.random.Generator, feet: Floats) -> Triangles:
    """Make a dense row of shrubs at ``feet`` (n, 3), 0.5 to 2.5 m high."""
    tall, path = log_uniform(rng, 0.5, 2.5) / 2, log_uniform(rng, 0.08, 0.25)
    apart = float(np.linalg.norm(feet[1, :2] - feet[0, :2]))
    radii, up = np.array([0.7 * apart, 0.7 * apart, tall]), np.array([0.0, 0.0, tall])
    return np.concatenate([_cloud(rng, foot + up * rng.uniform(0.85, 1.0), radii, foot, path) for foot in feet])


def tree(rng: np.random.Generator, base: Floats, height_m: float, clear_m: float | None = None) -> Triangles:
    """Make a tree on ``base`` (3,): broad-leaved with a crown on a trunk, or a conifer with lower branches.

    With ``clear_m`` it is broad-leaved and its crown starts at this height, as over a road.
    """
    thick = height_m * rng.uniform(0.012, 0.028) + 0.03
    lean = np.array([rng.normal(0, 0.04), rng.normal(0, 0.04), 1.0]) * height_m
    foot = base - np.array([0.0, 0.0, 0.2])
    parts = [tube(foot, base + 0.85 * lean, thick, 0.3 * thick, 10)]
    path = log_uniform(rng, 0.3, 1.2)
    conifer = rng.uniform() < 0.35 and clear_m is None
    lobes = int(rng.integers(3, 7))
    start = rng.uniform(0.05, 0.25) if conifer else rng.uniform(0.2, 0.5)
    start = start if clear_m is None else clear_m / height_m
    widest = height_m * (rng.uniform(0.12, 0.22) if conifer else rng.uniform(0.18, 0.38))
    for k in range(lobes):
        share = start + (1 - start) * (k + 0.5) / lobes
        wide = widest * ((1.15 - share) if conifer else rng.uniform(0.5, 0.8))
        tall = height_m * (1 - start) / lobes * rng.uniform(0.7, 1.1)
        away = 0.0 if conifer else widest * rng.uniform(0, 0.6)
        where = rng.uniform(0, 2 * np.pi)
        middle = base + share * lean + away * np.array([np.cos(where), np.sin(where), 0.0])
        parts.append(_cloud(rng, middle, np.array([wide, wide, tall]), base, path))
        parts.append(tube(base + 0.8 * share * lean, middle, 0.25 * thick, 0.1 * thick, 5))
    return np.concatenate(parts)


@dataclass(frozen=True, slots=True)
class Blob:
    """A patch of ground with a wavy margin: water, puddle, mud, rubble, bare dirt, a field of grass."""

    label: Label
    centre: tuple[float, float]
    """m."""
    radius_m: float
    waves: tuple[tuple[float, float], ...]
    """Amplitude (share of the radius) and phase of 2, 3, .. waves around the margin."""
    rough_m: float
    """Standard deviation of waves shorter than 2 m."""
    level_m: float | None = None
    """Height of a level surface such as water; None for ground."""
    pool_m: float = math.inf
    """Depth below the surrounding ground from which hollows contain water."""
    tracks: tuple[tuple[float, float, float, float], ...] = ()
    """Wheel tracks through it: bearing, distance from the centre [m], depth [m], width of a rut [m]."""

    def reach(self, x: Floats, y: Floats) -> Floats:
        """Distance from the centre divided by the radius in that direction."""
        east, north = x - self.centre[0], y - self.centre[1]
        bearing = np.arctan2(north, east)
        size = np.ones_like(bearing)
        for number, (amplitude, phase) in enumerate(self.waves, start=2):
            size += amplitude * np.cos(number * bearing + phase)
        return np.hypot(east, north) / self.radius_m / size

    def relief(self, x: Floats, y: Floats) -> Floats:
        """Return the relief of the wheel tracks, m; they fade out at the margin."""
        surface = np.zeros_like(x)
        for bearing, offset, depth, width in self.tracks:
            across = (x - self.centre[0]) * np.cos(bearing) + (y - self.centre[1]) * np.sin(bearing) - offset
            along = (y - self.centre[1]) * np.cos(bearing) - (x - self.centre[0]) * np.sin(bearing)
            surface += ruts(across + 0.8 * np.sin(along / 6.0 + offset), depth, width)
        return surface * np.clip((1.15 - self.reach(x, y)) / 0.25, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Road:
    """A road or a track that winds across the scene."""

    label: Label
    bearing: tuple[float, float]
    """Cosine and sine of its direction."""
    offset_m: float
    """Distance of its centreline from the origin."""
    bends: tuple[tuple[float, float, float], ...]
    """Amplitude [m], wave number [rad/m] and phase of its bends."""
    half_width_m: float
    rough_m: float
    crown_m: float = 0.0
    """Height of the centreline above the sides."""
    rut_m: float = 0.0
    """Depth of the two wheel ruts."""
    kerb_m: float = 0.0
    """Height of concrete kerbs on both sides; 0 without kerbs."""
    pavement_m: float = 0.0
    """Width of the pavements behind the kerbs; the ground beyond is as high as they are."""
    ditch_m: float = 0.0
    """Depth of the ditches on both sides."""
    verge_m: float = 3.0
    """Distance of the middle of the ditches, and of the foot of the banks, from the margin."""
    banks_m: tuple[float, float] = (0.0, 0.0)
    """Height of the ground beyond the verge, to the right and to the left, above that of the road."""
    bank_width_m: float = 6.0

    def across(self, x: Floats, y: Floats) -> Floats:
        """Signed distance from the centreline, m."""
        along, side = beside(x, y, self.bearing, self.offset_m)
        slope = np.zeros_like(x)
        for amplitude, number, phase in self.bends:
            side = side - amplitude * np.sin(number * along + phase)
            slope += amplitude * number * np.cos(number * along + phase)
        return side / np.hypot(1.0, slope)

    def reach(self, x: Floats, y: Floats) -> Floats:
        """Distance from the centreline divided by half the width."""
        return np.abs(self.across(x, y)) / self.half_width_m

    def relief(self, x: Floats, y: Floats) -> Floats:
        """Return the relief of crown, ruts and kerbs, m."""
        across = self.across(x, y)
        surface = self.crown_m * np.clip(1 - (across / self.half_width_m) ** 2, 0.0, 1.0)
        if self.rut_m > 0:
            surface += ruts(across, self.rut_m, 0.22)
        beyond = np.abs(across) - self.half_width_m
        if self.pavement_m > 0:
            surface += self.kerb_m * (beyond >= 0)
        elif self.kerb_m > 0:
            surface += self.kerb_m * self.on_kerb(across)
        if self.ditch_m > 0:
            surface -= self.ditch_m * smoothstep(1.0 - np.abs(beyond / self.verge_m - 1.0))
        for side, height in zip((-1.0, 1.0), self.banks_m, strict=True):
            past = (beyond - self.verge_m) / self.bank_width_m
            surface += np.where(across * side > 0, height * smoothstep(past), 0.0)
        return surface

    def places(self, along: Floats, across: Floats) -> Floats:
        """Return x and y [m] and heading [rad], (n, 3), at distances along the road and left of its centreline."""
        side, slope = np.full_like(along, self.offset_m), np.zeros_like(along)
        for amplitude, number, phase in self.bends:
            side += amplitude * np.sin(number * along + phase)
            slope += amplitude * number * np.cos(number * along + phase)
        side = side + across * np.hypot(1.0, slope)
        cos, sin = self.bearing
        heading = np.arctan2(sin, cos) + np.arctan(slope)
        return np.stack([along * cos - side * sin, along * sin + side * cos, heading], axis=-1)

    def on_kerb(self, across: Floats) -> Floats:
        """Return 1 on a kerb or pavement, 0 elsewhere."""
        beyond = np.abs(across) - self.half_width_m
        on: Floats = ((beyond >= 0) & (beyond < max(0.25, self.pavement_m))).astype(np.float64)
        return on if self.kerb_m > 0 else np.zeros_like(across)


@dataclass(frozen=True, slots=True)
class Bank:
    """A change of height along a wavy line: a terrace, an embankment, the foot of a hill."""

    bearing: tuple[float, float]
    """Cosine and sine of the direction of its line."""
    offset_m: float
    """Distance of its foot from the origin, to the left of the line's direction."""
    height_m: float
    width_m: float
    wave: tuple[float, float, float]
    """Amplitude [m], wave number [rad/m] and phase of the line's waves."""

    def rise(self, x: Floats, y: Floats) -> Floats:
        """Return what the bank adds to the height of the ground, m."""
        along, side = beside(x, y, self.bearing, self.offset_m)
        amplitude, number, phase = self.wave
        side = side - amplitude * np.sin(number * along + phase)
        return self.height_m * smoothstep(side / self.width_m)


Region = Blob | Road


def beside(x: Floats, y: Floats, bearing: tuple[float, float], offset_m: float) -> tuple[Floats, Floats]:
    """Return the distances along a straight line and to the left of it, m."""
    return x * bearing[0] + y * bearing[1], y * bearing[0] - x * bearing[1] - offset_m


def ruts(across: Floats, depth_m: float, width_m: float) -> Floats:
    """Return the relief of two grooves 1.5 m apart with low banks, m."""
    surface = np.zeros_like(across)
    for middle in (-0.75, 0.75):
        away = (across - middle) / width_m
        surface += depth_m * (0.35 * np.exp(-((np.abs(away) - 2.0) ** 2)) - np.exp(-(away**2)))
    return surface


def make_blob(
    rng: np.random.Generator,
    label: Label,
    centre: tuple[float, float],
    radius_m: float,
    rough_m: float,
    level_m: float | None = None,
) -> Blob:
    """Draw a random blob; mud gets wheel tracks all over, with water in the deepest ones."""
    waves = tuple((float(rng.uniform(0, 0.3 / n)), float(rng.uniform(0, 2 * np.pi))) for n in (2, 3, 4, 5))
    pool = math.inf
    tracks: tuple[tuple[float, float, float, float], ...] = ()
    if label == Label.MUD:
        deepest, pool = log_uniform(rng, 0.15, 0.4), float(rng.uniform(0.08, 0.25))
        count = int(np.clip(radius_m * rng.uniform(0.8, 1.4), 2, 20))
        main = rng.uniform(0, np.pi)
        tracks = tuple(
            (
                main + float(rng.normal(0, 0.3)),
                float(rng.uniform(-0.9, 0.9)) * radius_m,
                deepest * float(rng.uniform(0.4, 1.0)),
                float(rng.uniform(0.15, 0.3)),
            )
            for _ in range(count)
        )
    return Blob(label, centre, radius_m, waves, rough_m, level_m, pool, tracks)


def make_road(rng: np.random.Generator, label: Label, offset_m: float) -> Road:
    """Draw a random road of asphalt or concrete, or a dirt track."""
    bearing = rng.uniform(0, 2 * np.pi)
    bends = tuple(
        (float(rng.uniform(0, 5)), 2 * np.pi / float(rng.uniform(60, 150)), float(rng.uniform(0, 2 * np.pi)))
        for _ in range(2)
    )
    line = (float(np.cos(bearing)), float(np.sin(bearing)))
    if label == Label.DIRT:
        width, rough = float(rng.uniform(1.3, 2.5)), log_uniform(rng, 0.004, 0.025)
        return Road(label, line, offset_m, bends, width, rough, 0.0, log_uniform(rng, 0.01, 0.07))
    kerb = float(rng.uniform(0.08, 0.16)) if rng.uniform() < 0.4 else 0.0
    width, rough = float(rng.uniform(2.5, 5.5)), log_uniform(rng, 0.001, 0.005)
    return Road(label, line, offset_m, bends, width, rough, float(rng.uniform(0.02, 0.1)), 0.0, kerb)


_HILLSIDE_M = 40.0
"""Distance from the origin at which the hillside ends and its height stays the same."""
_START_M = 0.4
"""Inner radius of the mesh."""
STEP = 0.01
"""Vertex spacing of the mesh, as a share of the distance."""


@dataclass(frozen=True, slots=True)
class SceneGround:
    """Hills, bumps and fine relief, overlaid by regions of other ground in order."""

    hills: Field
    hills_m: float
    """Standard deviation of hills, waves of 25 m and more."""
    bumps: Field
    bumps_m: float
    """Standard deviation of bumps, waves of 2 to 20 m; roads are graded and have none."""
    fine: Field
    """Waves under 2 m."""
    cover: Label
    """Label outside all regions: grass or dirt."""
    cover_rough_m: float
    regions: tuple[Region, ...]
    grass_m: float
    """Mean height of the grass."""
    grass_tufts: Field
    grass_path_m: float
    """Mean path of a beam through grass before a blade stops it."""
    slope: tuple[float, float] = (0.0, 0.0)
    """Rise per metre eastwards and northwards of the hillside around the origin."""
    banks: tuple[Bank, ...] = ()

    def height(self, x: Floats, y: Floats) -> Floats:
        """Return the heights of the soil, without grass, at positions (n,) in metres from the origin."""
        return self.sample(x, y)[0]

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, NDArray[np.uint8]]:
        """Return heights of the soil [m] and RELLIS-3D ids at positions in metres from the origin, (n,) each."""
        bumps = self.bumps_m * self.bumps.at(x, y)
        z = self.hills_m * self.hills.at(x, y) + bumps
        away = np.hypot(x, y)
        z += (self.slope[0] * x + self.slope[1] * y) * np.minimum(1.0, _HILLSIDE_M / np.maximum(away, _HILLSIDE_M))
        for bank in self.banks:
            z += bank.rise(x, y)
        label = np.full(x.shape, self.cover, np.uint8)
        rough = np.full(x.shape, self.cover_rough_m)
        relief, floor = np.zeros_like(x), np.full(x.shape, -np.inf)
        for region in self.regions:
            reach = region.reach(x, y)
            inside = reach < 1.0
            if isinstance(region, Road):
                z -= bumps * smoothstep(2.0 - reach)
                relief[inside], floor[inside] = 0.0, -np.inf
                relief += region.relief(x, y)
            elif region.level_m is None:
                relief += region.relief(x, y)
                floor[inside] = -region.pool_m
            else:
                share = smoothstep((1.35 - reach) / 0.35)
                z += share * (region.level_m - z)
                relief *= 1 - share
            label[inside] = region.label
            rough[inside] = region.rough_m
            if isinstance(region, Road) and region.kerb_m > 0:
                kerb = region.on_kerb(region.across(x, y)) > 0
                label[kerb], rough[kerb] = Label.CONCRETE, 0.002
        return z + np.maximum(relief + rough * self.fine.at(x, y), floor), label

    def grass_height(self, x: Floats, y: Floats) -> Floats:
        """Return the height of grass at each position, m."""
        return self.grass_m * np.clip(1.0 + 0.4 * self.grass_tufts.at(x, y), 0.15, 1.8)


def ground_mesh(
    ground: SceneGround, rng: np.random.Generator, end_m: float
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Mesh the ground around the origin: (n, 3) vertices and (m, 3) triangles.

    The spacing grows with the distance, like that of the beams: 5 cm near 5 m, 50 cm near 50 m. Vertices are jittered
    within their cells, so that no line of the mesh coincides with a scan line.
    """
    around = round(2 * np.pi / STEP)
    rings = int(np.log(end_m / _START_M) / STEP)
    radius = _START_M * np.exp(STEP * (np.arange(rings)[:, None] + rng.uniform(-0.2, 0.2, (rings, around))))
    angle = 2 * np.pi / around * (np.arange(around)[None, :] + rng.uniform(-0.2, 0.2, (rings, around)))
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    corners = np.stack([x, y, ground.height(x, y)], axis=1).astype(np.float32)
    here = np.arange(rings * around).reshape(rings, around)
    right = np.roll(here, -1, axis=1)
    quads = (here[:-1], right[:-1], here[1:], right[1:])
    triangles = np.concatenate(
        [
            np.stack([quads[0], quads[2], quads[1]], axis=-1).reshape(-1, 3),
            np.stack([quads[1], quads[2], quads[3]], axis=-1).reshape(-1, 3),
        ]
    )
    return corners, triangles.astype(np.uint32)
