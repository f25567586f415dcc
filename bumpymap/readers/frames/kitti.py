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
_RIVALS = (3, 4, 5, 6, 7)
"""Widths that are compared; a file that fits 3 or 7 is none of ours."""
_STRETCH, _STRETCHES = 840, 6
"""Values of a stretch (a multiple of every rival and of 8), and the number of stretches that are looked at."""
_LEVELS = 64
"""Steps to which values are rounded, by their rank; the step after them is for values that are not finite."""
_FEWEST = 56
"""Values per step, at least: 8 for each of 7 columns."""
_SURE_BITS, _SURE_SHARE = 100.0, 0.05
"""A width is sure if it saves this many bits, and this many for each value, against every rival."""
_SAMPLED = 1_024
"""Rows, about, in which files of other widths are looked for."""
_ALIKE, _ALTERNATING = 0.25, 0.5
"""Greatest difference of distributions that are alike; least difference of shares of rows that alternate."""


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
    stretches = _stretches(values)
    likely = [width for width in fitting if _has_no_return(stretches, width)] or _likely_widths(stretches)
    found = [width for width in fitting if width in likely]
    if not found:
        raise BadInputError(
            f"the values of {path} lie in {likely[0]} columns of float32, but its size of {4 * len(values):,} bytes "
            f"fits {' or '.join(map(str, fitting))} columns ({_listed()}): is it truncated, or of another kind? Copy "
            f"it again, or convert it to PLY. If that is wrong, say `columns={fitting[0]}`"
        )
    if len(found) > 1 and np.nan_to_num(stretches).any():
        raise BadInputError(
            f"{path} may have {' or '.join(map(str, found))} columns of float32: its size fits each of them, and its "
            f"values do not tell which. Say it: `columns={found[0]}` ({_listed()})"
        )
    _refuse_other_rows(path, values.reshape(-1, found[0]))
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
    stretches = _stretches(values)
    likely = [columns] if _has_no_return(stretches, columns) else _likely_widths(stretches)
    if columns not in likely and likely[0] in BIN_COLUMNS and count % likely[0] == 0:
        raise BadInputError(
            f"the values of {path} lie in {likely[0]} columns of float32, not in {columns}, as `columns` says "
            f"({_listed()}). Say `columns={likely[0]}`, or leave it out: it is found from the values"
        )
    return columns


def _listed() -> str:
    return "; ".join(f"{width}: {names}" for width, names in BIN_COLUMNS.items())


def _has_no_return(stretches: NDArray[np.float32], width: int) -> bool:
    """Return whether all rows are beams without return: then there are no points that could be misread."""
    rows = stretches[:, : stretches.shape[1] // width * width].reshape(-1, width)[:, :3]
    return not np.nan_to_num(rows).any()


def _likely_widths(stretches: NDArray[np.float32]) -> list[int]:
    """Return the width with the shortest description and those that are not clearly longer."""
    levels = _levels(stretches)
    bits = {width: _bits(levels, width) for width in _RIVALS}
    sure = max(_SURE_BITS / levels.size, _SURE_SHARE)
    ordered = sorted(bits, key=bits.__getitem__)
    return [width for width in ordered if bits[width] - bits[ordered[0]] < sure]


def _stretches(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return stretches from all over the file, (stretches, length); each starts where a row starts at every width."""
    if len(values) <= _STRETCH * _STRETCHES:
        return values[None, :]
    starts = np.unique(np.linspace(0, len(values) - _STRETCH, _STRETCHES).astype(np.int64) // _STRETCH * _STRETCH)
    stretches: NDArray[np.float32] = values[starts[:, None] + np.arange(_STRETCH)]
    return stretches


def _levels(stretches: NDArray[np.float32]) -> NDArray[np.int64]:
    """Round values to at most ``_LEVELS`` steps that hold about equally many of them."""
    finite = np.isfinite(stretches)
    values = np.where(finite, stretches, np.float32(0.0))
    steps = min(max(values.size // _FEWEST, 2), _LEVELS)
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, steps + 1)[1:-1], method="nearest"))
    return np.where(finite, np.searchsorted(edges, values, side="right"), _LEVELS)


def _bits(levels: NDArray[np.int64], width: int) -> float:
    """Return the bits per value that describe a table of so many columns.

    Each column is described by how often each step occurs in it, or by how often each change from row to row occurs,
    whichever is shorter.
    """
    rows = levels[:, : levels.shape[1] // width * width].reshape(len(levels), -1, width)
    changes = rows[:, 1:] - rows[:, :-1] + _LEVELS
    shorter = np.minimum(_code_length(rows, _LEVELS + 1), _code_length(changes, 2 * _LEVELS + 1))
    return float(shorter.sum() / width)


def _code_length(table: NDArray[np.int64], kinds: int) -> NDArray[np.float64]:
    """Return the bits per value of each column of a table (.., columns) of numbers below ``kinds``.

    This is the entropy with the correction of Miller and Madow; without it, columns with fewer values seem simpler.
    """
    columns, each = table.shape[-1], max(table.size // table.shape[-1], 1)
    places = (table + kinds * np.arange(columns)).ravel()
    share = np.bincount(places, minlength=columns * kinds).reshape(columns, kinds) / each
    entropy = -(share * np.log2(np.where(share > 0.0, share, 1.0))).sum(axis=1)
    bits: NDArray[np.float64] = entropy + ((share > 0.0).sum(axis=1) - 1) / (2.0 * np.log(2.0) * each)
    return bits


def _refuse_other_rows(path: Path, table: NDArray[np.float32]) -> None:
    """Refuse files of 3 columns read with 6, and of twice the columns of the table."""
    width = table.shape[1]
    rows = table[:: max(len(table) // _SAMPLED, 1)]
    halves = np.stack([rows[:, :2], rows[:, 3:5]]) if width == 6 else np.empty((2, 0, 2))
    pairs = table[: len(table) // 2 * 2].reshape(-1, 2, width)[:: max(len(table) // 2 // _SAMPLED, 1), :, :2]
    other = 0
    if _alike(*halves):
        other = 3
    elif _alternate(pairs):
        other = 2 * width
    if other:
        raise BadInputError(
            f"{path} seems to have {other} columns of float32; write {_listed()}, or PLY. If it has {width}, say "
            f"`columns={width}`"
        )


def _alike(one: NDArray[np.float32], two: NDArray[np.float32]) -> bool:
    """Return whether x and y of one table are distributed as those of another."""
    seen = np.isfinite(one).all(axis=1) & np.isfinite(two).all(axis=1) & (one != 0.0).any(axis=1)
    if seen.sum() < _LEVELS:
        return False
    tenths = np.linspace(0.05, 0.95, 10)
    first, second = (np.quantile(half[seen], tenths, axis=0) for half in (one, two))
    return bool((np.abs(first - second).max(axis=0) <= _ALIKE * np.ptp(first, axis=0)).all())


def _alternate(pairs: NDArray[np.float32]) -> bool:
    """Return whether x and y of even and odd rows, (n, 2, 2), are not both coordinates."""
    pairs = pairs[np.isfinite(pairs).all(axis=(1, 2)) & (pairs != 0.0).any(axis=2).all(axis=1)]
    if len(pairs) < _LEVELS:
        return False
    shares = np.stack([(pairs < 0.0).mean(axis=0), (pairs == np.rint(pairs)).mean(axis=0)])
    return bool(np.abs(shares[:, 0] - shares[:, 1]).max() > _ALTERNATING)


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
