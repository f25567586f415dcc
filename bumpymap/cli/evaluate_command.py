"""``bumpymap evaluate``: compare a map with simulated drives over the same ground, or classes of scans with labels."""

import os
from collections.abc import Iterator
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import JOBS, LOCATION, PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._text import DRIVES_KEPT, interrupt_note, option_name
from bumpymap.core import OF_CRS, MapConfig, OutputError, UsageError, locked, refuse_clashes
from bumpymap.lab import EvaluateSettings, ScanEvaluateSettings

if TYPE_CHECKING:
    from bumpymap.lab import Findings, ScanFindings, Subject

_OF_SCANS = ("labels", "model")
_OF_READING = ("ground", "crs", "z_unit", "local")
_OF_SURVEYS = {field.name for field in fields(EvaluateSettings)}
_OF_SURVEYS |= {*_OF_READING, "force_crs", "vehicle", "calibration", "jobs"}


@job(
    "evaluate",
    settings_options(MapConfig, *_OF_READING),
    EvaluateSettings,
    ScanEvaluateSettings,
    [JOBS],
    owners=(EvaluateSettings, ScanEvaluateSettings),
)
@click.argument("surveys", nargs=-1, type=LOCATION, metavar="SURVEY...")
@grouped_option("--scans", is_flag=True, help="Evaluate the classes of scans: SURVEY are frames.", group="Input")
@grouped_option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the report.", group="Output")
@grouped_option("--force-crs", metavar="CRS", help="CRS of all surveys, whatever they state.", group="Input")
@grouped_option(
    "--vehicle", default="warthog", metavar="NAME|FILE", help="An included vehicle, or a TOML file.", group="Vehicle"
)
@grouped_option(
    "--calibration", type=PATH, metavar="FILE", help="Calibration file of your own vehicle.", group="Vehicle"
)
@grouped_option("--labels", metavar="NAME|FILE", help="With --scans: label set [by the ids].", group="Input")
@grouped_option("--overwrite", is_flag=True, help="Replace the report, and drives of other settings.", group="Output")
def command(run: Run, surveys: tuple[Any, ...], scans: bool, out: Path, **given: Any) -> None:
    """Compare the predictions for SURVEY files or folders with simulated drives over the same ground.

    To resume an interrupted run, give the same command again. With --scans, compare the classes of scans with labels
    instead.

    \b
    bumpymap evaluate site.laz --out trust
    bumpymap evaluate site.laz --out trust --calibration my_vehicle.json
    bumpymap evaluate --scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    _refuse_other_options(run.named(), scans=scans)
    if not surveys:
        raise UsageError("evaluate takes surveys, such as site.laz, or with --scans frames, such as the folder drive")
    if scans:
        _evaluate_scans(run, surveys, out, given)
        return
    forced = {} if given["force_crs"] is None else {"force_crs": given["force_crs"]}
    refuse_clashes(run.given | forced, OF_CRS, option_name)
    settings = EvaluateSettings(**_chosen(run, EvaluateSettings))
    subject = _subject(given)
    from bumpymap.lab import (
        TrialOptions,
        evaluate_survey,
        open_readers,
        require_dart,
        write_report,
    )
    from bumpymap.readers import ReadOptions

    require_dart()
    reading = run.given
    options = ReadOptions(reading.get("crs"), reading.get("z_unit"), force_crs=given["force_crs"])
    readers = open_readers(surveys, options, local=reading.get("local", False))
    with locked(out), interrupt_note(DRIVES_KEPT), run.progress() as progress:
        _check_place(out, overwrite=given["overwrite"])
        trial = TrialOptions(out, given["jobs"] or os.cpu_count() or 1, given["overwrite"], progress)
        findings = evaluate_survey(readers, options, reading.get("ground") or "auto", subject, settings, trial)
        files = write_report(findings, out)
    run.show(_record(out, files), _lines(findings, files))


def _refuse_other_options(given: list[str], *, scans: bool) -> None:
    """Raise UsageError for settings of the other evaluation, which would have no effect."""
    for name in given:
        if scans and name in _OF_SURVEYS:
            raise UsageError(
                f"{option_name(name)} applies to surveys and vehicles and has no effect with --scans: leave it out"
            )
        if not scans and name in _OF_SCANS:
            raise UsageError(f"{option_name(name)} applies to scans: add --scans, or leave it out")


def _record(out: Path, files: list[Path]) -> dict[str, Any]:
    return {"out": str(out), "files": [path.name for path in files]}


def _evaluate_scans(run: Run, places: tuple[Any, ...], out: Path, given: dict[str, Any]) -> None:
    from bumpymap.lab import ScanMethods, evaluate_scans, labels_of, write_scan_report
    from bumpymap.readers import find_frames, read_scan
    from bumpymap.scan import ScanModel, load_stripes

    settings = ScanEvaluateSettings(**_chosen(run, ScanEvaluateSettings))
    network = ScanModel.load(settings.model) if settings.model else ScanModel.shipped()
    methods = ScanMethods(load_stripes(), network)
    frames = find_frames([Path(place) for place in places])
    labels = labels_of(frames, given["labels"])
    with locked(out), run.progress() as progress:
        _check_place(out, overwrite=given["overwrite"])
        findings = evaluate_scans(map(read_scan, frames), len(frames), settings, methods, progress, labels)
        files = write_scan_report(findings, out)
    run.show(_record(out, files), chain(_scan_lines(findings), [f"wrote {files[0]}"]))


def _chosen(run: Run, owner: type) -> dict[str, Any]:
    """Return the settings of one class that differ from their defaults."""
    names = {field.name for field in fields(owner)}
    return {name: value for name, value in run.changed().items() if name in names}


def _subject(given: dict[str, Any]) -> "Subject":
    """Return the vehicle with the ratings that are held against its drives."""
    from bumpymap.lab import Subject
    from bumpymap.rating import TextureModel, find_calibration

    calibration = find_calibration(given["vehicle"], given["calibration"])
    return Subject.of(calibration, TextureModel.shipped())


def _check_place(out: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a report would be replaced, before the hours of work."""
    from bumpymap.lab import REPORT

    if (out / REPORT).exists() and not overwrite:
        raise OutputError(
            f"{out} holds a report; pass --overwrite to replace it (drives that fit are kept), or choose another --out"
        )


def _lines(findings: "Findings", files: list[Path]) -> Iterator[str]:
    from bumpymap.lab import number, percent

    found = findings.comparison
    yield f"{findings.vehicle['vehicle']}: {found.patches} patches, {found.drives} drives, {found.failed} failed"
    for name, own in found.agreement.items():
        yield (
            f"  {name:16s} Spearman {number(own.spearman, 4):>6s}   median error {percent(own.median_error):>7s}   "
            f"same class {percent(own.steps['same']):>7s}"
        )
    yield f"wrote {files[0]}"


def _scan_lines(findings: "ScanFindings") -> Iterator[str]:
    from bumpymap.lab import percent

    if findings.accuracy:
        yield f"{findings.facts['labelled']:,} labelled sectors with ground"
    for name, found in findings.accuracy.items():
        recalls = ", ".join(percent(recall) for recall in found.recall)
        yield (
            f"  {name:14s} right {percent(found.right):>7s}   balanced {percent(found.even):>7s}   "
            f"recall of 0, 1, 2: {recalls}"
        )
    if findings.ground:
        mean = findings.ground[-1]
        yield (
            f"ground of {mean['points']:,} labelled points: precision {percent(mean['precision'])}, recall "
            f"{percent(mean['recall'])}, F1 {percent(mean['f1'])}"
        )
    for name, score in findings.obstacles.items():
        if score["points"]:
            free = percent(score["in_free"] / score["points"])
            yield f"{name:8s} {free} of the points of obstacles in free sectors"
