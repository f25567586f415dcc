"""Rules for the keys of a vehicle profile: unit, bounds and description, for messages, docs and templates.

The bounds admit a rover of 2 kg and a haul truck of 600 t, and are narrow enough that most values in a wrong unit
(millimetres, radians for degrees, km/h) fall outside.
"""

import math
from dataclasses import MISSING, dataclass, fields, is_dataclass
from typing import Any

from bumpymap.core import field_rule

__all__ = ["OneLine", "ProfileKey", "Quantity", "profile_keys"]

_WORDS = {
    "m": "metres",
    "m/s": "metres per second",
    "deg": "degrees",
    "rad": "radians",
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
