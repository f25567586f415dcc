"""The scan job, step by step: frames in, sectors, their files and ``scan.json`` out; with poses, a map of the drive."""

import logging
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, TypeAlias

from pyproj import CRS

from bumpymap.core import (
    BadInputError,
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
    FramePart,
    FrameReport,
    check_scan_folder,
    describe_file,
    describe_input,
    explain_empty_scan,
    has_files,
    has_finished_parts,
    is_complete,
    name_frames,
    output_errors,
    refuse_replacing,
    report_frame,
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
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frames import (
    FrameProducts,
    FrameReader,
    frame_products,
    move_products,
    open_products,
    present_products,
    staging_folder,
)
from bumpymap.scan.merge import PlacedPoints
from bumpymap.scan.methods import Method, choose_method
from bumpymap.scan.pose_checks import WrongPosesError
from bumpymap.scan.registration import require_registration
from bumpymap.views import check_bag_file, write_grid_bag, write_picture
from bumpytiles import run_blocks

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
    frames: tuple[FrameReport, ...]
    """In time order, without those that were skipped."""
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
        own = {frame.name: frame for frame in frames}
        reports = tuple(FrameReport.of(own[each["name"]], each) for each in record["frames"])
        _require_files(config, frames, reports)
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        return ScanRun(
            present_products(config.out),
            method["name"],
            reports,
            skipped,
            dict(record["seconds"]),
            merged=record["gathered"],
            already_done=True,
        )


def _require_files(config: ScanConfig, frames: Sequence[Frame], reports: Sequence[FrameReport]) -> None:
    if config.bag is not None and not config.bag.exists():
        raise OutputError(
            f"{config.out} already holds a complete run, but its bag {config.bag} is missing. Pass `overwrite=True` to "
            "make both again"
        )
    done = {report.frame.name for report in reports}
    for number, frame in enumerate(frames):
        if frame.name in done and not has_files(frame.name, config.out, frame_products(config, number)):
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
    out, reader = config.out, FrameReader(config)
    run_folder = RunFolder.opened(
        out,
        run_spec,
        overwrite=config.overwrite,
        finished=has_finished_parts,
        advice="Run the same again to continue from the finished frames.",
        decide=lambda end: Kept.NOTHING if isinstance(end, WrongPosesError) else Kept.ALL,
    )
    with run_folder as run, output_errors(out), utf8_path(staging_folder(run.path, frames)) as staged:
        with clock.stage("scan"), open_products(config, frames, crs, run.path, staged) as products:
            reports = _classify_each(frames, method, run_spec["inputs"], reader, products, progress)
        accumulated = None if products.accumulated is None else products.accumulated.record()
        manifest = scan_manifest(config, frames, method, run_spec, reader.skipped)
        manifest |= {"gathered": accumulated, "bag": None, "seconds": clock.seconds}
        if config.bag is not None:
            write_grid_bag(config.bag, run.path, products.grids(frames))
            manifest["bag"] = describe_file(config.bag)
        with suppress(OSError):
            (staged / FRAME_FOLDER).rmdir()  # if no frame has files of its own
        write_scan_manifest(staged, manifest, reports, run_spec["inputs"])
        files = move_products(staged, out)
    return ScanRun(files, method.name, tuple(reports), reader.skipped, clock.seconds, merged=accumulated)


def _classify_each(
    frames: Sequence[Frame],
    method: Method,
    inputs: Mapping[str, Any],
    reader: FrameReader,
    products: FrameProducts,
    progress: Progress,
) -> list[FrameReport]:
    """Read, class and write frames in threads, unless an earlier run has; add them to the files of the run in order."""

    def finish(numbered: tuple[int, Frame]) -> tuple[FramePart, PlacedPoints | None, str] | BadInputError:
        number, frame = numbered
        try:
            finished = products.load(frame, number)
            if finished is not None:
                return *finished, ""
            begin = time.perf_counter()
            scan = reader.read(frame)
            try:
                classed = method.classify(scan)
            except BadInputError as error:
                raise BadInputError(f"cannot classify {frame.origin}: {error}") from error
            report = report_frame(frame, inputs.get(str(frame.path)), scan, classed, time.perf_counter() - begin)
            written = products.write(frame, number, report, scan, classed, write_picture)
            return *written, explain_empty_scan(scan, classed)
        except BadInputError as error:  # raised when it is the frame's turn: it may be skipped
            return error

    reports: list[FrameReport] = []
    progress.start("scanning frames", len(frames))
    with closing(run_blocks(finish, enumerate(frames), products.config.threads)) as results:
        for frame, result in zip(frames, results, strict=True):
            with reader.skipping(frame):
                if isinstance(result, BadInputError):
                    raise result
                part, placed, empty = result
                if empty:
                    _log.warning("no ground was classified in %s: %s", frame.origin, empty)
                products.add(part, placed)
                reports.append(part.report)
            progress.advance(1)
    reader.require_any(len(reports))
    return reports


def scan_frames(
    config: ScanConfig, progress: Progress | None = None, mapper: MapDrive | None = None
) -> ScanRun:  # fmt: skip
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
    with remove_empty_on_error(config.out), locked(config.out):
        return _scan(config, progress or SilentProgress(), mapper)


def _scan(config: ScanConfig, progress: Progress, mapper: MapDrive | None) -> ScanRun:
    clock = Stopwatch()
    with clock.stage("prepare"):
        unfinished = is_interrupted(config.out)
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
        run = earlier_frames(config, run_spec, frames)
    else:
        check_scan_folder(
            config.out, [frame.path for frame in frames], overwrite=config.overwrite, unfinished=unfinished
        )
        if config.bag is not None:
            inputs = [frame.path for frame in frames]
            check_bag_file(config.bag, config.out, inputs, overwrite=config.overwrite or unfinished)
        run = classify_frames(config, frames, method, crs, run_spec, progress, clock)
    if drive is None or run.merged is None or mapper is None:
        return run
    with clock.stage("map"):
        mapped = map_merged(drive, run.merged, progress, mapper)
    return replace(run, drive=mapped, already_done=is_done and (mapped is None or mapped.already_done))
