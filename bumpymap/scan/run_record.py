"""What a scan run depends on, and what it records in ``scan.json``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bumpymap.core import (
    OutputError,
    ScanMethod,
    differences,
    flat_settings,
    recorded_settings,
    same_content,
    spec_of_manifest,
)
from bumpymap.layers import (
    SCAN_MANIFEST_NAME,
    Frame,
    FrameReport,
    describe_input,
    has_files,
    refuse_replacing,
    software_versions,
    verified_record,
)
from bumpymap.rating import Calibration
from bumpymap.readers import LABEL_SETS, FramePoses, bag_files, files_beside_poses, identity, label_file, label_set
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.frames import frame_products, present_products
from bumpymap.scan.methods import Method

__all__ = ["ClassifiedFrames", "describe_scan", "earlier_frames", "scan_manifest"]

_WITHOUT_EFFECT = {"frames", "out", "overwrite", "resume", "skip_bad", "threads", "poses"}
"""Settings that do not change the files of the frames: a resumed run may use other values. The file of the poses is an
input."""


@dataclass(frozen=True, slots=True)
class ClassifiedFrames:
    """The result of classing all frames."""

    files: tuple[str, ...]
    """Names in the folder of the products; the folder of the frames stands for the files in it."""
    method: ScanMethod
    reports: tuple[FrameReport, ...]
    skipped: dict[str, str]
    """Frames that could not be read, with the error message."""
    accumulated: dict[str, Any] | None
    """What scan.json says of gathered.laz, see `DriveMerge.record`; None without poses."""
    seconds: dict[str, float]
    """Wall time by stage."""


def describe_scan(
    config: ScanConfig, frames: Sequence[Frame], method: Method, poses: FramePoses | None
) -> dict[str, Any]:
    """Return everything that the files of the frames depend on; a resumed run must have the same."""
    paths = [frame.path for frame in frames if frame.message is None] + _side_files(config, frames)
    return {
        "inputs": {str(path): identity(path) for path in paths},
        "settings": flat_settings(config, _WITHOUT_EFFECT),
        "made with": software_versions() | _made_with(method.name, method.basis, _calibration_id(method)),
        "poses": None if all(frame.pose is None for frame in frames) else _describe_poses(config, frames, poses),
    }


def _made_with(method: str, basis: str, calibration: str | None) -> dict[str, Any]:
    return {"method": f"{method}, {basis}", "calibration": calibration}


def _calibration_id(method: Method) -> str | None:
    return None if method.calibration is None else method.calibration.id


def _describe_poses(config: ScanConfig, frames: Sequence[Frame], poses: FramePoses | None) -> dict[str, Any]:
    return {
        "matched_by": "time" if poses is None else poses.matched_by,
        "calib": None if poses is None or poses.calib is None else str(poses.calib),
        "deskew": config.deskew and any(frame.motion is not None for frame in frames),
    }


def scan_manifest(
    config: ScanConfig,
    frames: Sequence[Frame],
    method: Method,
    run_spec: Mapping[str, Any],
    skipped: Mapping[str, str],
) -> dict[str, Any]:
    """Return what ``scan.json`` says beside the frames.

    Raises
    ------
    BadInputError
        A file that was read beside those of frames has changed since.
    """
    known = run_spec["inputs"]
    own = {str(frame.path) for frame in frames if frame.message is None}
    return {
        "settings": recorded_settings(config),
        "method": {"name": method.name, "basis": method.basis},
        "calibration": None if method.calibration is None else _describe_calibration(method.calibration),
        "poses": run_spec["poses"],
        "skipped": skipped,
        "skipped_inputs": [{"path": path, "mtime_ns": known[path]["mtime_ns"]} for path in skipped if path in known],
        "side_files": [
            describe_input({"path": path, "bytes": version["size"], "mtime_ns": version["mtime_ns"]})
            for path, version in known.items()
            if path not in own
        ],
    }


def _describe_calibration(calibration: Calibration) -> dict[str, Any]:
    return {
        "id": calibration.id,
        "vehicle": calibration.vehicle["name"],
        "class_limits": calibration.map_limits,
        "belly_m": calibration.body.lowest_obstacle_m,
        "height_m": calibration.body.height_m,
    }


def earlier_frames(config: ScanConfig, run_spec: Mapping[str, Any], frames: Sequence[Frame]) -> ClassifiedFrames:
    """Return the recorded result of the complete run in ``config.out``.

    Raises
    ------
    OutputError
        That run had other inputs or settings, or its products are no longer complete.
    """
    with verified_record(config.out, (), SCAN_MANIFEST_NAME) as record:
        method = record["method"]
        inputs = [*(frame for frame in record["frames"] if frame.get("message") is None), *record["side_files"]]
        ignored = _WITHOUT_EFFECT - {"skip_bad"} if record["skipped"] else _WITHOUT_EFFECT
        made_with = _made_with(method["name"], method["basis"], (record.get("calibration") or {}).get("id"))
        before = spec_of_manifest({**record, "inputs": inputs}, ignored, made_with)
        now = {**run_spec, "settings": flat_settings(config, ignored)}
        refuse_replacing(config.out, differences(before, now, same_content))
        own = {frame.name: frame for frame in frames}
        reports = tuple(FrameReport.of(own[each["name"]], each) for each in record["frames"])
        _require_files(config, frames, reports)
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        return ClassifiedFrames(
            present_products(config.out), method["name"], reports, skipped, record["gathered"], record["seconds"]
        )


def _side_files(config: ScanConfig, frames: Sequence[Frame]) -> list[Path]:
    """List the files that are read beside those of frames: poses, what belongs to them, labels and bags."""
    if config.labels is not None:
        label_set(config.labels)  # says which there are
    labels = [] if config.labels is None or config.labels in LABEL_SETS else [Path(config.labels)]
    labels += [found for frame in frames if frame.path.suffix.lower() == ".bin" and (found := label_file(frame.path))]
    beside = [] if config.poses is None else files_beside_poses(config.poses, [frame.path for frame in frames])
    bags = dict.fromkeys(frame.path for frame in frames if frame.message is not None)
    stored = [file for bag in bags for file in bag_files(bag)]
    return [*([] if config.poses is None else [config.poses]), *beside, *labels, *stored]


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
