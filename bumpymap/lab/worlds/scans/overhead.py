"""Ground sampled without shadows, as from a mast or a slope, with piles of blocks on part of it.

Seen from a low sensor, blocks hide one another, so its scans do not contain rough ground in which every pixel is
filled.
"""

import numpy as np

from bumpymap.lab.worlds.scans._fields import log_uniform
from bumpymap.lab.worlds.scans.labels import Label
from bumpymap.lab.worlds.scans.lidar import SimulatedScan
from bumpymap.lab.worlds.scans.scene import Scene

__all__ = ["overhead_scan"]

_START_M = 4.0
_TABLE = 128
"""Number of blocks in a row after which heights repeat."""


def overhead_scan(scene: Scene, seed: int) -> SimulatedScan:
    """Sample the ground of a scene, without objects, evenly over distance and azimuth.

    Parameters
    ----------
    scene : Scene
        Its ground is used; beyond a straight line, adjacent blocks of one width of 0.2 to 0.8 m are added.
    seed : int
        The same arguments give the same bits.

    Returns
    -------
    SimulatedScan
        Every row is a point; water has no label, because its lost returns are not simulated here.
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
