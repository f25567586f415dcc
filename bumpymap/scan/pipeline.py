"""The scan job, step by step: frames in, sectors, their files and ``scan.json`` out; with poses, a map of the drive."""

import logging
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

import numpy as np
from pyproj import CRS

from bumpymap.core import (
    Frame,
    Kept,
    MapConfig,
    OutputError,
    Progress,
    RunFolder,
    ScanMethod,
    SilentProgress,
    Stopwatch,
    UsageError,
    differences,
    flat_settings,
    is_interrupted,
    locked,
    parse_crs,
    recorded_settings,
    remove_empty_on_error,
    same_content,
    spec_of_manifest,
    utf8_path,
    what_to_keep,
)
from bumpymap.layers import (
    ACCUMULATED_NAME,
    FRAME_FOLDER,
    MAP_FOLDER,
    SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME,
    check_scan_folder,
    describe_file,
    describe_input,
    frame_files,
    has_finished_parts,
    is_complete,
    move_products,
    name_frames,
    open_accumulated,
    open_table,
    output_errors,
    present_products,
    refuse_replacing,
    software_versions,
    verified_record,
    write_scan_manifest,
)
from bumpymap.rating import find_calibration
from bumpymap.readers import (
    FramePoses,
    bag_files,
    files_beside_poses,
    find_sources,
    hash_survey,
    identity,
    label_file,
    place_sources,
)
from bumpymap.scan.classifier import Method, choose_method
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frames import FrameReader, FrameWork, frame_products, staging_folder
from bumpymap.scan.merge import DriveMerge
from bumpymap.scan.pose_checks import WrongPosesError
from bumpymap.scan.registration import require_registration
from bumpymap.views import check_bag_file, write_grid_bag

_log = logging.getLogger(__name__)

MapDrive: TypeAlias = Callable[[MapConfig, Progress], Any]
"""Maps a survey, as `bumpymap.survey.map_surveys` does."""

_WITHOUT_EFFECT = {"frames", "out", "overwrite", "skip_bad", "threads", "poses", "trust_poses"}
"""Settings that do not change the files of the frames: a resumed run may use other values. The file of the poses is an
input."""


@dataclass(frozen=True, slots=True)
class ScanRun:
    """Files and statistics of a run."""

    files: tuple[str, ...]
    """Names in the folder of the products; the folder of the frames stands for the files in it."""
    method: ScanMethod
    frames: tuple[dict[str, Any], ...]
    """Their entries in scan.json, in time order, without those that were skipped."""
    skipped: dict[str, str]
    """Frames that could not be read, with the error message (``skip_bad``)."""
    seconds: dict[str, float]
    """Wall time by stage."""
    drive: Any = None
    """The map of the merged frames, a `bumpymap.survey.MapResult`; None without poses, or without ground to map."""
    merged: Mapping[str, Any] | None = None
    """Entry ``gathered`` of scan.json, about the merged points: how many, and how well the poses agree."""
    already_done: bool = False
    """An earlier run with the same frames and settings is complete: nothing was written, and these are its results."""


def describe_scan(
    config: ScanConfig, frames: Sequence[Frame], method: Method, poses: FramePoses | None
) -> dict[str, Any]:
    """Return everything that the files of the frames depend on; a resumed run must have the same."""
    paths = [frame.path for frame in frames if frame.message is None]
    if config.poses is not None:
        paths += [config.poses, *files_beside_poses(config.poses, [frame.path for frame in frames])]
    paths += [found for frame in frames if frame.path.suffix.lower() == ".bin" and (found := label_file(frame.path))]
    bags = dict.fromkeys(frame.path for frame in frames if frame.message is not None)
    paths += [file for bag in bags for file in bag_files(bag)]
    calibration_id = None if method.calibration is None else method.calibration.id
    used = {
        "matched_by": "time" if poses is None else poses.matched_by,
        "calib": None if poses is None or poses.calib is None else str(poses.calib),
        "deskew": config.deskew and any(frame.motion is not None for frame in frames),
    }
    return {
        "inputs": {str(path): identity(path) for path in paths},
        "settings": flat_settings(config, _WITHOUT_EFFECT),
        "made with": software_versions() | _made_with(method.name, method.basis, calibration_id),
        "poses": None if all(frame.pose is None for frame in frames) else used,
    }


def _made_with(method: str, basis: str, calibration: str | None) -> dict[str, Any]:
    return {"method": f"{method}, {basis}", "calibration": calibration}


def scan_manifest(
    config: ScanConfig, frames: Sequence[Frame], method: Method, run_spec: Mapping[str, Any], skipped: Mapping[str, str]
) -> dict[str, Any]:
    """Return what ``scan.json`` says beside the frames.

    Raises BadInputError: a file that was read beside those of frames has changed since.
    """
    known = run_spec["inputs"]
    own = {str(frame.path) for frame in frames if frame.message is None}
    calibration = None
    if method.calibration is not None:
        body = method.calibration.body
        calibration = {
            "id": method.calibration.id,
            "vehicle": method.calibration.vehicle["name"],
            "class_limits": method.calibration.map_limits,
            "belly_m": body.lowest_obstacle_m,
            "height_m": body.height_m,
        }
    return {
        "settings": recorded_settings(config),
        "method": {"name": method.name, "basis": method.basis},
        "calibration": calibration,
        "poses": run_spec["poses"],
        "skipped": skipped,
        "skipped_inputs": [{"path": path, "mtime_ns": known[path]["mtime_ns"]} for path in skipped if path in known],
        "side_files": [
            describe_input({"path": path, "bytes": version["size"], "mtime_ns": version["mtime_ns"]})
            for path, version in known.items()
            if path not in own
        ],
    }


def earlier_frames(config: ScanConfig, run_spec: Mapping[str, Any], frames: Sequence[Frame]) -> ScanRun:
    """Return the recorded result of the complete run in ``config.out``.

    Raises OutputError: that run had other inputs or settings, or its products are no longer complete.
    """
    with verified_record(config.out, (), SCAN_MANIFEST_NAME) as record:
        method = record["method"]
        inputs = [*(frame for frame in record["frames"] if frame.get("message") is None), *record["side_files"]]
        ignored = _WITHOUT_EFFECT - {"skip_bad"} if record["skipped"] else _WITHOUT_EFFECT
        made_with = _made_with(method["name"], method["basis"], (record.get("calibration") or {}).get("id"))
        before = spec_of_manifest({**record, "inputs": inputs}, ignored, made_with)
        now = {**run_spec, "settings": flat_settings(config, ignored)}
        refuse_replacing(config.out, differences(before, now, partial(same_content, hashed=hash_survey)))
        _require_files(config, frames, {entry["name"] for entry in record["frames"]})
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        return ScanRun(
            present_products(config.out),
            method["name"],
            tuple(record["frames"]),
            skipped,
            dict(record["seconds"]),
            merged=record["gathered"],
            already_done=True,
        )


def _require_files(config: ScanConfig, frames: Sequence[Frame], done: Collection[str]) -> None:
    if config.bag is not None and not config.bag.exists():
        raise OutputError(
            f"{config.out} already holds a complete run, but its bag {config.bag} is missing. Pass `overwrite=True` to "
            "make both again"
        )
    for number, frame in enumerate(frames):
        files = frame_files(frame.name, config.out, frame_products(config, number))
        if frame.name in done and not all(path.is_file() for path in files):
            raise OutputError(
                f"{config.out} already holds a complete run, but files of the frame {frame.name} are missing. "
                "Choose another `out`, or pass `overwrite=True` to replace it"
            )


def crs_of_poses(config: ScanConfig) -> CRS | None:
    """Return the CRS of the poses, None for local coordinates; raise UsageError if its axes are not in metres."""
    if config.crs is None:
        return None
    crs = parse_crs(config.crs)
    if not crs.is_projected or any(axis.unit_conversion_factor != 1.0 for axis in crs.axis_info):
        raise UsageError(f"`crs='{config.crs}'` is {crs.name}; poses are in metres, so give a projected CRS in metres")
    return crs


def drive_settings(config: ScanConfig, frames: Sequence[Frame]) -> MapConfig | None:
    """Return the settings of the map of the drive, None without poses; check its calibration before the long work."""
    if all(frame.pose is None for frame in frames):
        config.refuse_crs()
        return None
    if config.correct_poses:
        require_registration()
    own = {"vehicle": config.vehicle} if config.vehicle is not None else {}
    drive = MapConfig(
        surveys=(config.out / ACCUMULATED_NAME,),
        out=config.out / MAP_FOLDER,
        ground="class",
        calibration=config.calibration,
        local=config.crs is None,
        overwrite=config.overwrite,
        **own,  # type: ignore[arg-type]
    )
    calibration = find_calibration(drive.vehicle, drive.calibration)
    calibration.require_grid(drive.tile_size, drive.pixels)
    return drive


def map_merged(drive: MapConfig, accumulated: Mapping[str, Any], progress: Progress, mapper: MapDrive) -> Any:
    """Map the merged frames; return None if none of their points is ground.

    ``accumulated``: number of merged ``points``, and of those that are ``ground``.
    """
    if not accumulated["ground"]:
        _log.warning("no map was made: none of the %d gathered points is ground", accumulated["points"])
        return None
    if drive.out.is_symlink():
        raise OutputError(
            f"{drive.out} is a link and was not touched. Remove it, or pass `overwrite=True` to replace it"
        )
    try:
        return mapper(drive, progress)
    except BaseException as end:
        note = "The products of the frames are complete; the map of the drive is missing."
        end.__notes__ = [note + (" Run the same again to make it." if what_to_keep(end) is not Kept.NOTHING else "")]
        raise


def classify_frames(
    config: ScanConfig,
    frames: Sequence[Frame],
    method: Method,
    crs: CRS | None,
    run_spec: dict[str, Any],
    progress: Progress,
    clock: Stopwatch,
) -> ScanRun:
    """Class the frames that an earlier run has not finished, and write the products of all of them.

    ``crs``: of the poses; None: local coordinates; ``run_spec``: see `describe_scan`. Raises BumpymapError: bad frames,
    or a full disk; products in ``config.out`` are replaced when all new ones are complete.
    """
    run_folder = RunFolder.opened(
        config.out,
        run_spec,
        overwrite=config.overwrite,
        finished=has_finished_parts,
        advice="Run the same again to continue from the finished frames.",
        decide=lambda end: Kept.NOTHING if isinstance(end, WrongPosesError) else Kept.ALL,
    )
    offset = next((np.round(frame.pose[:3, 3]) for frame in frames if frame.pose is not None), None)
    with run_folder as run, output_errors(config.out), utf8_path(staging_folder(run.path, frames)) as staged:
        work = FrameWork(config, method, run_spec["inputs"], run.path, staged, offset, FrameReader(config))
        with clock.stage("scan"):
            entries, merged = _write_data(work, frames, crs, progress)
        manifest = scan_manifest(config, frames, method, run_spec, work.skipped)
        manifest |= {"gathered": merged, "bag": None, "seconds": clock.seconds}
        if config.bag is not None:
            write_grid_bag(config.bag, run.path, work.grids(frames))
            manifest["bag"] = describe_file(config.bag)
        with suppress(OSError):
            (staged / FRAME_FOLDER).rmdir()  # if no frame has files of its own
        write_scan_manifest(staged, manifest, entries)
        files = move_products(staged, config.out)
    return ScanRun(files, method.name, tuple(entries), work.skipped, clock.seconds, merged=merged)


def _write_data(
    work: FrameWork, frames: Sequence[Frame], crs: CRS | None, progress: Progress
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    """Write the data of all frames; return their entries in scan.json, and that of the merged points, if there are any.

    Frames of an earlier run are not computed again.
    """
    config, entries, merge = work.config, list[dict[str, Any]](), None
    with ExitStack() as opened:
        if "table" in config.products:
            add_rows = opened.enter_context(open_table(work.staged / SECTOR_TABLE_NAME))
        if work.offset is not None:
            folder = Path(opened.enter_context(TemporaryDirectory(dir=work.run_folder, prefix=".merge-")))
            how = {"trusted": config.trust_poses, "corrected": config.correct_poses}
            merge = DriveMerge(folder, work.offset, config.robot, **how)
        for frame, part in opened.enter_context(closing(work.finished(frames, progress))):
            entries.append(part.entry)
            if part.rows is not None:
                add_rows(part.rows)
            if merge is not None and frame.pose is not None:
                merge.add_points(frame.name, frame.pose, part.arrays)
        if merge is None or work.offset is None:
            return entries, None
        with open_accumulated(work.staged / ACCUMULATED_NAME, work.offset, crs) as add_points:
            merge.write(add_points)
    return entries, merge.record()


def scan_frames(config: ScanConfig, progress: Progress | None = None, mapper: MapDrive | None = None) -> ScanRun:
    """Class the ground of each frame and write the products; with poses, map the drive.

    Parameters
    ----------
    mapper : callable, optional
        Maps the merged frames, such as `bumpymap.survey.map_surveys`; None: they are not mapped.

    Raises
    ------
    BumpymapError
        Bad inputs or settings, or a full disk; no file is left half-written.
    """
    progress, clock = progress or SilentProgress(), Stopwatch()
    with remove_empty_on_error(config.out), locked(config.out):
        with clock.stage("prepare"):
            unfinished = is_interrupted(config.out)
            is_done = not (unfinished or config.overwrite) and is_complete(config.out, SCAN_MANIFEST_NAME)
            method, crs = choose_method(config), crs_of_poses(config)
            sources, poses = find_sources(config.frames, config.bag_topics), None
            if config.poses is not None:
                poses, sources = place_sources(config.poses, sources)
            frames = name_frames(sources)
            drive = drive_settings(config, frames)
            run_spec = describe_scan(config, frames, method, poses)
        if is_done:
            run = earlier_frames(config, run_spec, frames)
        else:
            inputs = [frame.path for frame in frames]
            check_scan_folder(config.out, inputs, overwrite=config.overwrite, unfinished=unfinished)
            if config.bag is not None:
                check_bag_file(config.bag, config.out, inputs, overwrite=config.overwrite or unfinished)
            run = classify_frames(config, frames, method, crs, run_spec, progress, clock)
        if drive is None or run.merged is None or mapper is None:
            return run
        with clock.stage("map"):
            mapped = map_merged(drive, run.merged, progress, mapper)
        return replace(run, drive=mapped, already_done=is_done and (mapped is None or mapped.already_done))
