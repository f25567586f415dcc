"""``bumpymap batch``: map many surveys, each to a folder of its own."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import (
    PATH,
    GroupedCommand,
    config_options,
    given_options,
    merge_settings,
    output_options,
    settings_options,
)
from bumpymap.cli._progress import CommandProgress, show_progress
from bumpymap.cli._text import as_options, interrupt_note, print_json, print_line
from bumpymap.core import CLASHES, MapConfig, count_text
from bumpymap.survey import BatchConfig

if TYPE_CHECKING:
    from bumpymap.layers import SurveyRow, SurveyStatus
    from bumpymap.survey import BatchReport, BatchResult

__all__ = ["command"]

_CONTINUE = "Give the same command again to continue."
_BAD: tuple["SurveyStatus", ...] = ("failed", "incomplete", "not reached")
_MOST_LISTED = 20
"""Messages and warnings that the summary lists at most."""


@click.command("batch", cls=GroupedCommand)
@click.argument("source", type=PATH)
@settings_options(BatchConfig, required=("out",))
@settings_options(
    MapConfig,
    without=("out",),
    moved=("z_unit", "local", "skip_bad", "align", "speed", "sheets"),
    threads="Number of threads, shared by --jobs",
    memory="Memory, shared by --jobs",
    overwrite="Replace layers of other inputs or settings",
)
@config_options(MapConfig, clashes=CLASHES, apart=True)
@output_options()
@click.pass_context
def command(
    ctx: click.Context,
    /,
    source: Path,
    out: Path | str,
    *,
    stored: dict[str, Any],
    assigned: dict[str, Any],
    quiet: bool,
    log_json: bool,
    **given: Any,
) -> None:
    """Map the surveys of SOURCE, each to a folder of its own. The same command continues an interrupted batch.

    SOURCE is a folder, a .txt file with a path in each line, or a .csv file with the column "survey"; its other columns
    are settings of map, which override --config and are overridden by options and --set.

    \b
    bumpymap batch surveys --out maps
    bumpymap batch surveys.csv --out maps --jobs 4
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.survey import run_batch

    settings = merge_settings(assigned, given_options(given), CLASHES)
    own = {name: settings.pop(name) for name in ("survey_per", "jobs") if name in settings}
    config = BatchConfig(source, out, settings, stored, **own)
    with interrupt_note(_CONTINUE), show_progress(quiet=quiet, as_json=log_json) as progress:
        result = run_batch(config, _reporter(progress), lambda total: progress.start("surveys", total), as_options)
    if not quiet:
        _show(result, out, as_json=log_json)
    if result.exit_code:
        ctx.exit(result.exit_code)


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


def _show(result: "BatchResult", out: Path | str, *, as_json: bool) -> None:
    """Print how many surveys are done, and which are not."""
    counts = {status: len(result.with_status(status)) for status in dict.fromkeys(row.status for row in result.rows)}
    bad = result.with_status(*_BAD)
    if as_json:
        failed = {row.name: row.message for row in bad}
        warnings = {row.name: list(row.warnings) for row in result.rows if row.warnings}
        record = {"out": str(out), "surveys": len(result.rows), "counts": counts}
        print_json({**record, "failed": failed, "warnings": warnings})
        return
    warned = sum(bool(row.warnings) for row in result.rows)
    listed = [f"{count} {status}" for status, count in counts.items()] + [f"{warned} with warnings"] * bool(warned)
    print_line(f"{count_text(len(result.rows), 'survey')}: {', '.join(listed)}")
    lines = [f"  {row.name} {row.status}: {row.message}" for row in bad]
    lines += [f"  {row.name}, warning: {warning}" for row in result.rows for warning in row.warnings]
    for line in lines[:_MOST_LISTED]:
        print_line(line)
    if len(lines) > _MOST_LISTED:
        print_line(f"  and {len(lines) - _MOST_LISTED} more")
    print_line(f"Look at {str(out).rstrip('/')}/index.html; the table is summary.csv, events are in log.jsonl")
