"""The figures of a route as plain values, for GeoJSON properties and the manifest."""

import math
from typing import Any

from bumpymap.core import Route, RouteFigures

__all__ = ["P_ARRIVES_NOTE", "route_properties"]

P_ARRIVES_NOTE = "errors of neighbouring tiles go together: an estimate"
_SMALL = 6
"""Decimals of shares, angles per metre and ratios; lengths and times have 3."""
_DECIMALS = {
    **dict.fromkeys(("length_m", "straight_m"), 3),
    "detour": _SMALL,
    "cost_m": 3,
    **dict.fromkeys(("c_r_mean", "c_r_mean_low", "c_r_mean_high", "c_r_max", "c_r_max_low", "c_r_max_high"), _SMALL),
    "p_arrives": _SMALL,
    "p_fail_max": _SMALL,
    **dict.fromkeys(("unknown_m", "obstacle_m", "climb_m", "descent_m", "seconds"), 3),
}
"""Properties of `RouteFigures` and how many decimals of each are written."""


def route_properties(route: Route) -> dict[str, Any]:
    """Return name, vehicle and figures of a route; a number that is not known is None."""
    figures = {name: _number(route.figures, name, decimals) for name, decimals in _DECIMALS.items()}
    return {
        "name": route.name,
        "vehicle": route.vehicle.name,
        **figures,
        "p_arrives_note": P_ARRIVES_NOTE,
        "risk_m": round(route.risk_m, 3) if math.isfinite(route.risk_m) else None,
    }


def _number(figures: RouteFigures, name: str, decimals: int) -> float | None:
    value = float(getattr(figures, name))
    return round(value, decimals) if math.isfinite(value) else None
