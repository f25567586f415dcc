"""``bumpymap evaluate``: compare the predictions of a map with simulated drives over the same ground."""

import os
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import click

from bumpymap.cli._evaluate_routes import evaluate_routes_over, summarise_routes
from bumpymap.cli._evaluate_scans import summarise_scans
from bumpymap.cli._events import set_up_logging
from bumpymap.cli._map_options import crs_option, force_crs_option
from bumpymap.cli._options import given_options, merge_settings, option_name, output_options, workers_option
from bumpymap.cli._progress import show_progress
from bumpymap.cli._terminal import DRIVES_KEPT, LOCATION, PATH, interrupt_note
from bumpymap.cli._text import print_json, print_line
from bumpymap.core import OF_CRS, Ground, OutputError, Progress, Rating, UsageError, ZUnit, locked

if TYPE_CHECKING:
    from bumpymap.lab import EvaluateSettings, Findings, Subject

_OF_ALL = ("surveys", "library", "scans", "routes", "out", "seed", "overwrite", "quiet", "log_json")
_OF_SCANS = ("scenes", "labels", "model", "stripes")
_OF_ROUTES = ("pairs", "repeats")
_OF_VEHICLES = ("vehicle", "calibration", "workers")
_OF_SURVEYS = ("crs", "force_crs", "local", "z_unit", "ground", "densities")
_OF_PARTS = {"drives": ("min_starts", "max_starts", "workers"), "density": ("densities",)}
"""Options that have no effect if a part is skipped."""


@click.command("evaluate")
@click.argument("surveys", nargs=-1, type=LOCATION, metavar="SURVEY...")
@click.option("--library", is_flag=True, help="Evaluate on synthetic library terrain instead of a survey.")
@click.option("--scans", is_flag=True, help="Evaluate the classes of single scans: given frames, or simulated scenes.")
@click.option("--routes", is_flag=True, help="Evaluate ways over the layers of a map: folders that map wrote.")
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
@workers_option("one per core")
@click.option(
    "--densities",
    default="100,50,20,10,5",
    show_default=True,
    metavar="LIST",
    help="Points per m2 for the test with thinned surveys.",
)
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
@click.option("--pairs", type=int, metavar="N", help="With --routes: starts and goals [default: 20].")
@click.option("--repeats", type=int, metavar="N", help="With --routes: drives along each way [default: 4].")
@click.option("--skip", default="", metavar="LIST", help="Parts to omit: drives, density, invariance, noise, timing.")
@click.option("--overwrite", is_flag=True, help="Replace the report, and discard drives made with other settings.")
@output_options()
def command(*, surveys: tuple[Any, ...], library: bool, scans: bool, routes: bool, out: Path, **given: Any) -> None:
    """Compare the predictions for SURVEY files or folders with simulated drives over the same ground.

    With several vehicles, the report also compares their order; the first one determines the patches. To resume an
    interrupted run, give the same command again.

    \b
    bumpymap evaluate site.laz --out trust
    bumpymap evaluate site.laz --out trust --vehicle warthog --calibration my_vehicle.json
    bumpymap evaluate --library --out trust
    bumpymap evaluate --scans --out trust
    bumpymap evaluate --scans drive --labels kitti --out trust
    bumpymap evaluate --routes site_layers --out trust_routes
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    set_up_logging(as_json=given["log_json"])
    shown = _Output(given["quiet"], given["log_json"])
    if scans + library + routes > 1:
        raise UsageError("--scans, --library and --routes are separate evaluations; give one of them")
    _refuse_other_options(places=bool(surveys), scans=scans, routes=routes)
    if routes:
        _evaluate_routes(surveys, out, given, shown)
        return
    if scans:
        _evaluate_scans(surveys, out, given, shown, overwrite=given["overwrite"])
        return
    if library == bool(surveys):
        raise UsageError("evaluate takes either surveys, such as site.laz, or --library, or --scans, or --routes")
    settings = _settings(given)
    _refuse_unused_options(settings, library=library)
    subjects = _subjects(given)
    _require(settings)
    from bumpymap.lab import TrialOptions, evaluate_library, evaluate_survey, open_readers, write_report
    from bumpymap.readers import ReadOptions

    options = ReadOptions(crs=given["crs"], z_unit=given["z_unit"], force_crs=given["force_crs"])
    readers = [] if library else open_readers(surveys, options, local=given["local"])
    with locked(out), interrupt_note(DRIVES_KEPT), shown.progress() as progress:
        _check_place(out, overwrite=given["overwrite"])
        trial = TrialOptions(out, given["workers"] or os.cpu_count() or 1, given["overwrite"], progress)
        findings = (
            evaluate_library(subjects, settings, trial)
            if library
            else evaluate_survey(readers, options, given["ground"], subjects, settings, trial)
        )
        files = write_report(findings, out)
    if shown.summary(out, files):
        _summary(findings, files)


def _refuse_other_options(*, places: bool, scans: bool, routes: bool) -> None:
    """Raise UsageError for options of the other evaluations, which would have no effect."""
    given = given_options(click.get_current_context().params)
    for name in given:
        if scans and name not in (*_OF_ALL, *_OF_SCANS):
            raise UsageError(
                f"{option_name(name)} applies to {_subject_of(name)} and has no effect with --scans: leave it out"
            )
        if routes and name not in (*_OF_ALL, *_OF_ROUTES, *_OF_VEHICLES):
            raise UsageError(
                f"{option_name(name)} applies to {_subject_of(name)} and has no effect with --routes: leave it out"
            )
        if not scans and name in _OF_SCANS:
            raise UsageError(f"{option_name(name)} applies to scans: add --scans, or leave it out")
        if not routes and name in _OF_ROUTES:
            raise UsageError(f"{option_name(name)} applies to routes: add --routes, or leave it out")
    if scans and places and "scenes" in given:
        raise UsageError("--scenes applies to simulated scenes: leave out --scenes or the frames")
    if scans and not places and "labels" in given:
        raise UsageError("--labels applies to frames: give frames, or leave it out")
    if routes and not places:
        raise UsageError("evaluate --routes takes the folder of layers that `bumpymap map` wrote, such as site_layers")


def _subject_of(name: str) -> str:
    """Return what an option is about."""
    return "scans" if name in _OF_SCANS else "routes" if name in _OF_ROUTES else "surveys and vehicles"


def _refuse_unused_options(settings: "EvaluateSettings", *, library: bool) -> None:
    """Raise UsageError for options about inputs or parts that this evaluation does not use."""
    given = given_options(click.get_current_context().params)
    merge_settings({}, given, OF_CRS)
    for name in _OF_SURVEYS if library else ():
        if name in given:
            raise UsageError(f"{option_name(name)} applies to surveys and has no effect with --library: leave it out")
    for part, names in _OF_PARTS.items():
        for name in names:
            if part in settings.skip and name in given:
                raise UsageError(f"{option_name(name)} has no effect with --skip {part}: leave one of them out")


@dataclass(frozen=True, slots=True)
class _Output:
    """What an evaluation prints in addition to its report."""

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


def _evaluate_routes(folders: tuple[Any, ...], out: Path, given: dict[str, Any], shown: _Output) -> None:
    findings, files = evaluate_routes_over(
        folders, out, given, shown.progress(), lambda: _check_place(out, overwrite=given["overwrite"])
    )
    if shown.summary(out, files):
        summarise_routes(findings, files)


def _evaluate_scans(
    places: tuple[Any, ...], out: Path, given: dict[str, Any], shown: _Output, *, overwrite: bool
) -> None:
    from bumpymap.lab import (
        ScanEvaluateSettings,
        ScanMethods,
        compare_sensors,
        evaluate_scans,
        labels_of,
        load_open3d,
        read_frames,
        require_libraries,
        simulated_scans,
        write_scan_report,
    )
    from bumpymap.readers import find_frames
    from bumpymap.scan import ScanModel, load_stripes

    settings = ScanEvaluateSettings(scenes=given["scenes"], seed=given["seed"])
    network = ScanModel.load(given["model"]) if given["model"] else ScanModel.shipped()
    methods = ScanMethods(load_stripes(given["stripes"]), network)
    require_libraries(simulates=not places)
    if not places:
        load_open3d("evaluate --scans without frames")
    frames = find_frames([Path(place) for place in places]) if places else []
    labels = labels_of(frames, given["labels"])
    with locked(out), shown.progress() as progress:
        _check_place(out, overwrite=overwrite)
        scans = read_frames(frames, labels) if frames else simulated_scans(settings)
        findings = evaluate_scans(scans, len(frames) or settings.scenes, settings, methods, progress, labels)
        if not frames:
            progress.start("comparing two sensors", settings.pairs)
            findings.sensors = compare_sensors(settings, methods, progress)
        files = write_scan_report(findings, out)
    if not shown.summary(out, files):
        return
    summarise_scans(findings)
    for cost in findings.costs:
        print_line(f"{cost.method:8s} {cost.scan_ms:.1f} ms for a scan of {cost.points:,} points")
    print_line(f"wrote {files[0]}")


def _settings(given: dict[str, Any]) -> "EvaluateSettings":
    from bumpymap.lab import EvaluateSettings

    try:
        densities = tuple(float(word) for word in given["densities"].split(",") if word.strip())
    except ValueError as error:
        raise UsageError(f"--densities is '{given['densities']}'; it must be numbers, such as 100,50,20") from error
    skip = frozenset(word.strip() for word in given["skip"].split(",") if word.strip())
    names = ("total_patches", "min_starts", "max_starts", "seed", "rating")
    own = {name: value for name, value in given_options(given).items() if name in names}
    return EvaluateSettings(densities=densities, skip=skip, **own)


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


def _require(settings: "EvaluateSettings") -> None:
    """Raise UsageError if a library is missing, before the hours of work."""
    from bumpymap.lab import require_dart, require_matplotlib

    require_matplotlib()
    if "drives" not in settings.skip:
        require_dart()


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
