"""``bumpymap info``: report what a survey contains, and what a run needs."""

import logging
import shlex
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import (
    LOCATION,
    GroupedCommand,
    config_options,
    given_options,
    grouped_option,
    merge_settings,
    output_options,
    settings_options,
)
from bumpymap.cli._progress import CommandProgress, show_progress
from bumpymap.cli._text import as_options, print_json, print_labelled, print_line, print_table
from bumpymap.core import OF_CRS, Ground, MapConfig, count_text

if TYPE_CHECKING:
    from bumpymap.cli._info_report import Report
    from bumpymap.core import Georeference
    from bumpymap.readers import PointSummaryBuilder, ReadOptions
    from bumpymap.survey import Estimate
    from bumpytiles import Grid

__all__ = ["command"]

_BAD_INPUT = 3


@click.command("info", cls=GroupedCommand)
@click.argument("surveys", nargs=-1, required=True, type=LOCATION, metavar="SURVEY...")
@settings_options(
    MapConfig,
    *("crs", "force_crs", "z_unit", "trust_points", "tile_size", "pixels", "memory", "threads"),
)
@grouped_option(
    "--ground",
    type=click.Choice(["auto", "all", "class"]),
    metavar="KIND",
    help="Points to use: auto, all or class [auto].",
    group="Ground",
)
@click.option("--quick", is_flag=True, help="Read only the headers, no points.")
@config_options(MapConfig)
@output_options("Print no progress.")
@click.pass_context
def command(
    ctx: click.Context,
    /,
    surveys: tuple[Path | str, ...],
    *,
    stored: dict[str, Any],
    quick: bool,
    quiet: bool,
    log_json: bool,
    **given: Any,
) -> None:
    """Report what SURVEY files or folders contain, and what `bumpymap map` needs: memory, disk space, time.

    Every point is read once. The exit code is 3 if a file cannot be read.

    \b
    bumpymap info site.laz
    bumpymap info flights/ --quick
    """  # noqa: D301 (click wants the character)
    from bumpymap.cli._info_report import as_record, estimated, run_record, sheets_for
    from bumpymap.core import FeatureSettings, memory_bytes
    from bumpymap.readers import PointSummaryBuilder, ReadOptions, find_surveys
    from bumpymap.survey import Budget, with_memory
    from bumpytiles import Grid

    settings = merge_settings(stored, given_options(given), OF_CRS)
    logging.getLogger("bumpymap").setLevel(logging.ERROR)  # warnings of the readers are in the report
    # Checks that the settings are valid for a run.
    config = MapConfig(**{**settings, "surveys": surveys, "out": Path()})
    run = with_memory(config)
    ground = config.ground
    grid = Grid(run.tile_size, run.pixels)
    budget = Budget(memory_bytes(run.memory), run.threads)
    options = ReadOptions(
        config.crs, config.z_unit, config.trust_points, budget.memory, lines=True, force_crs=config.force_crs
    )
    paths = find_surveys(surveys)
    with show_progress(quiet=quiet or log_json, as_json=log_json) as progress:
        whole = None if quick else PointSummaryBuilder(grid, FeatureSettings())
        look = partial(_inspect, options=options, ground=ground, grid=grid, progress=progress, whole=whole)
        reports = [look(path) for path in paths]
    why_not_together = _why_not_together(reports)
    forecast = None if why_not_together else estimated(reports, budget)
    if log_json:
        record = {"files": [as_record(report) for report in reports], "together": " ".join(why_not_together)}
        sheets = {"sheets_km": sheets_for(grid, [report.bounds for report in reports])}
        print_json(record | sheets | {"run": forecast and run_record(forecast, budget)}, indent=1)
    else:
        _show(reports, why_not_together or _advise_one_map(surveys, reports, whole))
        if forecast is not None:
            memory = run.memory if run.memory == config.memory else f"{config.memory} ({run.memory} now)"
            _show_run(forecast, grid, memory, budget.threads)
            _show_sheets(grid, reports)
    if any(report.error for report in reports):
        ctx.exit(_BAD_INPUT)


def _inspect(
    path: Path | str,
    options: "ReadOptions",
    ground: Ground,
    grid: "Grid",
    progress: CommandProgress,
    whole: "PointSummaryBuilder | None",
) -> "Report":
    """Open and read a file, add it to ``whole`` if given; an error becomes part of the report."""
    from bumpymap.cli._info_report import Report
    from bumpymap.core import BadInputError, FeatureSettings
    from bumpymap.readers import PointSummaryBuilder, open_survey
    from bumpymap.survey import compare_lines

    given: tuple[str, ...] = ()
    try:
        reader = open_survey(path, options)
        given = tuple(_map_options(options, ground, reader.info.georeference))
        if whole is None:
            return Report(path, grid, reader.info, options=given, ground=ground)
        progress.start(f"reading {Path(path).name}", reader.info.point_count)
        builder = PointSummaryBuilder(grid, FeatureSettings()).read(reader, progress.advance)
        whole.merge(builder)
        summary = builder.summary()
        progress.advance(reader.info.point_count - (summary.points if summary else 0))  # read, but dropped
        lines = compare_lines(builder.lines)
        return Report(
            path, grid, reader.info, summary, reader.dropped, reader.classes, options=given, ground=ground, lines=lines
        )
    except BadInputError as error:
        return Report(path, grid, error=str(error))


def _map_options(options: "ReadOptions", ground: Ground, place: "Georeference") -> Iterator[str]:
    """Yield the options that ``map`` needs too: ``--crs`` only for a survey that has none."""
    from bumpymap.core import horizontal_of, parse_crs, same_crs

    if options.crs is not None:
        flat, own = horizontal_of(parse_crs(options.crs)), place.crs and horizontal_of(place.crs)
        if flat is not None and own is not None and same_crs(flat, own):
            yield from ("--crs", options.crs)
    if options.force_crs is not None:
        yield from ("--set", f"force_crs={options.force_crs}")
    if options.z_unit is not None:
        yield from ("--z-unit", options.z_unit)
    if options.trust_points:
        yield from ("--set", "trust_points=true")
    if ground != "auto":
        yield from ("--ground", ground)


def _why_not_together(reports: "list[Report]") -> list[str]:
    """Return why the files cannot be mapped in one run, in lines; empty if they can."""
    from bumpymap.core import BadInputError, common_georeference

    infos = [report.info for report in reports if report.info is not None]
    try:
        if infos:
            common_georeference(infos)
    except BadInputError as error:
        return [str(line) for line in error.args]
    return []


def _advise_one_map(
    surveys: tuple[Path | str, ...], reports: "list[Report]", whole: "PointSummaryBuilder | None"
) -> list[str]:
    """Return the command that maps several files together, and advice; empty for one file, or if one is bad."""
    from bumpymap.cli._info_report import outcome_of, sheet_options, sheets_for
    from bumpymap.core import FeatureSettings
    from bumpymap.survey import advise, compare_lines, describe_lines

    infos = [report.info for report in reports if report.info is not None and not report.error]
    if len(reports) == 1 or len(infos) < len(reports):
        return []
    points = sum(info.point_count for info in infos)
    sheets = sheet_options(sheets_for(reports[0].grid, [report.bounds for report in reports]))
    command = shlex.join(["bumpymap", "map", *map(str, surveys), *reports[0].options, *sheets, "--out", "DIR"])
    text = f"{count_text(len(reports), 'file')}, {count_text(points, 'point')}, one map: {command}"
    summary = whole.summary() if whole is not None else None
    if summary is None:
        return [text]
    outcome = outcome_of(summary, reports[0].ground)
    advice = advise(outcome, reports[0].grid, FeatureSettings(), before_run=True)
    steps = as_options(describe_lines(compare_lines(whole.lines), "report")) if whole is not None else ""
    return [advice or f"about {outcome.share:.0%} of the tiles will be unknown", *filter(None, [steps]), text]


def _show(reports: "list[Report]", why_not_together: list[str]) -> None:
    from bumpymap.cli._info_report import as_rows

    for report in reports:
        print_line(str(report.path), "bold")
        print_table(as_rows(report))
        # Not in the table, which would wrap commands: they must stay on one line to be copied.
        for need in report.needs():
            label = "error" if report.error else "to map it"
            print_labelled(f"  {label}: ", need, "yellow")
        print_line()
    for number, line in enumerate(why_not_together):
        print_line(line if number else f"together: {line}", "bold")


def _show_sheets(grid: "Grid", reports: "list[Report]") -> None:
    """Say that the survey is too large for one map, if it is."""
    from bumpymap.cli._info_report import sheets_for
    from bumpymap.layers import MAX_TILES

    sheets = sheets_for(grid, [report.bounds for report in reports])
    if sheets is not None:
        text = (
            f"it spans more than the {MAX_TILES:,} tiles of one map: --sheets {sheets:g} writes it in several folders"
        )
        print_labelled("  sheets: ", text, "yellow")


def _show_run(forecast: "Estimate", grid: "Grid", memory: str, threads: int) -> None:
    from bumpymap.cli._info_report import run_rows

    print_line(f"a run with --memory {memory} on {threads} thread" + ("s" if threads > 1 else ""), "bold")
    print_table(run_rows(forecast, grid))
