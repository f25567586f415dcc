"""Ride costs that real vehicles measured on named surfaces, which give the numbers of a map a size."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bumpymap.core import CLASS_NAMES, parse_json

__all__ = ["MeasuredSurfaces", "degrees_line", "read_surfaces"]

_FILE = Path(__file__).with_name("data") / "surfaces.json"
_NAMED = ("asphalt", "snow", "silty loam")
"""Surfaces in a line of a summary, which everyone has walked on."""


@dataclass(frozen=True, slots=True)
class MeasuredSurfaces:
    """C_r of one real vehicle on named surfaces."""

    vehicle: str
    kind: str
    """What sort of vehicle it is."""
    speed: str
    """Range of its speeds, in words."""
    source: str
    method: str
    """How C_r was measured."""
    floor: tuple[float, float]
    """rad/m: what the vehicle itself gives on even ground."""
    c_r: dict[str, float]
    """Surface -> rad/m, rising."""


def read_surfaces() -> MeasuredSurfaces:
    """Read the measured surfaces that come with the package."""
    known = parse_json(_FILE.read_text(encoding="utf-8"))
    costs = {str(one["name"]): float(one["c_r"]) for one in known.pop("surfaces")}
    low, high = known.pop("floor")
    rising = dict(sorted(costs.items(), key=lambda one: one[1]))
    return MeasuredSurfaces(**known, floor=(float(low), float(high)), c_r=rising)


def degrees_line(median_c_r: Sequence[float]) -> str:
    """Say in degrees of pitch per metre what classes cost, beside named surfaces.

    Parameters
    ----------
    median_c_r : sequence
        Of each class, rad/m; NaN without tiles.
    """
    classes = ", ".join(
        f"{name} {math.degrees(c_r):.1f}"
        for name, c_r in zip(CLASS_NAMES, median_c_r, strict=False)
        if math.isfinite(c_r)
    )
    real = read_surfaces()
    named = ", ".join(f"{math.degrees(real.c_r[name]):.1f} on {name}" for name in _NAMED)
    if not classes:
        return ""
    return f"Median c_r in degrees of pitch per metre: {classes}; a real {real.vehicle} measured {named}"
