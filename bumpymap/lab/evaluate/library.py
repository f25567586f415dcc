"""Terrain of the library as a survey: tiles side by side, measured like any survey."""

import numpy as np

from bumpymap.core import FeatureSettings, PatchStack, UsageError
from bumpymap.lab.simulate import CalibrationSettings, library_terrain
from bumpymap.lab.worlds import FINE, KINDS, Terrain
from bumpymap.patches import join_stacks, measure
from bumpymap.rating import Calibration, Vehicle
from bumpytiles import TileBuckets, TilePoints

__all__ = ["bucketed", "dead_flat", "library_terrains", "require_unseen", "stack_of"]


def require_unseen(calibration: Calibration, seed: int) -> None:
    """Raise UsageError where a calibration was driven over the terrain of that very seed."""
    if calibration.settings.get("seed") == seed:
        raise UsageError(
            f"--seed {seed} is that of the calibration {calibration.id}: its terrain is not unseen. Choose another"
        )


def library_terrains(calibration: Calibration, profile: Vehicle, seed: int, each: int) -> list[Terrain]:
    """Make terrain as high and as steep as suits a vehicle: ``each`` of every kind, kind by kind."""
    made = CalibrationSettings(profile, seed=seed, tile_size=calibration.tile_size, pixels=calibration.pixels)
    return [library_terrain(made, kind, index) for kind in KINDS for index in range(each)]


def dead_flat(calibration: Calibration, count: int) -> list[Terrain]:
    """Make ground without any relief."""
    side = calibration.pixels * FINE
    return [Terrain("dead flat", np.zeros((side, side)), calibration.tile_size)] * count


def stack_of(buckets: TileBuckets, features: FeatureSettings) -> PatchStack:
    """Measure all tiles, in the order of their columns where they lie in one row."""
    return join_stacks([measure(points, features, ground_only=False) for points in buckets.blocks()])


def bucketed(points: TilePoints) -> TileBuckets:
    """Put points that were moved inside their tiles into their own order again."""
    buckets = TileBuckets(points.grid)
    buckets.add(points.easting, points.northing, points.upward, points.flag)
    return buckets
