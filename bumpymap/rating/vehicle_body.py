"""The outline of a vehicle: what it passes over, between and under. It does not affect the simulated drives."""

import math
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import VehicleBody, field_rule

_WORDS = {
    "m": "metres",
    "m/s": "metres per second",
    "deg": "degrees",
    "rad": "radians",
    "rad/s": "radians per second",
    "m/s2": "m/s2",
    "kg": "kilograms",
    "kg m2": "kg m2",
    "m/rad": "metres per radian",
    "rad/m": "radians per metre",
    "N m/rad": "N m per radian",
    "N m s/rad": "N m s per radian",
}
_MISTAKEN = {
    "m": ("mm", 0.001),
    "m/s": ("km/h", 1 / 3.6),
    "deg": ("rad", math.degrees(1.0)),
    "rad": ("deg", math.radians(1.0)),
    "rad/m": ("deg/m", math.radians(1.0)),
}
"""The unit that is often used by mistake, and its size in the right one."""


@dataclass(frozen=True, slots=True)
class OneLine:
    """Rule for a text of one line."""

    @property
    def allowed(self) -> str:
        """Describe the allowed values."""
        return "a text of one line that is not empty"

    def fault(self, value: str) -> str:
        """Describe what is wrong with a text; return an empty string if it is valid."""
        return "" if value.strip() and value.isprintable() else f"it must be {self.allowed}"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Rule for a number with a unit, or for three moments of inertia."""

    unit: str
    low: float
    high: float
    """Lowest and highest allowed value."""
    what: str
    """Description in one line."""
    count: int = 1
    """How many numbers the key takes: 1, or 3 moments."""

    @property
    def allowed(self) -> str:
        """Describe the allowed values, such as ``between 0.1 and 20 metres``."""
        each = "three numbers, [roll, pitch, yaw], each " if self.count > 1 else ""
        return f"{each}between {_plain(self.low)} and {_plain(self.high)} {_WORDS[self.unit]}"

    def fault(self, value: float | tuple[float, ...]) -> str:
        """Describe what is wrong with a value; return an empty string if it is valid."""
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(map(self._is_within, numbers)):
            return f"it must be {self.allowed}{self._suggest_unit(numbers[0]) if self.count == 1 else ''}"
        if self.count > 1 and 2 * max(numbers) > sum(numbers):
            return "each moment must be at most the sum of the two others (no rigid body has other moments)"
        return ""

    def _is_within(self, value: float) -> bool:
        return self.low <= value <= self.high

    def _suggest_unit(self, value: float) -> str:
        """Name the unit in which a value outside the bounds would be valid; return an empty string if none."""
        unit, factor = _MISTAKEN.get(self.unit, ("", 0.0))
        return f"; {value:g} {unit} would be {value * factor:.3g}" if unit and self._is_within(value * factor) else ""


@dataclass(frozen=True, slots=True)
class ProfileKey:
    """One key of a vehicle profile whose value is a quantity."""

    name: str
    """Name with its table, such as ``chassis.mass_kg``."""
    quantity: Quantity
    default: float | None
    """Default of an optional key, NaN if it follows from other keys; None if the key is required."""

    @property
    def table(self) -> str:
        """Table of the TOML file that holds the key; empty for the top level."""
        return self.name.rpartition(".")[0]

    @property
    def short(self) -> str:
        """Name within the table."""
        return self.name.rpartition(".")[2]

    def value_in(self, profile: Mapping[str, Any]) -> Any:
        """Return its value in a profile, as `Vehicle.to_dict` returns one."""
        return (profile[self.table] if self.table else profile)[self.short]


def profile_keys(owner: Any, table: str = "") -> tuple[ProfileKey, ...]:
    """Return the quantities of a dataclass and of its nested dataclasses, in the order of the file."""
    found: list[ProfileKey] = []
    for field in fields(owner):
        rule, name = field_rule(field.type), f"{table}.{field.name}".lstrip(".")
        if isinstance(rule, Quantity):
            found.append(ProfileKey(name, rule, None if field.default is MISSING else field.default))
        elif is_dataclass(field.type):
            found += profile_keys(field.type, name)
    return tuple(found)


def _plain(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:g}"


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
        float, Quantity("rad/m", 0, 1, "C_r on even, level ground at `speed_mps`; enters `c_r` in power")
    ] = 0.0


@dataclass(frozen=True, slots=True)
class Comfort:
    """Limits of the ride, from which the speed made good of each tile follows."""

    pitch_rate_radps: Annotated[float, Quantity("rad/s", 0.001, 100, "most pitch motion, C_r times the speed")] = 0.3
    a_w_mps2: Annotated[
        float, Quantity("m/s2", 0, 1000, "most weighted vertical acceleration; 0: no limit, as nobody sits in it")
    ] = 0.0
    top_speed_mps: Annotated[
        float, Quantity("m/s", 0, 40, "speed on smooth ground; 0: `speed_mps`, or that of the map's `--speed`")
    ] = 0.0


def comfort_of(vehicle: Mapping[str, Any]) -> Comfort:
    """Return the limits of the ride of a vehicle profile (the nested dictionary of its TOML file)."""
    return Comfort(**{name: float(value) for name, value in vehicle.get("comfort", {}).items()})


def floor_of(vehicle: Mapping[str, Any]) -> float:
    """Return the floor of a vehicle profile (the nested dictionary of its TOML file), rad/m; 0 if it has none."""
    return float(vehicle.get("floor", {}).get("c_r_radpm", 0.0))


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
