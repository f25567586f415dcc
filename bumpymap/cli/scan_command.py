"""``bumpymap scan``: classify the ground in scans of a robot; with poses, map its drive."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import click

from bumpymap.cli._options import PATH, Run, grouped_option, job, settings_options
from bumpymap.cli._output import ALREADY_DONE, Table
from bumpymap.core import VEHICLE_OR_CALIBRATION, MapConfig, PolarSettings, Progress, Robot, count_text, shares_text
from bumpymap.scan import ScanConfig

if TYPE_CHECKING:
    from bumpymap.scan import ScanRun
    from bumpymap.survey import MapResult


def _lines(result: "ScanRun", record: Mapping[str, Any], config: ScanConfig) -> Iterator[str | Table]:
    from statistics import median

    if result.already_done:
        yield f"Already done: {config.out} {ALREADY_DONE}"
    yield (
        f"frames: {record['frames']:,}, {record['points']:,} points, method {result.method}, "
        f"{median(frame['seconds'] for frame in result.frames) * 1000.0:.0f} ms per frame (median), "
        f"{sum(result.seconds.values()):.1f} s in total"
    )
    dropped = record["dropped"]
    yield (
        f"excluded: {dropped['no_return']:,} returns at (0, 0, 0) or NaN, {dropped['not_finite']:,} not finite, "
        f"{dropped['on_robot']:,} on the robot"
    )
    heights = [high for frame in result.frames if (high := frame["origin_height_m"]) is not None]
    if heights:
        ends = f"{min(heights):.2f} to {max(heights):.2f} m"
        yield f"origin of the frames: {median(heights):.2f} m above the ground (median; {ends})"
    states = record["sector_states"]
    yield (
        f"sectors: {states['free']:,} free (class 0 or 1), {states['obstacle']:,} with an obstacle, "
        f"{states['rough']:,} of class 2 without one, {states['not ground']:,} not ground"
    )
    if record["sectors_by_ride"] is not None:
        *rated, unknown = record["sectors_by_ride"].values()
        classes = ", ".join(f"{count:,} of class {number}" for number, count in enumerate(rated))
        name = config.vehicle if config.calibration is None else config.calibration
        yield f"ride of {name}: {classes}; unknown in {unknown:,} of {unknown + sum(rated):,} sectors"
    titles = ("class", "sectors", "share", "points")
    yield Table(_rows(record["sectors"], record["points_by_class"]), titles)
    if result.skipped:
        yield f"skipped frames: {len(result.skipped)}; scan.json lists the reasons"
    yield f"Output in {config.out}: {', '.join(result.files)}"
    if result.merged is not None:
        yield _merged_line(result.merged)
    if config.bag is not None:
        yield f"Grids of the frames in {config.bag}"
    if result.drive is not None:
        tiles = result.drive.summary
        yield (
            f"Map of the drive in {result.drive.files[0].parent}: {count_text(tiles.tiles, 'tile')}, "
            f"{tiles.unknown:,} of them unknown"
        )


def _merged_line(merged: Mapping[str, Any]) -> str:
    """Tell how many points are left of the frames, and how well their poses agree."""
    poses = merged["poses"]
    agree = "the frames share no ground, so their poses were not compared"
    if poses["ground_spread_m"] is not None:
        agree = f"the height of the same ground differs by {100.0 * poses['ground_spread_m']:.1f} cm between frames"
    if poses["left_out"]:
        agree += f"; {count_text(len(poses['left_out']), 'frame')} left out"
    if poses["correction"] is not None:
        agree += f"; poses were corrected by up to {100.0 * poses['correction']['largest_move_m']:.1f} cm"
    kept = f"{merged['points']:,} of {merged['seen']:,} points, without {merged['moving']:,} of moving objects"
    return f"Merged: {kept}; {agree}"


def _rows(sectors: dict[str, int], points: dict[str, int]) -> Iterator[tuple[str, ...]]:
    shares = shares_text(list(sectors.values()), (), 1)
    for class_id, ((name, count), share) in enumerate(zip(sectors.items(), shares, strict=True)):
        shown = f"{class_id} {name}" if name in points else name
        yield shown, f"{count:,}", share, f"{points[name]:,}" if name in points else ""


def _map_drive(drive: MapConfig, progress: Progress) -> "MapResult":
    from bumpymap.survey import map_surveys  # only for a drive

    return map_surveys(drive, progress)


def _record(result: "ScanRun", config: ScanConfig) -> dict[str, Any]:
    frames = result.frames
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


def _sum(frames: Sequence[Mapping[str, Any]], name: str) -> dict[str, int]:
    return {part: sum(frame[name][part] for frame in frames) for part in frames[0][name]}


@job(
    "scan",
    ScanConfig,
    settings_options(PolarSettings),
    settings_options(Robot),
    clashes=[VEHICLE_OR_CALIBRATION],
)
@click.argument("frames", nargs=-1, type=PATH, metavar="FRAME...")
@grouped_option(
    "--pictures",
    type=int,
    is_flag=False,
    flag_value=1,
    metavar="N",
    help="Draw all frames, or every Nth one.",
    group="Output",
)
def command(run: Run) -> None:
    """Classify the ground around a robot in LiDAR scans: FRAME files or folders (PLY, PCD, KITTI .bin, ROS 2 bags).

    \b
    bumpymap scan frame.pcd --out out
    bumpymap scan drive --poses poses.txt --out out
    bumpymap scan drive.mcap --out out --bag grids.mcap
    """  # noqa: D301 - \b is click's mark for lines that must not be wrapped
    from bumpymap.layers import import_without_pandas
    from bumpymap.scan import scan_frames

    config = ScanConfig(**run.required(frames="a file or a folder of scans", out="--out DIR"))
    if run.ctx.obj:
        import_without_pandas(*["pyogrio.raw"] if config.may_have_poses else [])
    with run.progress() as progress:
        result = scan_frames(config, progress, _map_drive)
    record = _record(result, config)
    run.show(record, _lines(result, record, config))
    if result.skipped:
        run.end_partly_done()
