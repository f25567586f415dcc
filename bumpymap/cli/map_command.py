"""``bumpymap map``: make roughness layers and a cost map from surveys; ``batch`` of many, ``demo`` of an example."""

import shlex
import shutil
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._output import ALREADY_DONE, CommandProgress, Table, as_options, cell, interrupt_note
from bumpymap.core import (
    CLASHES,
    BadInputError,
    MapConfig,
    OutputError,
    Progress,
    atomic,
    count_text,
    override_settings,
    share_text,
    shares_text,
    with_pixels,
)
from bumpymap.survey import BatchConfig

if TYPE_CHECKING:
    from bumpymap.layers import MapSummary, SurveyRow, SurveyStatus
    from bumpymap.survey import BatchReport, BatchResult, MapResult

_SAMPLE = Path("sample_data") / "quarry.laz"
"""In an installed package it lies inside, in the sources beside it."""
_BEFORE_WRITING = "comparing neighbours"
"""The stage of `map` before layers are written: the points are gone."""
_TITLES = ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)")


class ImportsAhead:
    """A `Progress` that imports in a thread what writes layers, when the stage before that begins.

    Earlier the libraries would add to the most memory of a run, and the interpreter is busy; now it mostly waits for
    compiled code. pandas is hidden, see `import_without_pandas`, so this is for a process that only runs one command.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        if stage == _BEFORE_WRITING:
            with suppress(RuntimeError):  # no thread can be started: they are imported when they are needed
                threading.Thread(target=_import, name="imports").start()
        self._progress.start(stage, total)

    def advance(self, steps: int) -> None:
        """Report that ``steps`` more steps are done."""
        self._progress.advance(steps)


def _import() -> None:
    with suppress(Exception):  # whoever needs it tries again, and says what is wrong
        from bumpymap.layers import import_without_pandas

        import_without_pandas("pyogrio.raw", "bumpymap.layers.folder", "bumpymap.views.gis.project", "jinja2")


@job("map", MapConfig, clashes=CLASHES)
@click.argument("surveys", nargs=-1, type=PATH, metavar="SURVEY...")
def command(run: Run) -> None:
    """Make roughness layers and a cost map from SURVEY files or folders (LAS, LAZ, COPC, PLY, PCD, DSM as GeoTIFF).

    \b
    bumpymap map site.laz --out site_layers
    bumpymap map flight_1.laz flight_2.laz --out layers --crs EPSG:32614
    bumpymap map dsm.tif --photo ortho.tif --out layers
    bumpymap map site.laz --out layers --vehicle my_robot.toml --set pixels=21
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    config = MapConfig(**with_pixels(run.required(surveys="site.laz", out="--out DIR")))
    if run.ctx.obj:  # this process runs nothing else
        from bumpymap.readers import start_decoder

        start_decoder(config.surveys)  # LAZ is decoded by a process of its own, which starts on another core
    from bumpymap.survey import map_surveys, require_known

    with run.progress() as progress:
        # Dask may need what is hidden.
        ahead = run.ctx.obj and config.scheduler is None
        result = map_surveys(config, ImportsAhead(progress) if ahead else progress)
    run.show(_record(result, config), _lines(result, config))
    require_known(result, config, explain=run.quiet or run.as_json)
    if result.skipped:
        run.end_partly_done()


@job("demo")
@grouped_option(
    "--out",
    group="Output",
    default="demo_out",
    type=PATH,
    metavar="DIR",
    show_default=True,
    help="Folder for the survey and the layers.",
)
def demo_command(run: Run, out: Path) -> None:
    """Map a synthetic quarry as an example."""
    from bumpymap.layers import MapFile
    from bumpymap.survey import map_surveys

    survey = _copy_sample(out / "survey" / _SAMPLE.name)
    config = MapConfig(surveys=(survey,), out=out / "layers", overwrite=True)
    with run.progress() as progress:
        result = map_surveys(config, progress)
    look = [f"Open {config.out / MapFile.PROJECT} in QGIS, or the layers in any other GIS."]
    look += [f"Open {config.out / MapFile.REPORT} in a browser."]
    look += [f"Map a survey of yours: {_called()} map SURVEY.laz --out DIR"]
    run.show(_record(result, config), chain([f"Mapped {survey}"], _lines(result, config), look))


def _called() -> str:
    """Return how a shell in this folder calls this command."""
    command = sys.argv[0]
    if Path(command).stem == "__main__":
        return f"{shlex.quote(sys.executable)} -m bumpymap"
    on_path = shutil.which("bumpymap")
    return "bumpymap" if on_path and Path(on_path).absolute() == Path(command).absolute() else shlex.quote(command)


def _copy_sample(survey: Path) -> Path:
    """Copy the sample survey and return the copy."""
    package = Path(__file__).resolve().parents[1]
    found = [path for path in (package / _SAMPLE, package.parent / _SAMPLE) if path.is_file()]
    if not found:
        raise BadInputError(f"{package / _SAMPLE} is missing: install bumpymap again")
    try:
        survey.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write the survey to {survey.parent}: {error}. Choose another --out") from error
    with atomic(survey) as beside:
        shutil.copyfile(found[0], beside)
    return survey


def _lines(result: "MapResult", config: MapConfig) -> Iterator[str | Table]:
    """Yield the result of a run in lines."""
    from bumpymap.core import CLASS_NAMES
    from bumpymap.readers import project_photo, project_survey
    from bumpymap.survey import describe_lines, ground_line, outcome_of_run, unknown_line
    from bumpymap.views import degrees_line, zones_line

    summary = result.summary
    for folder in config.surveys:
        if (survey := project_survey(folder)) is not None:
            photo = project_photo(config.surveys) if config.photo is None else None
            files = [path.relative_to(folder).as_posix() for path in (survey, photo) if path is not None]
            yield f"From the ODM project {folder}: {' and '.join(files)}"
    if result.already_done:
        yield f"Already done: {config.out} {ALREADY_DONE}"
    which = outcome_of_run(result, config).measured
    rest = (
        f", {result.from_all:,} from all points: that part of the survey is not classified" if result.from_all else ""
    )
    yield (
        f"{count_text(result.points, 'point')}, {count_text(summary.tiles - result.from_all, 'tile')} of "
        f"{config.tile_size:g} m measured from {'all points' if which == 'points' else which}{rest}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    yield Table(_rows(summary), _TITLES)
    degrees, lines = degrees_line(summary.median_c_r[: len(CLASS_NAMES)]), describe_lines(result.lines)
    zones = zones_line(summary.zones, "%") if summary.zones else ""
    yield from filter(None, [degrees, _passable_line(summary), zones, summary.seen.sentence])
    if summary.by_holes:
        share = share_text(summary.by_holes / summary.tiles, 1)
        yield (
            f"compat='paper': {share} of the tiles are class 3 because they have too few points, or more than 30 % of "
            "their pixels hold none, which says nothing of the ground: leave compat out on sparse surveys"
        )
    yield unknown_line(result, config)
    yield from filter(None, [ground_line(result), lines])
    if result.skipped:
        were = "was" if len(result.skipped) == 1 else "were"
        yield f"{count_text(len(result.skipped), 'input')} {were} skipped; run.json lists the reasons"
    for folder in sorted({path.parent for path in result.files}):
        names = (path.name for path in result.files if path.parent == folder and path.suffix != ".qml")
        yield f"Layers in {folder}: {', '.join(names)}"  # a style belongs to a layer


def _passable_line(summary: "MapSummary") -> str:
    """Say which share of the tiles is passable, and what bars the others."""
    found = summary.crossing
    passable, *shares = shares_text(list(found.values()), (0, 1), 1)
    others = zip(list(found.items())[1:], shares, strict=True)
    bars = ", ".join(f"{text} {share}" for (text, count), share in others if count)
    line = f"{passable} of the tiles are passable"
    return f"{line}; what bars the others: {bars}" if bars else line


def _rows(summary: "MapSummary") -> Iterator[tuple[str, ...]]:
    from bumpymap.core import CLASS_NAMES

    names = [*(f"{class_id} {name}" for class_id, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    shares = shares_text(counts, (len(CLASS_NAMES),), 1)
    medians = zip(summary.median_c_r, summary.median_slope, strict=True)
    for name, count, share, (c_r, slope) in zip(names, counts, shares, medians, strict=True):
        if name == "unknown" and summary.failing:
            yield "  only too steep or drives fail", *_part(summary.failing, summary)
        if name == "unknown" and summary.by_holes:
            yield "  only by the paper's rule of holes", *_part(summary.by_holes, summary)
        yield name, f"{count:,}", share, cell(c_r, ".3f"), cell(slope, ".1f")
    reasons = summary.reasons
    shares = shares_text([*reasons.values(), summary.tiles - summary.unknown], (len(reasons),), 1)
    for (reason, count), share in zip(reasons.items(), shares, strict=False):
        yield f"  {reason}", f"{count:,}", share, "", ""


def _part(count: int, summary: "MapSummary") -> tuple[str, str, str, str]:
    """Return the cells of a part of class 3: tiles and their share of all."""
    return f"{count:,}", share_text(count / summary.tiles, 1), "", ""


def _record(result: "MapResult", config: MapConfig) -> dict[str, object]:
    """Return the result of a run as an object of JSON."""
    from bumpymap.survey import describe_lines, ground_line, unknown_line

    return {
        "out": str(config.out),
        "files": [path.relative_to(config.out).as_posix() for path in result.files],
        "points": result.points,
        "tiles": result.summary.tiles,
        "classes": result.summary.classes,
        "unknown": result.summary.reasons,
        "passable": result.summary.passable,
        "barred": result.summary.bars,
        "zones": None if result.summary.zones is None else asdict(result.summary.zones),
        "seen_sizes": result.summary.seen.record(),
        "unknown_share": result.summary.unknown / result.summary.tiles,
        "advice": unknown_line(result, config),
        "ground_advice": as_options(ground_line(result)),
        "ground_only": result.ground_only,
        "tiles_from_all_points": result.from_all,
        "flight_lines": describe_lines(result.lines),
        "skipped": result.skipped,
        "seconds": result.seconds,
        "already_done": result.already_done,
    }


_CONTINUE = "Give the same command again to continue."
_BAD: tuple["SurveyStatus", ...] = ("failed", "incomplete", "not reached")
_MOST_LISTED = 20
"""Messages and warnings that the summary lists at most."""


@job(
    "batch",
    settings_options(BatchConfig, required=("out",)),
    settings_options(
        MapConfig,
        without=(
            "out",
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
def batch_command(run: Run, source: Path) -> None:
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
        report = _batch_reporter(progress)
        result = run_batch(config, report, lambda total: progress.start("surveys", total), as_options)
    run.show(_batch_record(result, config.out), _batch_lines(result, config.out))
    if result.exit_code:
        run.ctx.exit(result.exit_code)


def _batch_reporter(progress: CommandProgress) -> "BatchReport":
    """Return a function that prints the result of a survey; what failed is printed as a warning already."""

    def report(row: "SurveyRow") -> None:
        progress.advance(1)
        if row.status not in _BAD:
            points, seconds, unknown = row.points or 0, row.seconds or 0.0, row.share_unknown or 0.0
            text = f"{row.name} {row.status}: {points:,} points, {unknown:.1%} unknown, {seconds:.1f} s"
            progress.note(text, "survey", name=row.name, status=row.status, points=points, seconds=seconds)

    return report


def _batch_record(result: "BatchResult", out: Path) -> dict[str, Any]:
    return {
        "out": str(out),
        "surveys": len(result.rows),
        "counts": Counter(row.status for row in result.rows),
        "failed": {row.name: row.message for row in result.with_status(*_BAD)},
        "warnings": {row.name: list(row.warnings) for row in result.rows if row.warnings},
    }


def _batch_lines(result: "BatchResult", out: Path) -> Iterator[str]:
    """Say how many surveys are done, and which are not."""
    warned = sum(bool(row.warnings) for row in result.rows)
    counts = Counter(row.status for row in result.rows)
    listed = [f"{count} {status}" for status, count in counts.items()] + [f"{warned} with warnings"] * bool(warned)
    yield (f"{count_text(len(result.rows), 'survey')}: {', '.join(listed)}")
    lines = [f"  {row.name} {row.status}: {row.message}" for row in result.with_status(*_BAD)]
    lines += [f"  {row.name}, warning: {warning}" for row in result.rows for warning in row.warnings]
    yield from lines[:_MOST_LISTED]
    if len(lines) > _MOST_LISTED:
        yield (f"  and {len(lines) - _MOST_LISTED} more")
    yield (f"Look at {out}/index.html; the table is summary.csv")
