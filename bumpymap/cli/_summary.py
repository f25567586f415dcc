"""The summary that ``map`` and ``demo`` print."""

import json
import math

from rich.console import Console
from rich.table import Table

from bumpymap.advice import Measured, Outcome, advise
from bumpymap.config import MapConfig
from bumpymap.pipeline import MapResult
from bumpymap.products import MapSummary
from bumpymap.types import CLASS_NAMES, Reason
from bumpytiles import Grid

__all__ = ["show"]

_MEASURED: tuple[Measured, Measured] = ("ground points (class 2)", "ground points (found by the cloth)")
"""Where ground comes from: the survey, or the filter."""


def show(result: MapResult, config: MapConfig, *, as_json: bool) -> None:
    """Print what a run did: as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(_record(result, config)))
        return
    console = Console(soft_wrap=True, highlight=False)
    summary = result.summary
    which = _outcome(result, config).measured
    console.print(
        f"{result.points:,} points, {summary.tiles:,} tiles of {config.tile_size:g} m measured from {which}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    console.print(_table(summary))
    if advice := _advice(result, config):
        console.print(advice, markup=False)
    if result.skipped:
        console.print(f"{len(result.skipped)} inputs were skipped; run.json says why")
    console.print(f"Layers in {config.out}: {', '.join(path.name for path in result.files)}", markup=False)


def _table(summary: MapSummary) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)"):
        table.add_column(title, justify="left" if title == "class" else "right")
    names = [*(f"{klass} {name}" for klass, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    for name, count, c_r, slope in zip(names, counts, summary.median_c_r, summary.median_slope, strict=True):
        table.add_row(name, f"{count:,}", f"{count / summary.tiles:.1%}", _number(c_r, 3), _number(slope, 1))
    for reason, count in summary.reasons.items():
        table.add_row(f"  {reason}", f"{count:,}", f"{count / summary.tiles:.1%}", "", "")
    return table


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
    """Say what to do where tiles are unknown; nothing where few are."""
    grid = Grid(config.tile_size, config.pixels)
    return advise(_outcome(result, config), grid, config.features, foretold=False)


def _record(result: MapResult, config: MapConfig) -> dict[str, object]:
    return {
        "out": str(config.out),
        "files": [path.name for path in result.files],
        "points": result.points,
        "tiles": result.summary.tiles,
        "classes": result.summary.classes,
        "unknown": result.summary.reasons,
        "advice": _advice(result, config),
        "ground_only": result.ground_only,
        "skipped": result.skipped,
        "seconds": result.seconds,
    }
