"""The summary that ``map`` and ``demo`` print."""

import json

import numpy as np
from rich.console import Console
from rich.table import Table

from bumpymap.config import MapConfig
from bumpymap.pipeline import MapResult
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
    klass = result.cost_map.klass
    return {
        "out": str(config.out),
        "files": [path.name for path in result.files],
        "points": result.points,
        "tiles": len(klass),
        "classes": {name: int(np.count_nonzero(klass == k)) for k, name in enumerate(CLASS_NAMES)},
        "unknown": _by_reason(result.cost_map),
        "advice": _advice(result, config),
        "ground_only": result.ground_only,
        "skipped": result.skipped,
        "seconds": result.seconds,
    }
