"""Checkpoints of a scan run: one file per finished frame, with all that the files of the drive need from it."""

import json
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bumpymap.core import atomic, parse_json
from bumpymap.layers.scan.names import Frame
from bumpymap.layers.scan.report import FrameReport

__all__ = ["FramePart", "has_finished_parts", "load_part", "part_path", "save_part"]


@dataclass(frozen=True, slots=True)
class FramePart:
    """What a finished frame adds to the files of the drive."""

    report: FrameReport
    rows: pa.Table | None
    """Rows for sectors.parquet; None if that is not written."""
    points: NDArray[np.float32]
    """(n, 3) m, in the sensor frame, for gathered.laz; empty if that is not written."""
    is_ground: NDArray[np.bool_]
    """(n,) whether the point is ground."""


def part_path(folder: Path, number: int) -> Path:
    """Return the checkpoint file of the frame with that number in the run."""
    return folder / f"frame-{number:06d}.npz"


def has_finished_parts(folder: Path) -> bool:
    """Return whether a folder holds the checkpoint of any frame."""
    return next(folder.glob("frame-*.npz"), None) is not None


def save_part(part: FramePart, path: Path) -> None:
    """Write the checkpoint of a finished frame; the file appears only when it is complete."""
    rows = np.empty(0, np.uint8)
    if part.rows is not None:
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, part.rows.schema) as stream:
            stream.write_table(part.rows)
        rows = np.frombuffer(sink.getvalue(), np.uint8)
    report = np.frombuffer(json.dumps(part.report.record() | {"pose": None}).encode(), np.uint8)
    with atomic(path) as temporary:
        np.savez(temporary, report=report, rows=rows, points=part.points, is_ground=part.is_ground)


def load_part(path: Path, frame: Frame) -> FramePart | None:
    """Read the checkpoint of a frame; None if it is missing, damaged or of another frame."""
    try:
        with np.load(path, allow_pickle=False) as saved:
            record = parse_json(saved["report"].tobytes().decode())
            rows = pa.ipc.open_stream(saved["rows"].tobytes()).read_all() if saved["rows"].size else None
            if record["name"] != frame.name:
                return None
            return FramePart(FrameReport.of(frame, record), rows, saved["points"], saved["is_ground"])
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, pa.ArrowException):
        return None
