"""Vehicle profiles: what a vehicle is, read from a TOML file and checked once."""

from dataclasses import asdict, dataclass, field
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated, Any

from bumpymap.core import BadInputError, UsageError, parse_record, read_toml, refuse_faults
from bumpymap.rating.calibration import DEFAULT_FAIL_WEIGHT
from bumpymap.rating.vehicle.faults import faults_together
from bumpymap.rating.vehicle.keys import OneLine, Quantity, profile_keys

__all__ = ["KEYS", "Belly", "Chassis", "Rocker", "Vehicle", "Wheel", "load_profile", "shipped_profiles"]

_SCHEMA = "docs/pages/vehicle-profile.md lists every key"


_Moments = tuple[float, float, float]
"""Roll (about the forward axis), pitch (left axis), yaw (upward axis)."""


@dataclass(frozen=True, slots=True)
class Chassis:
    """The body that carries the pitch-rate sensor."""

    mass_kg: Annotated[float, Quantity("kg", 0.2, 1e6, "all that neither rocker nor wheel is, payload too")]
    inertia_kgm2: Annotated[_Moments, Quantity("kg m2", 1e-6, 1e8, "moments about the centre of mass", count=3)]
    com_height_m: Annotated[float, Quantity("m", -2, 6, "centre of mass above the axles; may be negative")]
    """When the vehicle stands on level ground."""


@dataclass(frozen=True, slots=True)
class Belly:
    """The underside of the chassis: a level plate amid the wheels, with walls above it."""

    length_m: Annotated[float, Quantity("m", 0.05, 30, "along the vehicle, amid the axles, bumpers included")]
    width_m: Annotated[float, Quantity("m", 0.02, 15, "across the vehicle")]
    clearance_m: Annotated[
        float, Quantity("m", 0.005, 5, "of the lowest part that would strike a stone, over level ground")
    ]


@dataclass(frozen=True, slots=True)
class Rocker:
    """The beam on either side that joins a front and a rear wheel and turns about the chassis' left axis."""

    mass_kg: Annotated[float, Quantity("kg", 0.005, 1e5, "one rocker: the beam that joins a front and a rear wheel")]
    inertia_kgm2: Annotated[_Moments, Quantity("kg m2", 1e-8, 1e7, "moments about its centre", count=3)]
    limit_rad: Annotated[float, Quantity("rad", 0, 1.2, "stop, either way from level")]
    stiffness_nm_per_rad: Annotated[float, Quantity("N m/rad", 0, 1e9, "spring back to level; 0 is a free rocker")]
    damping_nms_per_rad: Annotated[float, Quantity("N m s/rad", 0, 1e8, "damper")]


@dataclass(frozen=True, slots=True)
class Wheel:
    """One of the four wheels: a rigid sphere to the ground, a cylinder to its own inertia."""

    mass_kg: Annotated[float, Quantity("kg", 0.005, 2e4, "one wheel")]
    radius_m: Annotated[float, Quantity("m", 0.02, 3, "the ground meets a sphere of this radius")]
    width_m: Annotated[float, Quantity("m", 0.005, 3, "for the wheel's own inertia")]


@dataclass(frozen=True, slots=True)
class Vehicle:
    """Four wheels on two rockers under a chassis, and how the vehicle is driven."""

    name: Annotated[str, OneLine()]
    description: Annotated[str, OneLine()]
    wheelbase_m: Annotated[float, Quantity("m", 0.1, 20, "between the axles")]
    track_m: Annotated[float, Quantity("m", 0.05, 15, "between the wheel centres of one axle")]
    speed_mps: Annotated[
        float,
        Quantity("m/s", 0.05, 15, "the speed of every drive. C_r depends on it: choose the speed you will drive"),
    ]
    slope_limit_deg: Annotated[float, Quantity("deg", 3, 60, "`map` gives steeper tiles a `p_fail` of 1")]
    ride_weight: Annotated[
        float, Quantity("m/rad", 0, 1000, "the detour that a radian of pitching is worth; a preference")
    ]
    """cost = 1 + ride_weight * c_r + fail_weight * hazard."""
    fail_weight: Annotated[
        float, Quantity("m", 0, 100_000, "the detour that a certain failure is worth; a preference")
    ] = field(default=DEFAULT_FAIL_WEIGHT, kw_only=True)
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
    def load(cls, name_or_path: str | Path) -> "Vehicle":
        """Read a profile: the name of one that ships (``warthog``), or a TOML file; see `load_profile`."""
        return load_profile(name_or_path)

    def to_dict(self) -> dict[str, Any]:
        """Return the nested dictionary that a TOML file of this profile would hold."""
        return {key: _plain(value) for key, value in asdict(self).items()}

    @classmethod
    def from_dict(cls, record: dict[str, Any], origin: str) -> "Vehicle":
        """Check a nested dictionary; ``origin`` names it in messages.

        Raises
        ------
        BadInputError
            A key that is unknown or missing, a value of the wrong kind or not plausible; all of them are said.
        """
        arguments, faults = parse_record(record, cls, Path(), complete=True)
        if not faults:
            profile = cls(**arguments)
            faults = faults_together(profile)
        refuse_faults(faults, origin, BadInputError, f"; {_SCHEMA}")
        return profile


KEYS = profile_keys(Vehicle)
"""In the order of the file."""


def load_profile(name_or_path: str | Path) -> Vehicle:
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
        with as_file(files("bumpymap.rating") / "data" / "vehicles" / f"{name_or_path}.toml") as shipped:
            return Vehicle.from_dict(
                read_toml(shipped, "the vehicle profile", BadInputError), f"vehicle profile {name_or_path}"
            )
    path = Path(name_or_path)
    if not path.exists():
        raise UsageError(
            f"no vehicle '{name_or_path}': it is neither a file nor an included vehicle "
            f"({', '.join(shipped_profiles())}). Give one of these names, or a TOML file; "
            "bumpymap vehicle new NAME writes a template"
        )
    return Vehicle.from_dict(read_toml(path, "the vehicle profile", BadInputError), str(path))


def shipped_profiles() -> list[str]:
    """Names of the profiles in the package."""
    folder = files("bumpymap.rating") / "data" / "vehicles"
    return sorted(entry.name.removesuffix(".toml") for entry in folder.iterdir() if entry.name.endswith(".toml"))


def _plain(value: Any) -> Any:
    """Tuples as lists, so that the dictionary equals its own JSON."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return list(value) if isinstance(value, tuple) else value
