"""Estimate what a short vehicle profile leaves out: inertia, centre of mass, belly, springs."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from bumpymap.core import parse_record
from bumpymap.rating.vehicle_body import Quantity

SUSPENSION = '"rigid": a frame without springs; "rocker": a beam on each side that pivots; "sprung": a spring a wheel.'
"""The choices, for a template."""
ESTIMATED = (
    "chassis.mass_kg",
    "chassis.inertia_kgm2",
    "chassis.com_height_m",
    "belly.length_m",
    "belly.width_m",
    "rocker.mass_kg",
    "rocker.inertia_kgm2",
    "rocker.limit_rad",
    "rocker.stiffness_nm_per_rad",
    "rocker.damping_nms_per_rad",
    "wheel.mass_kg",
)
"""Keys that a short profile may leave out."""


@dataclass(frozen=True, slots=True)
class Whole:
    """Mass and kind of the whole vehicle, which a short profile gives in the place of its parts."""

    mass_kg: Annotated[float, Quantity("kg", 0.3, 1.2e6, "mass of the whole vehicle, payload included")]
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
    "rocker": _Rules(0.1, 0.05, 0.4, 0.42, (1.3, 0.7, 0.4), 0.2, 6.5, 1.15),
    "sprung": _Rules(0.03, 0.025, 0.7, 0.44, (1.5, 1.0, 0.75), 0.1, 1.5, 0.5),
    "rigid": _Rules(0.01, 0.045, 0.2, 0.93, (1.3, 0.6, 0.35), 0.05, 12.0, 0.4),
}
_WHOLE = {"mass_kg", "suspension"}
_TABLES = ("chassis", "belly", "rocker", "wheel")
_BETWEEN = 0.95
"""Width of the belly over the space between the wheels."""
_BEAM = 0.15
"""Height and width of a rocker over its length, the wheelbase."""


@dataclass(frozen=True, slots=True)
class CompletedProfile:
    """A profile with estimates of what it leaves out."""

    record: Any
    """The profile, without the keys of `Whole`; without estimates where what they need is missing or faulty."""
    values: dict[str, Any]
    """Estimated values by key, such as ``chassis.com_height_m``."""
    faults: list[str]
    """Faults of the keys of `Whole`."""


def estimate_profile(record: Any) -> CompletedProfile:
    """Fill in what a short profile leaves out.

    Wheels and rockers have their shares of ``mass_kg``, and the chassis has the rest. The chassis has the moments of
    inertia of a solid box, the rockers those of beams as long as the wheelbase. Springs follow from the frequency at
    which the chassis pitches, ``2 k = I (2 pi f)^2``, dampers from ``2 b = 2 zeta sqrt(2 k I)``.

    Parameters
    ----------
    record : dict
        A profile as in its TOML file, short if it has ``mass_kg`` or ``suspension``; another is returned as it is.
        What is given stays.
    """
    if not isinstance(record, dict) or not _WHOLE & set(record):
        return CompletedProfile(record, {}, [])
    own, faults = parse_record({key: record[key] for key in _WHOLE & set(record)}, Whole, Path(), complete=True)
    rest = {name: {} for name in _TABLES} | {key: value for key, value in record.items() if key not in _WHOLE}
    tables = {name: rest[name] if isinstance(rest[name], dict) else {} for name in _TABLES}
    wheel = tables["wheel"]
    size = (rest.get("wheelbase_m"), rest.get("track_m"), wheel.get("radius_m"), wheel.get("width_m"))
    if faults or not all(map(_is_positive, size)):
        return CompletedProfile(rest, {}, faults)
    estimates = _estimates(Whole(**own), size, tables)
    if estimates["chassis"]["mass_kg"] <= 0:
        return CompletedProfile(
            rest, {}, [f"mass_kg is {own['mass_kg']:g}, and rockers and wheels alone weigh that much"]
        )
    values = {
        f"{name}.{key}": value
        for name, found in estimates.items()
        for key, value in found.items()
        if key not in tables[name]
    }
    full = {name: estimates[name] | rest[name] for name in _TABLES if isinstance(rest[name], dict)}
    return CompletedProfile(rest | full, values, [])


def _estimates(whole: Whole, size: tuple[Any, ...], given: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Return the estimates by table and key; those that follow from others take what is given of these."""
    wheelbase, track, radius, width = size

    def known(table: str, key: str, estimate: float) -> float:
        value = given[table].get(key)
        return float(value) if value is not None and _is_positive(value) else _rounded(estimate)

    rules = _RULES[whole.suspension]
    wheel_mass = known("wheel", "mass_kg", rules.wheel_mass * whole.mass_kg)
    rocker_mass = known("rocker", "mass_kg", rules.rocker_mass * whole.mass_kg)
    chassis_mass = known("chassis", "mass_kg", whole.mass_kg - 2 * rocker_mass - 4 * wheel_mass)
    length = known("belly", "length_m", (1 + rules.overhang) * wheelbase)
    between = known("belly", "width_m", _BETWEEN * (track - width))
    long, wide, high = rules.box
    box = _box(chassis_mass, long * wheelbase, wide * track, high * track)
    moments = given["chassis"].get("inertia_kgm2", box)
    pitch = moments[1] if isinstance(moments, list) and len(moments) == 3 and _is_positive(moments[1]) else 1.0
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


def _is_positive(value: Any) -> bool:
    """Return whether a value of a TOML file is a number above 0."""
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
