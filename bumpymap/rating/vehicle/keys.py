"""The keys of a vehicle profile: unit, plausible values, meaning. Messages, the page and new profiles are made of it.

The bounds are wide enough for a rover of 2 kg and for a haul truck of 600 t, and narrow enough that most values in
another unit (millimetres, radians for degrees, km/h) fall outside.
"""

import math
from dataclasses import dataclass

from bumpymap.rating.calibration import DEFAULT_FAIL_WEIGHT

__all__ = ["KEYS", "Key"]

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
class Key:
    """One number of a vehicle profile, or three."""

    name: str
    """With its table, such as ``chassis.mass_kg``."""
    unit: str
    low: float
    high: float
    """Lowest and highest value that is taken."""
    what: str
    """What it is, in a line."""
    default: float | None = None
    """Of a key that may be left out."""

    @property
    def table(self) -> str:
        """Table of the file that holds it; empty for the top."""
        return self.name.rpartition(".")[0]

    @property
    def short(self) -> str:
        """Name within its table."""
        return self.name.rpartition(".")[2]

    @property
    def count(self) -> int:
        """How many numbers it takes: three moments of inertia, one of anything else."""
        return 3 if self.short == "inertia_kgm2" else 1

    @property
    def allowed(self) -> str:
        """Say the unit and what is allowed, such as ``metres; between 0.1 and 20``."""
        each = "three numbers, [roll, pitch, yaw], each " if self.count == 3 else ""
        return f"{_WORDS[self.unit]}; {each}between {_plain(self.low)} and {_plain(self.high)}"

    def holds(self, value: float) -> bool:
        """Tell whether a number is within the bounds."""
        return self.low <= value <= self.high

    def mistaken(self, value: float) -> str:
        """Say in which other unit a value beyond the bounds would be within them; empty where in none."""
        unit, factor = _MISTAKEN.get(self.unit, ("", 0.0))
        return f"; {value:g} {unit} would be {value * factor:.3g}" if unit and self.holds(value * factor) else ""


def _plain(value: float) -> str:
    return f"{value:,.0f}" if value >= 1000 else f"{value:g}"


KEYS = (
    Key("wheelbase_m", "m", 0.1, 20, "distance between the axles"),
    Key("track_m", "m", 0.05, 15, "distance between the wheel centres of one axle"),
    Key(
        "speed_mps",
        "m/s",
        0.05,
        15,
        "the speed of every drive; C_r depends on it, so choose the speed at which you will drive",
    ),
    Key("slope_limit_deg", "deg", 3, 60, "`map` gives steeper tiles a `p_fail` of 1"),
    Key(
        "ride_weight",
        "m/rad",
        0,
        1000,
        "the detour that is acceptable to avoid one radian of pitch motion; a preference",
    ),
    Key(
        "fail_weight",
        "m",
        0,
        100_000,
        "the detour that is acceptable to avoid one failure; a preference",
        DEFAULT_FAIL_WEIGHT,
    ),
    Key("chassis.mass_kg", "kg", 0.2, 1e6, "everything except rockers and wheels, payload included"),
    Key("chassis.inertia_kgm2", "kg m2", 1e-6, 1e8, "moments of inertia about the centre of mass"),
    Key("chassis.com_height_m", "m", -2, 6, "height of the centre of mass above the axles; may be negative"),
    Key("belly.length_m", "m", 0.05, 30, "length along the vehicle, centred between the axles, bumpers included"),
    Key("belly.width_m", "m", 0.02, 15, "width across the vehicle"),
    Key("belly.clearance_m", "m", 0.005, 5, "height above level ground of the lowest part that could hit a stone"),
    Key("rocker.mass_kg", "kg", 0.005, 1e5, "mass of one rocker: the beam that joins a front and a rear wheel"),
    Key("rocker.inertia_kgm2", "kg m2", 1e-8, 1e7, "moments of inertia about its centre"),
    Key("rocker.limit_rad", "rad", 0, 1.2, "end stop, up and down from level"),
    Key(
        "rocker.stiffness_nm_per_rad",
        "N m/rad",
        0,
        1e9,
        "stiffness of the spring that returns it to level; 0 for a free rocker",
    ),
    Key("rocker.damping_nms_per_rad", "N m s/rad", 0, 1e8, "damping coefficient"),
    Key("wheel.mass_kg", "kg", 0.005, 2e4, "mass of one wheel"),
    Key("wheel.radius_m", "m", 0.02, 3, "radius; in contact with the ground, the wheel is a sphere"),
    Key("wheel.width_m", "m", 0.005, 3, "width, used for the moments of inertia of the wheel"),
)
"""In the order of the file."""
