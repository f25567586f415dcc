"""What the keys of a vehicle profile hold: units, plausible values, meaning. Used by messages, docs and new profiles.

The bounds are wide enough for a rover of 2 kg and for a haul truck of 600 t, and narrow enough that most values in
another unit (millimetres, radians for degrees, km/h) fall outside.
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
    "N m/rad": "N m per radian",
    "N m s/rad": "N m s per radian",
}
_MISTAKEN = {
    "m": ("mm", 0.001),
    "m/s": ("km/h", 1 / 3.6),
    "deg": ("rad", math.degrees(1.0)),
    "rad": ("deg", math.radians(1.0)),
}
"""The unit that a value is often given in instead, and what one of it is."""


@dataclass(frozen=True, slots=True)
class OneLine:
    """Rule of a text of one line."""

    @property
    def allowed(self) -> str:
        """Say what is allowed."""
        return "a text of one line that is not empty"

    def fault(self, value: str) -> str:
        """Say what is wrong with a text; empty where nothing is."""
        return "" if value.strip() and value.isprintable() else f"it must be {self.allowed}"


@dataclass(frozen=True, slots=True)
class Quantity:
    """Rule of a number with a unit, or of three moments of inertia."""

    unit: str
    low: float
    high: float
    """Lowest and highest value that is taken."""
    what: str
    """What it is, in a line."""
    count: int = 1
    """How many numbers it takes: 1, or 3 moments."""

    @property
    def allowed(self) -> str:
        """Say what is allowed, such as ``between 0.1 and 20 metres``."""
        each = "three numbers, [roll, pitch, yaw], each " if self.count > 1 else ""
        return f"{each}between {_plain(self.low)} and {_plain(self.high)} {_WORDS[self.unit]}"

    def fault(self, value: float | tuple[float, ...]) -> str:
        """Say what is wrong with a value; empty where nothing is."""
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(map(self._holds, numbers)):
            return f"it must be {self.allowed}{self._mistaken(numbers[0]) if self.count == 1 else ''}"
        if self.count > 1 and 2 * max(numbers) > sum(numbers):
            return "each moment must be at most the sum of the two others (no rigid body has other moments)"
        return ""

    def _holds(self, value: float) -> bool:
        return self.low <= value <= self.high

    def _mistaken(self, value: float) -> str:
        """Say in which other unit a value beyond the bounds would be within them; empty where in none."""
        unit, factor = _MISTAKEN.get(self.unit, ("", 0.0))
        return f"; {value:g} {unit} would be {value * factor:.3g}" if unit and self._holds(value * factor) else ""


@dataclass(frozen=True, slots=True)
class ProfileKey:
    """One key of a vehicle profile that holds a quantity."""

    name: str
    """With its table, such as ``chassis.mass_kg``."""
    quantity: Quantity
    default: float | None
    """Of a key that may be left out."""

    @property
    def table(self) -> str:
        """Table of the file that holds it; empty for the top."""
        return self.name.rpartition(".")[0]

    @property
    def short(self) -> str:
        """Name within its table."""
        return self.name.rpartition(".")[2]


def profile_keys(owner: Any, table: str = "") -> tuple[ProfileKey, ...]:
    """List the quantities of a dataclass and of the dataclasses in it, in the order of the file."""
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
