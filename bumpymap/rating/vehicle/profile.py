"""Vehicle profiles: what a vehicle is, read from a TOML file and checked once."""

from dataclasses import asdict, dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from bumpymap.core import BadInputError, UsageError, read_toml
from bumpymap.rating.calibration import DEFAULT_FAIL_WEIGHT
from bumpymap.rating.vehicle.faults import faults_alone, faults_together

__all__ = ["Belly", "Chassis", "Rocker", "VehicleProfile", "Wheel", "load_profile", "shipped_profiles"]

_SCHEMA = "docs/pages/vehicle-profile.md lists every key"


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
    """m/rad: cost = 1 + ride_weight * c_r + fail_weight * hazard."""
    fail_weight: float = field(default=DEFAULT_FAIL_WEIGHT, kw_only=True)
    """m: the detour that one certain failure is worth."""
    chassis: Chassis
    belly: Belly
    rocker: Rocker
    wheel: Wheel

    @property
    def mass_kg(self) -> float:
        """Mass of the whole vehicle, kg."""
        return self.chassis.mass_kg + 2 * self.rocker.mass_kg + 4 * self.wheel.mass_kg

    @property
    def length_m(self) -> float:
        """Length of the whole vehicle, over belly and wheels."""
        return max(self.belly.length_m, self.wheelbase_m + 2 * self.wheel.radius_m)

    @property
    def width_m(self) -> float:
        """Width of the whole vehicle, over belly and wheels."""
        return max(self.belly.width_m, self.track_m + self.wheel.width_m)

    @classmethod
    def load(cls, name_or_path: str | Path) -> "VehicleProfile":
        """Read a profile: the name of one that ships (``warthog``), or a TOML file; see `load_profile`."""
        return load_profile(name_or_path)

    def to_dict(self) -> dict[str, Any]:
        """Return the nested dictionary that a TOML file of this profile would hold."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: dict[str, Any], origin: str) -> "VehicleProfile":
        """Check a nested dictionary; ``origin`` names it in messages.

        Raises
        ------
        BadInputError
            A key that is unknown or missing, a value of the wrong kind or not plausible; all of them are said.
        """
        faults = faults_alone(record)
        if not faults:
            profile = _build(record)
            faults = faults_together(profile.to_dict(), profile.mass_kg, profile.length_m, profile.width_m)
        if not faults:
            return profile
        if len(faults) == 1:
            raise BadInputError(f"{origin}: {faults[0]}")
        raise BadInputError(f"{origin}: {len(faults)} faults; {_SCHEMA}", *(f"  {fault}" for fault in faults))


def load_profile(name_or_path: str | Path) -> VehicleProfile:
    """Read a vehicle profile: one that ships (``warthog``) or a TOML file.

    The name of a shipped profile means that, everything else a file.

    Raises
    ------
    UsageError
        Neither a shipped profile nor a file.
    BadInputError
        Not TOML, or values that cannot be.
    """
    if str(name_or_path) in shipped_profiles():
        with as_file(files("bumpymap") / "data" / "vehicles" / f"{name_or_path}.toml") as shipped:
            return VehicleProfile.from_dict(
                read_toml(shipped, "the vehicle profile", BadInputError), f"vehicle profile {name_or_path}"
            )
    path = Path(name_or_path)
    if not path.exists():
        raise UsageError(
            f"no vehicle '{name_or_path}': it is neither a file nor one that ships with bumpymap "
            f"({', '.join(shipped_profiles())}). Give one of these names, or a TOML file; "
            "bumpymap vehicle new NAME writes one to fill in"
        )
    return VehicleProfile.from_dict(read_toml(path, "the vehicle profile", BadInputError), str(path))


def shipped_profiles() -> list[str]:
    """Names of the profiles in the package."""
    folder = files("bumpymap") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def _build(record: dict[str, Any]) -> VehicleProfile:
    """Make the profile of a dictionary without faults."""
    tables = {"chassis": Chassis, "belly": Belly, "rocker": Rocker, "wheel": Wheel}
    parts = {name: kind(**_numbers(record[name])) for name, kind in tables.items()}
    return VehicleProfile(**parts, **_numbers({key: value for key, value in record.items() if key not in tables}))


def _numbers(table: dict[str, Any]) -> dict[str, Any]:
    """Whole numbers as floats, lists as tuples of them."""
    return {key: _number(value) for key, value in table.items()}


def _number(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return tuple(map(float, value))
    return value if isinstance(value, str) else float(value)


def _plain(value: Any) -> Any:
    """Tuples as lists, so that the dictionary equals its own JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
