"""The summary that ``map`` and ``demo`` print."""

import math
from collections.abc import Iterator

from bumpymap.cli._text import print_json, print_line, print_table
from bumpymap.cli._wording import as_options
from bumpymap.core import CLASS_NAMES, MapConfig
from bumpymap.layers import SHEET_FOLDER, MapSummary, degrees_line
from bumpymap.survey import MapResult, describe_lines, ground_line, outcome_of_run, unknown_line

__all__ = ["ALREADY_DONE", "show"]

ALREADY_DONE = "holds a complete run of these inputs and settings. Nothing was written; --overwrite replaces it"

_TITLES = ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)")


def show(result: MapResult, config: MapConfig, *, as_json: bool) -> None:
    """Print the result of a run as a table, or as one JSON object."""
    if as_json:
        print_json(_record(result, config))
        return
    summary = result.summary
    if result.already_done:
        print_line(f"Already done: {config.out} {ALREADY_DONE}")
    which = outcome_of_run(result, config).measured
    print_line(
        f"{result.points:,} points, {summary.tiles:,} tiles of {config.tile_size:g} m measured from "
        f"{'all points' if which == 'points' else which}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    print_table(_rows(summary), _TITLES)
    if line := degrees_line(summary.median_c_r[: len(CLASS_NAMES)]):
        print_line(line)
    print_line(_passable_line(summary))
    print_line(unknown_line(result, config))
    if line := ground_line(result):
        print_line(as_options(line))
    if steps := _steps(result, config):
        print_line(steps)
    if result.skipped:
        print_line(f"{len(result.skipped)} inputs were skipped; run.json lists the reasons")
    names = ", ".join(path.name for path in result.files if path.suffix != ".qml")  # a style belongs to a layer
    if result.sheets:
        sheets = f"{result.sheets:,} sheets in {config.out / SHEET_FOLDER}"
        print_line(f"Layers of {sheets}; over all of them, in {config.out}: {names}")
    else:
        print_line(f"Layers in {config.out}: {names}")


def _passable_line(summary: MapSummary) -> str:
    """Say which share of the tiles is passable, and what bars the others."""
    bars = ", ".join(f"{text} {count / summary.tiles:.1%}" for text, count in summary.bars.items())
    line = f"{summary.passable / summary.tiles:.1%} of the tiles are passable"
    return f"{line}; what bars the others: {bars}" if bars else line


def _rows(summary: MapSummary) -> Iterator[tuple[str, ...]]:
    names = [*(f"{class_id} {name}" for class_id, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    for name, count, c_r, slope in zip(names, counts, summary.median_c_r, summary.median_slope, strict=True):
        yield name, f"{count:,}", f"{count / summary.tiles:.1%}", _number(c_r, 3), _number(slope, 1)
    for reason, count in summary.reasons.items():
        yield f"  {reason}", f"{count:,}", f"{count / summary.tiles:.1%}", "", ""


def _number(value: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:.{decimals}f}"


def _steps(result: MapResult, config: MapConfig) -> str:
    """Return a sentence about flight lines, or an empty string."""
    return as_options(describe_lines(result.lines, config.align))


def _record(result: MapResult, config: MapConfig) -> dict[str, object]:
    return {
        "out": str(config.out),
        "sheets": result.sheets,
        "files": [path.name for path in result.files],
        "points": result.points,
        "tiles": result.summary.tiles,
        "classes": result.summary.classes,
        "unknown": result.summary.reasons,
        "passable": result.summary.passable,
        "barred": result.summary.bars,
        "unknown_share": result.summary.unknown / result.summary.tiles,
        "advice": unknown_line(result, config),
        "ground_advice": as_options(ground_line(result)),
        "ground_only": result.ground_only,
        "flight_lines": _steps(result, config),
        "skipped": result.skipped,
        "seconds": result.seconds,
        "already_done": result.already_done,
    }
