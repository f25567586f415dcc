"""The outline of a vehicle: what it passes over, between and under. It does not affect the simulated drives."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

from bumpymap.core import VehicleBody
from bumpymap.rating.vehicle.keys import Quantity

__all__ = ["Body", "body_defaults", "body_of", "body_table"]

_TALL = 0.7
"""Default height above the wheels or the belly, in track widths."""


@dataclass(frozen=True, slots=True)
class Body:
    """Outline of the vehicle; NaN stands for the default of `body_defaults`."""

    height_m: Annotated[
        float, Quantity("m", 0.02, 15, "height above ground, sensors and load included; what is higher is overhead")
    ] = math.nan
    width_m: Annotated[float, Quantity("m", 0.02, 20, "full width; the gap between obstacles must be wider")] = math.nan
    brush_stem_m: Annotated[
        float, Quantity("m", 0, 5, "plants up to this height above ground are brushed aside and no obstacle")
    ] = math.nan


def body_defaults(vehicle: Mapping[str, Any]) -> dict[str, float]:
    """Return the outline of a vehicle whose profile does not give one, m, rounded to centimetres.

    Height: the wheels' or the belly's clearance, the higher, plus 0.7 of the track. Width: the wider of belly and
    wheels. Brush: the belly's clearance, so that whatever reaches the belly is an obstacle.

    Parameters
    ----------
    vehicle : mapping
        A complete vehicle profile, as in its TOML file.
    """
    belly, wheel, track = vehicle["belly"], vehicle["wheel"], float(vehicle["track_m"])
    under = max(2 * float(wheel["radius_m"]), float(belly["clearance_m"]))
    found = {
        "height_m": under + _TALL * track,
        "width_m": max(float(belly["width_m"]), track + float(wheel["width_m"])),
        "brush_stem_m": float(belly["clearance_m"]),
    }
    return {name: round(value, 2) if name != "brush_stem_m" else value for name, value in found.items()}


def body_table(vehicle: Mapping[str, Any]) -> dict[str, float]:
    """Return the table ``[body]`` of a profile, with defaults for what it leaves out."""
    given = {name: float(value) for name, value in vehicle.get("body", {}).items() if not math.isnan(value)}
    unknown = set(given) - {field.name for field in fields(Body)}
    if unknown:
        raise ValueError(f"[body] holds {', '.join(sorted(unknown))}")
    return body_defaults(vehicle) | given


def body_of(vehicle: Mapping[str, Any]) -> VehicleBody:
    """Return the outline of the vehicle of a profile."""
    return VehicleBody(clearance_m=float(vehicle["belly"]["clearance_m"]), **body_table(vehicle))
