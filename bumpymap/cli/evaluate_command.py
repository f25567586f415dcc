"""``bumpymap evaluate``: compare a map with simulated drives over the same ground, or classes of scans with labels."""

import os
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from bumpymap.cli._options import (
    crs_option,
    force_crs_option,
    given_options,
    jobs_option,
    merge_settings,
    option_name,
    output_options,
)
from bumpymap.cli._progress import show_progress
from bumpymap.cli._terminal import DRIVES_KEPT, LOCATION, PATH, interrupt_note, set_up_logging
from bumpymap.cli._text import print_json, print_line
from bumpymap.core import OF_CRS, Ground, OutputError, Progress, Rating, UsageError, ZUnit, locked

if TYPE_CHECKING:
    from bumpymap.lab import EvaluateSettings, Findings, ScanFindings, Subject

_OF_ALL = ("surveys", "scans", "out", "seed", "overwrite", "quiet", "log_json")
_OF_SCANS = ("scenes", "labels", "model", "stripes")


@click.command("evaluate")
@click.argument("surveys", nargs=-1, type=LOCATION, metavar="SURVEY...")
@click.option("--scans", is_flag=True, help="Evaluate the classes of single scans: given frames, or simulated scenes.")
@click.option("--out", type=PATH, required=True, metavar="DIR", help="Folder for the report.")
@crs_option
@force_crs_option
@click.option("--local", is_flag=True, help="Treat coordinates without a CRS as metres.")
@click.option("--z-unit", type=click.Choice(get_args(ZUnit)), help="Unit of heights if the CRS does not define it.")
@click.option("--ground", type=click.Choice(get_args(Ground)), default="auto", show_default=True, help="Points to use.")
@click.option(
    "--vehicle",
    multiple=True,
    metavar="NAME_OR_FILE",
    help="Name of an included vehicle, or a TOML file [default: warthog].",
)
@click.option("--calibration", multiple=True, type=PATH, metavar="FILE", help="Calibration file of your own vehicle.")
@click.option(
    "--rating",
    type=click.Choice(get_args(Rating)),
    default="ride",
    show_default=True,
    help="table: evaluate without the ride model.",
)
@click.option("--total-patches", type=int, metavar="N", help="Patches to drive over [default: 300].")
@click.option("--min-starts", type=int, metavar="N", help="Minimum number of drives per patch [default: 16].")
@click.option("--max-starts", type=int, metavar="N", help="Maximum number of drives per patch [default: 48].")
@click.option("--seed", type=int, default=7, show_default=True, metavar="N", help="Random seed.")
@jobs_option
@click.option(
    "--labels",
    metavar="NAME_OR_FILE",
    help="With --scans: label set: kitti, semantic-kitti, rellis, or a file of ids and classes [default: by the ids].",
)
@click.option(
    "--scenes", type=int, default=44, show_default=True, metavar="N", help="With --scans: number of simulated scenes."
)
@click.option("--model", type=PATH, metavar="FILE", help="With --scans: your own scan network.")
@click.option("--stripes", type=PATH, metavar="FILE", help="With --scans: your own stripe classes.")
@click.option("--overwrite", is_flag=True, help="Replace the report, and discard drives made with other settings.")
@output_options()
def command(*, surveys: tuple[Any, ...], scans: bool, out: Path, **given: Any) -> None:
    """Compare the predictions for SURVEY files or folders with simulated drives over the same ground.

    With several vehicles, the report also compares their order; the first one determines the patches. To resume an
    interrupted run, give the same command again. With --scans, compare the classes of scans with labels instead.

    \b
    bumpymap evaluate site.laz --out trust
    bumpymap evaluate site.laz --out trust --vehicle warthog --calibration my_vehicle.json
    bumpymap evaluate --scans --out trust
    bumpymap evaluate --scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    set_up_logging(as_json=given["log_json"])
    shown = _Output(given["quiet"], given["log_json"])
    _refuse_other_options(places=bool(surveys), scans=scans)
    if scans:
        _evaluate_scans(surveys, out, given, shown)
        return
    if not surveys:
        raise UsageError("evaluate takes surveys, such as site.laz, or --scans")
    merge_settings({}, given_options(click.get_current_context().params), OF_CRS)
    settings = _settings(given)
    subjects = _subjects(given)
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
    with locked(out), interrupt_note(DRIVES_KEPT), shown.progress() as progress:
        _check_place(out, overwrite=given["overwrite"])
        trial = TrialOptions(out, given["jobs"] or os.cpu_count() or 1, given["overwrite"], progress)
        findings = evaluate_survey(readers, options, given["ground"], subjects, settings, trial)
        files = write_report(findings, out)
    if shown.summary(out, files):
        _summary(findings, files)


def _refuse_other_options(*, places: bool, scans: bool) -> None:
    """Raise UsageError for options of the other evaluation, which would have no effect."""
    given = given_options(click.get_current_context().params)
    for name in given:
        if scans and name not in (*_OF_ALL, *_OF_SCANS):
            raise UsageError(
                f"{option_name(name)} applies to surveys and vehicles and has no effect with --scans: leave it out"
            )
        if not scans and name in _OF_SCANS:
            raise UsageError(f"{option_name(name)} applies to scans: add --scans, or leave it out")
    if scans and places and "scenes" in given:
        raise UsageError("--scenes applies to simulated scenes: leave out --scenes or the frames")
    if scans and not places and "labels" in given:
        raise UsageError("--labels applies to frames: give frames, or leave it out")


@dataclass(frozen=True, slots=True)
class _Output:
    """Text that an evaluation prints in addition to its report."""

    quiet: bool
    log_json: bool

    def progress(self) -> AbstractContextManager[Progress]:
        """Return the context manager that shows the progress."""
        return show_progress(quiet=self.quiet, as_json=self.log_json)

    def summary(self, out: Path, files: list[Path]) -> bool:
        """Print the list of files as JSON with ``log_json``; return whether to print a summary as text."""
        if self.log_json and not self.quiet:
            print_json({"out": str(out), "files": [path.name for path in files]})
        return not (self.quiet or self.log_json)


def _evaluate_scans(places: tuple[Any, ...], out: Path, given: dict[str, Any], shown: _Output) -> None:
    from bumpymap.lab import (
        ScanEvaluateSettings,
        ScanMethods,
        evaluate_scans,
        labels_of,
        load_open3d,
        read_frames,
        simulated_scans,
        write_scan_report,
    )
    from bumpymap.readers import find_frames
    from bumpymap.scan import ScanModel, load_stripes

    settings = ScanEvaluateSettings(scenes=given["scenes"], seed=given["seed"])
    network = ScanModel.load(given["model"]) if given["model"] else ScanModel.shipped()
    methods = ScanMethods(load_stripes(given["stripes"]), network)
    if not places:
        load_open3d("evaluate --scans without frames")
    frames = find_frames([Path(place) for place in places]) if places else []
    labels = labels_of(frames, given["labels"])
    with locked(out), shown.progress() as progress:
        _check_place(out, overwrite=given["overwrite"])
        scans = read_frames(frames, labels) if frames else simulated_scans(settings)
        findings = evaluate_scans(scans, len(frames) or settings.scenes, settings, methods, progress, labels)
        files = write_scan_report(findings, out)
    if shown.summary(out, files):
        _summarise_scans(findings)
        print_line(f"wrote {files[0]}")


def _settings(given: dict[str, Any]) -> "EvaluateSettings":
    from bumpymap.lab import EvaluateSettings

    names = ("total_patches", "min_starts", "max_starts", "seed", "rating")
    own = {name: value for name, value in given_options(given).items() if name in names}
    return EvaluateSettings(**own)


def _subjects(given: dict[str, Any]) -> "list[Subject]":
    from bumpymap.lab import Subject
    from bumpymap.rating import TextureModel, find_calibration

    names = given["vehicle"] or (() if given["calibration"] else ("warthog",))
    calibrations = [find_calibration(name) for name in names]
    calibrations += [find_calibration("", file) for file in given["calibration"]]
    ids = [calibration.id for calibration in calibrations]
    if len(set(ids)) < len(ids):
        raise UsageError("the same calibration was given twice; give each vehicle once")
    textures = TextureModel.shipped()
    return [Subject.of(calibration, textures, given["rating"]) for calibration in calibrations]


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
                f"same class {percent(own.steps.same):>7s}"
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
            f"ground of {mean.points:,} labelled points: precision {percent(mean.precision)}, recall "
            f"{percent(mean.recall)}, F1 {percent(mean.f1)}"
        )
    for name, score in findings.obstacles.items():
        if score.points:
            print_line(f"{name:8s} {percent(score.in_free / score.points)} of the points of obstacles in free sectors")
