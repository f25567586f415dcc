"""The quantities that columns of a drive may hold, and the units that their names may state."""

import re
from collections.abc import Mapping
from math import pi

__all__ = [
    "ACCELERATIONS",
    "ANGLES",
    "DIMENSIONS",
    "EASTING_NORTHING",
    "LOCAL",
    "LONLAT",
    "QUANTITIES",
    "QUATERNION",
    "RATES",
    "SIDES",
    "UNITS",
    "plain_unit",
]

RATES = ("rate_x", "rate_y", "rate_z")
ACCELERATIONS = ("acc_x", "acc_y", "acc_z")
ANGLES = ("roll", "pitch", "yaw")
QUATERNION = ("q_x", "q_y", "q_z", "q_w")
LONLAT = ("longitude", "latitude")
EASTING_NORTHING = ("easting", "northing")
LOCAL = ("x", "y")
SIDES = ("speed_left", "speed_right")

DIMENSIONS: Mapping[str, str] = {
    "time": "time",
    "nanosec": "time",
    **dict.fromkeys(RATES, "rate"),
    **dict.fromkeys(ACCELERATIONS, "acceleration"),
    **dict.fromkeys(ANGLES, "angle"),
    **dict.fromkeys(QUATERNION, "number"),
    **dict.fromkeys(LONLAT, "degree"),
    **dict.fromkeys((*EASTING_NORTHING, *LOCAL, "error"), "length"),
    **dict.fromkeys(("speed", *SIDES), "speed"),
    "fix": "number",
}
"""Quantity -> what its unit is a unit of."""
QUANTITIES = tuple(DIMENSIONS)

_G = 9.80665
_DEGREE = pi / 180.0
UNITS: Mapping[str, Mapping[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rate": {"rad/s": 1.0, "mrad/s": 1e-3, "deg/s": _DEGREE, "mdeg/s": 1e-3 * _DEGREE},
    "acceleration": {"m/s2": 1.0, "g": _G, "mg": 1e-3 * _G},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "degree": {"deg": 1.0, "rad": 1.0 / _DEGREE, "dege7": 1e-7},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "km": 1e3},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "mph": 0.44704},
    "number": {"": 1.0},
}
"""Dimension -> unit, as `plain_unit` spells it -> factor to the unit of `DriveLog`."""

_SPELLED = {
    **dict.fromkeys(("sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("msec", "msecs", "millis", "millisec", "milliseconds"), "ms"),
    **dict.fromkeys(("usec", "usecs", "micros", "microsec", "microseconds"), "us"),
    **dict.fromkeys(("nsec", "nsecs", "nanos", "nanosec", "nanoseconds"), "ns"),
    **dict.fromkeys(("rads", "rad/sec", "radps", "radians/s", "radian/s", "rps"), "rad/s"),
    **dict.fromkeys(("dps", "degs", "deg/sec", "degps", "degrees/s", "degree/s"), "deg/s"),
    **dict.fromkeys(("mdps", "mdegs"), "mdeg/s"),
    **dict.fromkeys(("ms2", "ms-2", "mps2", "m/s/s", "m/s/2", "m/sec2", "mss"), "m/s2"),
    **dict.fromkeys(("gs", "gee", "g0"), "g"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees", "d"), "deg"),
    **dict.fromkeys(("e7", "dege-7", "1e-7deg", "1e7deg"), "dege7"),
    **dict.fromkeys(("meter", "metre", "meters", "metres"), "m"),
    **dict.fromkeys(("mps", "m/sec"), "m/s"),
    **dict.fromkeys(("kmh", "kph", "kmph", "km/hr"), "km/h"),
}
_LETTERS = str.maketrans({"µ": "u", "μ": "u", "°": "deg", "²": "2", "^": "", "*": "", " ": "", "_": "/"})


def plain_unit(text: str, dimension: str) -> str | None:
    """Return a unit of a dimension as `UNITS` spells it: ``Deg/sec``, ``deg_s``, ``dps`` are ``deg/s``; or None."""
    unit = text.strip().lower().translate(_LETTERS)
    unit = re.sub(r"/?per/?", "/", unit)
    unit = _SPELLED.get(unit, unit)
    return unit if unit in UNITS[dimension] else None
