"""What even, level ground costs a vehicle: tyre lugs and drive train, which no heightmap shows. Not in the drives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.vehicle.keys import Quantity

__all__ = ["Floor", "floor_of", "less_floor", "with_floor"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Floor:
    """Pitch motion that does not come from the ground; 0 where nobody has measured it."""

    c_r_radpm: Annotated[
        float, Quantity("rad/m", 0, 1, "C_r on even, level ground at `speed_mps`; enters `c_r` in power")
    ] = 0.0


def floor_of(vehicle: Mapping[str, Any]) -> float:
    """Return the floor of a vehicle profile (the nested dictionary of its TOML file), rad/m; 0 if it has none."""
    return float(vehicle.get("floor", {}).get("c_r_radpm", 0.0))


def with_floor(c_r: NDArray[np.floating], floor: float) -> Floats:
    """Add a floor in power, rad/m: the root of the sum of squares; without a floor every bit stays.

    The pitch rate that the ground causes and that of the vehicle itself know nothing of each other, so their powers
    add up. Mean absolute values add up like this where both are normal.
    """
    values = np.asarray(c_r, np.float64)
    return values if floor == 0.0 else np.hypot(values, floor)


def less_floor(c_r: NDArray[np.floating], floor: float) -> Floats:
    """Take a floor off in power, rad/m, the inverse of `with_floor`; 0 for values below the floor."""
    values = np.asarray(c_r, np.float64)
    return values if floor == 0.0 else np.sqrt(np.maximum(values - floor, 0.0) * (values + floor))
