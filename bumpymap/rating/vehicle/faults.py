"""Faults of a vehicle profile that no value shows alone: values that cannot go together."""

import math
from typing import TYPE_CHECKING

from bumpymap.core import short_repr

if TYPE_CHECKING:
    from bumpymap.rating.vehicle.profile import Chassis, Rocker, Vehicle

__all__ = ["faults_together"]

_LONGEST_BELLY = 4.0
"""Wheelbases; the overhangs of a bus make two of them."""
_LIGHTEST, _HEAVIEST = 5.0, 3000.0
"""Mass over the cube of the vehicle's size, the root of length times width, kg/m3: 98 to 140 for those that ship."""
_GYRATION = {"chassis": (0.03, 0.6), "rocker": (0.003, 0.6)}
"""Radius of gyration, the root of moment over mass, over the vehicle's length: no body has more than 0.6, two masses at
its ends; those that ship have 0.15 to 0.36 (chassis) and 0.02 to 0.21 (rocker)."""


def faults_together(profile: "Vehicle") -> list[str]:
    """Find what no value shows alone, in a profile without a fault in any key."""
    found = [_wheels(profile), _track(profile), _belly_width(profile), _belly_length(profile), _com(profile)]
    found += [_density(profile), *(_gyration(profile, table) for table in _GYRATION)]
    return [fault for fault in found if fault]


def _wheels(profile: "Vehicle") -> str:
    radius, wheelbase = profile.wheel.radius_m, profile.wheelbase_m
    if 2 * radius < wheelbase:
        return ""
    return (
        f"wheel.radius_m is {radius:g} and wheelbase_m {wheelbase:g}; front and rear wheels would touch: the wheelbase "
        "must exceed twice the radius"
    )


def _track(profile: "Vehicle") -> str:
    width, track = profile.wheel.width_m, profile.track_m
    if width < track:
        return ""
    return f"wheel.width_m is {width:g} and track_m {track:g}; the track must exceed the wheel width"


def _belly_width(profile: "Vehicle") -> str:
    belly, between = profile.belly, profile.track_m - profile.wheel.width_m
    if belly.width_m <= between or belly.clearance_m >= 2 * profile.wheel.radius_m:
        return ""
    return (
        f"belly.width_m is {belly.width_m:g}, and the wheels are {between:g} apart on the inside; "
        "a belly below the top of the wheels must fit between them"
    )


def _belly_length(profile: "Vehicle") -> str:
    length, wheelbase = profile.belly.length_m, profile.wheelbase_m
    if length <= _LONGEST_BELLY * wheelbase:
        return ""
    return (
        f"belly.length_m is {length:g} and wheelbase_m {wheelbase:g}; a belly has at most {_LONGEST_BELLY:g} times "
        "the wheelbase"
    )


def _com(profile: "Vehicle") -> str:
    height, radius = profile.chassis.com_height_m, profile.wheel.radius_m
    if height >= -radius:
        return ""
    return (
        f"chassis.com_height_m is {height:g}, below the ground; it is the height above the axles and must be above "
        f"-wheel.radius_m = {-radius:g}"
    )


def _density(profile: "Vehicle") -> str:
    size = math.sqrt(profile.length_m * profile.width_m)
    low, high = _LIGHTEST * size**3, _HEAVIEST * size**3
    if low <= profile.mass_kg <= high:
        return ""
    return (
        f"the whole vehicle weighs {profile.mass_kg:,.6g} kg and is {profile.length_m:.3g} m long and "
        f"{profile.width_m:.3g} m wide; one of that size weighs between {low:.3g} and {high:.3g} kg. Are masses in "
        "kilograms and lengths in metres?"
    )


def _gyration(profile: "Vehicle", table: str) -> str:
    part: Chassis | Rocker = getattr(profile, table)
    size = max(profile.length_m, profile.width_m)
    low, high = (part.mass_kg * (share * size) ** 2 for share in _GYRATION[table])
    moments = part.inertia_kgm2
    if low <= min(moments) and max(moments) <= high:
        return ""
    return (
        f"{table}.inertia_kgm2 is {short_repr(list(moments))}: with {table}.mass_kg = {part.mass_kg:g} in a vehicle of "
        f"{size:.3g} m, each moment lies between {low:.2g} and {high:.2g} kg m2; a solid box of mass m, length l, "
        "width w and height h has m (w2 + h2) / 12, m (l2 + h2) / 12, m (l2 + w2) / 12"
    )
