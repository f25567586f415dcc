"""The summary that ``map`` and ``demo`` print."""

import math
from collections.abc import Iterator

from bumpymap.cli._text import print_json, print_line, print_table
from bumpymap.core import CLASS_NAMES, MapConfig, Reason
from bumpymap.layers import MapSummary
from bumpymap.survey import MapResult, Measured, Outcome, advise
from bumpytiles import Grid

__all__ = ["ALREADY_DONE", "show"]

ALREADY_DONE = "holds a complete run of these inputs and settings. Nothing was written; --overwrite replaces it"

_TITLES = ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)")
_MEASURED: tuple[Measured, Measured] = ("ground points (class 2)", "ground points (found by the cloth)")
"""Source of the ground points: the survey, or the cloth filter."""


def show(result: MapResult, config: MapConfig, *, as_json: bool) -> None:
    """Print the result of a run as a table, or as one JSON object."""
    if as_json:
        print_json(_record(result, config))
        return
    summary = result.summary
    if result.already_done:
        print_line(f"Already done: {config.out} {ALREADY_DONE}")
    which = _outcome(result, config).measured
    print_line(
        f"{result.points:,} points, {summary.tiles:,} tiles of {config.tile_size:g} m measured from "
        f"{'all points' if which == 'points' else which}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    print_table(_rows(summary), _TITLES)
    share = summary.passable / summary.tiles
    print_line(f"{share:.1%} of the tiles are passable: known, not too steep, and under half of the drives fail")
    if advice := _advice(result, config):
        print_line(advice)
    if result.skipped:
        print_line(f"{len(result.skipped)} inputs were skipped; run.json lists the reasons")
    print_line(f"Layers in {config.out}: {', '.join(path.name for path in result.files)}")


def _rows(summary: MapSummary) -> Iterator[tuple[str, ...]]:
    names = [*(f"{class_id} {name}" for class_id, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    for name, count, c_r, slope in zip(names, counts, summary.median_c_r, summary.median_slope, strict=True):
        yield name, f"{count:,}", f"{count / summary.tiles:.1%}", _number(c_r, 3), _number(slope, 1)
    for reason, count in summary.reasons.items():
        yield f"  {reason}", f"{count:,}", f"{count / summary.tiles:.1%}", "", ""


def _number(value: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:.{decimals}f}"


def _outcome(result: MapResult, config: MapConfig) -> Outcome:
    summary = result.summary
    return Outcome(
        tiles=summary.tiles,
        unknown={code: summary.by_reason[code] for code in Reason if summary.by_reason[code]},
        measured=_MEASURED[config.ground == "csf"] if result.ground_only else "points",
        points_per_tile=summary.median_count,
        all_points_per_tile=result.points / summary.tiles,
    )


def _advice(result: MapResult, config: MapConfig) -> str:
    """Return advice if many tiles are unknown, else an empty string."""
    grid = Grid(config.tile_size, config.pixels)
    return advise(_outcome(result, config), grid, config.features, before_run=False)


def _record(result: MapResult, config: MapConfig) -> dict[str, object]:
    return {
        "out": str(config.out),
        "files": [path.name for path in result.files],
        "points": result.points,
        "tiles": result.summary.tiles,
        "classes": result.summary.classes,
        "unknown": result.summary.reasons,
        "passable": result.summary.passable,
        "advice": _advice(result, config),
        "ground_only": result.ground_only,
        "skipped": result.skipped,
        "seconds": result.seconds,
        "already_done": result.already_done,
    }
