"""The tables of a check, as texts: for its page and for the page of the map."""

import math
from collections.abc import Iterable, Sequence

import numpy as np

from bumpymap.core import CLASS_NAMES, NO_CLASS, CheckedDrive, CheckResult, MapAgreement
from bumpymap.layers.check.offset import MapOffset
from bumpymap.layers.check.words import columns_words, metres, percent, sorted_reasons
from bumpymap.layers.report.numbers import DASH, number

__all__ = [
    "AGREEMENT_HEAD",
    "WORST_HEAD",
    "agreement_rows",
    "drive_notes",
    "drive_rows",
    "left_out_rows",
    "warnings_of",
    "worst_rows",
]

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
