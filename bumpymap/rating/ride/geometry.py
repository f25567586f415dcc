"""Roll a vehicle over patches: what its wheels and its chassis do there, from geometry alone."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride._ride_kernels import PatchesToRide, VehicleGeometry, ride_patches, ride_scratch
from bumpymap.rating.ride.operator import RideOperator

__all__ = ["Rides", "roll_over"]

_APART = 2
"""Pixels between heights that are compared: 0.4 m in a tile of 3 m."""


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
    height_range: NDArray[np.float64]
    """(n,) highest above lowest pixel of the relief, m."""
    height_change: NDArray[np.float64]
    """(n,) mean absolute height difference of pixels two apart, m."""


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
    known = np.asarray(np.isfinite(patches).all(axis=(1, 2)))
    wheel = operator.wheel
    margin = int(max(np.abs(wheel.row).max(), np.abs(wheel.col).max()))
    rides = np.full((len(patches), 6), np.nan)
    ride_patches(
        PatchesToRide(known, patches, operator.fine),
        wheel,
        operator.samples,
        operator.poses,
        VehicleGeometry(operator.wheelbase, operator.track, operator.belly_half, operator.clearance),
        rides,
        ride_scratch(patches.shape[1], operator.nodes, margin),
    )
    heights = _heights(np.where(known[:, None, None], patches, np.float32(np.nan)))
    return Rides(*(*rides.T.copy(), *heights))


def _heights(patches: NDArray[np.float32]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return range and mean difference of the heights of patches, (n,) each, m; NaN where a patch has NaN.

    A patch has the same bits wherever it stands among others: its sums run over a row of its own.
    """
    count, pixels = patches.shape[:2]
    flat = patches.reshape(count, pixels * pixels)
    span = flat.max(axis=1).astype(np.float64) - flat.min(axis=1)
    apart = (patches[:, _APART:] - patches[:, :-_APART], patches[:, :, _APART:] - patches[:, :, :-_APART])
    sizes = [np.abs(part).reshape(count, (pixels - _APART) * pixels) for part in apart]
    return span, np.concatenate(sizes, axis=1).mean(axis=1, dtype=np.float64)
