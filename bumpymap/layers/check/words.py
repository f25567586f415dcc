"""What a check found, in words and tables: check.md, the page of the map, the terminal."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    CheckedDrive,
    CheckResult,
    DrivenStretches,
    MapAgreement,
    atomic,
    count_text,
)
from bumpymap.layers.check.offset import MapOffset
from bumpymap.layers.report.markup import DASH, number

__all__ = [
    "AGREEMENT_HEAD",
    "FEW",
    "WORST_HEAD",
    "agreement_rows",
    "check_headline",
    "check_page",
    "check_verdict",
    "columns_words",
    "drive_notes",
    "drive_rows",
    "left_out_rows",
    "level_words",
    "measured_mean",
    "metres",
    "names_of",
    "percent",
    "sorted_reasons",
    "warnings_of",
    "worst_rows",
    "write_check_page",
]

FEW = 5
"""Fewer stretches on the map say nothing about it."""
LEVEL = 1.15
"""Up to this factor of its median ratio from 1 a map holds."""
INSIDE = 0.8
"""Share of readings that the map's interval should hold; a level that is off with fewer is off beyond all errors."""
RANKS, ROUGHLY = 0.8, 0.5
"""From these Spearman correlations on a map ranks ground rightly, and roughly."""
EVEN = 1.5
"""Ground is too even to rank if its 90 % quantile is less than this factor above its 10 % quantile."""


def check_headline(result: CheckResult) -> str:
    """Return the result in two or three sentences: whether the map holds, over how much ground, how well."""
    agreement = result.agreement
    if agreement is None:
        mean = measured_mean(result.stretches)
        way = float(np.sum(result.stretches.way_m))
        count = count_text(len(result.drives), "drive")
        if not np.isfinite(mean):
            return f"Nothing was measured on {count}."
        return f"{count} measured over {metres(way)}: a ride cost of {mean:.3f} rad/m on average. No map was checked."
    over = f"{metres(agreement.way_m)} in {count_text(agreement.stretches, 'stretch', 'stretches')}"
    if agreement.stretches < FEW:
        return f"Too little was driven on the map to judge it: {over}. Drive at least {FEW} stretches of it."
    parts = [f"{check_verdict(result)}. Over {over} it {level_words(agreement)} in the median"]
    parts[0] += f", and half of the stretches are off by less than {percent(agreement.median_error)}."
    parts.append(f"{percent(agreement.inside)} of the drives' readings lie in its 80 % interval.")
    return " ".join(parts)


def check_verdict(result: CheckResult) -> str:
    """Return whether the map holds, in one sentence without its full stop; for at least ``FEW`` stretches."""
    agreement = result.agreement
    if agreement is None or not np.isfinite(agreement.median_ratio):
        return "The map cannot be judged"
    level = 1 / LEVEL <= agreement.median_ratio <= LEVEL
    allowed = "" if round(agreement.inside, 2) < INSIDE else " by no more than its interval allows"
    rank = agreement.spearman
    if _is_even(result.stretches) or not np.isfinite(rank):
        even = "the ground driven is too even to say whether the map ranks ground rightly"
        return f"The level of the map holds; {even}" if level else f"The map's level is off{allowed}; {even}"
    if round(rank, 2) >= RANKS:  # as it is shown
        return "The map holds" if level else f"The map ranks the ground rightly, but its level is off{allowed}"
    if round(rank, 2) >= ROUGHLY:
        return f"The map ranks the ground only roughly{'' if level else f', and its level is off{allowed}'}"
    return "The map does not rank this ground as the vehicle felt it"


def columns_words(drive: CheckedDrive) -> list[str]:
    """Return which columns a drive was read from, and the quantity where its name differs, for each file."""
    found: dict[str, list[str]] = {}
    for quantity, column in drive.columns.items():
        place, separator, name = column.rpartition(": ")
        said = name if name.startswith(quantity) else f"{name} as {quantity}"
        found.setdefault(place if separator else "the log", []).append(said)
    return [f"read from {place}: {', '.join(columns)}" for place, columns in found.items()]


def level_words(agreement: MapAgreement) -> str:
    """Return "reads 8 % low" for a median ratio of 0.92."""
    ratio = agreement.median_ratio
    if not np.isfinite(ratio):
        return "cannot be compared"
    if abs(ratio - 1.0) < 0.005:
        return "reads neither high nor low"
    if ratio > 2.0:
        return f"reads {ratio:.1f} times too high"
    return f"reads {percent(abs(ratio - 1.0))} {'high' if ratio > 1.0 else 'low'}"


def measured_mean(stretches: DrivenStretches) -> float:
    """Return the measured C_r over all stretches, weighted by their length, rad/m; NaN without any."""
    known = np.isfinite(stretches.measured) & (stretches.way_m > 0.0)
    if not known.any():
        return float("nan")
    return float(np.average(stretches.measured[known], weights=stretches.way_m[known]))


def metres(length: float) -> str:
    """Return a length in m, or in km from 5 km on."""
    return f"{length:,.0f} m" if length < 5000.0 else f"{length / 1000:,.1f} km"


def percent(part: float) -> str:
    """Return a share in per cent without decimals; a dash if it is not known."""
    return f"{100 * part:.0f} %" if np.isfinite(part) else "\N{EN DASH}"


def sorted_reasons(result: CheckResult) -> list[tuple[str, float]]:
    """Return why parts of the ways do not count, and their length over all drives, m; the longest first."""
    total: dict[str, float] = {}
    for drive in result.drives:
        for reason, length in drive.left_out_m.items():
            total[reason] = total.get(reason, 0.0) + length
    return sorted(((reason, length) for reason, length in total.items() if length > 0.0), key=lambda item: -item[1])


def _is_even(stretches: DrivenStretches) -> bool:
    known = stretches.measured[np.isfinite(stretches.c_r) & (stretches.measured > 0.0)]
    low, high = np.quantile(known, [0.1, 0.9]) if len(known) else (1.0, 1.0)
    return bool(high < EVEN * low)


def names_of(items: Sequence[str], most: int = 3) -> str:
    """Return names, the first few of them."""
    shown = ", ".join(items[:most])
    return shown if len(items) <= most else f"{shown} and {len(items) - most} more"


Rows = list[tuple[str, ...]]
AGREEMENT_HEAD = (
    *("ground by the map", "stretches", "way", "map / drive, median", "error, median", "Spearman"),
    *("in the 80 % interval", "same class"),
)
WORST_HEAD = (
    "drive",
    "from, clock of the IMU",
    "easting, northing, m",
    "drive, rad/m",
    "map, rad/m",
    "map's 80 % interval",
    "map / drive",
)
_WORST = 10
_NO_CLASS_NAME = "off the map"


def agreement_rows(result: CheckResult) -> Rows:
    """Return map against drives over all stretches, then by class of the map."""
    if result.agreement is None:
        return []
    by_class = [(f"{code} {CLASS_NAMES[code]}", found) for code, found in sorted(result.by_class.items())]
    return [_agreement(name, found) for name, found in [("all", result.agreement), *by_class] if found.stretches]


def _agreement(name: str, found: MapAgreement) -> tuple[str, ...]:
    return (
        name,
        f"{found.stretches:,}",
        metres(found.way_m),
        number(found.median_ratio, 2),
        percent(found.median_error),
        number(found.spearman, 2),
        percent(found.inside),
        percent(found.same_class),
    )


def worst_rows(result: CheckResult) -> Rows:
    """Return the stretches that are farthest off, of those whose difference errors do not explain; at most 10."""
    stretches, offset = result.stretches, MapOffset.of(result.stretches)
    order = np.argsort(-np.nan_to_num(offset.beyond, posinf=np.inf), kind="stable")
    names = [drive.name for drive in result.drives]
    return [
        (
            names[stretches.drive[at]],
            f"{stretches.start_s[at]:.1f} s",
            f"{stretches.easting[at]:.1f}, {stretches.northing[at]:.1f}",
            f"{stretches.measured[at]:.3f} ± {stretches.measured_sd[at]:.3f}",
            f"{stretches.c_r[at]:.3f} ({_class(int(stretches.class_id[at]))})",
            f"{number(float(stretches.c_r_low[at]), 3)} to {number(float(stretches.c_r_high[at]), 3)}",
            f"{offset.ratio[at]:.2f}",
        )
        for at in order[:_WORST].tolist()
        if offset.is_off[at]
    ]


def drive_rows(drives: Sequence[CheckedDrive]) -> Rows:
    """Return what was found about each drive and its sensors: a row for each figure, a column for each drive."""
    figures: list[tuple[str, list[str]]] = [
        ("way", [f"{metres(drive.way_m)} in {drive.seconds:,.0f} s" for drive in drives]),
        ("of it counts", [metres(drive.used_m) for drive in drives]),
        ("median speed there", [number(drive.speed_mps, 2, " m/s") for drive in drives]),
        ("rate of the IMU", [number(drive.rate_hz, 0, " Hz") for drive in drives]),
        ("pitch rates kept up to", [number(drive.band_hz, 1, " Hz") for drive in drives]),
        ("positions, standard deviation", [number(drive.position_error_m, 2, " m") for drive in drives]),
        ("clock of the positions", [_clock(drive) for drive in drives]),
        ("IMU in the vehicle: roll, pitch, yaw", [_mount(drive.mount_deg) for drive in drives]),
        ("floor at standstill", [number(drive.floor_radps, 4, " rad/s") for drive in drives]),
    ]
    return [(label, *texts) for label, texts in figures]


def left_out_rows(result: CheckResult) -> Rows:
    """Return why parts of the ways do not count, with their lengths over all drives."""
    return [(reason, metres(length)) for reason, length in sorted_reasons(result)]


def _class(code: int) -> str:
    return _NO_CLASS_NAME if code == NO_CLASS else CLASS_NAMES[code]


def _clock(drive: CheckedDrive) -> str:
    if not math.isfinite(drive.clock_offset_s):
        return "cannot be told"
    text = f"{drive.clock_offset_s:+.3f} s"
    if math.isfinite(drive.clock_offset_sd_s):
        text += f" ± {drive.clock_offset_sd_s:.3f} s"
    return f"{text}, {drive.clock_drift_ppm:+.0f} ppm" if math.isfinite(drive.clock_drift_ppm) else text


def _mount(angles: Iterable[float]) -> str:
    return ", ".join(f"{angle:+.1f}°" if math.isfinite(angle) else DASH for angle in angles)


def drive_notes(result: CheckResult) -> list[str]:
    """Return from which columns each drive was read and what was guessed, a sentence each."""
    return [note for drive in result.drives for note in _named(result, drive, [*columns_words(drive), *drive.notes])]


def warnings_of(result: CheckResult) -> list[str]:
    """Return which drives are left out, and the warnings of the whole check and of each drive, each once."""
    skipped = [f"{drive} is left out: {why}" for drive, why in result.skipped.items()]
    own = [text for drive in result.drives for text in _named(result, drive, drive.warnings)]
    return list(dict.fromkeys([*skipped, *result.warnings, *own]))


def _named(result: CheckResult, drive: CheckedDrive, texts: Iterable[str]) -> list[str]:
    """Put the name of a drive before texts that do not say it, where there are several drives."""
    several, name = len(result.drives) > 1, drive.name
    return [f"{name}: {text}" if several and not text.startswith(name) else text for text in texts]


_READ = """\
Ride cost C_r is pitch motion per metre driven, rad/m. Each drive is cut into stretches; on each, the C_r that the IMU
measured, less what it reads at standstill, stands beside that of the map over the same ground."""
_READ_FIGURES = """\
- **map / drive** is the ratio of both: under 1, the ground is rougher for this vehicle than the map says. Its median
  over many stretches says whether the level of the map fits this vehicle. A level that is off alike on all classes is
  one number to correct; one that differs by class says that smooth and rough ground are off in different ways.
- **error** is the median of the absolute difference of that ratio from 1.
- **Spearman** is the correlation of ranks: at 1 the map puts all stretches in the order in which the vehicle felt
  them. Planning routes needs this more than the level. Where all ground is alike it says little.
- **in the 80 % interval** is the share of stretches whose measurement lies in the map's interval, widened by the error
  of the measurement. 80 % is right; far less means that the map is surer than it may be.
- A stretch is listed as off only if neither the map's interval nor the errors of measurement and position explain the
  difference. If all is as it should be, that happens on one stretch in five."""
_FILES = {
    "check.png": "the map with the stretches on it, map against drive, and both along the way",
    "check.geojson": "the stretches, for QGIS and other GIS; QGIS takes its style from check.qml",
    "check_tiles.geojson": "the tiles that were driven over, likewise",
    "stretches.csv": "the stretches as a table",
    "check.json": "all of it, with settings, versions and checksums",
}


def write_check_page(result: CheckResult, names: Iterable[str], path: Path) -> None:
    """Write the page.

    Parameters
    ----------
    result : CheckResult
    names : iterable of str
        The files beside it.
    path : Path
        The file, which appears only when it is complete.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    text = check_page(result, names)
    with atomic(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace"))


def check_page(result: CheckResult, names: Iterable[str]) -> str:
    """Return the page as Markdown; ``names`` are the files beside it."""
    ground = result.ground
    drives = names_of([drive.name for drive in result.drives])
    title = f"Drives measured: {drives}" if ground is None else f"{ground.name} checked against {drives}"
    parts = [f"# {_plain(title)}", _plain(check_headline(result))]
    if ground is not None:
        limits = ", ".join(f"{limit:.3g}" for limit in ground.class_limits)
        parts.append(
            f"Map: vehicle {_plain(ground.vehicle)}, calibration {_plain(ground.calibration_id)}, driven at "
            f"{ground.speed_mps:g} m/s, limits of the classes {limits} rad/m."
        )
    parts += _section("Warnings", _list(map(_plain, warnings_of(result))))
    parts += _section("Map against drives", _table(AGREEMENT_HEAD, agreement_rows(result)))
    parts += _section("Where the map is off", *_off(result))
    parts += _section(
        "The drives",
        _table(("", *_drive_names(result)), drive_rows(result.drives)),
        _list(map(_plain, drive_notes(result))),
    )
    parts += _section("What does not count", _table(("why", "way"), left_out_rows(result)))
    parts += _section("How to read this", _READ, _READ_FIGURES if result.agreement is not None else "")
    parts += _section("Files", _list(f"`{name}`: {text}" for name, text in _FILES.items() if name in set(names)))
    return "\n\n".join(parts) + "\n"


def _off(result: CheckResult) -> list[str]:
    if result.agreement is None or result.agreement.stretches < FEW:
        return []
    rows = worst_rows(result)
    if not rows:
        return ["On no stretch more than the map's interval and the errors of measurement explain."]
    return ["Farthest beyond what the map's interval and the errors of measurement explain:", _table(WORST_HEAD, rows)]


def _drive_names(result: CheckResult) -> list[str]:
    return [drive.name for drive in result.drives]


def _section(title: str, *parts: str) -> list[str]:
    found = [part for part in parts if part]
    return [f"## {title}", *found] if found else []


def _list(items: Iterable[str]) -> str:
    return "\n".join(f"- {item}" for item in items)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(map(_cell, line))} |" for line in lines)


def _cell(text: str) -> str:
    return text if text == "---" else _plain(text).replace("|", "\\|")


def _plain(text: str) -> str:
    """Return text without line breaks, with what Markdown would take for marks or HTML made harmless."""
    one_line = " ".join(text.split())
    return "".join(f"\\{letter}" if letter in "\\`*<[" else letter for letter in one_line)
