"""Vehicle profiles: what a vehicle is, read from a TOML file and checked once."""

import math
import tomllib
from dataclasses import asdict, dataclass, fields, is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from bumpymap.errors import BadInputError

__all__ = ["Belly", "Chassis", "Rocker", "VehicleProfile", "Wheel", "load_profile", "shipped_profiles"]

_SCHEMA = "docs/pages/vehicle-profile.md lists every key"
_LARGEST_ROCKER_LIMIT_RAD = 1.2
_FASTEST_MPS = 15.0
_STEEPEST_DEG = 60.0


@dataclass(frozen=True, slots=True)
class Chassis:
    """The body that carries the pitch-rate sensor."""

    mass_kg: float
    inertia_kgm2: tuple[float, float, float]
    """Moments about the centre of mass: roll (forward axis), pitch (left axis), yaw (upward axis)."""
    com_height_m: float
    """Centre of mass above the axles when the vehicle stands on level ground; may be negative."""


@dataclass(frozen=True, slots=True)
class Belly:
    """The underside of the chassis: a level plate amid the wheels, with walls above it."""

    length_m: float
    """Along the vehicle, bumpers included."""
    width_m: float
    clearance_m: float
    """Over level ground."""


@dataclass(frozen=True, slots=True)
class Rocker:
    """The beam on either side that joins a front and a rear wheel and turns about the chassis' left axis."""

    mass_kg: float
    inertia_kgm2: tuple[float, float, float]
    """Moments about its centre: roll, pitch, yaw."""
    limit_rad: float
    """Largest angle between rocker and chassis, either way."""
    stiffness_nm_per_rad: float
    """Spring that brings the rocker back; 0 is a free rocker."""
    damping_nms_per_rad: float


@dataclass(frozen=True, slots=True)
class Wheel:
    """One of the four wheels: a rigid sphere to the ground, a cylinder to its own inertia."""

    mass_kg: float
    radius_m: float
    width_m: float


@dataclass(frozen=True, slots=True)
class VehicleProfile:
    """Four wheels on two rockers under a chassis, and how the vehicle is driven."""

    name: str
    description: str
    wheelbase_m: float
    """Between the axles."""
    track_m: float
    """Between the wheel centres of one axle."""
    speed_mps: float
    """The speed of every drive of the calibration."""
    slope_limit_deg: float
    """Steeper ground is not for this vehicle."""
    ride_weight: float
    """m/rad: cost = 1 + ride_weight * c_r."""
    chassis: Chassis
    belly: Belly
    rocker: Rocker
    wheel: Wheel

    @property
    def mass_kg(self) -> float:
        """Mass of the whole vehicle, kg."""
        return self.chassis.mass_kg + 2 * self.rocker.mass_kg + 4 * self.wheel.mass_kg

    def to_dict(self) -> dict[str, Any]:
        """Return the nested dictionary that a TOML file of this profile would hold."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: dict[str, Any], origin: str) -> "VehicleProfile":
        """Check a nested dictionary; ``origin`` names it in messages.

        Raises
        ------
        BadInputError
            A key that is unknown or missing, a value of the wrong kind or out of its range.
        """
        profile: VehicleProfile = _build(cls, record, origin, "")
        _check_together(profile, origin)
        return profile


def load_profile(name_or_path: str | Path) -> VehicleProfile:
    """Read a vehicle profile: one that ships (``warthog``) or a TOML file.

    A name without a suffix or a folder means a shipped profile, everything else a file.

    Raises
    ------
    BadInputError
        No such profile, not TOML, or values that cannot be.
    """
    text = str(name_or_path)
    path = Path(name_or_path)
    if text in shipped_profiles():
        content = (files("bumpymap") / "data" / "vehicles" / f"{text}.toml").read_text(encoding="utf-8")
        return _parse(content, f"vehicle profile {text}")
    if not path.exists():
        raise BadInputError(
            f"no vehicle profile '{text}': it is neither a file nor one that ships with bumpymap "
            f"({', '.join(shipped_profiles())}). Give one of these names, or a TOML file; {_SCHEMA}"
        )
    try:
        content = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInputError(f"cannot read the vehicle profile {path}: {error}") from error
    return _parse(content, str(path))


def shipped_profiles() -> list[str]:
    """Names of the profiles in the package."""
    folder = files("bumpymap") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def _parse(content: str, origin: str) -> VehicleProfile:
    try:
        record = tomllib.loads(content)
    except tomllib.TOMLDecodeError as error:
        raise BadInputError(f"{origin} is not a TOML file: {error}; {_SCHEMA}") from error
    return VehicleProfile.from_dict(record, origin)


def _build(kind: type[Any], record: Any, origin: str, table: str) -> Any:
    """Turn one TOML table into its dataclass."""
    if not isinstance(record, dict):
        raise BadInputError(f"{origin}: {table or 'the file'} is {record!r}; it must be a table; {_SCHEMA}")
    known = [f.name for f in fields(kind)]
    for problem, keys in (
        ("unknown", [key for key in record if key not in known]),
        ("missing", [key for key in known if key not in record]),
    ):
        if keys:
            where = f" in [{table}]" if table else ""
            raise BadInputError(f"{origin}: {problem} {', '.join(keys)}{where}; allowed: {', '.join(known)}")
    values = {}
    for f in fields(kind):
        value = record[f.name]
        if is_dataclass(f.type):
            values[f.name] = _build(f.type, value, origin, f.name)  # type: ignore[arg-type]
        else:
            values[f.name] = _value(f.name, value, f"{origin}: {table + '.' if table else ''}{f.name}")
    return kind(**values)


def _value(name: str, value: Any, where: str) -> Any:
    """Check one entry by the kind that its name tells."""
    if name in ("name", "description"):
        if not isinstance(value, str) or not value.strip():
            raise BadInputError(f"{where} is {value!r}; it must be a text that is not empty")
        return value
    if name == "inertia_kgm2":
        return _inertia(value, where)
    low, high, low_allowed = _range_of(name)
    number = _number(value, where)
    if not (number >= low if low_allowed else number > low) or number > high:
        sign = ">=" if low_allowed else ">"
        top = f" and <= {high:g}" if math.isfinite(high) else ""
        raise BadInputError(f"{where} is {value}; it must be {sign} {low:g}{top}")
    return number


def _range_of(name: str) -> tuple[float, float, bool]:
    """Lowest and highest value, and whether the lowest itself is allowed."""
    special = {
        "com_height_m": (-math.inf, math.inf, False),
        "limit_rad": (0.0, _LARGEST_ROCKER_LIMIT_RAD, True),
        "stiffness_nm_per_rad": (0.0, math.inf, True),
        "damping_nms_per_rad": (0.0, math.inf, True),
        "ride_weight": (0.0, math.inf, True),
        "speed_mps": (0.0, _FASTEST_MPS, False),
        "slope_limit_deg": (0.0, _STEEPEST_DEG, False),
    }
    return special.get(name, (0.0, math.inf, False))


def _number(value: Any, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise BadInputError(f"{where} is {value!r}; it must be a finite number")
    return float(value)


def _inertia(value: Any, where: str) -> tuple[float, float, float]:
    """Three positive moments that a rigid body can have: none exceeds the sum of the two others."""
    if not isinstance(value, list | tuple) or len(value) != 3:
        raise BadInputError(f"{where} is {value!r}; it must be three numbers: [roll, pitch, yaw]")
    roll, pitch, yaw = (_number(item, where) for item in value)
    if min(roll, pitch, yaw) <= 0 or 2 * max(roll, pitch, yaw) > roll + pitch + yaw:
        raise BadInputError(
            f"{where} is {list(value)}; each moment must be > 0 and at most the sum of the two others "
            "(no rigid body has other moments)"
        )
    return roll, pitch, yaw


def _check_together(profile: VehicleProfile, origin: str) -> None:
    """Check what no value shows alone."""
    if 2 * profile.wheel.radius_m >= profile.wheelbase_m:
        raise BadInputError(
            f"{origin}: wheel.radius_m is {profile.wheel.radius_m} and wheelbase_m {profile.wheelbase_m}; "
            "front and rear wheels would touch: the wheelbase must exceed twice the radius"
        )
    if profile.wheel.width_m >= profile.track_m:
        raise BadInputError(
            f"{origin}: wheel.width_m is {profile.wheel.width_m} and track_m {profile.track_m}; "
            "the track must exceed the wheel width"
        )
    between = profile.track_m - profile.wheel.width_m
    if profile.belly.width_m > between and profile.belly.clearance_m < 2 * profile.wheel.radius_m:
        raise BadInputError(
            f"{origin}: belly.width_m is {profile.belly.width_m}, and the wheels are {between:g} apart on the inside; "
            "a belly below the top of the wheels must fit between them"
        )
    if profile.chassis.com_height_m < -profile.wheel.radius_m:
        raise BadInputError(
            f"{origin}: chassis.com_height_m is {profile.chassis.com_height_m}, below the ground; "
            f"it must be above -wheel.radius_m = {-profile.wheel.radius_m}"
        )


def _plain(value: Any) -> Any:
    """Tuples as lists, so that the dictionary equals its own JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
