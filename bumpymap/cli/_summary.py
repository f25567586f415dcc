"""The summary that ``map`` and ``demo`` print."""

import json

import numpy as np
from rich.console import Console
from rich.table import Table

from bumpymap.config import MapConfig
from bumpymap.pipeline import MapResult
from bumpymap.products import summarise
from bumpymap.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostMap, Reason

__all__ = ["show"]

_MOST = 0.5
"""With a larger share of unknown tiles the summary says what to do."""


def show(result: MapResult, config: MapConfig, *, as_json: bool) -> None:
    """Print what a run did: as a table, or as one JSON object."""
    if as_json:
        print(json.dumps(_record(result, config)))
        return
    console = Console(soft_wrap=True, highlight=False)
    cost_map = result.cost_map
    tiles = len(cost_map.klass)
    which = "ground points (class 2)" if result.ground_only else "points"
    console.print(
        f"{result.points:,} points, {tiles:,} tiles of {config.tile_size:g} m measured from {which}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    table = Table(box=None, pad_edge=False)
    for title in ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)"):
        table.add_column(title, justify="left" if title == "class" else "right")
    for klass, name in enumerate(CLASS_NAMES):
        _add_row(table, f"{klass} {name}", cost_map, cost_map.klass == klass)
    _add_row(table, "unknown", cost_map, cost_map.klass == NO_CLASS)
    for reason, count in summarise(cost_map)["counts"]["by_reason"].items():
        table.add_row(f"  {reason}", f"{count:,}", f"{count / tiles:.1%}", "", "")
    console.print(table)
    if advice := _advice(result, config):
        console.print(advice, markup=False)
    if result.skipped:
        console.print(f"{len(result.skipped)} inputs were skipped; run.json says why")
    console.print(f"Layers in {config.out}: {', '.join(path.name for path in result.files)}", markup=False)


def _add_row(table: Table, name: str, cost_map: CostMap, chosen: np.ndarray) -> None:
    count = int(np.count_nonzero(chosen))
    c_r, slope = cost_map.c_r[chosen], cost_map.patches.slope[chosen]
    table.add_row(
        name,
        f"{count:,}",
        f"{count / len(chosen):.1%}",
        _median(c_r, "{:.3f}"),
        _median(slope, "{:.1f}"),
    )


def _median(values: np.ndarray, form: str) -> str:
    known = values[~np.isnan(values)]
    return form.format(np.median(known)) if len(known) else ""


def _advice(result: MapResult, config: MapConfig) -> str:
    """Say what to do where most tiles are unknown; nothing elsewhere."""
    reasons: dict[str, int] = summarise(result.cost_map)["counts"]["by_reason"]
    tiles = len(result.cost_map.klass)
    if sum(reasons.values()) <= _MOST * tiles:
        return ""
    most = max(reasons, key=lambda reason: reasons[reason])
    head = f"{reasons[most] / tiles:.0%} of the tiles are unknown: {most}."
    if most != REASON_TEXT[Reason.TOO_FEW_POINTS]:
        return head
    points = f"{np.median(result.cost_map.patches.count):.0f}"
    needed = f"at least {config.features.min_points}, spread over the tile, are needed"
    if result.ground_only:
        return (
            f"{head} They hold {points} ground points (class 2) in the median; {needed}. "
            "--ground all measures every point, vegetation too."
        )
    return (
        f"{head} They hold {points} points in the median; {needed}. "
        "Larger tiles need a calibration and a network made for them: bumpymap calibrate and train, --tile-size."
    )


def _record(result: MapResult, config: MapConfig) -> dict[str, object]:
    counts = summarise(result.cost_map)["counts"]
    return {
        "out": str(config.out),
        "files": [path.name for path in result.files],
        "points": result.points,
        "tiles": counts["tiles"],
        "classes": counts["by_class"],
        "unknown": counts["by_reason"],
        "advice": _advice(result, config),
        "ground_only": result.ground_only,
        "skipped": result.skipped,
        "seconds": result.seconds,
    }
