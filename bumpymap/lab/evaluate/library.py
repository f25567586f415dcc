"""Terrain of the library as the tiles of a survey."""

import numpy as np

from bumpymap.core import FeatureSettings, PatchStack, UsageError
from bumpymap.lab.simulate import CalibrationSettings, library_terrain
from bumpymap.lab.worlds import FINE, KINDS, Terrain
from bumpymap.patches import join_stacks, measure
from bumpymap.rating import Calibration, Vehicle
from bumpytiles import TileBuckets, TilePoints

__all__ = ["flat_terrains", "library_terrains", "measure_all", "rebuild_buckets", "require_unseen"]


def require_unseen(calibration: Calibration, seed: int) -> None:
    """Raise UsageError if a calibration was made with terrain of the same seed."""
    if calibration.settings.get("seed") == seed:
        raise UsageError(
            f"--seed {seed} is that of the calibration {calibration.id}, so its terrain is not unseen. Choose another"
        )


def library_terrains(calibration: Calibration, profile: Vehicle, seed: int, each: int) -> list[Terrain]:
    """Make terrain with heights and slopes scaled to a vehicle: ``each`` of every kind, kind by kind."""
    made = CalibrationSettings(profile, seed=seed, tile_size=calibration.tile_size, pixels=calibration.pixels)
    return [library_terrain(made, kind, index) for kind in KINDS for index in range(each)]


def flat_terrains(calibration: Calibration, count: int) -> list[Terrain]:
    """Make perfectly flat ground."""
    side = calibration.pixels * FINE
    return [Terrain("dead flat", np.zeros((side, side)), calibration.tile_size)] * count


def measure_all(buckets: TileBuckets, features: FeatureSettings) -> PatchStack:
    """Measure all tiles; tiles in one row come in the order of their columns."""
    return join_stacks([measure(points, features, ground_only=False) for points in buckets.blocks()])


def rebuild_buckets(points: TilePoints) -> TileBuckets:
    """Sort points that were moved inside their tiles into the canonical order."""
    buckets = TileBuckets(points.grid)
    buckets.add(points.easting, points.northing, points.upward, points.flag)
    return buckets
