"""Read KITTI-style scans: ``.bin`` files of float32 x, y, z, intensity, with ``.label`` files of uint32.

The lower 16 bits of a label are the semantic id. The label file of ``DIR/NAME.bin`` is in the same folder, or in a
folder beside ``DIR``: ``labels`` (SemanticKITTI) or ``os1_cloud_node_semantickitti_label_id`` (RELLIS-3D).
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.checks import refuse_count
from bumpymap.readers.frames.bin_columns import find_columns
from bumpymap.readers.frames.point_time import point_seconds
from bumpymap.readers.frames.raw import RawScan
from bumpymap.readers.source import pinned_version, read_range, require_unchanged, size_of, version_of

__all__ = ["LABEL_FOLDERS", "POINT_FOLDERS", "label_file", "read_kitti"]

POINT_FOLDERS = ("velodyne", "os1_cloud_node_kitti_bin")
"""Folders of ``.bin`` files inside a sequence."""
LABEL_FOLDERS = ("labels", "os1_cloud_node_semantickitti_label_id")
"""Folders of ``.label`` files, beside the folders of points."""
_FLOAT_BYTES, _LABEL_BYTES = 4, 4
_WITH_TIME = 6
_MOST_RINGS = 1024
_FARTHEST_M = 1e4
"""Beyond the range of any LiDAR on a robot: larger coordinates mean that the file holds something else."""
_CHECKED = 16_384
"""Values, about, that are checked."""


def read_kitti(path: Path, columns: int | None = None) -> RawScan:
    """Read a ``.bin`` file, and its labels if there are any.

    Parameters
    ----------
    path : Path
    columns : int, optional
        4 (x, y, z, intensity), 5 (and ring) or 6 (and time); None: told from the values.

    Raises
    ------
    BadInputError
        The file is empty, truncated or not a scan, its number of columns is in doubt, or the label file does not
        match it.
    """
    size = size_of(path)
    if size == 0:
        raise BadInputError(f"{path} is empty (0 bytes). Copy or download it again")
    if size % _FLOAT_BYTES:
        raise BadInputError(
            f"{path} has {size:,} bytes, which are no whole numbers of float32: it is truncated or not a KITTI-style "
            "scan. Copy it again, or convert it to PLY"
        )
    values = _whole(path, size).view("<f4")
    _refuse_nonsense(path, values[:_CHECKED, None])
    width = find_columns(path, values, columns)
    table = values.reshape(-1, width)
    _refuse_nonsense(path, table[:: max(len(table) // _CHECKED, 1), :3])
    labels = label_file(path)
    return RawScan(
        table[:, :3],
        table[:, 3],
        None if labels is None else _read_labels(labels, path, len(table)),
        _seconds(table) if width == _WITH_TIME else None,
    )


def _seconds(table: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """Return the time of each point; None if the columns after the intensity are not ring and time."""
    ring = table[:, 4]
    with np.errstate(invalid="ignore"):
        is_ring = bool(((ring >= 0.0) & (ring < _MOST_RINGS) & (ring == np.rint(ring))).all())
    return point_seconds(table[:, 5]) if is_ring else None


def _whole(path: Path, size: int) -> NDArray[np.uint8]:
    data = read_range(path, 0, size)
    refuse_count(path, size, data.size, "bytes")
    return data


def label_file(path: Path) -> Path | None:
    """Return the label file of a ``.bin`` file; None if there is none."""
    name = f"{path.stem}.label"
    near = [path.parent / name, *(path.parent.parent / folder / name for folder in LABEL_FOLDERS)]
    return next((file for file in near if file.is_file()), None)


def _read_labels(labels: Path, path: Path, count: int) -> NDArray[np.uint16]:
    version = version_of(labels)
    size = version["size"]
    if size != _LABEL_BYTES * count:
        raise BadInputError(
            f"{labels} has {size:,} bytes; {path} has {count:,} points, whose labels take {_LABEL_BYTES * count:,}. "
            "They do not belong together: copy both again, or remove the label file"
        )
    with pinned_version(labels, version):
        ids = (_whole(labels, size).view("<u4") & 0xFFFF).astype(np.uint16)
    require_unchanged(labels, version)
    return ids


def _refuse_nonsense(path: Path, table: NDArray[np.float32]) -> None:
    """Refuse a file of another kind: in most rows, a value is no plausible coordinate."""
    with np.errstate(invalid="ignore"):
        plausible = np.isnan(table) | (np.abs(table) < _FARTHEST_M) & ((table == 0.0) | (np.abs(table) > 1e-12))
    if plausible.all(axis=1).mean() < 0.5:
        raise BadInputError(
            f"{path} does not hold float32 x, y, z, intensity: most of its coordinates are not within "
            f"{_FARTHEST_M:,.0f} m. Is it another kind of file?"
        )
