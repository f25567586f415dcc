"""``bumpymap evaluate``: compare a map with simulated drives over the same ground, or classes of scans with labels."""

import os
from contextlib import AbstractContextManager
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import (
    LOCATION,
    PATH,
    GroupedCommand,
    changed_settings,
    config_options,
    given_options,
    grouped_option,
    jobs_option,
    merge_settings,
    output_options,
    settings_options,
)
from bumpymap.cli._progress import show_progress
from bumpymap.cli._text import DRIVES_KEPT, interrupt_note, option_name, print_json, print_line
from bumpymap.core import OF_CRS, MapConfig, OutputError, Progress, UsageError, locked
from bumpymap.lab import EvaluateSettings, ScanEvaluateSettings

if TYPE_CHECKING:
    from bumpymap.lab import Findings, ScanFindings, Subject

_OF_ALL = ("surveys", "scans", "out", "overwrite", "quiet", "log_json", "config_file", "assigned")
_OF_SCANS = ("labels", "model", "stripes")


@click.command("evaluate", cls=GroupedCommand)
@click.argument("surveys", nargs=-1, type=LOCATION, metavar="SURVEY...")
@grouped_option("--scans", is_flag=True, help="Evaluate the classes of scans: SURVEY are frames.", group="Input")
@grouped_option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the report.", group="Output")
@settings_options(MapConfig, "ground", "crs", "z_unit", "local")
@grouped_option("--force-crs", metavar="CRS", help="CRS of all surveys, whatever they state.", group="Input")
@grouped_option(
    "--vehicle",
    multiple=True,
    metavar="NAME|FILE",
    help="An included vehicle, or a TOML file [warthog].",
    group="Vehicle",
)
@grouped_option(
    "--calibration",
    multiple=True,
    type=PATH,
    metavar="FILE",
    help="Calibration file of your own vehicle.",
    group="Vehicle",
)
@settings_options(EvaluateSettings)
@settings_options(ScanEvaluateSettings)
@jobs_option
@grouped_option("--labels", metavar="NAME|FILE", help="With --scans: label set [by the ids].", group="Input")
@grouped_option("--overwrite", is_flag=True, help="Replace the report, and drives of other settings.", group="Output")
@config_options(EvaluateSettings, ScanEvaluateSettings)
@output_options()
def command(*, surveys: tuple[Any, ...], scans: bool, out: Path, stored: dict[str, Any], **given: Any) -> None:
    """Compare the predictions for SURVEY files or folders with simulated drives over the same ground.

    With several vehicles, the report also compares their order; the first one determines the patches. To resume an
    interrupted run, give the same command again. With --scans, compare the classes of scans with labels instead.

    \b
    bumpymap evaluate site.laz --out trust
    bumpymap evaluate site.laz --out trust --vehicle warthog --calibration my_vehicle.json
    bumpymap evaluate --scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    stored = changed_settings(stored, EvaluateSettings, ScanEvaluateSettings)
    _refuse_other_options(stored, scans=scans)
    if not surveys:
        raise UsageError("evaluate takes surveys, such as site.laz, or with --scans frames, such as the folder drive")
    if scans:
        _evaluate_scans(surveys, out, ScanEvaluateSettings(**_chosen(stored, ScanEvaluateSettings)), given)
        return
    merge_settings({}, given_options(click.get_current_context().params), OF_CRS)
    settings = EvaluateSettings(**_chosen(stored, EvaluateSettings))
    subjects = _subjects(given, settings)
    from bumpymap.lab import (
        TrialOptions,
        evaluate_survey,
        open_readers,
        require_dart,
        require_matplotlib,
        write_report,
    )
    from bumpymap.readers import ReadOptions

    require_matplotlib()
    require_dart()
    options = ReadOptions(crs=given["crs"], z_unit=given["z_unit"], force_crs=given["force_crs"])
    readers = open_readers(surveys, options, local=given["local"])
    with locked(out), interrupt_note(DRIVES_KEPT), _progress(given) as progress:
        _check_place(out, overwrite=given["overwrite"])
        trial = TrialOptions(out, given["jobs"] or os.cpu_count() or 1, given["overwrite"], progress)
        findings = evaluate_survey(readers, options, given["ground"] or "auto", subjects, settings, trial)
        files = write_report(findings, out)
    if _is_text(out, files, given):
        _summary(findings, files)


def _refuse_other_options(stored: dict[str, Any], *, scans: bool) -> None:
    """Raise UsageError for settings of the other evaluation, which would have no effect."""
    given = given_options(click.get_current_context().params) | stored
    for name in given:
        if scans and name not in (*_OF_ALL, *_OF_SCANS):
            raise UsageError(
                f"{option_name(name)} applies to surveys and vehicles and has no effect with --scans: leave it out"
            )
        if not scans and name in _OF_SCANS:
            raise UsageError(f"{option_name(name)} applies to scans: add --scans, or leave it out")


def _progress(given: dict[str, Any]) -> AbstractContextManager[Progress]:
    return show_progress(quiet=given["quiet"], as_json=given["log_json"])


def _is_text(out: Path, files: list[Path], given: dict[str, Any]) -> bool:
    """Return whether to print a summary as text; with ``--json``, the list of files is printed as JSON."""
    if given["log_json"] and not given["quiet"]:
        print_json({"out": str(out), "files": [path.name for path in files]})
    return not (given["quiet"] or given["log_json"])


def _evaluate_scans(places: tuple[Any, ...], out: Path, settings: ScanEvaluateSettings, given: dict[str, Any]) -> None:
    from bumpymap.lab import (
        ScanMethods,
        evaluate_scans,
        labels_of,
        read_frames,
        write_scan_report,
    )
    from bumpymap.readers import find_frames
    from bumpymap.scan import ScanModel, load_stripes

    network = ScanModel.load(settings.model) if settings.model else ScanModel.shipped()
    methods = ScanMethods(load_stripes(settings.stripes), network)
    frames = find_frames([Path(place) for place in places])
    labels = labels_of(frames, given["labels"])
    with locked(out), _progress(given) as progress:
        _check_place(out, overwrite=given["overwrite"])
        findings = evaluate_scans(read_frames(frames, labels), len(frames), settings, methods, progress, labels)
        files = write_scan_report(findings, out)
    if _is_text(out, files, given):
        _summarise_scans(findings)
        print_line(f"wrote {files[0]}")


def _chosen(stored: dict[str, Any], owner: type) -> dict[str, Any]:
    """Return the values of the settings of one class."""
    names = {field.name for field in fields(owner)}
    return {name: value for name, value in stored.items() if name in names}


def _subjects(given: dict[str, Any], settings: EvaluateSettings) -> "list[Subject]":
    from bumpymap.lab import Subject
    from bumpymap.rating import TextureModel, find_calibration

    names = given["vehicle"] or (() if given["calibration"] else ("warthog",))
    calibrations = [find_calibration(name) for name in names]
    calibrations += [find_calibration("", file) for file in given["calibration"]]
    ids = [calibration.id for calibration in calibrations]
    if len(set(ids)) < len(ids):
        raise UsageError("the same calibration was given twice; give each vehicle once")
    textures = TextureModel.shipped()
    return [Subject.of(calibration, textures, settings.rating) for calibration in calibrations]


def _check_place(out: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a report would be replaced, before the hours of work."""
    from bumpymap.lab import REPORT

    if (out / REPORT).exists() and not overwrite:
        raise OutputError(
            f"{out} holds a report; pass --overwrite to replace it (drives that fit are kept), or choose another --out"
        )


def _summary(findings: "Findings", files: list[Path]) -> None:
    from bumpymap.lab import number, percent

    for vehicle, found in findings.comparisons.items():
        print_line(f"{vehicle}: {found.patches} patches, {found.drives} drives, {found.failed} failed")
        for name, own in found.agreement.items():
            print_line(
                f"  {name:16s} Spearman {number(own.spearman, 4):>6s}   median error {percent(own.median_error):>7s}   "
                f"same class {percent(own.steps['same']):>7s}"
            )
    print_line(f"wrote {files[0]}")


def _summarise_scans(findings: "ScanFindings") -> None:
    """Print what an evaluation of scans found."""
    from bumpymap.lab import percent

    if findings.accuracy:
        print_line(f"{findings.facts['labelled']:,} labelled sectors with ground")
    for name, found in findings.accuracy.items():
        recalls = ", ".join(percent(recall) for recall in found.recall)
        print_line(
            f"  {name:14s} right {percent(found.right):>7s}   balanced {percent(found.even):>7s}   "
            f"recall of 0, 1, 2: {recalls}"
        )
    if findings.ground:
        mean = findings.ground[-1]
        print_line(
            f"ground of {mean['points']:,} labelled points: precision {percent(mean['precision'])}, recall "
            f"{percent(mean['recall'])}, F1 {percent(mean['f1'])}"
        )
    for name, score in findings.obstacles.items():
        if score["points"]:
            free = percent(score["in_free"] / score["points"])
            print_line(f"{name:8s} {free} of the points of obstacles in free sectors")
