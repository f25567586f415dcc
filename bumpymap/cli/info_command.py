"""``bumpymap info``: report what a survey contains, and what a run needs."""

import logging
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._output import CommandProgress, print_json, print_lines, show_progress
from bumpymap.core import OF_CRS, BadInputError, MapConfig, with_pixels

if TYPE_CHECKING:
    from bumpymap.cli._info_report import FileReport
    from bumpymap.readers import PointSummaryBuilder, ReadOptions
    from bumpytiles import Grid


@job("info", settings_options(MapConfig, "tile_size", "ground", "crs", "dtm"), owners=(MapConfig,), clashes=OF_CRS)
@click.argument("surveys", nargs=-1, required=True, type=PATH, metavar="SURVEY...")
@grouped_option("--quick", group="Run", is_flag=True, help="Read only the headers, no points.")
def command(run: Run, quick: bool) -> None:
    """Report what SURVEY files or folders contain, and what `bumpymap map` needs: memory, disk space, time.

    Every point is read once. The exit code is 3 if a file cannot be read.

    \b
    bumpymap info site.laz
    bumpymap info flights/ --quick
    """  # noqa: D301 (click wants the character)
    from bumpymap.cli._info_report import Report
    from bumpymap.core import FeatureSettings, memory_bytes
    from bumpymap.readers import PointSummaryBuilder, find_surveys, project_photo
    from bumpymap.survey import Budget, read_options, with_memory

    logging.getLogger("bumpymap").setLevel(logging.ERROR)  # warnings of the readers are in the report
    # Checks that the settings are valid for a run.
    config = MapConfig(**{**with_pixels(run.settings), "out": Path()})
    config = replace(config, photo=project_photo(config.surveys))
    limited = with_memory(config)
    grid, budget = config.grid, Budget(memory_bytes(limited.memory), config.threads)
    options = replace(read_options(limited), lines=True, keep_classes=True, colour=False)
    paths = find_surveys(config.surveys)
    with show_progress(quiet=run.quiet or run.as_json, as_json=run.as_json) as progress:
        whole = None if quick else PointSummaryBuilder(grid, FeatureSettings(), config.ground_classes)
        files = [_inspect(path, options, grid, progress, whole) for path in paths]
    memory = config.memory if limited.memory == config.memory else f"{config.memory} ({limited.memory} now)"
    report = Report(files, config, budget, memory, whole)
    if run.as_json:
        print_json(report.record(), indent=1)
    else:
        print_lines(report.lines())
    if any(file.error for file in files):
        run.ctx.exit(BadInputError.exit_code)


def _inspect(
    path: Path, options: "ReadOptions", grid: "Grid", progress: CommandProgress, whole: "PointSummaryBuilder | None"
) -> "FileReport":
    """Open and read a file, add it to ``whole`` if given; an error becomes part of the report."""
    from bumpymap.cli._info_report import FileReport
    from bumpymap.core import FeatureSettings
    from bumpymap.readers import PointSummaryBuilder, open_survey, reopen_survey
    from bumpymap.survey import compare_lines

    try:
        if whole is None:
            reader = reopen_survey(path, options)
            return FileReport(path, reader.info)
        reader = open_survey(path, options)
        progress.start(f"reading {Path(path).name}", reader.info.point_count)
        ground = options.ground_classes
        builder = PointSummaryBuilder(grid, FeatureSettings(), ground).read(reader, progress.advance)
        whole.merge(builder)
        summary = builder.summary()
        progress.advance(reader.info.point_count - (summary.points if summary else 0))  # read, but dropped
        lines = compare_lines(builder.lines)
        return FileReport(path, reader.info, summary, reader.dropped, lines=lines)
    except BadInputError as error:
        return FileReport(path, error=str(error))
