"""Roll a vehicle over patches: what its wheels and its chassis do there, from geometry alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride._kernels import GROUP, ride_patches
from bumpymap.rating.ride.operator import RideOperator

__all__ = ["Rides", "roll_over"]


@dataclass(frozen=True, slots=True)
class Rides:
    """What a vehicle does on each of n patches; NaN where a patch has NaN."""

    pitch_change: NDArray[np.float64]
    """(n,) mean absolute change of the chassis' pitch per metre, rad/m: the geometric C_r."""
    pitch_change_rms: NDArray[np.float64]
    """(n,) its root mean square, rad/m."""
    pitch: NDArray[np.float64]
    """(n,) root mean square of the pitch about the patch's plane, rad."""
    roll: NDArray[np.float64]
    """(n,) the same of the roll, rad."""
    twist: NDArray[np.float64]
    """(n,) the same of the difference of the two sides' pitch, rad."""
    belly_reach: NDArray[np.float64]
    """(n,) highest ground under the belly over its clearance; 1: it touches."""


def roll_over(relief_map: NDArray[np.float32], operator: RideOperator) -> Rides:
    """Roll a vehicle over patches.

    Parameters
    ----------
    relief_map : array (n, pixels, pixels) float32
        Plane-removed relief without holes, m; patches with NaN are left out.
    operator : RideOperator
        Of the vehicle.
    """
    patches = np.ascontiguousarray(relief_map, np.float32)
    known = np.isfinite(patches).all(axis=(1, 2))
    wheel, samples, poses, nodes = operator.wheel, operator.samples, operator.poses, operator.nodes
    wide = nodes + 2 * int(max(np.abs(wheel.row).max(), np.abs(wheel.col).max()))
    rides = np.full((len(patches), 6), np.nan)
    ride_patches(
        known,
        patches,
        operator.fine,
        wheel.row,
        wheel.col,
        wheel.rise,
        samples.starts,
        samples.node,
        samples.weight,
        poses.wheel_node,
        poses.wheel_weight,
        poses.belly_node,
        poses.belly_weight,
        np.array([operator.wheelbase, operator.track, operator.belly_half, operator.clearance]),
        np.empty((wide, wide), np.float32),
        np.empty((nodes, nodes), np.float32),
        np.zeros((nodes * nodes, GROUP), np.float32),
        np.zeros((nodes * nodes, GROUP), np.float32),
        np.empty(GROUP, np.int64),
        np.empty((2, GROUP)),
        rides,
    )
    return Rides(*rides.T.copy())
