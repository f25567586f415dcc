"""``bumpymap check``: a map against real drives over it."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import FILE, PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._output import Styled, Table, cell
from bumpymap.core import (
    BadInputError,
    BumpymapError,
    CheckConfig,
    OutputError,
    UsageError,
    atomic,
    locked,
    read_record,
)

if TYPE_CHECKING:
    from bumpymap.core import CheckedDrive, CheckResult, DrivenStretches
    from bumpymap.rating import Calibration, DriveUpdate


def _lines(result: "CheckResult", files: Sequence[Path], config: CheckConfig) -> Iterator[str | Styled | Table]:
    from bumpymap.views import check_headline, warnings_of

    for drive in result.drives:
        yield from _drive_lines(drive)
    yield from check_headline(result)
    if result.by_class:
        titles = ("ground by the map", "way", "map / measured", "typical error", "Spearman", "in the interval")
        yield Table(_classes(result), titles)
    for warning in warnings_of(result):
        yield Styled(f"Warning: {warning}", "yellow")
    if config.out is not None:
        yield f"Files in {config.out}: {', '.join(path.name for path in files)}"


def _drive_lines(drive: "CheckedDrive") -> Iterator[str]:
    from bumpymap.views import columns_words

    yield (
        f"{drive.name}: {drive.used_m:.0f} of {drive.way_m:.0f} m count, at {drive.speed_mps:.2f} m/s; rates up to "
        f"{drive.band_hz:g} Hz of an IMU with {drive.rate_hz:.0f} Hz"
    )
    if lost := ", ".join(f"{reason} {metres:.0f} m" for reason, metres in drive.left_out_m.items() if metres >= 0.5):
        yield f"  left out: {lost}"
    for columns in columns_words(drive):
        yield f"  {columns}"
    yield f"  {'; '.join(_sensor_words(drive))}"
    for note in drive.notes:
        yield f"  {note}"


def _sensor_words(drive: "CheckedDrive") -> Iterator[str]:
    angles = zip(("roll", "pitch", "yaw"), drive.mount_deg, strict=True)
    known = [f"{name} {angle:.1f}" for name, angle in angles if math.isfinite(angle)]
    yield f"the IMU is mounted at {', '.join(known)} degrees" if known else "how the IMU is mounted is not known"
    if math.isfinite(drive.floor_radps):
        yield f"at standstill it reads {drive.floor_radps:.4f} rad/s, which is taken off"
    if math.isfinite(drive.clock_offset_s):
        yield f"positions are {drive.clock_offset_s:+.3f} s (+-{drive.clock_offset_sd_s:.3f}) off its clock"


def _classes(result: "CheckResult") -> Iterator[tuple[str, ...]]:
    from bumpymap.views import agreements_of

    for name, found in agreements_of(result):
        values = (found.median_ratio, found.median_error, found.spearman, found.inside)
        cells = (cell(value, form, "-") for value, form in zip(values, (".2f", ".0%") * 2, strict=True))
        yield name, f"{found.way_m:.0f} m", *cells


def _record(result: "CheckResult", files: Sequence[Path], config: CheckConfig) -> dict[str, Any]:
    """Return the findings as check.json holds them, but for the single stretches."""
    from bumpymap.layers import check_entries
    from bumpymap.views import check_headline

    found = check_entries(result)
    for part in (found, found["line"] or {}):
        part.pop("stretches", None)
    out = None if config.out is None else str(config.out)
    return {"out": out, "files": [path.name for path in files], "headline": " ".join(check_headline(result)), **found}


_LEAST_WIDENING = 1.05
"""Wider intervals by a smaller factor are not reported."""


def write_refit(
    calibration: "Calibration", out: Path, stretches: "DrivenStretches", speed_mps: float, *, overwrite: bool
) -> "DriveUpdate":
    """Move a calibration to drives over a map at a speed, and write it.

    Raises BadInputError: the drives are too short, or agree with it; OutputError: the file cannot be written.
    """
    from bumpymap.rating import update_from_drives

    moved, update = update_from_drives(calibration, stretches, speed_mps)
    with locked(out.parent, f".{out.name}.lock"):
        _refuse_replacing(out, overwrite)
        with atomic(out) as beside:
            beside.write_text(moved.to_json(), encoding="utf-8")
    return update


def prepare_refit(layers: Path | None, calibration: Path | None, out: Path, *, overwrite: bool) -> "Calibration":
    """Find the calibration of a map before the drives are measured: ``calibration``, or the one of its run.json.

    Raises UsageError: there is no map, or its calibration is not found; BadInputError: it cannot be read, or is
    another; OutputError: the file ``out`` exists and is not to be replaced.
    """
    from bumpymap.layers import open_map
    from bumpymap.rating import map_calibration

    if layers is None:
        raise UsageError("`refit` moves the calibration of a map to drives over it: give the folder of the map")
    _refuse_replacing(out, overwrite)
    site = open_map(layers)
    found = map_calibration(site.manifest, site.grid.tile_size, calibration, follow_paths=True)
    own, speed = float(found.vehicle["speed_mps"]), found.map_speed
    if own != speed:  # what moves is the C_r of the calibration's own drives
        raise BadInputError(
            f"the map is made for {speed:g} m/s, and the calibration {found.id} rests on drives at {own:g} m/s, which "
            f"is what a refit moves. Drive at {own:g} m/s over a map at that speed, or calibrate a profile whose speed "
            f"is {speed:g} m/s"
        )
    return found


def _refuse_replacing(out: Path, overwrite: bool) -> None:
    above = next(folder for folder in out.absolute().parents if folder.exists())
    if not above.is_dir():
        raise OutputError(f"cannot write {out}: {above} is a file; choose a file in a folder that you may write")
    if out.is_dir():
        raise OutputError(f"{out} is a folder; `refit` takes the file to write, such as `refit='my_robot.json'`")
    if (out.exists() or out.is_symlink()) and not overwrite:
        raise OutputError(f"{out} exists; give `overwrite=True` to replace it, or another file with `refit`")
    # Nothing is replaced but a calibration, of any version.
    there = out.is_file() and not out.is_symlink()
    if there and (read_record(out) or {}).get("format") != "bumpymap-calibration":
        raise OutputError(f"{out} is no calibration, and was not touched; choose another file with `refit`")


def refit_lines(update: "DriveUpdate", out: Path) -> Iterator[str]:
    """Say how a calibration was moved, and how to use the one that was written to ``out``."""
    low, middle, high = (factor - 1.0 for factor in update.factor)
    more = "more" if middle >= 0 else "less"
    ends = sorted((abs(low), abs(high))) if low * high > 0 else (low, high)
    several = f" of {update.drives} drives" if update.drives > 1 else ""
    yield (
        f"{update.way_m:.0f} m of driving on {update.stretches} stretches{several}, {update.new_m:.0f} m of it on "
        f"different ground: this vehicle pitches {_refit_percent(abs(middle))} {more} than the calibration says (80 % "
        f"interval: {_refit_percent(ends[0])} to {_refit_percent(ends[1])})"
    )
    yield (
        f"C_r / measured, median: {update.ratio[0]:.2f} before, {update.ratio[1]:.2f} with the new calibration; on "
        f"parts of the drives left out in turn, the median error goes from "
        f"{_refit_percent(update.held_out_error[0])} to {_refit_percent(update.held_out_error[1])}"
    )
    if update.posterior.map_scale > _LEAST_WIDENING:
        yield (
            f"Over the same ground the drives are off the map {update.posterior.map_scale:.1f} times as far as its "
            "intervals say; those of the new calibration are wider by that"
        )
    yield f"Calibration: {out}. Map with it: bumpymap map SURVEY --out DIR --calibration {out}"


def _refit_percent(share: float) -> str:
    return f"{100 * share:.0f} %"


@job("check", settings_options(CheckConfig, required=("drives",)), owners=(CheckConfig,))
@click.argument("layers", type=PATH, metavar="[LAYERS]", required=False)
@grouped_option("--columns", metavar="LIST", help="Of the log: rate_y=GyrY[deg/s],time=t[ms] [by name].", group="Input")
@grouped_option(
    "--refit", type=FILE, metavar="FILE", help="Move the calibration to the drives (JSON).", group="Vehicle"
)
def command(run: Run, refit: Path | None) -> None:
    """Compare a map with real drives: LAYERS is a folder of `bumpymap map`; without it drives are measured alone.

    Drives that cannot be used are left out and named (exit code 4).

    \b
    bumpymap check site_layers --drive drive.mcap --out checked
    bumpymap check site_layers --drive imu.csv,gnss.csv --drive second.ulg
    bumpymap check --drive drive.csv
    bumpymap check site_layers --drive drive.mcap --refit my_robot.json
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.check import run_check
    from bumpymap.readers import parse_columns

    settings = run.settings
    if settings.get("columns") is not None:
        settings["columns"] = parse_columns(settings["columns"])
    moved, overwrite = None, "overwrite" in run.given
    if refit is not None:  # before drives are measured
        moved = prepare_refit(settings.get("layers"), settings.get("calibration"), refit, overwrite=overwrite)
    config = CheckConfig(**settings)
    with run.progress() as progress:
        result, files = run_check(config, progress)
    record, lines, refused = _record(result, files, config), _lines(result, files, config), None
    if moved is not None and refit is not None and result.ground is not None:
        try:
            update = write_refit(moved, refit, result.stretches, result.ground.speed_mps, overwrite=overwrite)
        except BumpymapError as error:  # reasons against it follow the findings of the check
            refused = error
        else:
            record["refit"] = {"out": str(refit), **update.to_record()}
            lines = chain(lines, refit_lines(update, refit))
    run.show(record, lines)
    if refused is not None:
        raise refused
    if result.skipped:
        run.end_partly_done()
