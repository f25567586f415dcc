"""The summary that ``scan`` prints."""

import json
from statistics import median
from typing import Any

from rich.console import Console
from rich.table import Table

from bumpymap.cli._summary import ALREADY_DONE
from bumpymap.scan import StripeModel
from bumpymap.scan_config import ScanConfig
from bumpymap.scan_pipeline import ScanResult

__all__ = ["show", "show_fit"]


def show(result: ScanResult, config: ScanConfig, *, as_json: bool) -> None:
    """Print what a run did: as a table, or as one JSON object."""
    record = _record(result, config)
    if as_json:
        print(json.dumps(record))
        return
    console = Console(soft_wrap=True, highlight=False)
    if result.already_done:
        console.print(f"Already done: {config.out} {ALREADY_DONE}", markup=False)
    console.print(
        f"frames: {record['frames']:,}, {record['points']:,} points, method {result.method}, "
        f"{median(frame.seconds for frame in result.frames) * 1000.0:.0f} ms from file to classes (median), "
        f"{sum(result.seconds.values()):.1f} s in all"
    )
    dropped = record["dropped"]
    console.print(
        f"left out: {dropped['no_return']:,} returns at (0, 0, 0), {dropped['not_finite']:,} not finite, "
        f"{dropped['on_robot']:,} on the robot"
    )
    console.print(_table(record["sectors"], record["points_by_class"]))
    if result.skipped:
        console.print(f"skipped frames: {len(result.skipped)}; scan.json says why")
    console.print(f"Products in {config.out}: {', '.join(result.files)}", markup=False)
    if result.drive is not None:
        tiles = result.drive.summary
        console.print(
            f"Map of the drive in {result.drive.files[0].parent}: {tiles.tiles:,} tiles, {tiles.unknown:,} of them "
            "unknown",
            markup=False,
        )


def show_fit(model: StripeModel, config: ScanConfig, skipped: dict[str, str], *, as_json: bool) -> None:
    """Print what a fit found."""
    if as_json:
        found = {"out": str(config.out), "centres": model.centres, "scans": model.scans, "sectors": model.sectors}
        print(json.dumps(found | {"skipped": skipped}))
        return
    centres = ", ".join(f"{centre:.2f}" for centre in model.centres)
    print(f"class 0 to 2: {centres} stripes, from {model.sectors:,} sectors of {model.scans:,} frames")
    print(f"wrote {config.out}; use it with: bumpymap scan FRAME --out DIR --stripes {config.out}")


def _table(sectors: dict[str, int], points: dict[str, int]) -> Table:
    table = Table(box=None, pad_edge=False)
    for title in ("class", "sectors", "share", "points"):
        table.add_column(title, justify="left" if title == "class" else "right")
    total = max(sum(sectors.values()), 1)
    for klass, (name, count) in enumerate(sectors.items()):
        shown = f"{klass} {name}" if name in points else name
        table.add_row(shown, f"{count:,}", f"{count / total:.1%}", f"{points[name]:,}" if name in points else "")
    return table


def _record(result: ScanResult, config: ScanConfig) -> dict[str, Any]:
    frames = [frame.record() for frame in result.frames]
    return {
        "out": str(config.out),
        "files": result.files,
        "method": result.method,
        "frames": len(frames),
        "points": sum(frame["points"] for frame in frames),
        **{name: _sum(frames, name) for name in ("dropped", "sectors", "points_by_class")},
        "skipped": result.skipped,
        "map": None if result.drive is None else [str(path) for path in result.drive.files],
        "seconds": result.seconds,
        "already_done": result.already_done,
    }


def _sum(frames: list[dict[str, Any]], name: str) -> dict[str, int]:
    return {part: sum(frame[name][part] for frame in frames) for part in frames[0][name]}
