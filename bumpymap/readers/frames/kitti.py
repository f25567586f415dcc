"""Read KITTI-style scans: ``.bin`` files of float32 x, y, z, intensity, with ``.label`` files of uint32.

The lower 16 bits of a label are the semantic id. The label file of ``DIR/NAME.bin`` is in the same folder, or in a
folder beside ``DIR``: ``labels`` (SemanticKITTI) or ``os1_cloud_node_semantickitti_label_id`` (RELLIS-3D).
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.frames.raw import RawScan, point_seconds
from bumpymap.readers.source import pinned_version, read_range, refuse_count, require_unchanged, size_of, version_of

BIN_COLUMNS = {
    4: "x, y, z, intensity",
    5: "x, y, z, intensity, ring",
    6: "x, y, z, intensity, ring, time",
}
"""Number of columns of a ``.bin`` scan -> what they are."""
POINT_FOLDERS = ("velodyne", "os1_cloud_node_kitti_bin")
"""Folders of ``.bin`` files inside a sequence."""
LABEL_FOLDERS = ("labels", "os1_cloud_node_semantickitti_label_id")
"""Folders of ``.label`` files, beside the folders of points."""
_MOST_RINGS = 1024
_FARTHEST_M = 1e4
"""Beyond the range of any LiDAR on a robot: larger coordinates mean that the file holds something else."""


def read_kitti(path: Path, columns: int | None = None) -> RawScan:
    """Read a ``.bin`` file, and its labels if there are any.

    Parameters
    ----------
    path : Path
    columns : int, optional
        4 (x, y, z, intensity), 5 (and ring) or 6 (and time); None: found from the values.

    Raises
    ------
    BadInputError
        The file is empty, truncated or not a scan, its number of columns is in doubt, or the label file does not
        match it.
    """
    size = size_of(path)
    if size == 0 or size % 4:
        raise BadInputError(
            f"{path} has {size:,} bytes, and a scan is one or more float32: it is truncated or not a KITTI-style scan. "
            "Copy it again, or convert it to PLY"
        )
    values = _whole(path, size).view("<f4")
    with np.errstate(invalid="ignore"):
        plausible = np.isnan(values) | (np.abs(values) < _FARTHEST_M) & ((values == 0.0) | (np.abs(values) > 1e-12))
    if plausible.mean() < 0.5:
        raise BadInputError(
            f"{path} does not hold float32 x, y, z, intensity: most of its values are not within {_FARTHEST_M:,.0f} m. "
            "Is it another kind of file?"
        )
    table = values.reshape(-1, _find_columns(path, values, columns))
    labels = label_file(path)
    ids = None if labels is None else _read_labels(labels, path, len(table))
    seconds = point_seconds(table[:, 5]) if table.shape[1] == 6 and _is_ring(table[:, 4]) else None
    return RawScan(table[:, :3], table[:, 3], ids, seconds)


def _find_columns(path: Path, values: NDArray[np.float32], columns: int | None) -> int:
    """Return the number of columns: what the user says, or the only one that size and values fit.

    Where the values fit no number, because of negative intensities or other columns, the user alone can tell.
    """
    fitting = [width for width in BIN_COLUMNS if len(values) % width == 0 and _fits(values.reshape(-1, width))]
    if columns is not None and len(values) % columns == 0 and (columns in fitting or not fitting):
        return columns
    if columns is None and (len(fitting) == 1 or (fitting and not np.nan_to_num(values).any())):
        return fitting[0]
    raise BadInputError(
        f"{path} holds {len(values):,} float32 values, which fit {' or '.join(map(str, fitting)) or 'none'} of 4, 5 or "
        f"6 columns ({'; '.join(f'{width}: {names}' for width, names in BIN_COLUMNS.items())}): "
        f"{'more than one' if columns is None and fitting else 'is it truncated, or of another kind'}? Say which they "
        "are with `columns`, copy it again, or convert it to PLY"
    )


def _fits(rows: NDArray[np.float32]) -> bool:
    """Return whether rows have an intensity of at least 0 and, if there are more columns, a ring.

    In rows of another width, coordinates stand there in some rows: these are below 0, or no whole numbers. If all rows
    are beams without return, there are no points that could be misread.
    """
    with np.errstate(invalid="ignore"):
        fits = bool((rows[:, 3] >= 0.0).all()) and (rows.shape[1] == 4 or _is_ring(rows[:, 4]))
    return fits or not np.nan_to_num(rows[:, :3]).any()


def _is_ring(column: NDArray[np.float32]) -> bool:
    with np.errstate(invalid="ignore"):
        return bool(((column >= 0.0) & (column < _MOST_RINGS) & (column == np.rint(column))).all())


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
    if size != 4 * count:
        raise BadInputError(
            f"{labels} has {size:,} bytes; {path} has {count:,} points, whose labels take {4 * count:,}. They do not "
            "belong together: copy both again, or remove the label file"
        )
    with pinned_version(labels, version):
        ids = (_whole(labels, size).view("<u4") & 0xFFFF).astype(np.uint16)
    require_unchanged(labels, version)
    return ids
