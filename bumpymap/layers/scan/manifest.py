"""scan.json, the manifest of a scan run: inputs, settings, software versions and files, enough to repeat the run."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bumpymap.layers.manifest import describe_file, software_versions, write_manifest
from bumpymap.layers.scan.folder import ACCUMULATED_NAME, SCAN_MANIFEST_NAME, SECTOR_TABLE_NAME
from bumpymap.layers.scan.report import FrameReport

__all__ = ["write_scan_manifest"]

_FORMAT = "bumpymap-scan-run"
_VERSION = 1


def write_scan_manifest(
    folder: Path, known: Mapping[str, Any], frames: Iterable[FrameReport], identities: Mapping[str, Mapping[str, Any]]
) -> None:
    """Write scan.json beside the products in ``folder``.

    Parameters
    ----------
    folder : Path
    known : mapping
        The run's own entries: settings, method, skipped frames, seconds. They are kept.
    frames : iterable of FrameReport
    identities : mapping
        Identity of each input file by its path, see `bumpymap.readers.source.identity`.
    """
    files = [
        describe_file(folder / name) | {"path": name}
        for name in (SECTOR_TABLE_NAME, ACCUMULATED_NAME)
        if (folder / name).exists()
    ]
    times = {path: identity["mtime_ns"] for path, identity in identities.items()}
    record = {
        "format": _FORMAT,
        "version": _VERSION,
        **known,
        "versions": software_versions(),
        "files": files,
        "frames": [{**frame.record(), "mtime_ns": times.get(str(frame.frame.path))} for frame in frames],
    }
    write_manifest(record, folder / SCAN_MANIFEST_NAME)
