"""Dynamic scenes, step by step: frames in, classed sectors and their files out. No arithmetic here, only the order."""

import logging
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from bumpymap.core import (
    BadInputError,
    ClassedSectors,
    Kept,
    MapConfig,
    OutputError,
    Progress,
    RunFolder,
    Scan,
    ScanMethod,
    SectorStack,
    SilentProgress,
    Stopwatch,
    UsageError,
    atomic,
    check_interrupted,
    locked,
    move_together,
    parse_crs,
    remove_empty_on_error,
    remove_path,
    utf8_path,
    what_to_keep,
)
from bumpymap.layers import (
    ACCUMULATED_NAME,
    FRAME_FOLDER,
    MAP_FOLDER,
    SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME,
    AccumulatedSurvey,
    Frame,
    FramePart,
    FrameReport,
    SectorTable,
    check_scan_folder,
    describe_file,
    explain_empty_scan,
    ground_points,
    has_files,
    has_finished_parts,
    is_complete,
    load_part,
    name_frames,
    open_accumulated,
    open_table,
    output_errors,
    part_path,
    remove_stale_products,
    report_frame,
    sample_evenly,
    save_part,
    sector_rows,
    sync_to_disk,
    write_frame,
    write_scan_manifest,
)
from bumpymap.rating import find_calibration
from bumpymap.readers import find_frames, read_poses, read_scan
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.methods import Method, choose_method
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.run_spec import DoneFrames, done_frames, scan_asked, side_files
from bumpymap.scan.stripes import StripeModel, fit_stripes, save_stripes as write_stripes
from bumpymap.survey import MapResult, map_surveys

__all__ = ["ScanRun", "fit_frames", "scan_frames"]

_log = logging.getLogger(__name__)

_STAGED = "products"
"""Folder for the products of a run, in that of its work, until all are there."""
_NAMED = 5
"""Frames that a message names."""
_MOST_FITTED = 500
"""Frames that a fit looks at: neighbours of a drive see the same ground, and their heightmaps wait in memory."""


@dataclass(frozen=True, slots=True)
class ScanRun:
    """What a run did."""

    files: tuple[str, ...]
    """Names in the folder of the products; of the frames the folder alone."""
    method: ScanMethod
    frames: tuple[FrameReport, ...]
    """In time order, without those that were skipped."""
    skipped: dict[str, str]
    """Frames that could not be read, with the message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    drive: MapResult | None
    """The map of the gathered frames; None without poses, or without ground to map."""
    already_done: bool = False
    """An earlier run made the same of the same frames; nothing was written, and all of this is what it noted."""


@dataclass(frozen=True, slots=True)
class _Sinks:
    """What takes frame after frame."""

    table: SectorTable | None
    gathered: AccumulatedSurvey | None


def scan_frames(config: ScanConfig, progress: Progress | None = None) -> ScanRun:
    """Class the ground of each frame and write the products; with poses, map the drive.

    Raises
    ------
    BumpymapError
        Anything a user can cause; no file is left half-written.
    """
    with remove_empty_on_error(config.out), locked(config.out):
        return _scan(config, progress or SilentProgress())


def fit_frames(config: ScanConfig, progress: Progress | None = None) -> tuple[StripeModel, dict[str, str]]:
    """Fit the stripe classes of the filter method on the frames, and write them to the file ``config.out``.

    Returns
    -------
    StripeModel
    dict
        Frames that could not be read, with the message (``skip_bad``).

    Raises
    ------
    BumpymapError
        Anything a user can cause; no file is left half-written.
    """
    progress = progress or SilentProgress()
    _check_fit(config)
    frames = sample_evenly(name_frames(find_frames(config.frames)), _MOST_FITTED)
    skipped: dict[str, str] = {}
    stacks: list[SectorStack] = []
    progress.start("measuring frames", len(frames))
    for frame in frames:
        with _skipping(frame, config, skipped):
            scan = _read(frame, config)
            with _about(frame):
                stack = polar_sectors(scan, config.polar)
            stacks.append(replace(stack, point_sector=np.empty(0, np.int32)))  # as large as the scan, and not needed
        progress.advance(1)
    _refuse_none(len(stacks), skipped)
    model = fit_stripes(stacks)
    with atomic(config.out) as temporary:
        write_stripes(model, temporary)
    return model, skipped


def _scan(config: ScanConfig, progress: Progress) -> ScanRun:
    clock = Stopwatch()
    with clock.stage("prepare"):
        unfinished = check_interrupted(config.out, resume=config.resume, overwrite=config.overwrite)
        is_there = not (unfinished or config.overwrite) and is_complete(config.out, SCAN_MANIFEST_NAME)
        method = choose_method(config)
        crs = _world(config)
        drive = _drive(config)
        paths = find_frames(config.frames)
        frames = name_frames(paths, None if config.poses is None else read_poses(config.poses, len(paths)))
        run_spec = scan_asked(config, frames, method)
    if is_there:
        done = done_frames(config, run_spec, frames)
    else:
        check_scan_folder(config.out, paths, overwrite=config.overwrite, unfinished=unfinished)
        done = _scan_frames(config, frames, method, crs, run_spec, progress, clock)
    mapped = None
    if drive is not None and done.gathered is not None:
        with clock.stage("map"):
            mapped = _map(drive, done.gathered, progress)
    seconds = {**done.seconds, **({} if is_there else clock.seconds)}
    already_done = is_there and (mapped is None or mapped.already_done)
    return ScanRun(done.files, done.method, done.reports, done.skipped, seconds, mapped, already_done)


def _scan_frames(
    config: ScanConfig,
    frames: list[Frame],
    method: Method,
    crs: CRS | None,
    run_spec: dict[str, Any],
    progress: Progress,
    clock: Stopwatch,
) -> DoneFrames:
    """Class the frames that are not done yet; put the products in their places when all are."""
    reports: list[FrameReport] = []
    skipped: dict[str, str] = {}
    how = "in the place of `overwrite=True`" if config.overwrite else "to the same command"
    advice = f"Pass `resume=True` {how} to continue from the finished frames."
    with (
        RunFolder.opened(
            config.out,
            run_spec,
            resume=config.resume,
            finished=has_finished_parts,
            advice=advice,
            decide=lambda _: Kept.ALL,
        ) as run,
        output_errors(config.out),
        utf8_path(_staged(run.path, frames)) as staged,
    ):
        with clock.stage("scan"), _opened(config, frames, crs, staged) as sinks:
            progress.start("scanning frames", len(frames))
            for number, frame in enumerate(frames):
                with _skipping(frame, config, skipped):
                    version, place = run_spec["inputs"][str(frame.path)], part_path(run.path, number)
                    reports.append(_scan_frame(frame, version, config, method, sinks, staged, place))
                progress.advance(1)
            _refuse_none(len(reports), skipped)
        gathered = None if sinks.gathered is None else sinks.gathered.record()
        known = {
            "settings": config,
            "method": {"name": method.name, "basis": method.basis},
            "skipped": skipped,
            "skipped_inputs": [{"path": path, "mtime_ns": run_spec["inputs"][path]["mtime_ns"]} for path in skipped],
            "side_files": [
                describe_file(path) | {"mtime_ns": run_spec["inputs"][str(path)]["mtime_ns"]}
                for path in side_files(config, frames)
            ],
            "gathered": gathered,
            "seconds": clock.seconds,
        }
        with suppress(OSError):  # it stays where it holds files
            (staged / FRAME_FOLDER).rmdir()
        write_scan_manifest(staged, known, reports, run_spec["inputs"])
        files = tuple(
            name
            for name in (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, SCAN_MANIFEST_NAME)
            if (staged / name).exists()
        )
        move_together(staged, config.out, SCAN_MANIFEST_NAME)
        remove_stale_products(config.out, files)
    return DoneFrames(files, method.name, tuple(reports), skipped, gathered, clock.seconds)


def _staged(folder: Path, frames: list[Frame]) -> Path:
    """Give the folder in which products wait for each other; files of frames that are finished are in it already."""
    staged = folder / _STAGED
    (staged / FRAME_FOLDER).mkdir(parents=True, exist_ok=True)
    for left in staged.iterdir():
        if left.name != FRAME_FOLDER:
            remove_path(left)
    finished = {frame.name for number, frame in enumerate(frames) if part_path(folder, number).exists()}
    for left in (staged / FRAME_FOLDER).iterdir():
        if left.stem not in finished:
            remove_path(left)
    return staged


def _scan_frame(
    frame: Frame,
    version: Mapping[str, Any],
    config: ScanConfig,
    method: Method,
    sinks: _Sinks,
    folder: Path,
    place: Path,
) -> FrameReport:
    """Read, cut, class, write one frame; or take up what is kept of it in ``place``."""
    part = load_part(place, frame) if has_files(frame.name, folder, config.products) else None
    fresh = None
    if part is None:
        fresh = _classed(frame, config, method)
        report = report_frame(frame, version, *fresh)
        part = _part(report, *fresh[:2], with_rows=sinks.table is not None, with_points=sinks.gathered is not None)
    if sinks.gathered is not None and frame.pose is not None:  # first: it may refuse the frame
        sinks.gathered.add_points(frame.name, part.points, frame.pose, part.is_ground)
    if fresh is not None:
        write_frame(frame.name, *fresh[:2], folder, config.products)
        save_part(part, place)
    if sinks.table is not None and part.rows is not None:
        sinks.table.add_rows(part.rows)
    return part.report


def _classed(frame: Frame, config: ScanConfig, method: Method) -> tuple[Scan, ClassedSectors, float]:
    """Read a frame and class it; the seconds that it took beside."""
    begin = time.perf_counter()
    scan = _read(frame, config)
    with _about(frame):
        classed = method.classify(scan)
    seconds = time.perf_counter() - begin
    if reason := explain_empty_scan(scan, classed):
        _log.warning("no ground was classified in %s: %s", frame.path, reason)
    return scan, classed, seconds


def _part(report: FrameReport, scan: Scan, classed: ClassedSectors, *, with_rows: bool, with_points: bool) -> FramePart:
    return FramePart(
        report,
        sector_rows(report.frame.name, classed) if with_rows else None,
        scan.points if with_points else np.empty((0, 3), np.float32),
        ground_points(classed) if with_points else np.empty(0, np.bool_),
    )


def _read(frame: Frame, config: ScanConfig) -> Scan:
    return replace(read_scan(frame.path, config.robot), name=frame.name)


@contextmanager
def _about(frame: Frame) -> Iterator[None]:
    """Name the frame in a message that does not."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError(f"cannot classify {frame.path}: {error}") from error


@contextmanager
def _skipping(frame: Frame, config: ScanConfig, skipped: dict[str, str]) -> Iterator[None]:
    """Note a bad frame and go on, or raise."""
    try:
        yield
    except BadInputError as error:
        if not config.skip_bad:
            error.add_note("`skip_bad=True` goes on without such frames.")
            raise
        _log.warning("skipped %s: %s", frame.path, error)
        skipped[str(frame.path)] = str(error)


def _refuse_none(count: int, skipped: dict[str, str]) -> None:
    if not count:
        shown = [
            *list(skipped.values())[:_NAMED],
            *([f"{len(skipped) - _NAMED} more"] if len(skipped) > _NAMED else []),
        ]
        raise BadInputError("none of the frames could be read:", *shown)


@contextmanager
def _opened(config: ScanConfig, frames: list[Frame], crs: CRS | None, folder: Path) -> Iterator[_Sinks]:
    """Open what takes frame after frame; close it, and put it on the disk, where all went well."""
    poses = [frame.pose for frame in frames if frame.pose is not None]
    with ExitStack() as open_files:
        table = open_files.enter_context(open_table(folder / SECTOR_TABLE_NAME)) if "table" in config.products else None
        gathered = (
            open_files.enter_context(open_accumulated(folder / ACCUMULATED_NAME, poses[0], crs)) if poses else None
        )
        yield _Sinks(table, gathered)
    for name in (SECTOR_TABLE_NAME, ACCUMULATED_NAME):
        if (folder / name).exists():
            sync_to_disk(folder / name)


def _world(config: ScanConfig) -> CRS | None:
    """Return the CRS of the poses; they are in metres, so it must be."""
    if config.crs is None:
        return None
    crs = parse_crs(config.crs)
    if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        raise UsageError(f"`crs='{config.crs}'` is {crs.name}; poses are in metres, so give a projected CRS in metres")
    return crs


def _drive(config: ScanConfig) -> MapConfig | None:
    """Return how the gathered frames will be mapped; refuse before the long work what will not do."""
    if config.poses is None:
        return None
    own = {"vehicle": config.vehicle} if config.vehicle is not None else {}
    drive = MapConfig(
        surveys=(config.out / ACCUMULATED_NAME,),
        out=config.out / MAP_FOLDER,
        ground="class",
        calibration=config.calibration,
        local=config.crs is None,
        overwrite=config.overwrite,
        resume=config.resume,
        **own,  # type: ignore[arg-type]
    )
    known = find_calibration(drive.vehicle, drive.calibration)
    known.require_grid(drive.tile_size, drive.pixels)
    return drive


def _map(drive: MapConfig, gathered: dict[str, int], progress: Progress) -> MapResult | None:
    if not gathered["ground"]:
        _log.warning("no map was made: none of the %d gathered points lies in a traversable sector", gathered["points"])
        return None
    if drive.out.is_symlink():
        raise OutputError(
            f"{drive.out} is a link and was not touched. Remove it, or pass `overwrite=True` to replace it"
        )
    try:
        return map_surveys(drive, progress)
    except BaseException as end:
        note = "The products of the frames are complete; the map of the drive is missing."
        end.__notes__ = [note + (" Pass `resume=True` to make it." if what_to_keep(end) is not Kept.NOTHING else "")]
        raise


def _check_fit(config: ScanConfig) -> None:
    if find_spec("sklearn") is None:
        raise UsageError("fitting stripe classes needs scikit-learn: pip install 'bumpymap[scan]'")
    if config.out.exists() and not config.overwrite:
        raise OutputError(f"{config.out} exists already. Choose another `fit`, or pass `overwrite=True` to replace it")
    if not config.out.parent.is_dir():
        raise OutputError(f"cannot write {config.out}: there is no folder {config.out.parent}. Choose another `fit`")
