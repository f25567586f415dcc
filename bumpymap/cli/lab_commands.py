"""Commands of the lab: ``calibrate`` a vehicle, ``train`` a network, ``evaluate`` classes of scans against labels."""

import os
import shlex
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, replace
from importlib.util import find_spec
from itertools import chain
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.cli._options import (
    FILE,
    JOBS,
    PATH,
    GroupedOption,
    Run,
    grouped_option,
    job,
    settings_options,
)
from bumpymap.cli._output import CommandProgress, about, interrupt_note, print_line
from bumpymap.core import (
    BumpymapError,
    OutputError,
    UsageError,
    atomic,
    install_command,
    locked,
    with_pixels,
)
from bumpymap.lab import CalibrationSettings, NetworkSettings, ScanEvaluateSettings, ScanTrainSettings, TrainSettings

if TYPE_CHECKING:
    from bumpymap.lab import EpochReport, ScanFindings
    from bumpymap.rating import Calibration


def _require_free(out: Path, overwrite: bool) -> None:
    if out.exists() and not overwrite:
        raise OutputError(f"{out} exists; give --overwrite to replace it, or another --out")


@job("calibrate", CalibrationSettings, [JOBS])
@grouped_option("--vehicle", metavar="NAME|FILE", help="An included vehicle, or a TOML file.", group="Vehicle")
@grouped_option(
    "--out", required=True, type=FILE, metavar="FILE", help="Calibration file to write (JSON).", group="Output"
)
@grouped_option("--quick", group="Run", is_flag=True, help="Rough calibration in minutes: fewer drives and z ranges.")
@grouped_option("--overwrite", is_flag=True, help="Replace the file, and drives of other settings.", group="Output")
def calibrate_command(run: Run, vehicle: str | None, out: Path, jobs: int | None, quick: bool, overwrite: bool) -> None:
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
    record["relative_standard_errors"] = calibration.settings["relative_standard_errors"]
    run.show(record, _calibration_lines(calibration, out, quick))


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
    from bumpymap.lab import calibrate_vehicle, calibration_jobs, calibration_journal, require_dart, seconds_of_drives

    require_dart()
    journal = calibration_journal(out.with_name(out.name + ".progress.jsonl"), settings)
    note = "The driven patches are kept: give the same command again to continue."
    with locked(out.parent, f".{out.name}.lock"), interrupt_note(note):
        _require_free(out, overwrite)
        drives = sum(job.starts for job in calibration_jobs(settings))
        seconds = seconds_of_drives(settings) / workers
        announce(
            f"{settings.profile.name}: {drives:,} drives, {about(seconds)} with {workers} "
            f"process{'es' * (workers > 1)}. An interrupted run goes on where it was"
        )
        calibration = calibrate_vehicle(
            settings,
            progress,
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


def _command_line(settings: CalibrationSettings, vehicle: str, out: Path, quick: bool) -> str:
    """Return the command that makes the file again."""
    words = ["bumpymap", "calibrate", "--vehicle", vehicle, "--out", out.name]
    words += ["--tile-size", repr(settings.tile_size).removesuffix(".0")] + ["--quick"] * quick
    for name in ("seed", "patches", "starts", "terrains", "terrain_starts", "pixels"):
        words += ["--set", f"{name}={getattr(settings, name)}"]
    return shlex.join(words)


def _calibration_lines(calibration: "Calibration", out: Path, quick: bool) -> Iterator[str]:
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
            f"  class {class_id} {name:10s} from {low:6.3g} rad/m ({degrees(low):4.1f} deg/m), "
            f"mean {mean:6.3g} rad/m ({degrees(mean):4.1f} deg/m)"
        )
    errors = calibration.settings["relative_standard_errors"]
    yield f"  standard error of c_r, median of terrains: {100 * errors['c_r']:.1f} %"
    if "class_limits" in errors:
        yield f"  of the class limits: {', '.join(f'{100 * error:.1f}' for error in errors['class_limits'])} %"
    if quick:
        yield "  --quick makes a quarter of the drives: without it these errors are smaller, and the table is finer"
    yield f"wrote {out}"


@click.group("train")
def train_command() -> None:
    """Train the texture network of maps, or the network of scans.

    \b
    bumpymap train textures --out textures.onnx
    bumpymap train scans Rellis-3D --out scan.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


_NETWORK = (
    GroupedOption(["--out"], required=True, type=FILE, metavar="FILE", help="ONNX file to write.", group="Output"),
    GroupedOption(["--overwrite"], is_flag=True, help="Replace the network of an earlier training.", group="Output"),
)


@job("textures", TrainSettings, settings_options(NetworkSettings), _NETWORK)
def textures_command(run: Run, out: Path, overwrite: bool) -> None:
    """Train the texture network on synthetic terrain.

    No survey is needed. To resume an interrupted training after its last complete epoch, give the same command again.

    \b
    bumpymap train textures --out textures.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    with _training(run, out, overwrite) as progress:
        from bumpymap.lab import make_model

        scores = make_model(TrainSettings(**run.changed()), out, _Epochs(progress))
    lines = [
        f"accuracy on unseen seeds:                      {100 * scores.unseen.right:.2f} %",
        f"accuracy on surveys anew (as in the paper):    {100 * scores.augmented_copies.right:.2f} %",
    ]
    _show_trained(run, out, scores.parameters, lines, "map SURVEY")


@job("scans", ScanTrainSettings, _NETWORK)
@click.argument("folder", type=PATH, metavar="FOLDER")
def train_scans_command(run: Run, folder: Path, out: Path, overwrite: bool) -> None:
    """Train the scan network on labelled frames.

    FOLDER has the layout of RELLIS-3D. To resume an interrupted training after its last complete epoch, give the same
    command again.

    \b
    bumpymap train scans Rellis-3D --out scan.onnx
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    with _training(run, out, overwrite) as progress:
        from bumpymap.lab import make_scan_model

        settings = ScanTrainSettings(**run.changed())
        scores = make_scan_model(settings, out, folder, _Epochs(progress), progress)
    even = 100 * scores.every.even
    lines = [
        f"accuracy on {scores.scans} unseen scans, classes weighted evenly: {even:.2f} %",
        f"accuracy on all {scores.every.count:,} of their sectors:        {100 * scores.every.right:.2f} %",
    ]
    _show_trained(run, out, scores.parameters, lines, "scan FRAME")


train_command.add_command(textures_command)
train_command.add_command(train_scans_command)


@contextmanager
def _training(run: Run, out: Path, overwrite: bool) -> Iterator[CommandProgress]:
    """Yield the progress of a training, unless its libraries are missing or ``out`` is taken."""
    if missing := [name for name in ("torch", "onnx") if find_spec(name) is None]:
        raise UsageError(f"training needs {' and '.join(missing)}. Install with: {install_command('learn')}")
    if out.suffix != ".onnx":
        raise UsageError(f"--out is {out}; its name must end in .onnx")
    _require_free(out, overwrite)
    note = "Give the same command again to continue after the last complete epoch."
    with interrupt_note(note), run.progress() as progress:
        yield progress


def _show_trained(run: Run, out: Path, parameters: int, lines: list[str], use: str) -> None:
    """Print the accuracy of a network, and the command that uses it."""
    lines += [
        f"{out} ({parameters:,} trained numbers)",
        f"use it with: bumpymap {use} --out DIR --set model={out}",
    ]
    run.show({"out": str(out), "parameters": parameters}, lines)


class _Epochs:
    """Reports each epoch of a training."""

    def __init__(self, progress: CommandProgress) -> None:
        self._progress, self._begun = progress, False

    def __call__(self, report: "EpochReport") -> None:
        """Count an epoch and report its result."""
        if not self._begun:
            self._progress.start("learning epochs", report.epochs)
            self._progress.advance(report.epoch - 1)
            self._begun = True
        self._progress.advance(1)
        text = (
            f"epoch {report.epoch}/{report.epochs}: loss {report.loss:.4f}, "
            f"accuracy while learning {100 * report.accuracy:.2f} %, {report.seconds:.1f} s"
        )
        self._progress.note(text, "epoch", **asdict(report))


@click.group("evaluate")
def evaluate_command() -> None:
    """Compare the classes of scans with labels.

    \b
    bumpymap evaluate scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


_REPORT = (
    GroupedOption(["--out"], type=PATH, required=True, metavar="DIR", help="Folder for the report.", group="Output"),
    GroupedOption(["--overwrite"], is_flag=True, help="Replace an earlier report.", group="Output"),
)


@job("scans", ScanEvaluateSettings, _REPORT)
@click.argument("frames", nargs=-1, required=True, type=PATH, metavar="FRAME...")
@grouped_option("--labels", metavar="NAME|FILE", help="Label set [by the ids].", group="Input")
def evaluate_scans_command(run: Run, frames: tuple[Path, ...], labels: str | None, out: Path, overwrite: bool) -> None:
    """Compare the classes of FRAME files or folders with labels.

    \b
    bumpymap evaluate scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.lab import REPORT, evaluate_scans, labels_of, write_scan_report
    from bumpymap.readers import find_frames, read_scan
    from bumpymap.scan import ScanModel, load_stripes

    settings = ScanEvaluateSettings(**run.changed())
    network = None
    if settings.method != "filter":
        network = ScanModel.load(settings.model) if settings.model else ScanModel.shipped()
    found = find_frames(list(frames))
    label_set = labels_of(found, labels)
    with locked(out), run.progress() as progress:
        if (out / REPORT).exists() and not overwrite:  # before the hours of work
            raise OutputError(f"{out} holds a report; pass --overwrite to replace it, or choose another --out")
        scans = map(read_scan, found)
        findings = evaluate_scans(scans, len(found), settings, load_stripes(), network, progress, label_set)
        files = write_scan_report(findings, out)
    record = {"out": str(out), "files": [path.name for path in files]}
    run.show(record, chain(_scan_lines(findings), [f"wrote {files[0]}"]))


evaluate_command.add_command(evaluate_scans_command)


def _scan_lines(findings: "ScanFindings") -> Iterator[str]:
    from bumpymap.lab import percent

    yield f"{findings.facts['labelled']:,} labelled sectors with ground"
    for name, found in findings.accuracy.items():
        recalls = ", ".join(percent(recall) for recall in found.recall)
        yield (
            f"  {name:14s} right {percent(found.right):>7s}   balanced {percent(found.even):>7s}   "
            f"recall of 0, 1, 2: {recalls}"
        )
    mean = findings.ground[-1]
    yield (
        f"ground of {mean['points']:,} labelled points: precision {percent(mean['precision'])}, recall "
        f"{percent(mean['recall'])}, F1 {percent(mean['f1'])}"
    )
    for name, score in findings.obstacles.items():
        if score["points"]:
            free = percent(score["in_free"] / score["points"])
            yield f"{name:8s} {free} of the points of obstacles in free sectors"
