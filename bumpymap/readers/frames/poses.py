"""Read the pose of the sensor at each frame.

KITTI's ``poses.txt`` has twelve numbers per line: the upper three rows of the matrix that transforms points from the
sensor frame to the world frame. A CSV file has a header and one line per frame, with one of these sets of columns in
any order (others, such as a time stamp, are ignored): ``x y z qx qy qz qw`` (metres and a quaternion) or
``T00 T01 .. T23`` (the same matrix). The poses must be those of the LiDAR, not of a camera or of the robot's base.
"""

import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.source import open_source

__all__ = ["read_poses"]

_PLACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MATRIX = tuple(f"t{row}{column}" for row in range(3) for column in range(4))
_ROUNDING = 0.02
"""Tolerance of rotation matrices and quaternions: some files have only three decimals."""


def read_poses(path: Path, count: int) -> NDArray[np.float64]:
    """Read the pose of each of ``count`` frames.

    Returns
    -------
    (count, 4, 4) float64
        Transforms from the sensor frame to the world frame, m.

    Raises
    ------
    BadInputError
        The file cannot be read, holds another number of poses, or invalid poses.
    """
    with open_source(path) as stream:
        text = stream.read().decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise BadInputError(f"{path} is empty; it must have one line per frame")
    has_header = any(letter.isalpha() and letter not in "eEnaifNAIF" for letter in lines[0])
    words = [line.split() for line in lines]
    poses = _from_csv(path, lines) if has_header else _from_matrices(_numbers(path, words, 12))
    if len(poses) != count:
        raise BadInputError(
            f"{path} holds {len(poses):,} poses, but there are {count:,} frames; there must be one pose per frame, "
            "in order of time. Does the file belong to another drive, or are frames missing?"
        )
    _make_rigid(path, poses)
    return poses


def _from_csv(path: Path, lines: list[str]) -> NDArray[np.float64]:
    head, *rows = ([word.strip() for word in row] for row in csv.reader(lines))
    names = [name.lower() for name in head]
    wanted = next((kind for kind in (_PLACE, _MATRIX) if set(kind) <= set(names)), None)
    if wanted is None:
        raise BadInputError(
            f"{path} has the columns {', '.join(head)}; poses need {', '.join(_PLACE)}, or T00, T01 to T23"
        )
    table = _numbers(path, rows, len(names))[:, [names.index(name) for name in wanted]]
    return _from_quaternions(path, table) if wanted is _PLACE else _from_matrices(table)


def _numbers(path: Path, rows: list[list[str]], width: int) -> NDArray[np.float64]:
    """Convert text to a table; a word that is not a number (a time, a name) becomes NaN, which no pose may contain."""
    table = np.empty((len(rows), width))
    for number, row in enumerate(rows):
        if len(row) != width:
            raise BadInputError(f"pose {number} of {path} has {len(row)} numbers; {width} are required")
        for column, word in enumerate(row):
            try:
                table[number, column] = float(word)
            except ValueError:
                table[number, column] = np.nan
    return table


def _from_matrices(table: NDArray[np.float64]) -> NDArray[np.float64]:
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3] = table.reshape(-1, 3, 4)
    return poses


def _from_quaternions(path: Path, table: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(table[:, 3:], axis=1)
    far = np.abs(length - 1.0)
    _refuse_first(path, np.isnan(far) | (far > _ROUNDING), "a quaternion whose length is not 1")
    x, y, z, w = (table[:, 3:] / length[:, None]).T
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, 3] = table[:, :3]
    poses[:, 0, :3] = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], axis=1)
    poses[:, 1, :3] = np.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], axis=1)
    poses[:, 2, :3] = np.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], axis=1)
    return poses


def _make_rigid(path: Path, poses: NDArray[np.float64]) -> None:
    """Refuse invalid poses; replace each rotation, rounded in the file, by the nearest exact one."""
    _refuse_first(path, ~np.isfinite(np.abs(poses).max(axis=(1, 2))), "something that is not a finite number")
    turn = poses[:, :3, :3]
    error = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    _refuse_first(path, (error > _ROUNDING) | (np.linalg.det(turn) < 0.0), "a matrix that is not a rotation")
    left, _, right = np.linalg.svd(turn)
    poses[:, :3, :3] = left @ right


def _refuse_first(path: Path, bad: NDArray[np.bool_], what: str) -> None:
    if bad.any():
        raise BadInputError(
            f"pose {int(bad.argmax()):,} of {path} (counted from 0) has {what}; {int(bad.sum()):,} of {len(bad):,} do"
        )
