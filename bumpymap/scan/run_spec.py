"""What a scan run was asked, and whether a complete one was asked the same."""

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
    has_files,
    refuse_replacing,
    software_versions,
    verified_record,
)
from bumpymap.readers import identity, label_file
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.methods import Method

__all__ = ["DoneFrames", "done_frames", "scan_asked", "side_files"]

_NO_SAY = {"frames", "out", "overwrite", "resume", "skip_bad", "poses", "vehicle", "calibration"}
"""Settings without a say in the files of the frames: a run may go on with others. The map sees to its own."""


@dataclass(frozen=True, slots=True)
class DoneFrames:
    """What a run noted that has done all frames."""

    files: tuple[str, ...]
    """Names in the folder of the products; of the frames the folder alone."""
    method: ScanMethod
    reports: tuple[FrameReport, ...]
    skipped: dict[str, str]
    gathered: dict[str, int] | None
    """Points in gathered.laz, and those of them that are ground."""
    seconds: dict[str, float]


def scan_asked(config: ScanConfig, frames: Sequence[Frame], method: Method) -> dict[str, Any]:
    """Give everything that the files of the frames depend on; a run that goes on must have been asked the same."""
    paths = [frame.path for frame in frames] + side_files(config, frames)
    return {
        "inputs": {str(path): identity(path) for path in paths},
        "settings": flat_settings(config, _NO_SAY),
        "made with": software_versions() | {"method": f"{method.name}, {method.basis}"},
    }


def side_files(config: ScanConfig, frames: Sequence[Frame]) -> list[Path]:
    """List what is read beside the frames: poses and labels."""
    labels = [found for frame in frames if frame.path.suffix == ".bin" and (found := label_file(frame.path))]
    return [*([] if config.poses is None else [config.poses]), *labels]


def done_frames(config: ScanConfig, run_spec: Mapping[str, Any], frames: Sequence[Frame]) -> DoneFrames:
    """Give what the run noted whose products are complete in ``config.out``.

    Raises
    ------
    OutputError
        It was asked something else, or its products are not whole any more.
    """
    with verified_record(config.out, (), SCAN_MANIFEST_NAME) as record:
        method = record["method"]
        inputs = [*record["frames"], *record["side_files"]]
        no_say = _NO_SAY - {"skip_bad"} if record["skipped"] else _NO_SAY
        before = spec_of_manifest(
            {**record, "inputs": inputs}, no_say, {"method": f"{method['name']}, {method['basis']}"}
        )
        now = {**run_spec, "settings": flat_settings(config, no_say)}
        refuse_replacing(config.out, differences(before, now, same_content))
        own = {str(frame.path): frame for frame in frames}
        reports = tuple(FrameReport.of(own[each["path"]], each) for each in record["frames"])
        _refuse_missing(config, reports)
        files = tuple(
            name
            for name in (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, SCAN_MANIFEST_NAME)
            if (config.out / name).exists()
        )
        skipped = {str(path): str(why) for path, why in record["skipped"].items()}
        return DoneFrames(files, method["name"], reports, skipped, record["gathered"], record["seconds"])


def _refuse_missing(config: ScanConfig, reports: Sequence[FrameReport]) -> None:
    for report in reports:
        if not has_files(report.frame.name, config.out, config.products):
            raise OutputError(
                f"{config.out} already holds a complete run, but files of the frame {report.frame.name} are missing. "
                "Choose another `out`, or pass `overwrite=True` to replace it"
            )
