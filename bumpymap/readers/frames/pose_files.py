"""Poses of a sensor over time: from files of several formats, and from the transforms in the messages of a bag."""

import csv
import re
from array import array
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PoseTrack
from bumpymap.readers.source import open_source

__all__ = [
    "FIXED_FRAMES",
    "FrameTree",
    "PoseFile",
    "Trajectory",
    "calib_beside",
    "frame_name",
    "in_lidar_frame",
    "read_pose_file",
    "refuse_wrong_frame",
    "seconds_of_names",
    "seconds_of_words",
    "seconds_since",
]

_EPOCH = ((1e8, 1e10, 1.0), (1e11, 1e13, 1e-3), (1e14, 1e16, 1e-6), (1e17, 1e19, 1e-9))
"""From, to, unit in seconds: times since 1970 (from 1973 on) tell their unit by their size."""
_DATE = re.compile(r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(\.\d+)?Z?")
_STAMP = re.compile(r"(?<!\d)(?:(\d{9,10})([._])(\d{1,9})|(\d{13}|\d{16}|\d{19}))(?!\d)")
_WHOLE = re.compile(r"(?<!\d)\d{10}(?!\d)")


def seconds_of_words(words: Sequence[str], unit: float | None = None) -> NDArray[np.float64] | None:
    """Return the times that words hold, (n,) s; None if any is neither a number nor a date.

    Parameters
    ----------
    words : sequence of str
        Numbers, or dates such as ``2011-09-26 13:02:25.594360375``.
    unit : float, optional
        Unit of the numbers, s. None: found from their size if they are times since 1970; otherwise seconds.
    """
    if words and all(_DATE.fullmatch(word.strip()) for word in words):
        try:
            stamps = np.array([word.strip().rstrip("Z").replace(" ", "T") for word in words], "datetime64[ns]")
        except ValueError:  # the 31st of February
            return None
        return stamps.astype(np.int64).astype(np.float64) * 1e-9
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        return None
    if not len(numbers) or not np.isfinite(numbers).all():
        return None
    return numbers * (_unit_of(numbers) if unit is None else unit)


def _unit_of(numbers: NDArray[np.float64]) -> float:
    middle = float(np.median(numbers))
    return next((unit for least, most, unit in _EPOCH if least <= middle < most), 1.0)


def seconds_of_names(names: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the times in the names of files, (n,) s since 1970; None if any has none.

    A time is seconds with a fraction (``1666877643.267394304``), seconds and nanoseconds (``1666877643_267394304``), or
    one number in s, ms, us or ns.
    """
    found = [_STAMP.search(name) or _WHOLE.search(name) for name in names]
    if not names or not all(found):
        return None
    matches = [match for match in found if match is not None]
    parts = [match.group(3) if match.re is _STAMP and match.group(3) else "" for match in matches]
    separated = {match.group(2) for match, part in zip(matches, parts, strict=True) if part}
    if separated and len(separated) + (not all(parts)) > 1:
        return None
    if separated == {"_"}:  # a whole number of ms, us or ns, perhaps without its zeros in front
        digits = next(size for size in (3, 6, 9) if max(map(len, parts)) <= size)
        times = np.array([int(m.group(1)) + int(m.group(3)) / 10**digits for m in matches])
    else:
        times = np.array([float(match.group()) for match in matches])
        times = times * _unit_of(times)
    return times if (times > _EPOCH[0][0]).all() else None


_PLACE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_MATRIX = tuple(f"t{row}{column}" for row in range(3) for column in range(4))
_TIME = ("time", "stamp", "timestamp", "t", "sec", "secs", "seconds", "__time", "%time")
_SYNONYMS = {"tx": "x", "ty": "y", "tz": "z"}
_NANOSECONDS = ("nanosec", "nsecs", "nsec", "nanosecs")
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
    """True if the file is in the format of KITTI, whose own poses are those of a camera."""


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
    if _has_letters(rows[0]):
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


CALIB_NAME = "calib.txt"
_STEP_M = 0.5
"""Way after which the direction of motion is measured."""
_LEAST_WAY_M = 3.0
"""Shorter drives do not tell their frame."""
_MOST_ALONG_Z, _CAMERA_ALONG_Z = 0.3, 0.7
"""Share of the way along z: at most this for a LiDAR, at least this for a camera."""
_LEAST_UP = 0.3
"""Least mean of the z axes' upward component: the mean tilt of a sensor is below 72 degrees."""


def calib_beside(folders: Sequence[Path]) -> Path | None:
    """Return KITTI's ``calib.txt`` in the first of some folders that has it; None if none has."""
    return next((folder / CALIB_NAME for folder in folders if (folder / CALIB_NAME).is_file()), None)


def in_lidar_frame(poses: NDArray[np.float64], calib: Path, *, is_kitti: bool) -> NDArray[np.float64] | None:
    """Turn poses of the left camera into those of the LiDAR.

    Parameters
    ----------
    poses : (n, 4, 4)
    calib : Path
        A file with the line ``Tr:``, the transform from the LiDAR to the camera.
    is_kitti : bool
        Whether the poses are in KITTI's format, whose poses are of the camera unless their motion shows otherwise.

    Returns
    -------
    (n, 4, 4) or None
        In the frame of the first LiDAR pose. None if the poses move like those of a LiDAR, or ``calib`` has no ``Tr:``.

    Raises
    ------
    BadInputError
        ``Tr:`` is not a transform.
    """
    along_z = _share_along_z(poses)
    is_camera = is_kitti if along_z is None else along_z > (_MOST_ALONG_Z if is_kitti else _CAMERA_ALONG_Z)
    transform = _read_transform(calib) if is_camera else None
    if transform is None:
        return None
    turned: NDArray[np.float64] = np.linalg.inv(transform) @ poses @ transform
    return turned


def refuse_wrong_frame(path: Path, poses: NDArray[np.float64]) -> None:
    """Raise BadInputError if the poses are those of a camera, or their z axes do not point up."""
    along_z = _share_along_z(poses)
    if along_z is not None and along_z > _CAMERA_ALONG_Z:
        raise BadInputError(
            f"{path} holds the poses of a camera: {along_z:.0%} of the way goes along their z axis, but the z axis of "
            f"a LiDAR points up. KITTI: put the sequence's {CALIB_NAME} (with the line Tr:) beside it. Otherwise "
            "convert the poses to those of the LiDAR: pose of the camera times the transform from LiDAR to camera"
        )
    upward = float(poses[:, 2, 2].mean())
    if upward < _LEAST_UP:
        raise BadInputError(
            f"{path}: the z axis of the LiDAR does not point up in the world of the poses (mean upward component "
            f"{upward:.2f}; 1 is upright). Is the world that of a camera (y down) or NED (z down), are the transforms "
            "inverted, or do quaternions begin with w instead of x? Convert the poses: x forward, y left, z up, from "
            "the LiDAR to the world"
        )


def _share_along_z(poses: NDArray[np.float64]) -> float | None:
    """Return the share of the way along the z axis of the poses, 0..1; None if the way is too short to tell."""
    places = poses[:, :3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    steps = np.floor(way / _STEP_M)
    marks = np.unique([0, *np.flatnonzero(np.diff(steps) > 0.0) + 1, len(way) - 1])
    moved = np.diff(places[marks], axis=0)
    lengths = np.linalg.norm(moved, axis=1)
    if lengths.sum() < _LEAST_WAY_M:
        return None
    ahead = np.einsum("nij,ni->nj", poses[marks[:-1], :3, :3], moved)
    return float(np.abs(ahead[:, 2]).sum() / lengths.sum())


def _read_transform(calib: Path) -> NDArray[np.float64] | None:
    with open_source(calib) as stream:
        lines = stream.read(1 << 16).decode("utf-8", "replace").splitlines()
    line = next((line for line in lines if line.strip().lower().startswith("tr:")), None)
    if line is None:
        return None
    transform = np.eye(4)
    try:
        transform[:3] = np.array([float(word) for word in line.split(":", 1)[1].split()]).reshape(3, 4)
    except ValueError:
        transform[:] = np.nan
    turn = transform[:3, :3]
    if not np.isfinite(transform).all() or np.abs(turn @ turn.T - np.eye(3)).max() > _ROUNDING:
        raise BadInputError(f"the line Tr: of {calib} is not a transform: it must be twelve numbers, a 3 x 4 matrix")
    return transform


FIXED_FRAMES = ("map", "odom")
"""Coordinate frames that a drive can be mapped in; the first one that is known is taken (REP-105)."""


def frame_name(name: str) -> str:
    """Return the name of a coordinate frame without the slash that older drivers put before it."""
    return name.strip("/")


def seconds_since(origin_ns: int, times_ns: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return times in seconds after an origin; equal times stay equal."""
    seconds: NDArray[np.float64] = (times_ns - origin_ns) * np.float64(1e-9)
    return seconds


class Trajectory:
    """The transform from one coordinate frame to another over time; 64 bytes a sample.

    Parameters
    ----------
    name : str
        For messages.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self._times = array("q")
        self._rows = array("d")

    def add(self, stamp: Any, place: Any, turn: Any) -> None:
        """Add a sample: time (``sec``, ``nanosec``), place (``x`` to ``z``, m) and quaternion (``x`` to ``w``)."""
        self._times.append(stamp.sec * 1_000_000_000 + stamp.nanosec)
        self._rows.extend((place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w))

    def track(self, origin_ns: int) -> PoseTrack:
        """Return the samples in the order of time, in seconds after an origin; of equal times the last one counts.

        Raises
        ------
        BadInputError
            A sample is not finite, or the length of its quaternion is not 1.
        """
        times, rows = np.frombuffer(self._times, np.int64), np.frombuffer(self._rows, np.float64).reshape(-1, 7)
        if not np.isfinite(rows).all():
            raise BadInputError(f"{self._name} holds a transform that is not finite")
        order = np.argsort(times, kind="stable")
        order = order[np.append(np.diff(times[order]) > 0, True)]
        return PoseTrack(seconds_since(origin_ns, times[order]), from_quaternions(self._name, rows[order]))


class FrameTree:
    """The coordinate frames of ``/tf`` and ``/tf_static``, each with its parent."""

    def __init__(self) -> None:
        self._parent: dict[str, str] = {}
        self._static: dict[str, Trajectory] = {}
        self._moving: dict[str, Trajectory] = {}

    def add(self, message: Any, *, static: bool) -> None:
        """Add the transforms of a message ``tf2_msgs/TFMessage``."""
        for each in message.transforms:
            child = frame_name(each.child_frame_id)
            self._parent[child] = frame_name(each.header.frame_id)
            if static:
                self._static.pop(child, None)  # the last one counts
            samples = self._static if static else self._moving
            part = each.transform
            samples.setdefault(child, Trajectory(f"tf of {child}")).add(
                each.header.stamp, part.translation, part.rotation
            )

    def mount(self, base: str, sensor: str) -> NDArray[np.float64] | None:
        """Return the fixed transform (4, 4) from a sensor to the base; None if it is unknown or the sensor moves."""
        if base == sensor:
            return np.eye(4)
        up, down = self._ancestors(sensor), self._ancestors(base)
        common = next((frame for frame in up if frame in down), None)
        if common is None:
            return None
        ways = [way[: way.index(common)] for way in (up, down)]
        if any(frame in self._moving for way in ways for frame in way):
            return None
        ends = [_product([self._fixed(frame) for frame in way]) for way in ways]
        pose: NDArray[np.float64] = np.linalg.inv(ends[1]) @ ends[0]
        return pose

    def track(self, sensor: str, origin_ns: int, times: NDArray[np.float64]) -> PoseTrack | None:
        """Return the poses of a sensor in a fixed frame.

        Parameters
        ----------
        sensor : str
            Its coordinate frame.
        origin_ns : int
        times : (n,) float64
            Times at which poses are wanted, s after the origin.

        Returns
        -------
        PoseTrack or None
            At these times and at those of all transforms between, as far as all of them are known. None if the sensor
            is not connected with a fixed frame, or at no such time.
        """
        chain = self._ancestors(sensor)
        fixed = next((frame for frame in FIXED_FRAMES if frame in chain[1:]), None)
        if fixed is None:
            return None
        links = chain[: chain.index(fixed)]
        moving = {frame: self._moving[frame].track(origin_ns) for frame in links if frame in self._moving}
        times = np.unique(np.concatenate([times, *(track.times for track in moving.values())]))
        for track in moving.values():
            times = times[track.covers(times)]
        if not len(times):
            return None
        steps = [moving[frame].at(times) if frame in moving else self._fixed(frame) for frame in links]
        return PoseTrack(times, np.broadcast_to(_product(steps), (len(times), 4, 4)))

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on up to the root."""
        found = [frame]
        while (parent := self._parent.get(found[-1])) is not None and parent not in found:
            found.append(parent)
        return found

    def _fixed(self, frame: str) -> NDArray[np.float64]:
        """Return the fixed transform (4, 4) from a frame to its parent."""
        transform: NDArray[np.float64] = self._static[frame].track(0).poses[-1]
        return transform


def _product(steps: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Multiply transforms, (4, 4) or (n, 4, 4), each from a frame to its parent, beginning with the lowest frame."""
    product = np.eye(4)
    for step in steps:
        product = step @ product
    return product
