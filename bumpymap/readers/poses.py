"""The pose of the sensor at each frame, from a file of poses: KITTI or TUM.

Poses and frames that both have times are matched by time: the poses may have another rate, and are interpolated. Others
must be as many as the frames, in the same order.
"""

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import LONGEST_GAP_S, NEAREST_S, SCAN_S, BadInputError, Frame, PoseTrack
from bumpymap.readers.scans import POINT_FOLDERS, find_frames
from bumpymap.readers.source import open_source
from bumpymap.readers.transforms import ROUNDING, from_quaternions, refuse_poses

_log = logging.getLogger(__name__)

_EPOCH = ((1e8, 1e10, 1.0), (1e11, 1e13, 1e-3), (1e14, 1e16, 1e-6), (1e17, 1e19, 1e-9))
"""From, to, unit in seconds: times since 1970 (from 1973 on) tell their unit by their size."""
_STAMP = re.compile(r"(?<!\d)(?:(\d{9,10})([._])(\d{1,9})|(\d{13}|\d{16}|\d{19}))(?!\d)")
_WHOLE = re.compile(r"(?<!\d)\d{10}(?!\d)")
_KITTI, _TUM = 12, 8
"""Numbers of a pose in each format."""
_FORMATS = (
    f"Poses are KITTI ({_KITTI} numbers each) or TUM ({_TUM}: time, x, y, z, qx, qy, qz, qw), without a line of names; "
    "evo_traj makes TUM of those in bags and of EuRoC"
)
_CALIB, _TIMES = "calib.txt", "times.txt"
_POINT_FOLDERS = (*POINT_FOLDERS, "data")
"""Folders of frames inside of a sequence, which holds the files beside them."""
_STEP_M, _LEAST_WAY_M = 0.5, 3.0
"""Way after which the direction of motion is measured; shorter drives do not tell their frame."""
_MOST_ALONG_Z, _CAMERA_ALONG_Z = 0.3, 0.7
"""Share of the way along z: at most this for a LiDAR, at least this for a camera."""
_LEAST_UP = 0.3
"""Least mean of the z axes' upward component: the mean tilt of a sensor is below 72 degrees."""


@dataclass(frozen=True, slots=True)
class FramePoses:
    """The pose of each frame, and the motion around it."""

    poses: NDArray[np.float64]
    """(n, 4, 4) transforms from the sensor frame to the world frame, m."""
    motions: tuple[PoseTrack | None, ...]
    """(n,) poses around each frame, at times relative to the frame's; None if poses or frames have no times."""
    matched_by: Literal["time", "order"]
    """How poses and frames were matched."""
    calib: Path | None
    """The ``calib.txt`` by which poses of a camera were turned into those of the LiDAR; None if they were not."""


_PoseFile = tuple[NDArray[np.float64] | None, NDArray[np.float64], bool]
"""Times of the poses of a file, (n,) s, None if it has none; transforms from the sensor frame to the world frame, m,
(n, 4, 4); whether it is in the format of KITTI, whose own poses are those of a camera."""


def read_poses(path: Path, frames: Sequence[Path], known: NDArray[np.float64] | None = None) -> FramePoses:
    """Read the pose of each frame.

    ``path``: KITTI or TUM. KITTI's ``calib.txt`` beside it or beside the frames is used;
    ``frames``: files of scans; ``known`` (n,) float64: times of the frames, s, if they have none of
    their own: those of messages in a bag. Raises BadInputError: the file cannot be read or holds
    invalid poses; the poses are those of a camera; they cannot be matched with the frames, or do
    not cover their times.
    """
    own_times, poses, is_kitti = _read_file(path)
    poses, calib = _in_lidar_frame(path, poses, _beside(_CALIB, path, frames), is_kitti=is_kitti)
    times, source = known, "their messages"
    if known is None and own_times is not None:
        times, source = _frame_times(frames, _beside(_TIMES, path, frames))
    if own_times is not None and times is not None:
        track = _track(path, own_times, poses)
        missing = ~track.covers(times)
        if missing.any():
            raise BadInputError(
                f"{int(missing.sum()):,} of {len(times):,} frames have no pose, the first is number "
                f"{int(missing.argmax()):,} (counted from 0): there is none within {NEAREST_S} s, nor are there two at "
                f"most {LONGEST_GAP_S} s apart. The poses of {path} span {track.times[0]:.3f} to {track.times[-1]:.3f} "
                f"s, the frames {times.min():.3f} to {times.max():.3f} s (from {source}). Leave these frames out, "
                "complete the poses, or give both the same clock"
            )
        motions = tuple(track.around(time, SCAN_S) for time in times.tolist())
        return FramePoses(track.at(times), motions, "time", calib)
    if len(poses) != len(frames):
        advice = "Does the file belong to another drive, or are frames missing?"
        if own_times is not None:
            advice = "Its poses have times, but the frames have none: give them times.txt, or time stamps as names"
        raise BadInputError(
            f"{path} holds {len(poses):,} poses, but there are {len(frames):,} frames; there must be one pose per "
            f"frame, in order of time. {advice}"
        )
    return FramePoses(poses, (None,) * len(frames), "order", calib)


def place_sources(path: Path, sources: Sequence[Frame]) -> tuple[FramePoses, list[Frame]]:
    """Read the pose of each frame, see `read_poses`; return them, and the sources with them."""
    messages = [source.message for source in sources if source.message is not None]
    known = np.array([message.stamp_ns for message in messages]) * 1e-9 if messages else None
    found = read_poses(path, [source.path for source in sources], known)
    placed = zip(sources, found.poses, found.motions, strict=True)
    return found, [replace(source, pose=pose, motion=motion) for source, pose, motion in placed]


def files_beside_poses(path: Path, frames: Sequence[Path]) -> list[Path]:
    """List the files that are read together with a file of poses: ``calib.txt`` and ``times.txt``."""
    return [file for name in (_CALIB, _TIMES) if (file := _beside(name, path, frames)) is not None]


def _beside(name: str, path: Path, frames: Sequence[Path]) -> Path | None:
    """Return a file in the folder of the frames, in that of their sequence, or beside the poses; None without one."""
    of_frames = [frame.parent for frame in frames[:1]]
    of_sequence = [folder.parent for folder in of_frames if folder.name in _POINT_FOLDERS]
    files = (folder / name for folder in (*of_frames, *of_sequence, path.parent))
    return next((file for file in files if file.is_file()), None)


def _frame_times(frames: Sequence[Path], listed: Path | None) -> tuple[NDArray[np.float64] | None, str]:
    """Return the times of frames, (n,) s, None if they are unknown, and where they are from."""
    named = seconds_of_names([frame.stem for frame in frames])
    if named is not None:
        return named, "the names of the frames"
    if listed is None or len({frame.parent for frame in frames}) != 1:
        return None, ""
    with open_source(listed) as stream:
        lines = stream.read().decode("utf-8-sig", "replace").split("\n")
    times = _seconds([line for line in lines if line.strip()])
    sequence = {file.name: number for number, file in enumerate(find_frames([frames[0].parent]))}
    if times is None or len(times) != len(sequence):
        raise BadInputError(
            f"{listed} is no list of times of the {len(sequence):,} frames in {frames[0].parent}; it must have one "
            "line per frame, with a number of seconds. Copy both again, or remove the list"
        )
    return times[[sequence[frame.name] for frame in frames]], str(listed)


def _seconds(words: Sequence[str]) -> NDArray[np.float64] | None:
    """Return times, (n,) s, of which those since 1970 tell their unit by their size; None if any is no number."""
    try:
        numbers = np.array([float(word) for word in words])
    except ValueError:
        return None
    if not len(numbers) or not np.isfinite(numbers).all():
        return None
    return numbers * _unit_of(numbers)


def _unit_of(numbers: NDArray[np.float64]) -> float:
    middle = float(np.median(numbers))
    return next((unit for least, most, unit in _EPOCH if least <= middle < most), 1.0)


def seconds_of_names(names: Sequence[str]) -> NDArray[np.float64] | None:
    """Return the times in the names of files, (n,) s since 1970; None if any has none.

    A time is seconds with a fraction (``1666877643.267394304``), seconds and nanoseconds (``1666877643_267394304``), or
    one number in s, ms, us or ns.
    """
    matches = [match for name in names if (match := _STAMP.search(name) or _WHOLE.search(name)) is not None]
    if not names or len(matches) < len(names):
        return None
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


def _track(path: Path, times: NDArray[np.float64], poses: NDArray[np.float64]) -> PoseTrack:
    """Return the poses with increasing times; of several at the same time, the first."""
    back = np.flatnonzero(np.diff(times) < 0.0)
    if len(back):
        raise BadInputError(
            f"the times of {path} go back at pose {back[0] + 1:,} (counted from 0), from {times[back[0]]:.3f} s to "
            f"{times[back[0] + 1]:.3f} s; poses must be in the order of time. Are there two drives in the file?"
        )
    first = np.concatenate([[True], np.diff(times) > 0.0])
    return PoseTrack(times[first], poses[first])


def _read_file(path: Path) -> _PoseFile:
    """Read all poses of a file."""
    with open_source(path) as stream:
        data = stream.read()
    if b"\0" in data:
        raise BadInputError(f"{path} is not a text file. {_FORMATS}")
    lines = data.decode("utf-8-sig", "replace").splitlines()
    rows = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not rows:
        raise BadInputError(f"{path} is empty; it must have one line per pose")
    words = [row.replace(",", " ").split() for row in rows]
    width = _TUM if len(words[0]) == _TUM else _KITTI
    wrong = next((number for number, row in enumerate(words) if len(row) != width), None)
    if wrong is not None:
        raise BadInputError(f"pose {wrong} of {path} has {len(words[wrong])} numbers; {width} are required. {_FORMATS}")
    try:
        table = np.array(words, np.float64)
    except ValueError as error:
        raise BadInputError(f"{path} holds something else than numbers: {error}. {_FORMATS}") from error
    if width == _TUM:
        times, poses = _seconds([row[0] for row in words]), from_quaternions(path, table[:, 1:])
    else:
        times, poses = None, np.tile(np.eye(4), (len(table), 1, 1))
        poses[:, :3] = table.reshape(-1, 3, 4)
    _make_rigid(path, poses)
    return times, poses, width == _KITTI


def _make_rigid(path: Path, poses: NDArray[np.float64]) -> None:
    """Refuse invalid poses; replace each rotation, rounded in the file, by the nearest exact one."""
    refuse_poses(path, ~np.isfinite(np.abs(poses).max(axis=(1, 2))), "something that is not a finite number")
    turn = poses[:, :3, :3]
    error = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    refuse_poses(path, (error > ROUNDING) | (np.linalg.det(turn) < 0.0), "a matrix that is not a rotation")
    left, _, right = np.linalg.svd(turn)
    poses[:, :3, :3] = left @ right


def _in_lidar_frame(
    path: Path, poses: NDArray[np.float64], calib: Path | None, *, is_kitti: bool
) -> tuple[NDArray[np.float64], Path | None]:
    """Return poses of the LiDAR, and the file that turned those of KITTI's camera into them.

    Poses in KITTI's format beside its ``calib.txt`` are of the camera unless their motion shows otherwise. Raises
    BadInputError: other poses are those of a camera, or the z axes do not point up.
    """
    along_z, used = _share_along_z(poses), None
    if is_kitti and calib is not None and (along_z is None or along_z > _MOST_ALONG_Z):
        transform = _read_transform(calib)
        poses, along_z, used = np.linalg.inv(transform) @ poses @ transform, None, calib
        _log.warning("the poses of %s are those of KITTI's camera; %s turns them into those of the LiDAR", path, calib)
    if along_z is not None and along_z > _CAMERA_ALONG_Z:
        raise BadInputError(
            f"{path} holds the poses of a camera: {along_z:.0%} of the way goes along their z axis, but the z axis of "
            f"a LiDAR points up. KITTI: put the sequence's {_CALIB} (with the line Tr:) beside it. Otherwise convert "
            "the poses to those of the LiDAR: pose of the camera times the transform from LiDAR to camera"
        )
    upward = float(poses[:, 2, 2].mean())
    if upward < _LEAST_UP:
        raise BadInputError(
            f"{path}: the z axis of the LiDAR does not point up in the world of the poses (mean upward component "
            f"{upward:.2f}; 1 is upright). Convert the poses: x forward, y left, z up, from the LiDAR to the world; "
            "quaternions are x, y, z, w"
        )
    return poses, used


def _share_along_z(poses: NDArray[np.float64]) -> float | None:
    """Return the share of the way along the z axis of the poses, 0..1; None if the way is too short to tell."""
    places = poses[:, :3, 3]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1))])
    marks = np.unique([0, *np.flatnonzero(np.diff(np.floor(way / _STEP_M)) > 0.0) + 1, len(way) - 1])
    moved = np.diff(places[marks], axis=0)
    length = np.linalg.norm(moved, axis=1).sum()
    if length < _LEAST_WAY_M:
        return None
    ahead = np.einsum("nij,ni->nj", poses[marks[:-1], :3, :3], moved)
    return float(np.abs(ahead[:, 2]).sum() / length)


def _read_transform(calib: Path) -> NDArray[np.float64]:
    """Read the transform from the LiDAR to the camera (4, 4): the line ``Tr:``."""
    with open_source(calib) as stream:
        lines = stream.read(1 << 16).decode("utf-8", "replace").splitlines()
    words = next((line.split()[1:] for line in lines if line.strip().lower().startswith("tr:")), [])
    transform = np.eye(4)
    try:
        transform[:3] = np.array([float(word) for word in words]).reshape(3, 4)
    except ValueError:
        transform[:] = np.nan
    turn = transform[:3, :3]
    if not np.isfinite(transform).all() or np.abs(turn @ turn.T - np.eye(3)).max() > ROUNDING:
        raise BadInputError(f"the line Tr: of {calib} is not a transform: it must be twelve numbers, a 3 x 4 matrix")
    return transform
