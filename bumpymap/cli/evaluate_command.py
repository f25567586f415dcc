"""``bumpymap evaluate scans``: compare classes of scans with labels."""

from collections.abc import Iterator
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.cli._options import PATH, CommandGroup, GroupedOption, Run, grouped_option, job
from bumpymap.core import OutputError, locked
from bumpymap.lab import ScanEvaluateSettings

if TYPE_CHECKING:
    from bumpymap.lab import ScanFindings


@click.group("evaluate", cls=CommandGroup)
def command() -> None:
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
def scans_command(run: Run, frames: tuple[Path, ...], labels: str | None, out: Path, overwrite: bool) -> None:
    """Compare the classes of FRAME files or folders with labels.

    \b
    bumpymap evaluate scans drive --labels kitti --out trust
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.lab import evaluate_scans, labels_of, write_scan_report
    from bumpymap.readers import find_frames, read_scan
    from bumpymap.scan import ScanModel, load_stripes

    names = {field.name for field in fields(ScanEvaluateSettings)}
    settings = ScanEvaluateSettings(**{name: value for name, value in run.changed().items() if name in names})
    network = ScanModel.load(settings.model) if settings.model else ScanModel.shipped()
    found = find_frames(list(frames))
    label_set = labels_of(found, labels)
    with locked(out), run.progress() as progress:
        _check_place(out, overwrite=overwrite)
        scans = map(read_scan, found)
        findings = evaluate_scans(scans, len(found), settings, load_stripes(), network, progress, label_set)
        files = write_scan_report(findings, out)
    record = {"out": str(out), "files": [path.name for path in files]}
    run.show(record, chain(_scan_lines(findings), [f"wrote {files[0]}"]))


command.add_command(scans_command)


def _check_place(out: Path, *, overwrite: bool) -> None:
    """Raise OutputError if a report would be replaced, before the hours of work."""
    from bumpymap.lab import REPORT

    if (out / REPORT).exists() and not overwrite:
        raise OutputError(f"{out} holds a report; pass --overwrite to replace it, or choose another --out")


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
