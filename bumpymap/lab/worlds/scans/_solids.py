"""Triangles of simple bodies, as arrays (m, 3, 3): triangle, corner, x y z [m]."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.scans._fields import Floats

__all__ = ["Triangles", "boxes", "leaves", "ribbon", "stones", "tube"]

Triangles = NDArray[np.float32]

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
    shape: Floats = corners[np.array(faces)]
    return shape


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
    first = np.stack([low[:-1], low[1:], high[:-1]], axis=1)
    second = np.stack([low[1:], high[1:], high[:-1]], axis=1)
    return np.concatenate([first, second]).astype(np.float32)


def ribbon(points: Floats, height_m: float) -> Triangles:
    """Make an upright band along ``points`` (n, 3), which form its lower edge."""
    top = points + np.array([0.0, 0.0, height_m])
    first = np.stack([points[:-1], points[1:], top[:-1]], axis=1)
    second = np.stack([points[1:], top[1:], top[:-1]], axis=1)
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
