"""What a run keeps of each finished frame, so that it can go on: all that the files of the drive need of it."""

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
    """One finished frame."""

    report: FrameReport
    rows: pa.Table | None
    """Of sectors.parquet; None where that is not written."""
    points: NDArray[np.float32]
    """(n, 3) m, in the frame of the sensor, for gathered.laz; none where that is not written."""
    is_ground: NDArray[np.bool_]
    """(n,) whether they lie in traversable sectors."""


def part_path(folder: Path, number: int) -> Path:
    """Where the frame of that number in the run is kept."""
    return folder / f"frame-{number:06d}.npz"


def has_finished_parts(folder: Path) -> bool:
    """Whether any frame is kept in a folder."""
    return next(folder.glob("frame-*.npz"), None) is not None


def save_part(part: FramePart, path: Path) -> None:
    """Keep a finished frame, whole or not at all."""
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
    """Take up a finished frame; None where it was not finished, or what is kept of it is damaged."""
    try:
        with np.load(path, allow_pickle=False) as kept:
            record = parse_json(kept["report"].tobytes().decode())
            rows = pa.ipc.open_stream(kept["rows"].tobytes()).read_all() if kept["rows"].size else None
            if record["name"] != frame.name:
                return None
            return FramePart(FrameReport.of(frame, record), rows, kept["points"], kept["is_ground"])
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile, pa.ArrowException):
        return None
