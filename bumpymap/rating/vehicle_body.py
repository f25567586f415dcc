"""Outline of a vehicle, and estimates of what a short profile leaves out: inertia, centre of mass, belly, springs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, Setting


def within(what: str, low: float, high: float, unit: str) -> Setting:
    """Return the declaration of a number of a profile: what it is, its bounds and their unit."""
    return Setting(what, low=low, high=high, unit=unit)


@dataclass(frozen=True, slots=True)
class Floor:
    """Pitch motion that does not come from the ground; 0 where nobody has measured it."""

    c_r_radpm: Annotated[
        float, within("C_r on even, level ground at `speed_mps`; enters `c_r` in power", 0, 1, "rad/m")
    ] = 0.0


@dataclass(frozen=True, slots=True)
class Comfort:
    """Limits of the ride, from which the speed made good of each tile follows."""

    pitch_rate_radps: Annotated[float, within("most pitch motion, C_r times the speed", 0.001, 100, "rad/s")] = 0.3
    a_w_mps2: Annotated[
        float, within("most weighted vertical acceleration; 0: no limit, as nobody sits in it", 0, 1000, "m/s2")
    ] = 0.0
    top_speed_mps: Annotated[
        float, within("speed on smooth ground; 0: `speed_mps`, or that of the map's `--speed`", 0, 40, "m/s")
    ] = 0.0


def with_floor(c_r: NDArray[np.floating], floor: float) -> Floats:
    """Add a floor in power, rad/m: the root of the sum of squares; without a floor every bit stays.

    The pitch rate that the ground causes and that of the vehicle itself know nothing of each other, so their powers
    add up. Mean absolute values add up like this where both are normal.
    """
    values = np.asarray(c_r, np.float64)
    return values if floor == 0.0 else np.hypot(values, floor)


def less_floor(c_r: NDArray[np.floating], floor: float | Floats) -> Floats:
    """Take a floor off in power, rad/m, the inverse of `with_floor`; 0 for values below the floor."""
    values = np.asarray(c_r, np.float64)
    return values if not np.any(floor) else np.sqrt(np.maximum(values - floor, 0.0) * (values + floor))


@dataclass(frozen=True, slots=True)
class Body:
    """Outline of the vehicle; NaN stands for what follows from the other keys."""

    height_m: Annotated[
        float,
        within("height above ground, sensors and load included; what is higher is overhead", 0.02, 15, "m"),
    ] = math.nan
    width_m: Annotated[float, within("full width; the gap between obstacles must be wider", 0.02, 20, "m")] = math.nan
    brush_stem_m: Annotated[
        float, within("plants up to this height above ground are brushed aside and no obstacle", 0, 5, "m")
    ] = math.nan


SUSPENSION = '"rigid": a frame without springs; "rocker": a beam on each side that pivots; "sprung": a spring a wheel.'
"""The choices, for a template."""
ESTIMATED = (
    *("chassis.mass_kg", "chassis.inertia_kgm2", "chassis.com_height_m", "belly.length_m", "belly.width_m"),
    *("rocker.mass_kg", "rocker.inertia_kgm2", "rocker.limit_rad", "rocker.stiffness_nm_per_rad"),
    *("rocker.damping_nms_per_rad", "wheel.mass_kg"),
)
"""Keys that a short profile may leave out."""


@dataclass(frozen=True, slots=True)
class Whole:
    """Mass and kind of the whole vehicle, which a short profile gives in the place of its parts."""

    mass_kg: Annotated[float, within("mass of the whole vehicle, payload included", 0.3, 1.2e6, "kg")]
    suspension: Literal["rocker", "sprung", "rigid"]


@dataclass(frozen=True, slots=True)
class _Rules:
    """Proportions of one kind of vehicle, read off the included ones: warthog and small_rover, car, husky."""

    rocker_mass: float
    """Mass of one rocker over that of the vehicle."""
    wheel_mass: float
    """Mass of one wheel over that of the vehicle."""
    centre: float
    """Height of the centre of mass above the axles, in wheel radii."""
    overhang: float
    """Length of the belly beyond the wheelbase, over the wheelbase."""
    box: tuple[float, float, float]
    """Solid box with the chassis' moments of inertia: length over the wheelbase, width and height over the track."""
    limit_rad: float
    """End stop of the rockers."""
    pitch_hz: float
    """Frequency at which the chassis pitches on its springs."""
    damping: float
    """Damping of that pitching, as a share of the critical one."""


_RULES = {
    "rocker": _Rules(
        rocker_mass=0.1, wheel_mass=0.05, centre=0.4, overhang=0.42, box=(1.3, 0.7, 0.4), limit_rad=0.2, pitch_hz=6.5,
        damping=1.15,
    ),
    "sprung": _Rules(
        rocker_mass=0.03, wheel_mass=0.025, centre=0.7, overhang=0.44, box=(1.5, 1.0, 0.75), limit_rad=0.1,
        pitch_hz=1.5, damping=0.5,
    ),
    "rigid": _Rules(
        rocker_mass=0.01, wheel_mass=0.045, centre=0.2, overhang=0.93, box=(1.3, 0.6, 0.35), limit_rad=0.05,
        pitch_hz=12.0, damping=0.4,
    ),
}  # fmt: skip
_BETWEEN = 0.95
"""Width of the belly over the space between the wheels."""
_BEAM = 0.15
"""Height and width of a rocker over its length, the wheelbase."""


def estimate(whole: Whole, given: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Return what a short profile may leave out, by table and key; what is given of it counts for the rest.

    Wheels and rockers have their shares of the mass, and the chassis has the rest. The chassis has the moments of
    inertia of a solid box, the rockers those of beams as long as the wheelbase. Springs follow from the frequency at
    which the chassis pitches, ``2 k = I (2 pi f)^2``, dampers from ``2 b = 2 zeta sqrt(2 k I)``. ``given``: the rest of
    the profile, without faults, with its tables as dictionaries.
    """
    rules, wheel = _RULES[whole.suspension], given["wheel"]
    wheelbase, track, radius = given["wheelbase_m"], given["track_m"], wheel["radius_m"]

    def known(table: str, key: str, usual: float) -> float:
        return float(given[table].get(key) or _rounded(usual))  # dampers of free rockers, 0 N m/rad, are as usual

    wheel_mass = known("wheel", "mass_kg", rules.wheel_mass * whole.mass_kg)
    rocker_mass = known("rocker", "mass_kg", rules.rocker_mass * whole.mass_kg)
    chassis_mass = known("chassis", "mass_kg", whole.mass_kg - 2 * rocker_mass - 4 * wheel_mass)
    length = known("belly", "length_m", (1 + rules.overhang) * wheelbase)
    between = known("belly", "width_m", _BETWEEN * (track - wheel["width_m"]))
    long, wide, high = rules.box
    moments = given["chassis"].get("inertia_kgm2", _box(chassis_mass, long * wheelbase, wide * track, high * track))
    pitch = max(moments[1], 0.0)  # below: the parts weigh more than the whole, which the caller refuses
    stiffness = known("rocker", "stiffness_nm_per_rad", pitch * (2 * math.pi * rules.pitch_hz) ** 2 / 2)
    damping = rules.damping * math.sqrt(2 * stiffness * pitch)
    return {
        "chassis": {"mass_kg": chassis_mass, "inertia_kgm2": moments, "com_height_m": _rounded(rules.centre * radius)},
        "belly": {"length_m": length, "width_m": between},
        "rocker": {
            "mass_kg": rocker_mass,
            "inertia_kgm2": _box(rocker_mass, wheelbase, _BEAM * wheelbase, _BEAM * wheelbase),
            "limit_rad": rules.limit_rad,
            "stiffness_nm_per_rad": stiffness,
            "damping_nms_per_rad": _rounded(damping),
        },
        "wheel": {"mass_kg": wheel_mass},
    }


def _box(mass: float, length: float, width: float, height: float) -> list[float]:
    """Return the moments of inertia of a solid box about its roll, pitch and yaw axis, kg m2."""
    sides = ((width, height), (length, height), (length, width))
    return [_rounded(mass * (one**2 + other**2) / 12) for one, other in sides]


def _rounded(value: float) -> float:
    """Return a value with four digits."""
    return float(f"{value:.4g}")
