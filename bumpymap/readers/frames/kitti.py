"""Read KITTI-style scans: ``.bin`` files of float32 x, y, z, intensity, with ``.label`` files of uint32.

The lower 16 bits of a label are the semantic id. The label file of ``DIR/NAME.bin`` is in the same folder, or in a
folder beside ``DIR``: ``labels`` (SemanticKITTI) or ``os1_cloud_node_semantickitti_label_id`` (RELLIS-3D).
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, UsageError
from bumpymap.readers.frames.raw import RawScan, point_seconds
from bumpymap.readers.source import pinned_version, read_range, refuse_count, require_unchanged, size_of, version_of

__all__ = ["BIN_COLUMNS", "POINT_FOLDERS", "find_columns", "label_file", "read_kitti"]

BIN_COLUMNS = {
    4: "x, y, z, intensity",
    5: "x, y, z, intensity, ring",
    6: "x, y, z, intensity, ring, time",
}
"""Number of columns of a ``.bin`` scan -> what they are."""
_MOST_RINGS = 1024
_SAMPLED = 1_024
"""Rows, about, in which files of twice the width are looked for, and the fewest that tell."""
_FEWEST_ROWS, _ALTERNATING = 64, 0.5
"""Rows at least, and least difference of the shares of numbers below zero and of whole ones, in rows that alternate."""


def find_columns(path: Path, values: NDArray[np.float32], columns: int | None) -> int:
    """Return the number of columns of a ``.bin`` scan.

    Parameters
    ----------
    path : Path
        For messages.
    values : (n,) float32
        The whole file; at least one value.
    columns : int, optional
        What the user says. It decides where the values leave doubt.

    Raises
    ------
    UsageError
        ``columns`` is not 4, 5 or 6.
    BadInputError
        The size is no multiple of any width, the values fit another width than the size or ``columns``, or several
        fit.
    """
    if columns is not None:
        return _given(path, values, columns)
    fitting = [width for width in BIN_COLUMNS if len(values) % width == 0]
    if not fitting:
        raise BadInputError(
            f"{path} holds {len(values):,} float32 values, which is no multiple of 4, 5 or 6 columns ({_listed()}): it "
            "is truncated, or another kind of file. Copy it again, or convert it to PLY"
        )
    likely = [width for width in BIN_COLUMNS if _fits(values, width)]
    found = [width for width in fitting if width in likely]
    if not found:
        what = f"lie in {likely[0]} columns of float32" if likely else "fit none of these columns"
        raise BadInputError(
            f"the values of {path} {what}, and its size of {4 * len(values):,} bytes "
            f"fits {' or '.join(map(str, fitting))} columns ({_listed()}): is it truncated, or of another kind? Copy "
            f"it again, or convert it to PLY. If that is wrong, say `columns={fitting[0]}`"
        )
    if len(found) > 1 and np.nan_to_num(values).any():
        raise BadInputError(
            f"{path} may have {' or '.join(map(str, found))} columns of float32: its size fits each of them, and its "
            f"values do not tell which. Say it: `columns={found[0]}` ({_listed()})"
        )
    _refuse_double_rows(path, values.reshape(-1, found[0]))
    return found[0]


def _given(path: Path, values: NDArray[np.float32], columns: int) -> int:
    count = len(values)
    if columns not in BIN_COLUMNS:
        raise UsageError(f"`columns` is {columns}; a .bin scan has {_listed()}")
    if count % columns:
        raise BadInputError(
            f"{path} has {4 * count:,} bytes, which is no multiple of the {4 * columns} bytes of a point of {columns} "
            "columns (`columns`): it is truncated, or has another number of columns"
        )
    likely = [width for width in BIN_COLUMNS if count % width == 0 and _fits(values, width)]
    if likely and columns not in likely:
        raise BadInputError(
            f"the values of {path} lie in {likely[0]} columns of float32, not in {columns}, as `columns` says "
            f"({_listed()}). Say `columns={likely[0]}`, or leave it out: it is found from the values"
        )
    return columns


def _listed() -> str:
    return "; ".join(f"{width}: {names}" for width, names in BIN_COLUMNS.items())


def _fits(values: NDArray[np.float32], width: int) -> bool:
    """Return whether rows of a width have an intensity of at least 0 and, if there are more columns, a ring.

    In rows of another width, coordinates stand there in some rows: these are below 0, or no whole numbers. If all rows
    are beams without return, there are no points that could be misread.
    """
    rows = values[: len(values) // width * width].reshape(-1, width)
    with np.errstate(invalid="ignore"):
        ring = rows[:, 4] if width > 4 else np.zeros(1, np.float32)
        is_ring = (ring >= 0.0) & (ring < _MOST_RINGS) & (ring == np.rint(ring))
        fits = bool((rows[:, 3] >= 0.0).all() and is_ring.all())
    return fits or not np.nan_to_num(rows[:, :3]).any()


def _refuse_double_rows(path: Path, table: NDArray[np.float32]) -> None:
    """Refuse files of twice the columns of a table: x and y of its even and odd rows are not both coordinates."""
    width = table.shape[1]
    pairs = table[: len(table) // 2 * 2].reshape(-1, 2, width)[:: max(len(table) // 2 // _SAMPLED, 1), :, :2]
    pairs = pairs[np.isfinite(pairs).all(axis=(1, 2)) & (pairs != 0.0).any(axis=2).all(axis=1)]
    if len(pairs) < _FEWEST_ROWS:
        return
    shares = np.stack([(pairs < 0.0).mean(axis=0), (pairs == np.rint(pairs)).mean(axis=0)])
    if np.abs(shares[:, 0] - shares[:, 1]).max() > _ALTERNATING:
        raise BadInputError(
            f"{path} seems to have {2 * width} columns of float32; write {_listed()}, or PLY. If it has {width}, say "
            f"`columns={width}`"
        )


POINT_FOLDERS = ("velodyne", "os1_cloud_node_kitti_bin")
"""Folders of ``.bin`` files inside a sequence."""
LABEL_FOLDERS = ("labels", "os1_cloud_node_semantickitti_label_id")
"""Folders of ``.label`` files, beside the folders of points."""
_FLOAT_BYTES, _LABEL_BYTES = 4, 4
_WITH_TIME = 6
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
        4 (x, y, z, intensity), 5 (and ring) or 6 (and time); None: found from the values.

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
    ids = None if labels is None else _read_labels(labels, path, len(table))
    seconds = None
    if width == _WITH_TIME:
        ring = table[:, 4]
        with np.errstate(invalid="ignore"):
            is_ring = bool(((ring >= 0.0) & (ring < _MOST_RINGS) & (ring == np.rint(ring))).all())
        seconds = point_seconds(table[:, 5]) if is_ring else None  # else the columns are not ring and time
    return RawScan(table[:, :3], table[:, 3], ids, seconds)


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
