"""What a page says in sentences: the result, the numbers of the vehicle, and what the map does not know.

Ride costs that real vehicles measured on named surfaces give the numbers of a map a size.
"""

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from bumpymap.core import CLASS_NAMES, MapConfig, parse_json
from bumpymap.layers.report.markup import Html, join, number, share, shares, table, tag
from bumpymap.layers.report.site import Site

__all__ = [
    "MeasuredSurfaces",
    "base_name",
    "command_of",
    "degrees_line",
    "headline",
    "limits_of",
    "meaning_of",
    "measured_surfaces",
    "read_surfaces",
    "settings_of",
]

_FILE = Path(__file__).with_name("data") / "surfaces.json"
_NAMED = ("asphalt", "snow", "silty loam")
"""Surfaces in a line of a summary, which everyone has walked on."""


@dataclass(frozen=True, slots=True)
class MeasuredSurfaces:
    """C_r of one real vehicle on named surfaces."""

    vehicle: str
    kind: str
    """What sort of vehicle it is."""
    speed: str
    """Range of its speeds, in words."""
    source: str
    method: str
    """How C_r was measured."""
    floor: tuple[float, float]
    """rad/m: what the vehicle itself gives on even ground."""
    c_r: dict[str, float]
    """Surface -> rad/m, rising."""


def read_surfaces() -> MeasuredSurfaces:
    """Read the measured surfaces that come with the package."""
    known = parse_json(_FILE.read_text(encoding="utf-8"))
    costs = {str(one["name"]): float(one["c_r"]) for one in known.pop("surfaces")}
    low, high = known.pop("floor")
    rising = dict(sorted(costs.items(), key=lambda one: one[1]))
    return MeasuredSurfaces(**known, floor=(float(low), float(high)), c_r=rising)


def degrees_line(median_c_r: Sequence[float]) -> str:
    """Say in degrees of pitch per metre what classes cost, beside named surfaces.

    Parameters
    ----------
    median_c_r : sequence
        Of each class, rad/m; NaN without tiles.
    """
    classes = ", ".join(
        f"{name} {math.degrees(c_r):.1f}"
        for name, c_r in zip(CLASS_NAMES, median_c_r, strict=False)
        if math.isfinite(c_r)
    )
    real = read_surfaces()
    named = ", ".join(f"{math.degrees(real.c_r[name]):.1f} on {name}" for name in _NAMED)
    if not classes:
        return ""
    return f"Median c_r in degrees of pitch per metre: {classes}; a real {real.vehicle} measured {named}"


_NAMELESS = "vehicle"
"""What `Site.vehicle` gives if the record names none."""
_PRIVATE = {
    *("surveys", "out", "threads", "memory", "scratch", "scheduler", "overwrite", "resume"),
    *("features", "csf"),
}
"""Settings that do not change the layers, or that are tables of their own."""
_FILES = ("vehicle", "calibration", "model")
"""Settings that may be paths. The name of a CRS may hold a slash too."""


def headline(site: Site) -> str:
    """Return the result in one or two sentences: shares of the tiles that hold points."""
    summary = site.summary
    parts = (summary.passable, summary.unknown, summary.tiles - summary.passable - summary.unknown)
    passable, unknown, barred = shares(parts, (0, 1))
    named, total = site.vehicle, summary.tiles
    subject = "The vehicle" if named == _NAMELESS else f"The vehicle {named}"
    text = f"{subject} can cross {passable} of the surveyed ground"
    if parts[2]:
        text += f" and cannot cross {barred}"
    if parts[1]:
        text += f"; {unknown} is not known"
    calm = _capital(share(site.tiles.calm, total))
    return f"{text}. {calm} of the ground can be crossed and is smooth or fair to ride on."


def _speeds(vehicle: Mapping[str, Any]) -> str:
    """Return the speed of the drives, and that of the map if it was asked for another."""
    asked, driven = vehicle.get("speed_mps"), vehicle.get("drives_mps")
    if driven is None or driven == asked:
        return number(asked, 2, " m/s")
    return f"{number(driven, 2, ' m/s')}; the ride costs of this map are for {number(asked, 2, ' m/s')}"


def meaning_of(site: Site) -> list[str]:
    """Return what the numbers of the vehicle mean, in sentences."""
    vehicle: Mapping[str, Any] = site.record.get("vehicle") or {}
    cost = site.record["cost"]
    known = site.record.get("calibration")
    floor = known.get("floor_radpm") if isinstance(known, Mapping) else None
    about = (known.get("preferences") or {}).get("description") if isinstance(known, Mapping) else None
    sentences = []
    if about:
        sentences.append(f"The vehicle: {about}.")
    if vehicle:
        sizes = {key: number(vehicle.get(key), 2, " m") for key in ("width_m", "height_m", "clearance_m")}
        sentences.append(
            f"It is {sizes['width_m']} wide and {sizes['height_m']} high, with {sizes['clearance_m']} under its belly, "
            f"and was driven in simulation at {_speeds(vehicle)}."
        )
    return [
        *sentences,
        (
            "Ride cost, C_r, is how much the nose of the vehicle goes up and down for each metre driven. C_r = "
            f"0.1 rad/m means {math.degrees(0.1):.1f} degrees of pitch for each metre, ups and downs added."
        ),
        *([_of_floor(float(floor))] if floor else []),
        (
            f"Chance of failure is the share of simulated drives of {cost['drive_m']:g} m over such ground that rolled "
            "over or got stuck. From one half on, the ground counts as not passable."
        ),
        f"Ground steeper than {cost['slope_limit_deg']:g} degrees counts as not passable.",
        (
            "Cost of a metre is what a route planner counts: 1 for the metre itself, "
            f"{cost['ride_weight_m_per_rad']:g} m for each radian of pitch, and {cost['fail_weight_m']:g} m for one "
            "certain failure. A metre that costs 3 is worth a detour of 2 m."
        ),
    ]


def _of_floor(floor: float) -> str:
    return (
        f"Even, level ground costs this vehicle {floor:g} rad/m ({math.degrees(floor):.1f} degrees per metre), by its "
        "tyres and drive train; every ride cost holds that, and so do the limits of the classes."
    )


def measured_surfaces() -> Html:
    """Return measured ride costs of named surfaces, with where they come from."""
    real = read_surfaces()
    rows = [(name, f"{c_r:.3f}", f"{math.degrees(c_r):.1f}") for name, c_r in real.c_r.items()]
    low, high = real.floor
    return join(
        table(
            f"Measured on real ground with a {real.vehicle}",
            ("surface", "C_r, rad/m", "degrees of pitch per metre; at 1 m/s, per second"),
            rows,
        ),
        tag(
            "p",
            f"A real robot ({real.vehicle}, {real.kind}, {real.speed}), not the vehicle of this map and not this "
            f"ground: it shows the size of such numbers, no more. {low:g} to {high:g} rad/m are the vehicle's own: "
            f"the lugs of its tyres and its drive train, on any ground. Source: {real.source}; {real.method}.",
            class_="note",
        ),
    )


def limits_of(site: Site) -> list[str]:
    """Return what the map does not know, in sentences."""
    spot, summary = site.tiles.spot, site.summary
    unknown = share(summary.unknown, summary.tiles)
    known = [
        "The map says how the ground was on the day of the survey.",
        "It knows shape, not firmness: mud, wet grass, snow, ice and loose sand look like firm ground.",
        (
            f"Ground that is not known ({unknown} of the tiles with points, and all ground without points) is not "
            "drivable ground. It is grey and hatched on the map, or white where there is no point."
        ),
        (
            "Ride cost and chance of failure come from simulated drives of one vehicle, at one speed, on hard ground. "
            "They hold for no other vehicle, nor for a heavier load or another speed."
        ),
        (
            f"Every value is that of a tile of {spot.tile_size:g} m. A single stone, wire or hole between the points "
            "of the survey is not seen."
        ),
    ]
    if site.record.get("ground_only"):
        known.append("Under trees and bushes there are few ground points; much of it may be unknown.")
    elif "ground_only" in site.record:
        known.append(
            "All points count as ground here: grass, bushes and whatever else stood there are part of the relief, and "
            "obstacles are not told apart from it."
        )
    if site.record.get("crs") is None:
        known.append("The survey has no CRS: the map has shapes and distances, but no place on Earth.")
    return known


def command_of(record: Mapping[str, Any]) -> str | None:
    """Return the command that makes these layers again, without the folders of the machine; None if not of `map`."""
    settings = record.get("settings")
    if not isinstance(settings, Mapping) or not settings.get("surveys"):
        return None
    surveys = " ".join(_quoted(base_name(str(path))) for path in settings["surveys"])
    words = [f"bumpymap map {surveys} --out LAYERS"]
    for name, value in _changed(settings).items():
        option = f"--{name.replace('_', '-')}"
        text = ",".join(f"{one:g}" for one in value) if isinstance(value, list) else str(value)
        text = base_name(text) if name in _FILES else text
        words.append(option if value is True else f"{option} {_quoted(text)}")
    return " ".join(words)


def settings_of(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of the settings that have no option of their own: how tiles are measured."""
    settings = record.get("settings")
    settings = settings if isinstance(settings, Mapping) else {}
    tables = {
        "features": settings.get("features"),
        "csf": settings.get("csf") if settings.get("ground") == "csf" else None,
    }
    return [
        (f"{group}.{name}", str(value))
        for group, values in tables.items()
        if isinstance(values, Mapping)
        for name, value in values.items()
    ]


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def base_name(path: str) -> str:
    """Return the last part of a path or URL: folders are private."""
    return PurePosixPath(PureWindowsPath(path.partition("?")[0]).as_posix()).name or path


def _changed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return the settings that differ from their defaults and that change the layers."""
    defaults = {one.name: one.default for one in fields(MapConfig) if one.name not in _PRIVATE}
    return {
        name: settings[name]
        for name, usual in defaults.items()
        if name in settings and settings[name] != usual and not (settings[name] is None or settings[name] is False)
    }


def _quoted(word: str) -> str:
    return shlex.quote(word)
