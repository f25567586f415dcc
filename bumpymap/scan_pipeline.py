"""Dynamic scenes, step by step: frames in, classed sectors and their files out. No arithmetic here, only the order."""

import logging
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from pyproj import CRS

from bumpymap.atomic import atomic, no_empty_folder, together
from bumpymap.calibration import Calibration
from bumpymap.config import MapConfig
from bumpymap.crs import parse_crs
from bumpymap.errors import BadInputError, OutputError, UsageError
from bumpymap.frames import find_frames, read_poses, read_scan
from bumpymap.pipeline import MapResult, map_surveys
from bumpymap.progress import Progress, SilentProgress, Stopwatch
from bumpymap.scan import Scan, ScanMethod, SectorStack, StripeModel, fit_stripes, polar_sectors
from bumpymap.scan import save_stripes as write_stripes
from bumpymap.scan_config import ScanConfig
from bumpymap.scan_methods import Method, choose_method
from bumpymap.scan_products import (
    FRAME_FOLDER,
    GATHERED,
    MANIFEST,
    MAP_FOLDER,
    TABLE,
    Frame,
    FrameReport,
    Gathered,
    SectorTable,
    check_scan_folder,
    drop_older,
    name_frames,
    open_gathered,
    open_table,
    report_frame,
    spread_out,
    sync,
    why_empty,
    write_frame,
    write_scan_manifest,
    writing,
)

__all__ = ["ScanResult", "fit_frames", "scan_frames"]

_log = logging.getLogger(__name__)

_NAMED = 5
"""Frames that a message names."""
_MOST_FITTED = 500
"""Frames that a fit looks at: neighbours of a drive see the same ground, and their heightmaps wait in memory."""


@dataclass(frozen=True, slots=True)
class ScanResult:
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


@dataclass(frozen=True, slots=True)
class _Sinks:
    """What takes frame after frame."""

    table: SectorTable | None
    gathered: Gathered | None


def scan_frames(config: ScanConfig, progress: Progress | None = None) -> ScanResult:
    """Class the ground of each frame and write the products; with poses, map the drive.

    Raises
    ------
    BumpymapError
        Anything a user can cause; no file is left half-written.
    """
    with no_empty_folder(config.out):
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
    told = progress or SilentProgress()
    _check_fit(config)
    frames = spread_out(name_frames(find_frames(config.frames)), _MOST_FITTED)
    skipped: dict[str, str] = {}
    stacks: list[SectorStack] = []
    told.start("measuring frames", len(frames))
    for frame in frames:
        with _skipping(frame, config, skipped):
            scan = _read(frame, config)
            with _about(frame):
                stack = polar_sectors(scan, config.polar)
            stacks.append(replace(stack, point_sector=np.empty(0, np.int32)))  # as large as the scan, and not needed
        told.advance(1)
    _refuse_none(len(stacks), skipped)
    model = fit_stripes(stacks)
    with atomic(config.out) as temporary:
        write_stripes(model, temporary)
    return model, skipped


def _scan(config: ScanConfig, told: Progress) -> ScanResult:
    clock = Stopwatch()
    with clock.stage("prepare"):
        method = choose_method(config)
        crs = _world(config)
        drive = _drive(config)
        paths = find_frames(config.frames)
        frames = name_frames(paths, None if config.poses is None else read_poses(config.poses, len(paths)))
        check_scan_folder(config.out, paths, overwrite=config.overwrite)
    reports: list[FrameReport] = []
    skipped: dict[str, str] = {}
    with writing(config.out), together(config.out, MANIFEST) as staged:
        with clock.stage("scan"), _opened(config, frames, crs, staged) as sinks:
            told.start("scanning frames", len(frames))
            for frame in frames:
                with _skipping(frame, config, skipped):
                    reports.append(_scan_frame(frame, config, method, sinks, staged))
                told.advance(1)
            _refuse_none(len(reports), skipped)
        known = {
            "settings": config,
            "method": {"name": method.name, "basis": method.basis},
            "skipped": skipped,
            "gathered": None if sinks.gathered is None else sinks.gathered.record(),
            "seconds": clock.seconds,
        }
        write_scan_manifest(staged, known, reports)
        files = tuple(name for name in (FRAME_FOLDER, TABLE, GATHERED, MANIFEST) if (staged / name).exists())
    drop_older(config.out, files)
    mapped = None
    if drive is not None and sinks.gathered is not None:
        with clock.stage("map"):
            mapped = _map(drive, sinks.gathered, told)
    return ScanResult(files, method.name, tuple(reports), skipped, clock.seconds, mapped)


def _scan_frame(frame: Frame, config: ScanConfig, method: Method, sinks: _Sinks, folder: Path) -> FrameReport:
    """Read, cut, class, write one frame."""
    begin = time.perf_counter()
    scan = _read(frame, config)
    with _about(frame):
        classed = method.classify(scan)
    seconds = time.perf_counter() - begin
    if reason := why_empty(scan, classed):
        _log.warning("%s gives no classed ground: %s", frame.path, reason)
    report = report_frame(frame, scan, classed, seconds)
    if sinks.gathered is not None and frame.pose is not None:  # first: it may refuse the frame
        sinks.gathered.add(scan, frame.pose, classed)
    write_frame(frame.name, scan, classed, folder, config.products)
    if sinks.table is not None:
        sinks.table.add(frame.name, classed)
    return report


def _read(frame: Frame, config: ScanConfig) -> Scan:
    return replace(read_scan(frame.path, config.robot), name=frame.name)


@contextmanager
def _about(frame: Frame) -> Iterator[None]:
    """Name the frame in a message that does not."""
    try:
        yield
    except BadInputError as error:
        raise BadInputError(f"cannot class {frame.path}: {error}") from error


@contextmanager
def _skipping(frame: Frame, config: ScanConfig, skipped: dict[str, str]) -> Iterator[None]:
    """Note a bad frame and go on, or raise."""
    try:
        yield
    except BadInputError as error:
        if not config.skip_bad:
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
        table = open_files.enter_context(open_table(folder / TABLE)) if "table" in config.products else None
        gathered = open_files.enter_context(open_gathered(folder / GATHERED, poses[0], crs)) if poses else None
        yield _Sinks(table, gathered)
    for name in (TABLE, GATHERED):
        if (folder / name).exists():
            sync(folder / name)


def _world(config: ScanConfig) -> CRS | None:
    """Return the CRS of the poses; they are in metres, so it must be."""
    if config.crs is None:
        return None
    crs = parse_crs(config.crs)
    if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        raise UsageError(f"--crs {config.crs} is {crs.name}; poses are in metres, so give a projected CRS in metres")
    return crs


def _drive(config: ScanConfig) -> MapConfig | None:
    """Return how the gathered frames will be mapped; refuse before the long work what will not do."""
    if config.poses is None:
        return None
    own = {"vehicle": config.vehicle} if config.vehicle is not None else {}
    drive = MapConfig(
        surveys=(config.out / GATHERED,),
        out=config.out / MAP_FOLDER,
        ground="class",
        calibration=config.calibration,
        local=config.crs is None,
        overwrite=config.overwrite,
        **own,  # type: ignore[arg-type]
    )
    known = Calibration.load(drive.calibration) if drive.calibration else Calibration.shipped(drive.vehicle)
    known.require_grid(drive.tile_size, drive.pixels)
    return drive


def _map(drive: MapConfig, gathered: Gathered, told: Progress) -> MapResult | None:
    if not gathered.ground:
        _log.warning("no map was made: none of the %d gathered points lies in a traversable sector", gathered.points)
        return None
    try:
        return map_surveys(drive, told)
    except KeyboardInterrupt as end:
        end.__notes__ = ["The products of the frames are complete; the map of the drive is missing."]
        raise


def _check_fit(config: ScanConfig) -> None:
    if find_spec("sklearn") is None:
        raise UsageError("fitting stripe classes needs scikit-learn: pip install 'bumpymap[scan]'")
    if config.out.exists() and not config.overwrite:
        raise OutputError(f"{config.out} exists already. Choose another --fit, or pass --overwrite to replace it")
    if not config.out.parent.is_dir():
        raise OutputError(f"cannot write {config.out}: there is no folder {config.out.parent}. Choose another --fit")
