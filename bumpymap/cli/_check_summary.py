"""The summary that ``check`` prints."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from bumpymap.check import CheckConfig, CheckRun
from bumpymap.cli._text import print_json, print_line, print_table
from bumpymap.core import CLASS_NAMES, CheckedDrive, CheckResult, MapAgreement
from bumpymap.layers import check_headline, columns_words, warnings_of

__all__ = ["show"]


def show(run: CheckRun, config: CheckConfig, refit: Mapping[str, Any] | None = None, *, as_json: bool) -> None:
    """Print what was found, or one JSON object, with what became of the calibration."""
    if as_json:
        print_json(_record(run, config) | ({} if refit is None else {"refit": refit}))
        return
    result = run.result
    for drive in result.drives:
        for line in _drive_lines(drive):
            print_line(line)
    print_line(check_headline(result))
    if result.by_class:
        print_table(_classes(result), ("class of the map", "way", "map / measured", "typical error", "in the interval"))
    for warning in warnings_of(result):
        print_line(f"Warning: {warning}", "yellow")
    if config.out is not None:
        print_line(f"Files in {config.out}: {', '.join(path.name for path in run.files)}")


def _drive_lines(drive: CheckedDrive) -> Iterator[str]:
    yield (
        f"{drive.name}: {drive.used_m:.0f} of {drive.way_m:.0f} m count, at {drive.speed_mps:.2f} m/s; rates up to "
        f"{drive.band_hz:g} Hz of an IMU with {drive.rate_hz:.0f} Hz"
    )
    if drive.left_out_m:
        lost = ", ".join(f"{reason} {metres:.0f} m" for reason, metres in drive.left_out_m.items() if metres >= 0.5)
        if lost:
            yield f"  left out: {lost}"
    for columns in columns_words(drive):
        yield f"  {columns}"
    yield f"  {'; '.join(_sensor_words(drive))}"
    for note in drive.notes:
        yield f"  {note}"


def _sensor_words(drive: CheckedDrive) -> Iterator[str]:
    angles = zip(("roll", "pitch", "yaw"), drive.mount_deg, strict=True)
    told = [f"{name} {angle:.1f}" for name, angle in angles if math.isfinite(angle)]
    yield f"the IMU is mounted at {', '.join(told)} degrees" if told else "how the IMU is mounted is not known"
    if math.isfinite(drive.floor_radps):
        yield f"at standstill it reads {drive.floor_radps:.4f} rad/s, which is taken off"
    if math.isfinite(drive.clock_offset_s):
        yield f"positions are {drive.clock_offset_s:+.3f} s (+-{drive.clock_offset_sd_s:.3f}) off its clock"


def _classes(result: CheckResult) -> Iterator[tuple[str, ...]]:
    for number, found in sorted(result.by_class.items()):
        name = f"{number} {CLASS_NAMES[number]}" if number < len(CLASS_NAMES) else "unknown"
        yield (
            name,
            f"{found.way_m:.0f} m",
            _number(found.median_ratio),
            _percent(found.median_error),
            _percent(found.inside),
        )


def _number(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "-"


def _percent(value: float) -> str:
    return f"{value:.0%}" if math.isfinite(value) else "-"


def _record(run: CheckRun, config: CheckConfig) -> dict[str, Any]:
    result = run.result
    return {
        "out": None if config.out is None else str(config.out),
        "files": [path.name for path in run.files],
        "headline": check_headline(result),
        "drives": [_drive_record(drive) for drive in result.drives],
        "agreement": None if result.agreement is None else _agreement_record(result.agreement),
        "by_class": {str(number): _agreement_record(found) for number, found in result.by_class.items()},
        "warnings": list(result.warnings),
        "skipped": dict(result.skipped),
    }


def _drive_record(drive: CheckedDrive) -> dict[str, Any]:
    return {
        "name": drive.name,
        "way_m": _plain(drive.way_m),
        "used_m": _plain(drive.used_m),
        "left_out_m": {reason: _plain(metres) for reason, metres in drive.left_out_m.items()},
        "speed_mps": _plain(drive.speed_mps),
        "clock_offset_s": _plain(drive.clock_offset_s),
        "mount_deg": [_plain(angle) for angle in drive.mount_deg],
        "floor_radps": _plain(drive.floor_radps),
        "notes": list(drive.notes),
        "warnings": list(drive.warnings),
    }


def _agreement_record(found: MapAgreement) -> dict[str, Any]:
    names = ("way_m", "spearman", "median_ratio", "median_error", "inside", "same_class")
    return {"stretches": found.stretches, **{name: _plain(getattr(found, name)) for name in names}}


def _plain(value: float) -> float | None:
    """Return a rounded number; None for what JSON cannot hold."""
    return round(float(value), 5) if math.isfinite(value) else None
