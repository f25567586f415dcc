"""Ground seen without shadows, as from a mast or a slope, with heaps of blocks on part of it.

From a low sensor blocks hide one another, so its scans never show how relief of 20 cm looks where every pixel is full.
"""

import numpy as np

from bumpymap.lab.worlds.scans._fields import log_uniform
from bumpymap.lab.worlds.scans.labels import Label
from bumpymap.lab.worlds.scans.lidar import SimulatedScan
from bumpymap.lab.worlds.scans.scene import Scene

__all__ = ["look_down"]

_START_M = 4.0
_TABLE = 128
"""Blocks in a row until their heights repeat."""


def look_down(scene: Scene, seed: int) -> SimulatedScan:
    """Sample the ground of a scene, without what stands on it, evenly over distance and azimuth.

    Parameters
    ----------
    scene : Scene
        Its ground is used; beyond a straight line, blocks of one width of 0.2 to 0.8 m lie on it side by side.
    seed : int
        The same arguments give the same bits.

    Returns
    -------
    SimulatedScan
        Every row is a point; water, whose lost returns are not told here, has no label.
    """
    rng = np.random.default_rng([*scene.seed, seed, 5])
    count = int(log_uniform(rng, 2e4, 1.2e5))
    away, turn = rng.uniform(_START_M, rng.uniform(25.0, 60.0), count), rng.uniform(-np.pi, np.pi, count)
    x, y = away * np.cos(turn), away * np.sin(turn)
    ground = scene.ground.sample(x, y)
    above = scene.ground.grass_height(x, y) - rng.exponential(scene.ground.grass_path_m, count)
    z = ground.z + np.where(ground.label == Label.GRASS, np.maximum(above, 0.0), 0.0)
    wide, high, bearing = log_uniform(rng, 0.2, 0.8), log_uniform(rng, 0.25, 0.9), rng.uniform(0, 2 * np.pi)
    across = x * np.cos(bearing) + y * np.sin(bearing)
    along = y * np.cos(bearing) - x * np.sin(bearing)
    column, row = (np.floor(way / wide).astype(np.int64) % _TABLE for way in (across, along))
    wet = np.isin(ground.label, (Label.WATER, Label.PUDDLE))
    heap = across > rng.uniform(-10.0, 10.0)
    z += np.where(heap, rng.uniform(0.0, high, (_TABLE, _TABLE))[row, column], 0.0)
    z += rng.uniform(0.005, 0.03) * rng.standard_normal(count)
    here = scene.ground.sample(np.zeros(1), np.zeros(1)).z[0] + rng.uniform(0.6, 4.0)
    return SimulatedScan(
        np.column_stack([x, y, z - here]).astype(np.float32),
        np.full(count, 0.3, np.float32),
        np.where(heap, Label.RUBBLE, np.where(wet, Label.VOID, ground.label)).astype(np.uint32),
    )
