"""The scan job, step by step: frames in, classed sectors and their files out; with poses, a map of the drive."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from bumpymap.core import (
    Progress,
    ScanMethod,
    SilentProgress,
    Stopwatch,
    check_interrupted,
    locked,
    remove_empty_on_error,
)
from bumpymap.layers import SCAN_MANIFEST_NAME, FrameReport, check_bag_file, check_scan_folder, is_complete, name_frames
from bumpymap.readers import find_sources, place_sources
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.drive import crs_of_poses, drive_settings, map_drive
from bumpymap.scan.frame_run import FrameRun
from bumpymap.scan.methods import choose_method
from bumpymap.scan.run_record import describe_scan, earlier_frames
from bumpymap.survey import MapResult

__all__ = ["ScanRun", "scan_frames"]


@dataclass(frozen=True, slots=True)
class ScanRun:
    """What a run wrote and found."""

    files: tuple[str, ...]
    """Names in the folder of the products; the folder of the frames stands for the files in it."""
    method: ScanMethod
    frames: tuple[FrameReport, ...]
    """In time order, without those that were skipped."""
    skipped: dict[str, str]
    """Frames that could not be read, with the error message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    drive: MapResult | None
    """The map of the merged frames; None without poses, or without ground to map."""
    merged: Mapping[str, Any] | None = None
    """What scan.json says of the merged points (``gathered``): how many, and how well the poses agree."""
    already_done: bool = False
    """An earlier run with the same frames and settings is complete: nothing was written, and these are its results."""


def scan_frames(config: ScanConfig, progress: Progress | None = None) -> ScanRun:
    """Class the ground of each frame and write the products; with poses, map the drive.

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    """
    with remove_empty_on_error(config.out), locked(config.out):
        return _scan(config, progress or SilentProgress())


def _scan(config: ScanConfig, progress: Progress) -> ScanRun:
    clock = Stopwatch()
    with clock.stage("prepare"):
        unfinished = check_interrupted(config.out, resume=config.resume, overwrite=config.overwrite)
        is_done = not (unfinished or config.overwrite) and is_complete(config.out, SCAN_MANIFEST_NAME)
        method = choose_method(config)
        crs = crs_of_poses(config)
        sources = find_sources(config.frames, config.bag_topics)
        found = None
        if config.poses is not None:
            found, sources = place_sources(config.poses, sources)
        frames = name_frames(sources)
        drive = drive_settings(config, frames)
        run_spec = describe_scan(config, frames, method, found)
    if is_done:
        classified = earlier_frames(config, run_spec, frames)
        seconds = dict(classified.seconds)
    else:
        check_scan_folder(
            config.out, [frame.path for frame in frames], overwrite=config.overwrite, unfinished=unfinished
        )
        if config.bag is not None:
            inputs = [frame.path for frame in frames]
            check_bag_file(config.bag, config.out, inputs, overwrite=config.overwrite or unfinished)
        classified = FrameRun(config, frames, method, crs, run_spec).classify(progress, clock)
        seconds = clock.seconds
    mapped = None
    if drive is not None and classified.accumulated is not None:
        with clock.stage("map"):
            mapped = map_drive(drive, classified.accumulated, progress)
    already_done = is_done and (mapped is None or mapped.already_done)
    return ScanRun(
        classified.files,
        classified.method,
        classified.reports,
        classified.skipped,
        seconds,
        mapped,
        classified.accumulated,
        already_done,
    )
