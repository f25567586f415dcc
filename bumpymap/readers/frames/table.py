"""Read PLY and PCD scans: points, intensity, semantic ids and the time of each point."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.detect import read_columns
from bumpymap.readers.frames.raw import TIME_COLUMNS, RawScan, point_seconds, start_of_day_time

__all__ = ["read_start", "read_table"]

_WANTED = {
    "label": ("label", "labels", "scalar_label", "semantic", "semantic_label", "sem_id"),
    "intensity": ("intensity", "scalar_intensity", "reflectivity", "remission"),
    "time": TIME_COLUMNS,
}
_MOST_ID = 65_535


def read_table(path: Path) -> RawScan:
    """Read a PLY or PCD scan; a column ``label`` holds the semantic ids."""
    columns = read_columns(path, _WANTED)
    with np.errstate(over="ignore", invalid="ignore"):  # non-finite points are dropped and counted later
        points = np.stack([columns[axis].astype(np.float32) for axis in "xyz"], axis=1)
        intensity = columns["intensity"].astype(np.float32) if "intensity" in columns else None
    return RawScan(
        points,
        intensity,
        _semantic(path, columns["label"]) if "label" in columns else None,
        point_seconds(columns["time"]) if "time" in columns else None,
    )


def read_start(path: Path) -> float | None:
    """Return the time of the first return of a PLY or PCD scan, s since 1970; None if it has no times of day."""
    columns = read_columns(path, {"time": TIME_COLUMNS})
    return start_of_day_time(columns["time"]) if "time" in columns else None


def _semantic(path: Path, column: NDArray[Any]) -> NDArray[np.uint16]:
    ids = column.astype(np.float64)
    if not bool(((ids >= 0) & (ids <= _MOST_ID) & (ids == np.rint(ids))).all()):
        raise BadInputError(f"the labels of {path} are not all whole numbers from 0 to {_MOST_ID:,}: not semantic ids")
    return ids.astype(np.uint16)
