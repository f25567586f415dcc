"""Checkpoints of a scan run: one file per finished frame, with all that the files of the drive need from it."""

import json
import os
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bumpymap.core import parse_json
from bumpymap.layers.scan.names import Frame
from bumpymap.layers.scan.report import FrameReport

__all__ = ["FramePart", "file_sizes", "has_finished_parts", "load_part", "part_path", "save_part"]


@dataclass(frozen=True, slots=True)
class FramePart:
    """What a finished frame adds to the files of the drive."""

    report: FrameReport
    rows: pa.Table | None
    """Rows for sectors.parquet; None if that is not written."""
    points: NDArray[np.float32]
    """(n, 3) m, in the sensor frame, for gathered.laz; empty if that is not written."""
    is_ground: NDArray[np.bool_]
    """(n,) whether each of them is ground."""
    files: Mapping[str, int] = field(default_factory=dict)
    """Size of each file of the frame's own by its name, bytes."""


def file_sizes(paths: Iterable[Path]) -> dict[str, int] | None:
    """Return the sizes of files by their names, bytes; None if one is missing."""
    try:
        return {path.name: path.stat().st_size for path in paths}
    except OSError:
        return None


def part_path(folder: Path, number: int) -> Path:
    """Return the checkpoint file of the frame with that number in the run."""
    return folder / f"frame-{number:06d}.npz"


def has_finished_parts(folder: Path) -> bool:
    """Return whether a folder holds the checkpoint of any frame."""
    return next(folder.glob("frame-*.npz"), None) is not None


def save_part(part: FramePart, path: Path) -> None:
    """Write the checkpoint of a finished frame; the file appears only when it is complete.

    It is not flushed to the disk, which would take longer than classifying the frame. After a power cut it may be
    damaged, or complete while a file of the frame is not; `load_part` and the sizes of the files show that.
    """
    rows = np.empty(0, np.uint8)
    if part.rows is not None:
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, part.rows.schema) as stream:
            stream.write_table(part.rows)
        rows = np.frombuffer(sink.getvalue(), np.uint8)
    record = {"report": part.report.record() | {"pose": None}, "files": dict(part.files)}
    known = np.frombuffer(json.dumps(record).encode(), np.uint8)
    temporary = path.with_name(f".{path.name}")  # removed by the next run if this one is killed
    np.savez(temporary, known=known, rows=rows, points=part.points, is_ground=part.is_ground)
    os.replace(temporary, path)  # noqa: PTH105 (os.replace says that it overwrites)


def load_part(path: Path, frame: Frame) -> FramePart | None:
    """Read the checkpoint of a frame; None if it is missing, damaged or of another frame."""
    try:
        with np.load(path, allow_pickle=False) as saved:
            record = parse_json(saved["known"].tobytes().decode())
            rows = pa.ipc.open_stream(saved["rows"].tobytes()).read_all() if saved["rows"].size else None
            if record["report"]["name"] != frame.name:
                return None
            report = FrameReport.of(frame, record["report"])
            return FramePart(report, rows, saved["points"], saved["is_ground"], record["files"])
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, pa.ArrowException):
        return None
