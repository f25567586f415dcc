"""Trees, bushes and herbs: stems and loose leaves."""

import numpy as np

from bumpymap.lab.worlds.scans._fields import Floats, log_uniform
from bumpymap.lab.worlds.scans._solids import Triangles, leaves, tube

__all__ = ["bush", "hedge", "herb", "tree"]


def _leaf_count(base: Floats, volume_m3: float) -> int:
    """Return the number of leaves to draw; fewer at distances at which the sensor cannot resolve them."""
    distance = float(np.hypot(base[0], base[1]))
    dense, most = (700.0, 7000) if distance < 15 else (150.0, 2500) if distance < 35 else (40.0, 900)
    return int(np.clip(dense * volume_m3, 60, most))


def _cloud(rng: np.random.Generator, middle: Floats, radii: Floats, base: Floats, free_path_m: float) -> Triangles:
    volume = 4 / 3 * np.pi * float(np.prod(radii))
    return leaves(rng, middle, radii, _leaf_count(base, volume), free_path_m)


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
