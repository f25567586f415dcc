"""``bumpymap evaluate``: compare a map with simulated drives over the same ground, or classes of scans with labels."""

import os
from collections.abc import Iterator
from dataclasses import field, fields, make_dataclass
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import (
    JOBS,
    LOCATION,
    PATH,
    CommandGroup,
    GroupedOption,
    Run,
    grouped_option,
    job,
    settings_options,
)
from bumpymap.cli._text import DRIVES_KEPT, interrupt_note
from bumpymap.core import OF_CRS, VEHICLE_OR_CALIBRATION, MapConfig, OutputError, locked
from bumpymap.lab import EvaluateSettings, ScanEvaluateSettings

if TYPE_CHECKING:
    from bumpymap.lab import Findings, ScanFindings

Reading = make_dataclass(
    "Reading",
    [
        (each.name, each.type, field(default=each.default))
        for each in fields(MapConfig)
        if each.name in {"crs", "force_crs", "xy_unit", "z_unit", "local", "ground", "vehicle", "calibration"}
    ],
)
"""Settings of a map that say how its survey is read, and who drives."""


@click.group("evaluate", cls=CommandGroup)
def command() -> None:
    """Compare what a map or a scan says with simulated drives, or with labels.

    \b
    bumpymap evaluate survey site.laz --out trust
    bumpymap evaluate scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped


_REPORT = (
    GroupedOption(["--out"], type=PATH, required=True, metavar="DIR", help="Folder for the report.", group="Output"),
    GroupedOption(
        ["--overwrite"], is_flag=True, help="Replace the report, and drives of other settings.", group="Output"
    ),
)


@job(
    "survey",
    EvaluateSettings,
    settings_options(Reading, moved=("crs", "force_crs", "xy_unit", "z_unit", "local", "ground")),
    [*_REPORT, JOBS],
    owners=(EvaluateSettings, Reading),
    clashes=(VEHICLE_OR_CALIBRATION, *OF_CRS),
)
@click.argument("surveys", nargs=-1, required=True, type=LOCATION, metavar="SURVEY...")
def survey_command(run: Run, surveys: tuple[Any, ...], out: Path, jobs: int | None, overwrite: bool) -> None:
    """Compare the map of SURVEY with simulated drives.

    SURVEY are files or folders; drives go over the same ground.

    The same command continues an interrupted run.

    \b
    bumpymap evaluate survey site.laz --out trust
    bumpymap evaluate survey site.laz --out trust --calibration my_vehicle.json
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    settings = EvaluateSettings(**_chosen(run, EvaluateSettings))
    reading = Reading(**_chosen(run, Reading))
    from bumpymap.lab import Subject, TrialOptions, evaluate_survey, open_readers, require_dart, write_report
    from bumpymap.rating import TextureModel, find_calibration
    from bumpymap.readers import ReadOptions

    require_dart()
    subject = Subject.of(find_calibration(reading.vehicle, reading.calibration), TextureModel.shipped())
    pixel_m = subject.calibration.tile_size / subject.calibration.pixels
    crs, unit = reading.force_crs, reading.xy_unit
    options = ReadOptions(reading.crs, reading.z_unit, force_crs=crs, xy_unit=unit, pixel_m=pixel_m)
    readers = open_readers(surveys, options, local=reading.local)
    with locked(out), interrupt_note(DRIVES_KEPT), run.progress() as progress:
        _check_place(out, overwrite=overwrite)
        trial = TrialOptions(out, jobs or os.cpu_count() or 1, overwrite, progress)
        findings = evaluate_survey(readers, options, reading.ground, subject, settings, trial)
        files = write_report(findings, out)
    run.show(_record(out, files), _lines(findings, files))


@job("scans", ScanEvaluateSettings, _REPORT)
@click.argument("frames", nargs=-1, required=True, type=PATH, metavar="FRAME...")
@grouped_option("--labels", metavar="NAME|FILE", help="Label set [by the ids].", group="Input")
def scans_command(run: Run, frames: tuple[Path, ...], labels: str | None, out: Path, overwrite: bool) -> None:
    """Compare the classes of FRAME files or folders with labels.

    \b
    bumpymap evaluate scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.lab import evaluate_scans, labels_of, write_scan_report
    from bumpymap.readers import find_frames, read_scan
    from bumpymap.scan import ScanModel, load_stripes

    settings = ScanEvaluateSettings(**_chosen(run, ScanEvaluateSettings))
    network = ScanModel.load(settings.model) if settings.model else ScanModel.shipped()
    found = find_frames(list(frames))
    label_set = labels_of(found, labels)
    with locked(out), run.progress() as progress:
        _check_place(out, overwrite=overwrite)
        scans = map(read_scan, found)
        findings = evaluate_scans(scans, len(found), settings, load_stripes(), network, progress, label_set)
        files = write_scan_report(findings, out)
    run.show(_record(out, files), chain(_scan_lines(findings), [f"wrote {files[0]}"]))


command.add_command(survey_command)
command.add_command(scans_command)


def _record(out: Path, files: list[Path]) -> dict[str, Any]:
    return {"out": str(out), "files": [path.name for path in files]}


def _chosen(run: Run, owner: type) -> dict[str, Any]:
    """Return the settings of one class that differ from their defaults."""
    names = {field.name for field in fields(owner)}
    return {name: value for name, value in run.changed().items() if name in names}


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
