"""Decide, tile by tile, what has changed: the ground first, then the ride over it.

A ride cost may jump although the ground has not moved: a stone lies in or out of a wheel's way, a border step is just
seen or just not. So a change of the ride counts only where the heights say, by themselves, that the ground has changed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.change.discovery import hold_false_discoveries, two_sided, upper_sided, widening
from bumpymap.change.ground import GroundChange

__all__ = ["Decision", "decide"]

Floats = NDArray[np.float64]

_AS_BEFORE, _ROUGHER, _SMOOTHER, _UNKNOWN = range(1, 5)


@dataclass(frozen=True, slots=True)
class Decision:
    """What has changed. Arrays are (rows, cols)."""

    z_height: Floats
    """Widened; NaN where not compared (so are the next)."""
    z_shape: Floats
    z_c_r: Floats
    code: Floats
    """Position in ``CHANGE_KINDS``."""
    widened: dict[str, float]
    """By how much the spread of each z was too narrow, at least 1."""


def decide(ground: GroundChange, z_c_r: Floats, fdr: float) -> Decision:
    """Find the tiles that have changed.

    Parameters
    ----------
    ground : GroundChange
        Of all tiles, (rows, cols).
    z_c_r : array (rows, cols)
        From `ride_z`; NaN where a ride is unknown.
    fdr : float
        Share of false discoveries, for the ground and again for the ride.
    """
    widened = {"height": widening(ground.z_height), "shape": widening(ground.z_shape), "c_r": widening(z_c_r)}
    height = ground.z_height / widened["height"]
    # What all tiles have in common is no change of any: a shift of one survey makes every shape differ a little.
    common = max(0.0, _median(ground.z_shape))
    shape = (ground.z_shape - common) / widened["shape"]
    ride = z_c_r / widened["c_r"]
    of_ground = np.minimum(1.0, 2.0 * np.fmin(two_sided(height), upper_sided(shape)))
    moved = hold_false_discoveries(of_ground, fdr)
    of_ride = np.maximum(of_ground, two_sided(ride))
    rides = moved & hold_false_discoveries(of_ride, fdr)
    code = np.where(moved, _AS_BEFORE, 0).astype(np.float64)
    code[moved & np.isnan(ride)] = _UNKNOWN
    code[rides] = np.where(ride[rides] > 0.0, _ROUGHER, _SMOOTHER)
    code[np.isnan(of_ground)] = np.nan
    return Decision(height, shape, ride, code, widened)


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else 0.0
