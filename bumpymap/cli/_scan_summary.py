"""The summary that ``scan`` prints."""

from collections.abc import Iterator, Mapping
from statistics import median
from typing import Any

from bumpymap.cli._summary import ALREADY_DONE
from bumpymap.cli._text import print_json, print_line, print_table
from bumpymap.core import count_text, shares_text
from bumpymap.scan import ScanConfig, ScanRun, StripeModel

__all__ = ["show", "show_fit"]


def show(result: ScanRun, config: ScanConfig, *, as_json: bool) -> None:
    """Print the result of a run as a table, or as one JSON object."""
    record = _record(result, config)
    if as_json:
        print_json(record)
        return
    if result.already_done:
        print_line(f"Already done: {config.out} {ALREADY_DONE}")
    print_line(
        f"frames: {record['frames']:,}, {record['points']:,} points, method {result.method}, "
        f"{median(frame.seconds for frame in result.frames) * 1000.0:.0f} ms per frame (median), "
        f"{sum(result.seconds.values()):.1f} s in total"
    )
    dropped = record["dropped"]
    print_line(
        f"excluded: {dropped['no_return']:,} returns at (0, 0, 0) or NaN, {dropped['not_finite']:,} not finite, "
        f"{dropped['on_robot']:,} on the robot"
    )
    states = record["sector_states"]
    print_line(
        f"sectors: {states['free']:,} free (class 0 or 1), {states['obstacle']:,} with an obstacle, "
        f"{states['rough']:,} rough, {states['not ground']:,} not ground"
    )
    if record["sectors_by_ride"] is not None:
        *rated, unknown = record["sectors_by_ride"].values()
        classes = ", ".join(f"{count:,} of class {number}" for number, count in enumerate(rated))
        name = config.vehicle if config.calibration is None else config.calibration
        print_line(f"ride of {name}: {classes}; unknown in {unknown:,} of {unknown + sum(rated):,} sectors")
    print_table(_rows(record["sectors"], record["points_by_class"]), ("class", "sectors", "share", "points"))
    if result.skipped:
        print_line(f"skipped frames: {len(result.skipped)}; scan.json lists the reasons")
    print_line(f"Output in {config.out}: {', '.join(result.files)}")
    if result.merged is not None:
        print_line(_merged_line(result.merged))
    if config.bag is not None:
        print_line(f"Grids of the frames in {config.bag}")
    if result.drive is not None:
        tiles = result.drive.summary
        print_line(
            f"Map of the drive in {result.drive.files[0].parent}: {count_text(tiles.tiles, 'tile')}, "
            f"{tiles.unknown:,} of them unknown"
        )


def _merged_line(merged: Mapping[str, Any]) -> str:
    """Tell how many points are left of the frames, and how well their poses agree."""
    poses = merged["poses"]
    agree = "the frames share no ground, so their poses were not compared"
    if poses["before_m"] is not None:
        agree = (
            f"poses disagree by {100.0 * poses['before_m']:.1f} cm in height, {100.0 * poses['after_m']:.1f} cm after "
            "correction"
        )
    kept = f"{merged['points']:,} of {merged['seen']:,} points, without {merged['moving']:,} of moving things"
    return f"Merged: {kept}; {agree}"


def show_fit(model: StripeModel, config: ScanConfig, skipped: dict[str, str], *, as_json: bool) -> None:
    """Print the result of a fit."""
    if as_json:
        found = {"out": str(config.out), "centres": model.centres, "scans": model.scans, "sectors": model.sectors}
        print_json(found | {"skipped": skipped})
        return
    centres = ", ".join(f"{centre:.2f}" for centre in model.centres)
    print_line(
        f"class 0 to 2: {centres} stripes, from {count_text(model.sectors, 'sector')} of "
        f"{count_text(model.scans, 'frame')}"
    )
    print_line(f"wrote {config.out}; use it with: bumpymap scan FRAME --out DIR --stripes {config.out}")


def _rows(sectors: dict[str, int], points: dict[str, int]) -> Iterator[tuple[str, ...]]:
    shares = shares_text(list(sectors.values()), (), 1)
    for class_id, ((name, count), share) in enumerate(zip(sectors.items(), shares, strict=True)):
        shown = f"{class_id} {name}" if name in points else name
        yield shown, f"{count:,}", share, f"{points[name]:,}" if name in points else ""


def _record(result: ScanRun, config: ScanConfig) -> dict[str, Any]:
    frames = [frame.record() for frame in result.frames]
    return {
        "out": str(config.out),
        "files": result.files,
        "method": result.method,
        "frames": len(frames),
        "points": sum(frame["points"] for frame in frames),
        **{name: _sum(frames, name) for name in ("dropped", "sectors", "sector_states", "points_by_class")},
        "sectors_by_ride": None if frames[0]["sectors_by_ride"] is None else _sum(frames, "sectors_by_ride"),
        "skipped": result.skipped,
        "gathered": result.merged,
        "map": None if result.drive is None else [str(path) for path in result.drive.files],
        "seconds": result.seconds,
        "already_done": result.already_done,
    }


def _sum(frames: list[dict[str, Any]], name: str) -> dict[str, int]:
    return {part: sum(frame[name][part] for frame in frames) for part in frames[0][name]}
