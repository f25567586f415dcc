"""What a scan run depends on, and what it records in ``scan.json``."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bumpymap.core import OutputError, ScanMethod, differences, flat_settings, same_content, spec_of_manifest
from bumpymap.layers import (
    ACCUMULATED_NAME,
    FRAME_FOLDER,
    SCAN_MANIFEST_NAME,
    SECTOR_TABLE_NAME,
    Frame,
    FrameReport,
    describe_file,
    has_files,
    refuse_replacing,
    software_versions,
    verified_record,
)
from bumpymap.readers import identity, label_file
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.methods import Method

__all__ = ["ClassifiedFrames", "describe_scan", "earlier_frames", "scan_manifest"]

_WITHOUT_EFFECT = {"frames", "out", "overwrite", "resume", "skip_bad", "poses", "vehicle", "calibration"}
"""Settings that do not change the files of the frames: a resumed run may use other values. Those of the map of the
drive are checked when it is made."""


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


def describe_scan(config: ScanConfig, frames: Sequence[Frame], method: Method) -> dict[str, Any]:
    """Return everything that the files of the frames depend on; a resumed run must have the same."""
    paths = [frame.path for frame in frames] + _side_files(config, frames)
    return {
        "inputs": {str(path): identity(path) for path in paths},
        "settings": flat_settings(config, _WITHOUT_EFFECT),
        "made with": software_versions() | {"method": f"{method.name}, {method.basis}"},
    }


def scan_manifest(
    config: ScanConfig,
    frames: Sequence[Frame],
    method: Method,
    run_spec: Mapping[str, Any],
    skipped: Mapping[str, str],
) -> dict[str, Any]:
    """Return what ``scan.json`` says beside the frames."""
    known = run_spec["inputs"]
    return {
        "settings": config,
        "method": {"name": method.name, "basis": method.basis},
        "skipped": skipped,
        "skipped_inputs": [{"path": path, "mtime_ns": known[path]["mtime_ns"]} for path in skipped],
        "side_files": [
            describe_file(path) | {"mtime_ns": known[str(path)]["mtime_ns"]} for path in _side_files(config, frames)
        ],
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
        inputs = [*record["frames"], *record["side_files"]]
        ignored = _WITHOUT_EFFECT - {"skip_bad"} if record["skipped"] else _WITHOUT_EFFECT
        before = spec_of_manifest(
            {**record, "inputs": inputs}, ignored, {"method": f"{method['name']}, {method['basis']}"}
        )
        now = {**run_spec, "settings": flat_settings(config, ignored)}
        refuse_replacing(config.out, differences(before, now, same_content))
        own = {str(frame.path): frame for frame in frames}
        reports = tuple(FrameReport.of(own[each["path"]], each) for each in record["frames"])
        _require_files(config, reports)
        files = tuple(
            name
            for name in (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, SCAN_MANIFEST_NAME)
            if (config.out / name).exists()
        )
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        return ClassifiedFrames(files, method["name"], reports, skipped, record["gathered"], record["seconds"])


def _side_files(config: ScanConfig, frames: Sequence[Frame]) -> list[Path]:
    """List the files that are read beside the frames: poses and labels."""
    labels = [found for frame in frames if frame.path.suffix == ".bin" and (found := label_file(frame.path))]
    return [*([] if config.poses is None else [config.poses]), *labels]


def _require_files(config: ScanConfig, reports: Sequence[FrameReport]) -> None:
    for report in reports:
        if not has_files(report.frame.name, config.out, config.products):
            raise OutputError(
                f"{config.out} already holds a complete run, but files of the frame {report.frame.name} are missing. "
                "Choose another `out`, or pass `overwrite=True` to replace it"
            )
