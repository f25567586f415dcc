"""Numbers as pages show them, and what a page says that takes more than a template: commands, names, degrees."""

import math
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import fields
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from bumpymap.core import CLASS_NAMES, MapConfig, parse_json, share_text, shares_text

__all__ = [
    "DASH",
    "area",
    "base_name",
    "command_of",
    "degrees",
    "degrees_line",
    "number",
    "read_surfaces",
    "settings_of",
    "share",
    "shares",
    "signed",
    "survey_name",
    "whole",
]

DASH = "\N{EN DASH}"
"""Stands where nothing is known."""
_PERCENT = "\N{NO-BREAK SPACE}%"
_SQUARE_KILOMETRE, _HECTARE = 1e6, 1e4


def number(value: Any, decimals: int, unit: str = "") -> str:
    """Return a number with its unit; a dash if it is not known."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return DASH
    return f"{value:,.{decimals}f}{unit}"


def whole(value: int) -> str:
    """Return a whole number with its thousands apart."""
    return f"{value:,}"


def share(part: float, total: float, percent: str = _PERCENT) -> str:
    """Return a share in per cent; small shares are not rounded to nothing, nor large ones to all."""
    return share_text(part / total, percent=percent) if total else DASH


def shares(counts: Sequence[float], alone: Collection[int] = ()) -> list[str]:
    """Return the shares of all parts of a whole, which make 100 % together; see `shares_text`."""
    return shares_text(counts, alone, percent=_PERCENT) if sum(counts) else [DASH] * len(counts)


def area(square_metres: float) -> str:
    """Return an area in m2, ha or km2."""
    if square_metres >= _SQUARE_KILOMETRE:
        return f"{square_metres / _SQUARE_KILOMETRE:,.2f} km²"
    if square_metres >= _HECTARE:
        return f"{square_metres / _HECTARE:,.2f} ha"
    return f"{square_metres:,.0f} m²"


def signed(value: Any, decimals: int) -> str:
    """Return a difference with its sign."""
    text = number(value, decimals)
    if text == DASH or not text.strip("-0."):
        return text.removeprefix("-")
    return f"+{text}" if value > 0 else text


def degrees(radians: float) -> str:
    """Return an angle in radians as degrees."""
    return f"{math.degrees(radians):.1f}"


_FILE = Path(__file__).with_name("data") / "surfaces.json"
_NAMED = ("asphalt", "snow", "silty loam")
"""Surfaces in a line of a summary, which everyone has walked on."""


def read_surfaces() -> dict[str, Any]:
    """Read the C_r that one real vehicle measured on named surfaces, from the file that comes with the package.

    Returns
    -------
    dict
        ``vehicle``, ``kind``, ``speed``, ``source`` and ``method`` in words; ``floor``, rad/m: what the vehicle itself
        gives on even ground, from and to; ``c_r``: surface -> rad/m, rising.
    """
    known: dict[str, Any] = parse_json(_FILE.read_text(encoding="utf-8"))
    rising = sorted(known.pop("surfaces"), key=lambda one: float(one["c_r"]))
    return known | {"c_r": {str(one["name"]): float(one["c_r"]) for one in rising}}


def degrees_line(median_c_r: Sequence[float]) -> str:
    """Say in degrees of pitch per metre what classes cost, beside named surfaces.

    Parameters
    ----------
    median_c_r : sequence
        Of each class, rad/m; NaN without tiles.
    """
    known = zip(CLASS_NAMES, median_c_r, strict=False)
    classes = ", ".join(f"{name} {degrees(c_r)}" for name, c_r in known if math.isfinite(c_r))
    if not classes:
        return ""
    real = read_surfaces()
    named = ", ".join(f"{degrees(real['c_r'][name])} on {name}" for name in _NAMED)
    return f"Median c_r in degrees of pitch per metre: {classes}; a real {real['vehicle']} measured {named}"


_PRIVATE = {
    *("surveys", "out", "threads", "memory", "scratch", "scheduler", "overwrite"),
    *("features", "csf"),
}
"""Settings that do not change the layers, or that are tables of their own."""
_FILES = ("vehicle", "calibration", "model")
"""Settings that may be paths. The name of a CRS may hold a slash too."""


def command_of(record: Mapping[str, Any]) -> str | None:
    """Return the command that makes these layers again, without the folders of the machine; None if not of `map`."""
    settings = record.get("settings") or {}
    if not settings.get("surveys"):
        return None
    surveys = " ".join(shlex.quote(base_name(path)) for path in settings["surveys"])
    words = [f"bumpymap map {surveys} --out LAYERS"]
    for name, usual in {one.name: one.default for one in fields(MapConfig) if one.name not in _PRIVATE}.items():
        value = settings.get(name, usual)
        if value == usual or value is None or value is False:
            continue
        option = f"--{name.replace('_', '-')}"
        text = ",".join(f"{one:g}" for one in value) if isinstance(value, list) else str(value)
        text = base_name(text) if name in _FILES else text
        words.append(option if value is True else f"{option} {shlex.quote(text)}")
    return " ".join(words)


def settings_of(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return names and values of the settings that have no option of their own: how tiles are measured."""
    settings = record.get("settings") or {}
    names = ("features", "csf") if settings.get("ground") == "csf" else ("features",)
    return [(f"{group}.{name}", str(value)) for group in names for name, value in (settings.get(group) or {}).items()]


def base_name(path: str) -> str:
    """Return the last part of a path or URL: folders are private."""
    return PurePosixPath(PureWindowsPath(path.partition("?")[0]).as_posix()).name or path


def survey_name(record: Mapping[str, Any]) -> str:
    """Return the name of a survey: as recorded, else from its files, without their folders; of a sheet with its own."""
    sheet = (record.get("sheet") or {}).get("name")
    name = (record.get("survey") or {}).get("name")
    if not name:
        given = (record.get("settings") or {}).get("surveys") or [item["path"] for item in record.get("inputs") or ()]
        stems = [PurePosixPath(PureWindowsPath(path).as_posix()).stem for path in map(str, given) if path]
        name = (f"{stems[0]} and {len(stems) - 1} more" if len(stems) > 1 else stems[0]) if stems else "Survey"
    return f"{name}, sheet {sheet}" if sheet else str(name)
