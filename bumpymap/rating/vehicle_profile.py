"""Vehicle profiles: outline, masses, preferences of a vehicle, read from TOML and checked; what may be left out."""

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    UNFILLED,
    BadInputError,
    Declared,
    Floats,
    OutputError,
    Setting,
    UsageError,
    allowed_values,
    declared_fields,
    parse_record,
    path_of_call,
    plain_json,
    read_toml,
    refuse_faults,
    short_repr,
)


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


_SHORT = "; or give mass_kg and suspension, from which most other values are estimated"
_SCHEMA = "`bumpymap vehicle new NAME` writes a file to fill in, with units and ranges"
_LONGEST_BELLY = 4.0
"""Longest belly in wheelbases; a bus with its overhangs has about two."""
_LIGHTEST, _HEAVIEST = 5.0, 3000.0
"""Bounds of mass / size^3, kg/m3, with size = sqrt(length * width); included vehicles have 98 to 140."""
_GYRATION = {"chassis": (0.03, 0.6), "rocker": (0.003, 0.6)}
"""Bounds of the radius of gyration, sqrt(moment / mass), over the vehicle's size. Even two masses at the ends of a body
stay below 0.6; included vehicles have 0.15 to 0.36 (chassis) and 0.02 to 0.21 (rocker)."""
_TALL = 0.7
"""Default height above the wheels or the belly, in track widths."""
_Moments = tuple[float, float, float]
"""Roll (about the forward axis), pitch (left axis), yaw (upward axis)."""


@dataclass(frozen=True, slots=True)
class Chassis:
    """The body that carries the pitch-rate sensor."""

    mass_kg: Annotated[float, within("everything except rockers and wheels, payload included", 0.2, 1e6, "kg")]
    inertia_kgm2: Annotated[
        _Moments, within("moments of inertia [roll, pitch, yaw] about the centre of mass", 1e-6, 1e8, "kg m2")
    ]
    com_height_m: Annotated[float, within("height of the centre of mass above the axles; may be negative", -2, 6, "m")]
    """Measured with the vehicle on level ground."""


@dataclass(frozen=True, slots=True)
class Belly:
    """The underside of the chassis: a level plate centred between the wheels, with walls above it."""

    length_m: Annotated[
        float, within("length along the vehicle, centred between the axles, bumpers included", 0.05, 30, "m")
    ]
    width_m: Annotated[float, within("width across the vehicle", 0.02, 15, "m")]
    clearance_m: Annotated[
        float, within("height above level ground of the lowest part that could hit a stone", 0.005, 5, "m")
    ]


@dataclass(frozen=True, slots=True)
class Rocker:
    """The beam on each side that joins a front and a rear wheel and pivots about the chassis' left axis."""

    mass_kg: Annotated[
        float, within("mass of one rocker: the beam that joins a front and a rear wheel", 0.005, 1e5, "kg")
    ]
    inertia_kgm2: Annotated[
        _Moments, within("moments of inertia [roll, pitch, yaw] about its centre", 1e-8, 1e7, "kg m2")
    ]
    limit_rad: Annotated[float, within("end stop, up and down from level", 0, 1.2, "rad")]
    stiffness_nm_per_rad: Annotated[
        float, within("stiffness of the spring that returns it to level; 0 for a free rocker", 0, 1e9, "N m/rad")
    ]
    damping_nms_per_rad: Annotated[float, within("damping coefficient", 0, 1e8, "N m s/rad")]


@dataclass(frozen=True, slots=True)
class Wheel:
    """One of the four wheels: a rigid cylinder."""

    mass_kg: Annotated[float, within("mass of one wheel", 0.005, 2e4, "kg")]
    radius_m: Annotated[float, within("radius", 0.02, 3, "m")]
    width_m: Annotated[float, within("width", 0.005, 3, "m")]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """A vehicle profile: four wheels on two rockers under a chassis, driving speed and preferences.

    Attributes have the names of the keys in the TOML file; the page "Describe your vehicle" lists units and bounds.
    """

    name: str
    description: str
    wheelbase_m: Annotated[float, within("distance between the axles", 0.1, 20, "m")]
    track_m: Annotated[float, within("distance between the wheel centres of one axle", 0.05, 15, "m")]
    speed_mps: Annotated[
        float,
        within(
            "the speed of every drive; C_r depends on it, so choose the speed at which you will drive", 0.05, 15, "m/s"
        ),
    ]
    slope_limit_deg: Annotated[float, within("steeper tiles are class 3 and not passable", 3, 60, "deg")]
    ride_weight: Annotated[
        float,
        within("the detour that is acceptable to avoid one radian of pitch motion; a preference", 0, 1000, "m/rad"),
    ] = field(default=5.0, kw_only=True)
    """cost = 1 + ride_weight * c_r + fail_weight * hazard."""
    fail_weight: Annotated[
        float, within("the detour that is acceptable to avoid one failure; a preference", 0, 100_000, "m")
    ] = field(default=300.0, kw_only=True)
    chassis: Chassis
    belly: Belly
    rocker: Rocker
    wheel: Wheel
    body: Body = field(default=Body(), kw_only=True)
    """Does not affect the drives; what the profile leaves out follows from the other keys."""
    comfort: Comfort = field(default=Comfort(), kw_only=True)
    """Does not affect the drives: how fast a map says that ground is driven."""
    floor: Floor = field(default=Floor(), kw_only=True)
    """Does not affect the drives either; added to what they say."""

    @property
    def mass_kg(self) -> float:
        """Mass of the whole vehicle in kg."""
        return self.chassis.mass_kg + 2 * self.rocker.mass_kg + 4 * self.wheel.mass_kg

    @property
    def tips_deg(self) -> float:
        """Slope across which the vehicle at rest tips over: of half the track over the height of the centre of mass."""
        height = self.wheel.radius_m + self.chassis.com_height_m * self.chassis.mass_kg / self.mass_kg
        return math.degrees(math.atan2(0.5 * self.track_m, height))

    @property
    def length_m(self) -> float:
        """Length of the whole vehicle in metres, the larger of belly and wheels."""
        return max(self.belly.length_m, self.wheelbase_m + 2 * self.wheel.radius_m)

    @property
    def width_m(self) -> float:
        """Width of the whole vehicle in metres, the larger of belly and wheels."""
        return max(self.belly.width_m, self.track_m + self.wheel.width_m)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "Vehicle":
        """Read a vehicle profile: the name of an included vehicle, such as ``warthog``, or a TOML file.

        Raises UsageError if there is no such vehicle or file, BadInputError if the file is not TOML, or a value is
        missing or not plausible.
        """
        return cls.from_dict(*_profile_record(name_or_path))

    def to_dict(self) -> dict[str, Any]:
        """Return the profile as a nested dictionary, as in its TOML file."""
        plain: dict[str, Any] = plain_json(self)
        return plain

    @classmethod
    def from_dict(cls, record: dict[str, Any], origin: str) -> "Vehicle":
        """Check a nested dictionary and make a profile of it.

        ``record``: the profile, as in a TOML file; ``origin``: name of the file for error messages. Raises
        BadInputError, whose message lists all faults, if a key is unknown or missing, or a value is of the wrong type
        or not plausible.
        """
        arguments, faults, estimates = _parsed(record)
        if not faults:
            profile = cls(**arguments)
            profile = replace(profile, body=_outline(profile))
            faults = [
                f"{key} is {short_repr(text)}; it must be a text of one line that is not empty"
                for key, text in (("name", profile.name), ("description", profile.description))
                if not (text.strip() and text.isprintable())
            ]
            faults += [*_size_faults(profile), *_mass_faults(profile, record.get("mass_kg", profile.mass_kg))]
        lacking = estimates is None and any(fault.startswith("missing") for fault in faults)
        refuse_faults(faults, origin, BadInputError, f"; {_SCHEMA}{_SHORT if lacking else ''}")
        return profile


def _parsed(record: Any) -> tuple[dict[str, Any], list[str], dict[str, Any] | None]:
    """Return the arguments of a `Vehicle`, the faults of its record, and what was estimated, by key; None: nothing.

    Estimated is what a short profile, which has ``mass_kg`` or ``suspension``, leaves out; what it gives stays.
    """
    short = {key: record[key] for key in declared_fields(Whole) if isinstance(record, dict) and key in record}
    if not short:
        return *parse_record(record, Vehicle, Path(), complete=True), None
    whole, faults = parse_record(short, Whole, Path(), complete=True)
    rest: dict[str, Any] = {name.partition(".")[0]: {} for name in ESTIMATED}
    rest |= {key: value for key, value in record.items() if key not in short}
    lacks = tuple(f"missing {name}:" for name in ESTIMATED)
    faults += [fault for fault in parse_record(rest, Vehicle, Path(), complete=True)[1] if not fault.startswith(lacks)]
    if faults:
        return {}, faults, {}
    found = estimate(Whole(**whole), rest)
    if found["chassis"]["mass_kg"] <= 0:
        return {}, [f"mass_kg is {whole['mass_kg']:g}, and rockers and wheels alone weigh that much"], {}
    full = rest | {name: own | rest[name] for name, own in found.items()}
    estimates = {f"{name}.{key}": own[key] for name, own in found.items() for key in own if key not in rest[name]}
    return *parse_record(full, Vehicle, Path(), complete=True), estimates


def _outline(vehicle: Vehicle) -> Body:
    """Return the ``[body]`` of a profile, with defaults for what it leaves out, to centimetres.

    Height: the wheels' or the belly's clearance, the higher, plus 0.7 of the track. Width: the wider of belly and
    wheels. Brush: the belly's clearance, so that whatever reaches the belly is an obstacle.
    """
    clearance = vehicle.belly.clearance_m
    height = round(max(2 * vehicle.wheel.radius_m, clearance) + _TALL * vehicle.track_m, 2)
    usual = {"height_m": height, "width_m": round(vehicle.width_m, 2), "brush_stem_m": clearance}
    return Body(**usual | {name: value for name, value in asdict(vehicle.body).items() if not math.isnan(value)})


def _keys(owner: Any, table: str = "") -> tuple[Declared, ...]:
    """Return the quantities of a dataclass and of its nested dataclasses, in the order of the file.

    Names hold the table, such as ``chassis.mass_kg``. A default is NaN if it follows from other keys.
    """
    found: list[Declared] = []
    for each in declared_fields(owner).values():
        name = f"{table}.{each.name}".lstrip(".")
        if each.setting is not None:
            found.append(replace(each, name=name))
        elif is_dataclass(each.kind) and not each.optional:
            found += _keys(each.kind, name)
    return tuple(found)


KEYS = _keys(Vehicle)
"""All numeric keys of a profile, in the order of the file."""


def flat_profile(vehicle: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of a profile, as in its TOML file, by names such as ``belly.length_m``."""
    tables = {name: part for name, part in vehicle.items() if isinstance(part, dict)}
    rest = {name: value for name, value in vehicle.items() if name not in tables}
    return rest | {f"{name}.{key}": value for name, part in tables.items() for key, value in part.items()}


def _profile_record(name_or_path: str | Path) -> tuple[dict[str, Any], str]:
    """Return a profile as its file has it, and what to call it in messages."""
    if str(name_or_path) in shipped_profiles():
        with as_file(files("bumpymap.rating") / "data" / "vehicles" / f"{name_or_path}.toml") as shipped:
            return read_toml(shipped, "the vehicle profile", BadInputError), f"vehicle profile {name_or_path}"
    path = Path(path_of_call("the vehicle", name_or_path))
    if not path.exists():
        raise UsageError(
            f"no vehicle '{name_or_path}': it is neither a file nor an included vehicle "
            f"({', '.join(shipped_profiles())}). Give one of these names, or a TOML file; "
            "bumpymap vehicle new NAME writes a template"
        )
    return read_toml(path, "the vehicle profile", BadInputError), str(path)


def shipped_profiles() -> list[str]:
    """Return the names of the included vehicle profiles."""
    folder = files("bumpymap.rating") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def estimated_values(name_or_path: str | Path) -> dict[str, Any]:
    """Return what a short profile leaves out and `Vehicle.load` estimates, by key, such as ``chassis.com_height_m``."""
    return _parsed(_profile_record(name_or_path)[0])[2] or {}


def _size_faults(profile: Vehicle) -> Iterator[str]:
    """Describe each dimension that contradicts another."""
    wheel, belly, body = profile.wheel, profile.belly, profile.body
    radius, between = wheel.radius_m, profile.track_m - wheel.width_m
    under, wide = max(2 * radius, belly.clearance_m), profile.width_m
    if 2 * radius >= profile.wheelbase_m:
        yield (
            f"wheel.radius_m is {radius:g} and wheelbase_m {profile.wheelbase_m:g}; front and rear wheels would touch: "
            "the wheelbase must exceed twice the radius"
        )
    if between <= 0:
        yield (
            f"wheel.width_m is {wheel.width_m:g} and track_m {profile.track_m:g}; the track must exceed the wheel width"
        )
    if belly.width_m > between and belly.clearance_m < 2 * radius:
        yield (
            f"belly.width_m is {belly.width_m:g}, and the wheels are {between:g} apart on the inside; "
            "a belly below the top of the wheels must fit between them"
        )
    if belly.length_m > _LONGEST_BELLY * profile.wheelbase_m:
        yield (
            f"belly.length_m is {belly.length_m:g} and wheelbase_m {profile.wheelbase_m:g}; a belly has at most "
            f"{_LONGEST_BELLY:g} times the wheelbase"
        )
    if profile.chassis.com_height_m < -radius:
        yield (
            f"chassis.com_height_m is {profile.chassis.com_height_m:g}, below the ground; it is the height above the "
            f"axles and must be above -wheel.radius_m = {-radius:g}"
        )
    if body.height_m < under:
        yield f"body.height_m is {body.height_m:g}, and wheels and belly reach up to {under:g}; it must not be lower"
    elif body.height_m <= body.brush_stem_m:
        yield f"body.height_m is {body.height_m:g} and body.brush_stem_m {body.brush_stem_m:g}; it must be higher"
    if (own := profile.floor.c_r_radpm * profile.speed_mps) >= profile.comfort.pitch_rate_radps:
        yield (
            f"comfort.pitch_rate_radps is {profile.comfort.pitch_rate_radps:g}, and [floor] says that even ground "
            f"takes {own:.3g} rad/s: no speed would be slow enough"
        )
    if body.width_m < round(wide, 2) - 0.005:  # the default is rounded
        yield f"body.width_m is {body.width_m:g}, and belly and wheels are {wide:.3g} wide; it must not be less"


def _mass_faults(profile: Vehicle, whole: float) -> Iterator[str]:
    """Describe each mass or moment that does not fit the size, or the mass of the whole vehicle, kg."""
    if not math.isclose(whole, profile.mass_kg, rel_tol=0.01):
        yield (
            f"mass_kg is {whole:g}, and chassis, rockers and wheels weigh {profile.mass_kg:g} together: leave one of "
            "them out"
        )
    long, wide = profile.length_m, profile.width_m
    low, high = (density * math.sqrt(long * wide) ** 3 for density in (_LIGHTEST, _HEAVIEST))
    if not low <= profile.mass_kg <= high:
        yield (
            f"the whole vehicle weighs {profile.mass_kg:,.6g} kg and is {long:.3g} m long and {wide:.3g} m wide; one "
            f"of that size weighs between {low:.3g} and {high:.3g} kg. Are masses in kilograms and lengths in metres?"
        )
    size = max(long, wide)
    for table, shares in _GYRATION.items():
        part: Chassis | Rocker = getattr(profile, table)
        if 2 * max(part.inertia_kgm2) > sum(part.inertia_kgm2):
            yield (
                f"{table}.inertia_kgm2 is {short_repr(list(part.inertia_kgm2))}; each moment must be at most the sum "
                "of the two others (no rigid body has other moments)"
            )
        low, high = (part.mass_kg * (share * size) ** 2 for share in shares)
        if min(part.inertia_kgm2) < low or max(part.inertia_kgm2) > high:
            yield (
                f"{table}.inertia_kgm2 is {short_repr(list(part.inertia_kgm2))}: with {table}.mass_kg = "
                f"{part.mass_kg:g} in a vehicle of {size:.3g} m, each moment lies between {low:.2g} and {high:.2g} kg "
                "m2; a solid box of mass m, length l, width w and height h has m (w2 + h2) / 12, m (l2 + h2) / 12, "
                "m (l2 + w2) / 12"
            )


_NAME = re.compile(r"[\w-]{1,64}")


def write_profile_template(name: str, path: Path, like: str | None) -> None:
    """Write `profile_template` to a new file.

    Raises UsageError if the name is that of an included vehicle, or not one word, or there is no vehicle ``like``;
    OutputError if the file exists, or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"the name of a vehicle is {name!r}; it must be up to 64 letters, digits, _ and -")
    if name in shipped_profiles():
        raise UsageError(f"a vehicle named {name} is included in bumpymap: choose another name, or --like {name}")
    text = profile_template(name, like)
    try:
        with path.open("x", encoding="utf-8") as file:  # "x" does not follow a symbolic link either
            try:
                file.write(text)
                file.flush()
            except OSError:
                path.unlink()
                raise
    except FileExistsError as error:
        raise OutputError(f"{path} exists and is not overwritten: give another --out") from error
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}; give another --out") from error


def profile_template(name: str, like: str | None) -> str:
    """Return the text of a profile to edit, of a new vehicle of this name.

    ``like``: a vehicle (name or TOML file) to copy every number from; None: a short profile, with placeholders that
    `vehicle check` reports.
    """
    lines = ["# A vehicle profile for bumpymap. Check it with: bumpymap vehicle check FILE"]
    if like is None:
        lines += [
            f'# Replace each "{UNFILLED}" by a value. Inertia, centre of mass, springs, belly, outline are estimated',
            "# from these values: the check shows them, and each may be set.",
        ]
        keys = tuple(key for key in KEYS if key.default is None and key.name not in ESTIMATED)
        values, description = {key.name: UNFILLED for key in keys}, UNFILLED
    else:
        model = Vehicle.load(like).to_dict()
        lines.append(f"# The numbers are those of {model['name']}: change whatever differs.")
        keys, description = KEYS, f"like {model['name']}"
        values = flat_profile(model)
    lines += [f"name = {json.dumps(name)}", "# A one-line description."]
    lines.append(f"description = {json.dumps(description, ensure_ascii=False)}")
    if like is None:
        (mass,) = _keys(Whole)
        lines += [_about(mass), f'mass_kg = "{UNFILLED}"', f"# {SUSPENSION}", f'suspension = "{UNFILLED}"']
    table = ""
    for key in keys:
        before, (table, _, short) = table, key.name.rpartition(".")
        lines += ["", f"[{table}]"] * (table != before)
        lines += [_about(key), f"{short} = {json.dumps(values[key.name])}"]
    return "\n".join(lines) + "\n"


def _about(key: Declared) -> str:
    """Return the comment above a value."""
    what = key.setting.help.replace("`", "") if key.setting else ""
    return f"# {what[0].upper()}{what[1:]} ({allowed_values(key.kind, key.setting)})."
