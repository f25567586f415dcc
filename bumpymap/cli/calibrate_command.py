"""``bumpymap calibrate``: drive a vehicle over simulated terrain and write its ride cost by kind of ground."""

import os
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.cli._options import FILE, JOBS, Run, grouped_option, job
from bumpymap.cli._progress import CommandProgress
from bumpymap.cli._text import DRIVES_KEPT, about, interrupt_note, option_name, print_error, print_line
from bumpymap.core import OutputError, Steps, UsageError, atomic, locked
from bumpymap.lab import CalibrationSettings

if TYPE_CHECKING:
    from bumpymap.rating import Calibration, Vehicle


_NO_OUT = "calibrate needs a file to write: --out FILE.json (or --check)"


@job("calibrate", CalibrationSettings, [JOBS])
@grouped_option("--vehicle", metavar="NAME|FILE", help="An included vehicle, or a TOML file.", group="Vehicle")
@grouped_option("--out", type=FILE, metavar="FILE", help="Calibration file to write (JSON).", group="Output")
@click.option("--quick", is_flag=True, help="Rough calibration in minutes: fewer drives and z ranges.")
@grouped_option("--overwrite", is_flag=True, help="Replace the file, and drives of other settings.", group="Output")
@click.option("--check", is_flag=True, help="Only check the simulation against formulas; write no file.")
def command(
    run: Run, vehicle: str | None, out: Path | None, jobs: int | None, quick: bool, overwrite: bool, check: bool
) -> None:
    """Calibrate the ride cost of a vehicle by driving a model of it over simulated terrain.

    To resume an interrupted run, give the same command again.
    """
    from bumpymap.rating import load_profile

    vehicle = vehicle or _default_vehicle(out, check=check)
    profile = load_profile(vehicle)
    workers = jobs or os.cpu_count() or 1
    settings = CalibrationSettings(profile)
    settings = replace(settings.quick() if quick else settings, **run.settings)
    if check:
        for name in sorted({*run.named()} - {"check", "vehicle", "seed"}):
            raise UsageError(
                f"--check makes no calibration and writes nothing: leave out {option_name(name)} or --check"
            )
        _check(profile, settings.seed)
        return
    if out is None:
        raise UsageError(_NO_OUT)
    again = _command_line(settings, vehicle, out, quick)
    with run.progress() as progress:
        announce = print_line if not (run.quiet or run.as_json) else (lambda _text: None)
        calibration = _calibrate(settings, out, workers, overwrite, again, progress, announce)
    record = {"out": str(out), "id": calibration.id, "class_limits": calibration.class_limits}
    run.show(record, _lines(calibration, out))


def _default_vehicle(out: Path | None, *, check: bool) -> str:
    """Return the vehicle of a check; hours of drives are for a vehicle that was named."""
    from bumpymap.rating import shipped_profiles

    if check:
        return "warthog"
    if out is None:
        raise UsageError(_NO_OUT)
    raise UsageError(
        "calibrate needs the vehicle to drive: --vehicle NAME_OR_FILE. Included vehicles are "
        f"{', '.join(shipped_profiles())}; they have calibrations already. For your own, write a profile: bumpymap "
        "vehicle new my_robot.toml, fill it in, and give --vehicle my_robot.toml"
    )


def _calibrate(
    settings: CalibrationSettings,
    out: Path,
    workers: int,
    overwrite: bool,
    again: str,
    progress: CommandProgress,
    announce: Callable[[str], None],
) -> "Calibration":
    from bumpymap.lab import (
        Journal,
        MotionEffort,
        add_motion,
        add_steps,
        calibrate_vehicle,
        crossing_jobs,
        fit_ride,
        fit_thin_surveys,
        motion_journal,
        require_dart,
        seconds_of_a_drive,
    )

    require_dart()
    journal = Journal(out.with_name(out.name + ".progress.jsonl"), settings.to_dict())
    with locked(out.parent, f".{out.name}.lock"), interrupt_note(DRIVES_KEPT):
        _check_place(out, overwrite)
        effort, crossings = MotionEffort.of(settings), crossing_jobs(settings.profile)
        drives = settings.total_drives + len(crossings) + effort.total
        seconds = drives * seconds_of_a_drive(settings) / workers
        announce(
            f"{settings.profile.name}: {drives:,} drives, {about(seconds)} with {workers} "
            f"process{'es' * (workers > 1)}. An interrupted run goes on where it was"
        )
        progress.start("driving", settings.total_drives)
        calibration = calibrate_vehicle(
            settings,
            Steps(progress),
            workers=workers,
            journal=journal,
            discard_other=overwrite,
            command=again,
            fit=fit_ride,
            fit_thin=fit_thin_surveys,
        )
        progress.start("driving over steps", len(crossings))
        calibration = add_steps(calibration, Steps(progress), workers=workers, journal=journal)
        speeds = motion_journal(out.with_name(out.name + ".speeds.jsonl"), settings, effort)
        progress.start("driving at other speeds", effort.total)
        calibration = add_motion(
            calibration,
            Steps(progress),
            effort=effort,
            workers=workers,
            journal=speeds,
            discard_other=overwrite,
        )
        with atomic(out) as beside:
            beside.write_text(calibration.to_json(), encoding="utf-8")
        journal.remove()
        speeds.remove()
    return calibration


def _check_place(out: Path, overwrite: bool) -> None:
    """Raise OutputError if the file cannot be written, before the hours of work."""
    if out.exists() and not overwrite:
        raise OutputError(f"{out} exists; give --overwrite to replace it, or another --out")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=out.parent, prefix=f".{out.name}."):
            pass
    except OSError as error:
        raise OutputError(f"cannot write {out}: {error}; choose an --out in a folder that you may write") from error


def _command_line(settings: CalibrationSettings, vehicle: str, out: Path, quick: bool) -> str:
    """Return the command that makes the file again."""
    words = ["bumpymap", "calibrate", "--vehicle", vehicle, "--out", out.name]
    words += ["--tile-size", repr(settings.tile_size).removesuffix(".0")] + ["--quick"] * quick
    for name in ("seed", "patches", "starts", "terrains", "terrain_starts", "pixels"):
        words += ["--set", f"{name}={getattr(settings, name)}"]
    return shlex.join(words)


def _lines(calibration: "Calibration", out: Path) -> Iterator[str]:
    from bumpymap.core import CLASS_NAMES
    from bumpymap.lab import library_terrains

    pairs = zip(sum(calibration.p_fail, ()), sum(calibration.drives, ()), strict=True)
    drives, failed = sum(map(sum, calibration.drives)), sum(share * count for share, count in pairs)
    yield f"calibration {calibration.id} of {calibration.vehicle['name']}"
    yield f"  {drives} drives over textures, {failed:.0f} failed"
    library = library_terrains(calibration)
    drives, failed = sum(t.drives for t in library), sum(t.failed for t in library)
    yield f"  {drives} drives over {len(library)} terrains of the library, {failed} failed"
    limits = (0.0, *calibration.class_limits)
    for class_id, (name, low, mean) in enumerate(zip(CLASS_NAMES, limits, calibration.class_c_r, strict=True)):
        yield (
            f"  class {class_id} {name:10s} from {low:.3f} rad/m ({degrees(low):4.1f} deg/m), "
            f"mean {mean:.3f} rad/m ({degrees(mean):4.1f} deg/m)"
        )
    yield f"wrote {out}"


def _check(profile: "Vehicle", seed: int) -> None:
    """Print a table of the checks; exit with code 1 if one fails."""
    from bumpymap.lab import all_checks

    failed = 0
    print_line(f"{'check':52s} {'measured':>12s} {'allowed':>12s}")
    for result in all_checks(profile, seed):
        print_line(
            f"{result.name:52s} {result.measured:12.3g} {result.allowed:>12s}  {'ok' if result.ok else 'FAILED'}"
        )
        failed += not result.ok
    if failed:
        print_error(
            f"{failed} checks failed: its calibrations are not reliable; look for a wrong number in the profile"
        )
        sys.exit(1)
