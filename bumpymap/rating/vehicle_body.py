"""Outline of a vehicle, and estimates of what a short profile leaves out: inertia, centre of mass, belly, springs."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Declared, Setting, declared_fields, parse_record


def profile_keys(owner: Any, table: str = "") -> tuple[Declared, ...]:
    """Return the quantities of a dataclass and of its nested dataclasses, in the order of the file.

    Names hold the table, such as ``chassis.mass_kg``. A default is NaN if it follows from other keys.
    """
    found: list[Declared] = []
    for each in declared_fields(owner).values():
        name = f"{table}.{each.name}".lstrip(".")
        if each.setting is not None:
            found.append(replace(each, name=name))
        elif is_dataclass(each.kind) and not each.optional:
            found += profile_keys(each.kind, name)
    return tuple(found)


def flat_profile(vehicle: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a profile, as in its TOML file, by names such as ``belly.length_m``."""
    tables = {name: part for name, part in vehicle.items() if isinstance(part, dict)}
    rest = {name: value for name, value in vehicle.items() if name not in tables}
    return rest | {f"{name}.{key}": value for name, part in tables.items() for key, value in part.items()}


def plain_lists(value: Any) -> Any:
    """Return a value with lists in the place of tuples, as JSON and TOML have them, in nested mappings too."""
    if isinstance(value, Mapping):
        return {key: plain_lists(item) for key, item in value.items()}
    return [plain_lists(item) for item in value] if isinstance(value, tuple) else value


def number_tuples(value: Any) -> Any:
    """Return a number of JSON as a float, lists of them as tuples; raise ValueError or TypeError at anything else."""
    return tuple(map(number_tuples, value)) if isinstance(value, list | tuple) else float(value)


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Floor:
    """Pitch motion that does not come from the ground; 0 where nobody has measured it."""

    c_r_radpm: Annotated[
        float, Setting("C_r on even, level ground at `speed_mps`; enters `c_r` in power", None, 0, 1, "rad/m")
    ] = 0.0


@dataclass(frozen=True, slots=True)
class Comfort:
    """Limits of the ride, from which the speed made good of each tile follows."""

    pitch_rate_radps: Annotated[float, Setting("most pitch motion, C_r times the speed", None, 0.001, 100, "rad/s")] = (
        0.3
    )
    a_w_mps2: Annotated[
        float, Setting("most weighted vertical acceleration; 0: no limit, as nobody sits in it", None, 0, 1000, "m/s2")
    ] = 0.0
    top_speed_mps: Annotated[
        float, Setting("speed on smooth ground; 0: `speed_mps`, or that of the map's `--speed`", None, 0, 40, "m/s")
    ] = 0.0


def comfort_of(vehicle: Mapping[str, Any]) -> Comfort:
    """Return the limits of the ride of a vehicle profile (the nested dictionary of its TOML file)."""
    return Comfort(**{name: float(value) for name, value in vehicle.get("comfort", {}).items()})


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


_TALL = 0.7
"""Default height above the wheels or the belly, in track widths."""


@dataclass(frozen=True, slots=True)
class Body:
    """Outline of the vehicle; NaN stands for the default of `body_table`."""

    height_m: Annotated[
        float,
        Setting("height above ground, sensors and load included; what is higher is overhead", None, 0.02, 15, "m"),
    ] = math.nan
    width_m: Annotated[float, Setting("full width; the gap between obstacles must be wider", None, 0.02, 20, "m")] = (
        math.nan
    )
    brush_stem_m: Annotated[
        float, Setting("plants up to this height above ground are brushed aside and no obstacle", None, 0, 5, "m")
    ] = math.nan


def body_table(vehicle: Mapping[str, Any]) -> dict[str, float]:
    """Return the table ``[body]`` of a complete profile, m, with defaults for what it leaves out, to centimetres.

    Height: the wheels' or the belly's clearance, the higher, plus 0.7 of the track. Width: the wider of belly and
    wheels. Brush: the belly's clearance, so that whatever reaches the belly is an obstacle.
    """
    given = {name: float(value) for name, value in vehicle.get("body", {}).items() if not math.isnan(value)}
    unknown = set(given) - {field.name for field in fields(Body)}
    if unknown:
        raise ValueError(f"[body] holds {', '.join(sorted(unknown))}")
    belly, wheel, track = vehicle["belly"], vehicle["wheel"], float(vehicle["track_m"])
    clearance = float(belly["clearance_m"])
    return {
        "height_m": round(max(2 * float(wheel["radius_m"]), clearance) + _TALL * track, 2),
        "width_m": round(max(float(belly["width_m"]), track + float(wheel["width_m"])), 2),
        "brush_stem_m": clearance,
    } | given


SUSPENSION = '"rigid": a frame without springs; "rocker": a beam on each side that pivots; "sprung": a spring a wheel.'
"""The choices, for a template."""
_ESTIMATED = {
    "chassis": ("mass_kg", "inertia_kgm2", "com_height_m"),
    "belly": ("length_m", "width_m"),
    "rocker": ("mass_kg", "inertia_kgm2", "limit_rad", "stiffness_nm_per_rad", "damping_nms_per_rad"),
    "wheel": ("mass_kg",),
}
ESTIMATED = tuple(f"{table}.{key}" for table, keys in _ESTIMATED.items() for key in keys)
"""Keys that a short profile may leave out."""


@dataclass(frozen=True, slots=True)
class Whole:
    """Mass and kind of the whole vehicle, which a short profile gives in the place of its parts."""

    mass_kg: Annotated[float, Setting("mass of the whole vehicle, payload included", None, 0.3, 1.2e6, "kg")]
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
_WHOLE = {"mass_kg", "suspension"}
_BETWEEN = 0.95
"""Width of the belly over the space between the wheels."""
_BEAM = 0.15
"""Height and width of a rocker over its length, the wheelbase."""


def estimate_profile(record: Any) -> tuple[Any, dict[str, Any], list[str]]:
    """Fill in what a short profile, which has ``mass_kg`` or ``suspension``, leaves out; what is given stays.

    Wheels and rockers have their shares of ``mass_kg``, and the chassis has the rest. The chassis has the moments of
    inertia of a solid box, the rockers those of beams as long as the wheelbase. Springs follow from the frequency at
    which the chassis pitches, ``2 k = I (2 pi f)^2``, dampers from ``2 b = 2 zeta sqrt(2 k I)``.

    Returns the profile without the keys of `Whole`, and without estimates where what they need is missing or faulty;
    the estimated values by key, such as ``chassis.com_height_m``; and the faults of the keys of `Whole`.
    """
    if not isinstance(record, dict) or not _WHOLE & set(record):
        return record, {}, []
    own, faults = parse_record({key: record[key] for key in _WHOLE & set(record)}, Whole, Path(), complete=True)
    rest = {name: {} for name in _ESTIMATED} | {key: value for key, value in record.items() if key not in _WHOLE}
    tables = {name: rest[name] if isinstance(rest[name], dict) else {} for name in _ESTIMATED}
    wheel = tables["wheel"]
    size = (rest.get("wheelbase_m"), rest.get("track_m"), wheel.get("radius_m"), wheel.get("width_m"))
    if faults or not all(map(_is_positive, size)):
        return rest, {}, faults
    estimates = _estimates(Whole(**own), size, tables)
    if estimates["chassis"]["mass_kg"] <= 0:
        return rest, {}, [f"mass_kg is {own['mass_kg']:g}, and rockers and wheels alone weigh that much"]
    values = {
        f"{name}.{key}": value
        for name, found in estimates.items()
        for key, value in found.items()
        if key not in tables[name]
    }
    full = {name: estimates[name] | rest[name] for name in _ESTIMATED if isinstance(rest[name], dict)}
    return rest | full, values, []


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
