"""``bumpymap info``: what is in a survey, and what a run would need."""

import json
import logging
import os
import shlex
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, get_args

import click

from bumpymap.cli._terminal import LOCATION, BarProgress
from bumpymap.config import Ground, ZUnit

if TYPE_CHECKING:
    from rich.table import Table

    from bumpymap.cli._info_report import Report
    from bumpymap.engine import Estimate
    from bumpymap.readers import PointTally, ReadOptions
    from bumpytiles import Grid

__all__ = ["command"]

_BAD_INPUT = 3


@click.command("info")
@click.argument("surveys", nargs=-1, required=True, type=LOCATION, metavar="SURVEY...")
@click.option("--crs", metavar="CRS", help="CRS of surveys that carry none, such as EPSG:32614.")
@click.option("--z-unit", type=click.Choice(get_args(ZUnit)), help="Unit of heights, where the CRS does not say.")
@click.option("--trust-points", is_flag=True, help="Go on where a header's extent contradicts the points.")
@click.option(
    "--ground", type=click.Choice(["auto", "all", "class"]), default="auto", help="As for map [default: auto]."
)
@click.option(
    "--tile-size", type=click.FloatRange(0.05, 1000), default=3.0, metavar="M", help="Tile side [default: 3]."
)
@click.option("--pixels", type=click.IntRange(3, 255), default=15, metavar="N", help="Pixels a side [default: 15].")
@click.option("--memory", default="1GB", metavar="SIZE", help="As for map: what a run would take [default: 1GB].")
@click.option("--threads", type=click.IntRange(1), metavar="N", help="As for map [default: every core].")
@click.option("--quick", is_flag=True, help="Look at headers alone, read no points.")
@click.option("--json", "as_json", is_flag=True, help="JSON, for machines.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    surveys: tuple[Path | str, ...],
    crs: str | None,
    z_unit: ZUnit | None,
    ground: Ground,
    tile_size: float,
    pixels: int,
    memory: str,
    threads: int | None,
    *,
    trust_points: bool,
    quick: bool,
    as_json: bool,
) -> None:
    """Tell what is in SURVEY files or folders, and what `bumpymap map` would need: memory, disk, time.

    Reads every point once; the exit code is 3 where a file cannot be read.

    \b
    bumpymap info site.laz
    bumpymap info flights/ --quick
    """  # noqa: D301 (click wants the character)
    from bumpymap.cli._info_report import as_record, estimated, run_record
    from bumpymap.config import FeatureSettings
    from bumpymap.engine import Budget, memory_bytes
    from bumpymap.readers import PointTally, ReadOptions, find_surveys
    from bumpytiles import Grid

    # What the readers would warn about stands in the report.
    logging.getLogger("bumpymap").addHandler(logging.NullHandler())
    options = ReadOptions(crs, z_unit, trust_points)
    grid = Grid(tile_size, pixels)
    budget = Budget(memory_bytes(memory), threads or os.cpu_count() or 1)
    paths = find_surveys(surveys)
    with BarProgress(quiet=as_json) as progress:
        whole = None if quick else PointTally(grid, FeatureSettings())
        look = partial(_look, options=options, ground=ground, grid=grid, progress=progress, whole=whole)
        reports = [look(path) for path in paths]
    together = _together(reports)
    told = None if together else estimated(reports, budget)
    if as_json:
        record = {"files": [as_record(report) for report in reports], "together": together}
        click.echo(json.dumps(record | {"run": told and run_record(told, budget)}, indent=1))
    else:
        _show(reports, together or _one_map(surveys, reports, whole))
        if told is not None:
            _show_run(told, grid, memory, budget.threads)
    if any(report.error for report in reports):
        ctx.exit(_BAD_INPUT)


def _look(
    path: Path | str,
    options: "ReadOptions",
    ground: Ground,
    grid: "Grid",
    progress: BarProgress,
    whole: "PointTally | None",
) -> "Report":
    """Open a file, read it and add it to the whole if there is one; what is wrong becomes part of the report."""
    from bumpymap.cli._info_report import Report
    from bumpymap.config import FeatureSettings
    from bumpymap.errors import BadInputError
    from bumpymap.readers import PointTally, open_survey

    given = tuple(_given(options, ground))
    try:
        reader = open_survey(path, options)
        if whole is None:
            return Report(path, grid, reader.info, options=given, ground=ground)
        progress.start(f"reading {Path(path).name}", reader.info.point_count)
        tally = PointTally(grid, FeatureSettings()).read(reader, progress.advance)
        whole.merge(tally)
        return Report(path, grid, reader.info, tally.summary(), reader.dropped, options=given, ground=ground)
    except BadInputError as error:
        return Report(path, grid, error=str(error))


def _given(options: "ReadOptions", ground: Ground) -> Iterator[str]:
    """Give the options that ``map`` wants as well."""
    if options.crs is not None:
        yield from ("--crs", options.crs)
    if options.z_unit is not None:
        yield from ("--z-unit", options.z_unit)
    if options.trust_points:
        yield "--trust-points"
    if ground != "auto":
        yield from ("--ground", ground)


def _together(reports: "list[Report]") -> str:
    """Why the files cannot be mapped in one run; empty where they can."""
    from bumpymap.crs import common_georeference
    from bumpymap.errors import BadInputError

    infos = [report.info for report in reports if report.info is not None]
    try:
        if infos:
            common_georeference(infos)
    except BadInputError as error:
        return str(error)
    return ""


def _one_map(surveys: tuple[Path | str, ...], reports: "list[Report]", whole: "PointTally | None") -> str:
    """Say how several files make one map; empty for one file, or where one is bad."""
    from bumpymap.advice import advise
    from bumpymap.cli._info_report import outcome_of
    from bumpymap.config import FeatureSettings

    infos = [report.info for report in reports if report.info is not None and not report.error]
    if len(reports) == 1 or len(infos) < len(reports):
        return ""
    points = sum(info.point_count for info in infos)
    command = shlex.join(["bumpymap", "map", *map(str, surveys), *reports[0].options, "--out", "DIR"])
    said = f"{len(reports)} files, {points:,} points, one map: {command}"
    summary = whole.summary() if whole is not None else None
    if summary is None:
        return said
    outcome = outcome_of(summary, reports[0].ground)
    advice = advise(outcome, reports[0].grid, FeatureSettings(), foretold=True)
    return f"{advice or f'about {outcome.share:.0%} of the tiles will be unknown'}\n{said}"


def _show(reports: "list[Report]", together: str) -> None:
    from rich.console import Console
    from rich.text import Text

    from bumpymap.cli._info_report import as_rows

    console = Console(highlight=False)
    for report in reports:
        console.print(Text(str(report.path), style="bold"), soft_wrap=True)
        console.print(_table(as_rows(report)))
        # Not in the table: commands must come out in one line, to be copied.
        for need in report.needs():
            label = "cannot be read" if report.error else "to map it"
            console.print(Text(f"  {label}: ", style="yellow").append(need, style="default"), soft_wrap=True)
        console.print()
    if together:
        console.print(Text(f"together: {together}", style="bold"), soft_wrap=True)


def _show_run(told: "Estimate", grid: "Grid", memory: str, threads: int) -> None:
    from rich.console import Console
    from rich.text import Text

    from bumpymap.cli._info_report import run_rows

    console = Console(highlight=False)
    title = f"a run with --memory {memory} on {threads} thread" + ("s" if threads > 1 else "")
    console.print(Text(title, style="bold"))
    console.print(_table(run_rows(told, grid)))


def _table(rows: list[tuple[str, str]]) -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table.grid(padding=(0, 2))
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for name, value in rows:
        table.add_row(Text(f"  {name}"), Text(value))
    return table
