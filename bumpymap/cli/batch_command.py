"""``bumpymap batch``: map many surveys, each to a folder of its own."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, job, settings_options
from bumpymap.cli._progress import CommandProgress
from bumpymap.cli._text import as_options, interrupt_note
from bumpymap.core import CLASHES, MapConfig, count_text, override_settings
from bumpymap.survey import BatchConfig

if TYPE_CHECKING:
    from bumpymap.layers import SurveyRow, SurveyStatus
    from bumpymap.survey import BatchReport, BatchResult

_CONTINUE = "Give the same command again to continue."
_BAD: tuple["SurveyStatus", ...] = ("failed", "incomplete", "not reached")
_MOST_LISTED = 20
"""Messages and warnings that the summary lists at most."""


@job(
    "batch",
    settings_options(BatchConfig, required=("out",)),
    settings_options(
        MapConfig,
        without=("out",),
        moved=(
            "xy_unit",
            "z_unit",
            "local",
            "skip_bad",
            "align",
            "speed",
            "tile_size",
            "ground_classes",
            "calibration",
        ),
        threads="Number of threads, shared by --jobs",
        memory="Memory, shared by --jobs",
        overwrite="Replace layers of other inputs or settings",
    ),
    owners=(MapConfig,),
    clashes=CLASHES,
)
@click.argument("source", type=PATH)
def command(run: Run, source: Path) -> None:
    """Map the surveys of SOURCE, each to a folder of its own. The same command continues an interrupted batch.

    SOURCE is a folder, a .txt file with a path in each line, or a .csv file with the column "survey"; its other columns
    are settings of map, which override --config and are overridden by options and --set.

    \b
    bumpymap batch surveys --out maps
    bumpymap batch surveys.csv --out maps --jobs 4
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.survey import run_batch

    given = override_settings(run.assigned, run.given, CLASHES)
    own = {name: given.pop(name) for name in ("out", "survey_per", "jobs") if name in given}
    config = BatchConfig(source, given=given, defaults=run.stored, **own)
    with interrupt_note(_CONTINUE), run.progress() as progress:
        result = run_batch(config, _reporter(progress), lambda total: progress.start("surveys", total), as_options)
    run.show(_record(result, config.out), _lines(result, config.out))
    if result.exit_code:
        run.ctx.exit(result.exit_code)


def _reporter(progress: CommandProgress) -> "BatchReport":
    """Return a function that prints the result of a survey; what failed is printed as a warning already."""

    def report(row: "SurveyRow") -> None:
        progress.advance(1)
        if row.status not in _BAD:
            points, seconds = row.points or 0, row.seconds or 0.0
            text = (
                f"{row.name} {row.status}: {points:,} points, {row.share_unknown or 0.0:.1%} unknown, {seconds:.1f} s"
            )
            progress.note(text, "survey", name=row.name, status=row.status, points=points, seconds=seconds)

    return report


def _counts(result: "BatchResult") -> dict["SurveyStatus", int]:
    return {status: len(result.with_status(status)) for status in dict.fromkeys(row.status for row in result.rows)}


def _record(result: "BatchResult", out: Path) -> dict[str, Any]:
    return {
        "out": str(out),
        "surveys": len(result.rows),
        "counts": _counts(result),
        "failed": {row.name: row.message for row in result.with_status(*_BAD)},
        "warnings": {row.name: list(row.warnings) for row in result.rows if row.warnings},
    }


def _lines(result: "BatchResult", out: Path) -> Iterator[str]:
    """Say how many surveys are done, and which are not."""
    warned = sum(bool(row.warnings) for row in result.rows)
    listed = [f"{count} {status}" for status, count in _counts(result).items()] + [f"{warned} with warnings"] * bool(
        warned
    )
    yield (f"{count_text(len(result.rows), 'survey')}: {', '.join(listed)}")
    lines = [f"  {row.name} {row.status}: {row.message}" for row in result.with_status(*_BAD)]
    lines += [f"  {row.name}, warning: {warning}" for row in result.rows for warning in row.warnings]
    yield from lines[:_MOST_LISTED]
    if len(lines) > _MOST_LISTED:
        yield (f"  and {len(lines) - _MOST_LISTED} more")
    yield (f"Look at {out}/index.html; the table is summary.csv")
