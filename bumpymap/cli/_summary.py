"""The summary that ``map`` and ``demo`` print."""

import math
from collections.abc import Iterator

from bumpymap.cli._text import say, say_json, say_table
from bumpymap.config import MapConfig
from bumpymap.pipeline import MapResult
from bumpymap.products import MapSummary
from bumpymap.types import CLASS_NAMES, REASON_TEXT, Reason

__all__ = ["ALREADY_DONE", "show"]

ALREADY_DONE = "holds a complete run of these inputs and settings. Nothing was written; --overwrite makes it anew"

_TITLES = ("class", "tiles", "share", "median c_r (rad/m)", "median slope (deg)")
_MOST = 0.5
"""With a larger share of unknown tiles the summary says what to do."""
_SAID = ("class 2", "found by the cloth")
"""Where ground comes from: the survey, or the filter."""


def show(result: MapResult, config: MapConfig, *, as_json: bool) -> None:
    """Print what a run did: as a table, or as one JSON object."""
    if as_json:
        say_json(_record(result, config))
        return
    summary = result.summary
    if result.already_done:
        say(f"Already done: {config.out} {ALREADY_DONE}")
    which = f"ground points ({_SAID[config.ground == 'csf']})" if result.ground_only else "points"
    say(
        f"{result.points:,} points, {summary.tiles:,} tiles of {config.tile_size:g} m measured from {which}, "
        f"{sum(result.seconds.values()):.1f} s"
    )
    say_table(_rows(summary), _TITLES)
    share = summary.passable / summary.tiles
    say(f"{share:.1%} of the tiles are passable: known, not too steep, and under half of the drives fail")
    if advice := _advice(result, config):
        say(advice)
    if result.skipped:
        say(f"{len(result.skipped)} inputs were skipped; run.json says why")
    say(f"Layers in {config.out}: {', '.join(path.name for path in result.files)}")


def _rows(summary: MapSummary) -> Iterator[tuple[str, ...]]:
    names = [*(f"{klass} {name}" for klass, name in enumerate(CLASS_NAMES)), "unknown"]
    counts = [*summary.by_class, summary.unknown]
    for name, count, c_r, slope in zip(names, counts, summary.median_c_r, summary.median_slope, strict=True):
        yield name, f"{count:,}", f"{count / summary.tiles:.1%}", _number(c_r, 3), _number(slope, 1)
    for reason, count in summary.reasons.items():
        yield f"  {reason}", f"{count:,}", f"{count / summary.tiles:.1%}", "", ""


def _number(value: float, decimals: int) -> str:
    return "" if math.isnan(value) else f"{value:.{decimals}f}"


def _advice(result: MapResult, config: MapConfig) -> str:
    """Say what to do where most tiles are unknown; nothing elsewhere."""
    summary = result.summary
    reasons, tiles = summary.reasons, summary.tiles
    if summary.unknown <= _MOST * tiles:
        return ""
    most = max(reasons, key=lambda reason: reasons[reason])
    head = f"{reasons[most] / tiles:.0%} of the tiles are unknown: {most}."
    if most != REASON_TEXT[Reason.TOO_FEW_POINTS]:
        return head
    points = f"{summary.median_count:.0f}"
    needed = f"at least {config.features.min_points}, spread over the tile, are needed"
    if result.ground_only:
        return (
            f"{head} They hold {points} ground points ({_SAID[config.ground == 'csf']}) in the median; {needed}. "
            "--ground all measures every point, vegetation too."
        )
    return (
        f"{head} They hold {points} points in the median; {needed}. "
        "Larger tiles need a calibration and a network made for them: bumpymap calibrate and train, --tile-size."
    )


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
