"""``bumpymap calibrate``: drive a vehicle over simulated terrain and write its ride cost by kind of ground."""

import os
import shlex
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

from bumpymap.cli._options import FILE, JOBS, Run, grouped_option, job
from bumpymap.cli._progress import CommandProgress
from bumpymap.cli._text import DRIVES_KEPT, about, interrupt_note, print_line
from bumpymap.core import BumpymapError, OutputError, Steps, UsageError, atomic, locked, with_pixels
from bumpymap.lab import CalibrationSettings

if TYPE_CHECKING:
    from bumpymap.rating import Calibration


@job(
    "calibrate",
    CalibrationSettings,
    [JOBS],
)
@grouped_option("--vehicle", metavar="NAME|FILE", help="An included vehicle, or a TOML file.", group="Vehicle")
@grouped_option(
    "--out", required=True, type=FILE, metavar="FILE", help="Calibration file to write (JSON).", group="Output"
)
@grouped_option("--quick", group="Run", is_flag=True, help="Rough calibration in minutes: fewer drives and z ranges.")
@grouped_option("--overwrite", is_flag=True, help="Replace the file, and drives of other settings.", group="Output")
def command(run: Run, vehicle: str | None, out: Path, jobs: int | None, quick: bool, overwrite: bool) -> None:
    """Calibrate the ride cost of a vehicle by driving a model of it over simulated terrain.

    To resume an interrupted run, give the same command again.
    """
    from bumpymap.rating import Vehicle, shipped_profiles

    if vehicle is None:  # hours of drives are for a vehicle that was named
        raise UsageError(
            "calibrate needs the vehicle to drive: --vehicle NAME_OR_FILE. Included vehicles are "
            f"{', '.join(shipped_profiles())}; they have calibrations already. For your own, write a profile: bumpymap "
            "vehicle new my_robot.toml, fill it in, and give --vehicle my_robot.toml"
        )
    workers = jobs or os.cpu_count() or 1
    settings = CalibrationSettings(Vehicle.load(vehicle))
    settings = replace(settings.quick() if quick else settings, **with_pixels(run.settings))
    again = _command_line(settings, vehicle, out, quick)
    with run.progress() as progress:
        announce = print_line if not (run.quiet or run.as_json) else (lambda _text: None)
        like = _of_other_tiles(vehicle, settings)
        calibration = _calibrate(settings, out, workers, overwrite, again, progress, announce, like)
    record = {"out": str(out), "id": calibration.id, "class_limits": calibration.class_limits}
    run.show(record, _lines(calibration, out))


def _of_other_tiles(vehicle: str, settings: CalibrationSettings) -> "Calibration | None":
    """Return the calibration of the vehicle for tiles of another size, if it is found: classes mean the same there."""
    from bumpymap.rating import find_calibration

    try:
        found = find_calibration(vehicle)
    except BumpymapError:
        return None
    return None if found.tile_size == settings.tile_size else found


def _calibrate(
    settings: CalibrationSettings,
    out: Path,
    workers: int,
    overwrite: bool,
    again: str,
    progress: CommandProgress,
    announce: Callable[[str], None],
    like: "Calibration | None",
) -> "Calibration":
    from bumpymap.lab import (
        calibrate_vehicle,
        calibration_jobs,
        calibration_journal,
        require_dart,
        seconds_of_drives,
    )

    require_dart()
    journal = calibration_journal(out.with_name(out.name + ".progress.jsonl"), settings)
    with locked(out.parent, f".{out.name}.lock"), interrupt_note(DRIVES_KEPT):
        _check_place(out, overwrite)
        drives = sum(job.starts for job in calibration_jobs(settings))
        seconds = seconds_of_drives(settings) / workers
        announce(
            f"{settings.profile.name}: {drives:,} drives, {about(seconds)} with {workers} "
            f"process{'es' * (workers > 1)}. An interrupted run goes on where it was"
        )
        progress.start("driving", drives)
        calibration = calibrate_vehicle(
            settings,
            Steps(progress),
            workers=workers,
            journal=journal,
            discard_other=overwrite,
            command=again,
            like=like,
        )
        with atomic(out) as beside:
            beside.write_text(calibration.to_json(), encoding="utf-8")
        journal.remove()
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
