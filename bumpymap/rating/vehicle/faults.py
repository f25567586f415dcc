"""What is wrong with a vehicle profile, said in the words of its keys: each value alone, and all of them together."""

import math
from itertools import groupby
from typing import Any

from bumpymap.core import shown, shown_names
from bumpymap.rating.vehicle.keys import KEYS, Key

__all__ = ["UNFILLED", "faults_alone", "faults_together"]

UNFILLED = "?"
"""What stands in a new profile where a number is wanted."""
_TEXTS = ("name", "description")
_TABLES = {table: list(keys) for table, keys in groupby(KEYS, key=lambda key: key.table)}
_LONGEST_BELLY = 4.0
"""Wheelbases; the overhangs of a bus make two of them."""
_LIGHTEST, _HEAVIEST = 5.0, 3000.0
"""Mass over the cube of the vehicle's size, the root of length times width, kg/m3: 98 to 140 for those that ship."""
_GYRATION = {"chassis": (0.03, 0.6), "rocker": (0.003, 0.6)}
"""Radius of gyration, the root of moment over mass, over the vehicle's length: no body has more than 0.6, two masses at
its ends; those that ship have 0.15 to 0.36 (chassis) and 0.02 to 0.21 (rocker)."""


def faults_alone(record: Any) -> list[str]:
    """Find the keys that are unknown or missing and the values that are not plausible; one sentence each."""
    if not isinstance(record, dict):
        return [f"the profile is {shown(record)}; it must be a table"]
    faults = _unknown(record, [*_TEXTS, *(key.name for key in _TABLES[""]), *filter(None, _TABLES)], "")
    faults += [fault for name in _TEXTS for fault in _text_faults(record, name)]
    for table, keys in _TABLES.items():
        part = record.get(table) if table else record
        names = ", ".join(key.short for key in keys)
        if table and table not in record:
            faults.append(f"missing {table}: it is a table, [{table}], with {names}")
        elif not isinstance(part, dict):
            faults.append(f"{table} is {shown(part)}; it must be a table, [{table}], with {names}")
        else:
            faults += _unknown(part, [key.short for key in keys], table) if table else []
            faults += [fault for key in keys for fault in _key_faults(part, key)]
    return faults


def faults_together(profile: dict[str, Any], mass_kg: float, length_m: float, width_m: float) -> list[str]:
    """Find what no value shows alone.

    Parameters
    ----------
    profile : dict
        Without a fault in any key.
    mass_kg, length_m, width_m : float
        Of the whole vehicle.
    """
    found = [_wheels(profile), _track(profile), _belly_width(profile), _belly_length(profile), _com(profile)]
    found += [_density(mass_kg, length_m, width_m)]
    found += [_gyration(table, profile[table], length_m, width_m) for table in _GYRATION]
    return [fault for fault in found if fault]


def _unknown(part: dict[str, Any], known: list[str], table: str) -> list[str]:
    unknown = [key for key in part if key not in known]
    where = f" in [{table}]" if table else ""
    return [f"unknown {shown_names(unknown)}{where}; allowed: {', '.join(known)}"] if unknown else []


def _text_faults(record: dict[str, Any], name: str) -> list[str]:
    if name not in record:
        return [f"missing {name}: a string"]
    if record[name] == UNFILLED:
        return [f"{name} is not filled in: a string"]
    if not isinstance(record[name], str) or not record[name].strip() or not record[name].isprintable():
        return [f"{name} is {shown(record[name])}; it must be a string of one line that is not empty"]
    return []


def _key_faults(part: dict[str, Any], key: Key) -> list[str]:
    if key.short not in part:
        return [f"missing {key.name}: {key.allowed}"] if key.default is None else []
    value = part[key.short]
    if value == UNFILLED:
        return [f"{key.name} is not filled in: {key.allowed}"]
    numbers = value if key.count == 3 and isinstance(value, list | tuple) else [value]
    if len(numbers) != key.count or not all(map(_is_number, numbers)):
        return [f"{key.name} = {shown(value)}: {key.allowed}"]
    if not all(map(key.holds, numbers)):
        return [f"{key.name} = {shown(value)}: {key.allowed}{key.mistaken(value) if key.count == 1 else ''}"]
    if key.count == 3 and 2 * max(numbers) > sum(numbers):
        rule = "each moment must be at most the sum of the two others (no rigid body has other moments)"
        return [f"{key.name} = {shown(value)}: {rule}"]
    return []


def _is_number(value: Any) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return math.isfinite(value) if isinstance(value, float) else abs(value) < 2**1023


def _wheels(profile: dict[str, Any]) -> str:
    radius, wheelbase = profile["wheel"]["radius_m"], profile["wheelbase_m"]
    if 2 * radius < wheelbase:
        return ""
    return (
        f"wheel.radius_m is {radius:g} and wheelbase_m {wheelbase:g}; front and rear wheels would touch: the wheelbase "
        "must exceed twice the radius"
    )


def _track(profile: dict[str, Any]) -> str:
    width, track = profile["wheel"]["width_m"], profile["track_m"]
    if width < track:
        return ""
    return f"wheel.width_m is {width:g} and track_m {track:g}; the track must exceed the wheel width"


def _belly_width(profile: dict[str, Any]) -> str:
    belly, between = profile["belly"], profile["track_m"] - profile["wheel"]["width_m"]
    if belly["width_m"] <= between or belly["clearance_m"] >= 2 * profile["wheel"]["radius_m"]:
        return ""
    return (
        f"belly.width_m is {belly['width_m']:g}, and the wheels are {between:g} apart on the inside; "
        "a belly below the top of the wheels must fit between them"
    )


def _belly_length(profile: dict[str, Any]) -> str:
    length, wheelbase = profile["belly"]["length_m"], profile["wheelbase_m"]
    if length <= _LONGEST_BELLY * wheelbase:
        return ""
    return (
        f"belly.length_m is {length:g} and wheelbase_m {wheelbase:g}; a belly has at most {_LONGEST_BELLY:g} times "
        "the wheelbase"
    )


def _com(profile: dict[str, Any]) -> str:
    height, radius = profile["chassis"]["com_height_m"], profile["wheel"]["radius_m"]
    if height >= -radius:
        return ""
    return (
        f"chassis.com_height_m is {height:g}, below the ground; it is the height above the axles and must be above "
        f"-wheel.radius_m = {-radius:g}"
    )


def _density(mass_kg: float, length_m: float, width_m: float) -> str:
    size = math.sqrt(length_m * width_m)
    low, high = _LIGHTEST * size**3, _HEAVIEST * size**3
    if low <= mass_kg <= high:
        return ""
    return (
        f"the whole vehicle weighs {mass_kg:,.6g} kg and is {length_m:.3g} m long and {width_m:.3g} m wide; one of "
        f"that size weighs between {low:.3g} and {high:.3g} kg. Are masses in kilograms and lengths in metres?"
    )


def _gyration(table: str, part: dict[str, Any], length_m: float, width_m: float) -> str:
    size = max(length_m, width_m)
    low, high = (part["mass_kg"] * (share * size) ** 2 for share in _GYRATION[table])
    moments = part["inertia_kgm2"]
    if low <= min(moments) and max(moments) <= high:
        return ""
    return (
        f"{table}.inertia_kgm2 = {shown(moments)}: with {table}.mass_kg = {part['mass_kg']:g} in a vehicle of "
        f"{size:.3g} m, each moment lies between {low:.2g} and {high:.2g} kg m2; a solid box of mass m, length l, "
        "width w and height h has m (w2 + h2) / 12, m (l2 + h2) / 12, m (l2 + w2) / 12"
    )
