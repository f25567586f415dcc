"""Read a file of poses: KITTI, TUM, CSV, or an export of TF.

KITTI has twelve numbers per line: the upper three rows of the matrix that transforms points from the sensor frame to
the world frame. TUM has eight: time, place, quaternion (x, y, z, w). A CSV file has a header with one of these sets of
columns in any order, and perhaps a time: ``x y z qx qy qz qw`` (metres and a quaternion; also as ROS tools name them:
``translation.x``, ``pose.position.x``, ``rotation.w``) or ``T00 T01 .. T23`` (the same matrix). ``ros2 topic echo --csv
/tf`` writes lines without header: seconds, nanoseconds, parent frame, child frame, place, quaternion.
"""

import csv
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.frames.time_text import seconds_of_words
from bumpymap.readers.source import open_source

__all__ = ["PoseFile", "from_quaternions", "read_pose_file"]

_PLACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MATRIX = tuple(f"t{row}{column}" for row in range(3) for column in range(4))
_TIME = ("time", "stamp", "timestamp", "t", "sec", "secs", "seconds", "__time", "%time")
_SYNONYMS = {"tx": "x", "ty": "y", "tz": "z"}
_NANOSECONDS = ("nanosec", "nsecs", "nsec", "nanosecs")
_TF_WORDS = 11
"""Words of a transform in an export of TF."""
_FORMATS = "Poses are KITTI (12 numbers), TUM (8: time, x, y, z, qx, qy, qz, qw), or CSV with a header"
_ROUNDING = 0.02
"""Tolerance of rotation matrices and quaternions: some files have only three decimals."""


class PoseFile(NamedTuple):
    """The poses of a file."""

    times: NDArray[np.float64] | None
    """(n,) s, as in the file; None if it has none."""
    poses: NDArray[np.float64]
    """(n, 4, 4) transforms from the sensor frame to the world frame, m."""
    is_kitti: bool = False
    """Whether the file is in the format of KITTI, whose own poses are those of a camera."""


def read_pose_file(path: Path) -> PoseFile:
    """Read all poses of a file.

    Raises
    ------
    BadInputError
        The file cannot be read, holds invalid poses, or transforms of several frames.
    """
    with open_source(path) as stream:
        data = stream.read()
    if b"\0" in data:
        raise BadInputError(f"{path} is not a text file. {_FORMATS}")
    text = data.decode("utf-8-sig", "replace")
    lines = [line for line in text.splitlines() if line.strip()]
    head = lines[0].lstrip("#% ") if lines else ""
    rows = [line for line in lines if not line.lstrip().startswith("#")]
    if not rows:
        raise BadInputError(f"{path} is empty; it must have one line per pose")
    if _is_tf(rows[0]):
        found = _from_tf(path, rows)
    elif _has_letters(rows[0]):
        found = _from_csv(path, rows)
    elif {_plain(name) for name in head.split(",")} >= set(_PLACE):  # the header is a remark
        found = _from_csv(path, [head, *rows])
    else:
        found = _from_numbers(path, rows)
    _make_rigid(path, found.poses)
    return found


def _has_letters(line: str) -> bool:
    return any(letter.isalpha() and letter not in "eEnaifNAIF" for letter in line)


def _from_numbers(path: Path, lines: list[str]) -> PoseFile:
    words = [line.replace(",", " ").split() for line in lines]
    if len(words[0]) == len(_PLACE) + 1:
        table = _numbers(path, words, len(_PLACE) + 1)
        return PoseFile(seconds_of_words([row[0] for row in words]), from_quaternions(path, table[:, 1:]))
    return PoseFile(None, _from_matrices(_numbers(path, words, len(_MATRIX))), is_kitti=True)


def _from_csv(path: Path, lines: list[str]) -> PoseFile:
    try:
        head, *rows = ([word.strip() for word in row] for row in csv.reader(lines))
    except csv.Error as error:
        raise BadInputError(f"{path} is not CSV: {error}") from error
    names = [_plain(name) for name in head]
    wanted = next((kind for kind in (_PLACE, _MATRIX) if set(kind) <= set(names)), None)
    if wanted is None:
        raise BadInputError(
            f"{path} has the columns {', '.join(head)[:300]}; poses need {', '.join(_PLACE)}, or T00, T01 to T23"
        )
    table = _numbers(path, rows, len(names))[:, [names.index(name) for name in wanted]]
    poses = from_quaternions(path, table) if wanted is _PLACE else _from_matrices(table)
    _refuse_several(path, head, rows)
    return PoseFile(_times_of(head, rows), poses)


def _plain(name: str) -> str:
    """Return the short name of a column: ``field.transform.rotation.x`` is ``qx``."""
    parts = re.split(r"[./: ]+", name.strip().lower())
    turned = len(parts) > 1 and parts[-2] in {"rotation", "orientation", "quaternion", "q"} and len(parts[-1]) == 1
    return f"q{parts[-1]}" if turned else _SYNONYMS.get(parts[-1], parts[-1])


def _times_of(head: list[str], rows: list[list[str]]) -> NDArray[np.float64] | None:
    names = [_plain(name) for name in head]
    place = next((names.index(name) for name in _TIME if name in names), None)
    if place is None:
        return None
    rest = next((names.index(name) for name in _NANOSECONDS if name in names[place + 1 :]), None)
    if rest is not None and rest != place:
        whole, part = (seconds_of_words([row[column] for row in rows], unit=1.0) for column in (place, rest))
        return None if whole is None or part is None else whole + part * 1e-9
    return seconds_of_words([row[place] for row in rows])


def _refuse_several(path: Path, head: list[str], rows: list[list[str]]) -> None:
    """Refuse transforms of several frames: one after another, they are no drive."""
    names = [_plain(name) for name in head]
    for name in ("child_frame_id", "frame_id"):
        column = names.index(name) if name in names else None
        found = [] if column is None else sorted({row[column] for row in rows})
        if len(found) > 1:
            raise BadInputError(
                f"{path} holds the poses of several frames ({name}: {', '.join(found)[:200]}); keep the rows of one: "
                "those of the LiDAR in the fixed frame of the world"
            )


def _is_tf(line: str) -> bool:
    words = [word.strip() for word in line.split(",")]
    return len(words) % _TF_WORDS == 0 and words[0].isdigit() and words[1].isdigit() and _has_letters(words[3])


def _from_tf(path: Path, lines: list[str]) -> PoseFile:
    head = ["sec", "nanosec", "frame_id", "child_frame_id", *_PLACE]
    rows = []
    for line in lines:
        words = [word.strip() for word in line.split(",")]
        rows += [words[first : first + _TF_WORDS] for first in range(0, len(words), _TF_WORDS)]
    return _from_csv(path, [",".join(row) for row in [head, *rows]])


def _numbers(path: Path, rows: list[list[str]], width: int) -> NDArray[np.float64]:
    """Convert text to a table; a word that is not a number (a time, a name) becomes NaN, which no pose may contain."""
    table = np.empty((len(rows), width))
    for number, row in enumerate(rows):
        if len(row) != width:
            raise BadInputError(f"pose {number} of {path} has {len(row)} numbers; {width} are required. {_FORMATS}")
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


def from_quaternions(path: Path | str, table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the transforms (n, 4, 4) of places (m) and quaternions, (n, 7): x, y, z, qx, qy, qz, qw.

    Raises
    ------
    BadInputError
        A quaternion is invalid; ``path`` says where the poses are from.
    """
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
    if not len(poses):
        raise BadInputError(f"{path} holds no poses; it must have one line per pose")
    _refuse_first(path, ~np.isfinite(np.abs(poses).max(axis=(1, 2))), "something that is not a finite number")
    turn = poses[:, :3, :3]
    error = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    _refuse_first(path, (error > _ROUNDING) | (np.linalg.det(turn) < 0.0), "a matrix that is not a rotation")
    left, _, right = np.linalg.svd(turn)
    poses[:, :3, :3] = left @ right


def _refuse_first(path: Path | str, bad: NDArray[np.bool_], what: str) -> None:
    if bad.any():
        raise BadInputError(
            f"pose {int(bad.argmax()):,} of {path} (counted from 0) has {what}; {int(bad.sum()):,} of {len(bad):,} do"
        )
