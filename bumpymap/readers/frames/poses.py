"""The pose of the sensor at each frame, from a file of poses.

Poses and frames that both have times are matched by time: the poses may have another rate, and are interpolated. Others
must be as many as the frames, in the same order.
"""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import LONGEST_GAP_S, NEAREST_S, SCAN_S, BadInputError, FrameSource, PoseTrack
from bumpymap.readers.frames.kitti import POINT_FOLDERS
from bumpymap.readers.frames.pose_files import (
    calib_beside,
    in_lidar_frame,
    read_pose_file,
    refuse_wrong_frame,
    seconds_of_names,
    seconds_of_words,
)
from bumpymap.readers.frames.raw import read_start
from bumpymap.readers.frames.read import find_frames
from bumpymap.readers.source import open_source

__all__ = ["FramePoses", "files_beside_poses", "place_sources", "read_poses"]

_TIMES_NAMES = ("times.txt", "timestamps.txt")


def frame_times(frames: Sequence[Path], folders: Sequence[Path]) -> tuple[NDArray[np.float64] | None, str]:
    """Return the times of frames, (n,) s, None if they are unknown, and where they are from.

    Parameters
    ----------
    frames : sequence of Path
    folders : sequence of Path
        Where a list of times may be.

    Raises
    ------
    BadInputError
        A list of times is not one, or has another number of times than its sequence has frames.
    """
    named = seconds_of_names([frame.stem for frame in frames])
    if named is not None:
        return named, "the names of the frames"
    listed = find_times(folders)
    if listed is not None and len({frame.parent for frame in frames}) == 1:
        times = read_times(listed)
        sequence = {file.name: number for number, file in enumerate(find_frames([frames[0].parent]))}
        if len(times) != len(sequence):
            raise BadInputError(
                f"{listed} holds {len(times):,} times, but {frames[0].parent} {len(sequence):,} frames; there must be "
                "one line per frame. Copy both again, or remove the list"
            )
        return times[[sequence[frame.name] for frame in frames]], str(listed)
    starts = []
    for frame in frames:
        start = None if frame.suffix.lower() == ".bin" else read_start(frame)
        if start is None:
            return None, ""
        starts.append(start)
    return np.array(starts), "the times of their points"


def find_times(folders: Sequence[Path]) -> Path | None:
    """Return the first list of times in some folders; None if there is none."""
    files = (folder / name for folder in folders for name in _TIMES_NAMES)
    return next((file for file in files if file.is_file()), None)


def read_times(path: Path) -> NDArray[np.float64]:
    """Read a list of times, one per line: numbers in s, or dates. Raises BadInputError if it is none."""
    with open_source(path) as stream:
        lines = stream.read().decode("utf-8-sig", "replace").splitlines()
    times = seconds_of_words([line for line in lines if line.strip()])
    if times is None:
        raise BadInputError(f"{path} is not a list of times: a line must be a number of seconds, or a date with time")
    return times


_log = logging.getLogger(__name__)

_POINT_FOLDERS = (*POINT_FOLDERS, "data")
"""Folders of frames inside of a sequence, which holds the files beside them."""


@dataclass(frozen=True, slots=True)
class FramePoses:
    """The pose of each frame, and the motion around it."""

    poses: NDArray[np.float64]
    """(n, 4, 4) transforms from the sensor frame to the world frame, m."""
    motions: tuple[PoseTrack | None, ...]
    """(n,) poses around each frame, at times relative to the frame's; None if the poses have no times."""
    matched_by: Literal["time", "order"]
    """How poses and frames were matched."""
    calib: Path | None
    """The ``calib.txt`` by which poses of a camera were turned into those of the LiDAR; None if they were not."""


def read_poses(path: Path, frames: Sequence[Path], known: NDArray[np.float64] | None = None) -> FramePoses:
    """Read the pose of each frame.

    Parameters
    ----------
    path : Path
        KITTI, TUM or CSV. KITTI's ``calib.txt`` and ``times.txt`` beside it are used.
    frames : sequence of Path
        Files of scans.
    known : (n,) float64, optional
        Times of the frames, s, if they have none of their own: those of messages in a bag.

    Raises
    ------
    BadInputError
        The file cannot be read or holds invalid poses; the poses are those of a camera; they cannot be matched with the
        frames, or do not cover their times.
    """
    file = read_pose_file(path)
    folders = _folders(path, frames)
    poses, calib = file.poses, calib_beside(folders)
    turned = None if calib is None else in_lidar_frame(poses, calib, is_kitti=file.is_kitti)
    if turned is None:
        calib = None
    else:
        poses = turned
        _log.warning("the poses of %s are those of KITTI's camera; %s turns them into those of the LiDAR", path, calib)
    refuse_wrong_frame(path, poses)
    times = _times_beside(path, len(poses), len(frames)) if file.times is None else file.times
    track = None if times is None else _track(path, times, poses)
    source = "their messages"
    if known is None and track is not None:
        known, source = frame_times(frames, folders)
    if track is None or times is None or known is None:
        _require_same_count(path, len(poses), len(frames), with_times=track is not None)
        motions = (None,) * len(frames) if track is None or times is None else _motions(track, times)
        return FramePoses(poses, motions, "order", calib)
    _require_cover(path, track, known, source)
    return FramePoses(track.at(known), _motions(track, known), "time", calib)


def place_sources(path: Path, sources: Sequence[FrameSource]) -> tuple[FramePoses, list[FrameSource]]:
    """Read the pose of each frame, see `read_poses`; return them, and the sources with them."""
    messages = [source.message for source in sources if source.message is not None]
    known = np.array([message.stamp_ns for message in messages]) * 1e-9 if messages else None
    found = read_poses(path, [source.path for source in sources], known)
    placed = zip(sources, found.poses, found.motions, strict=True)
    return found, [replace(source, pose=pose, motion=motion) for source, pose, motion in placed]


def files_beside_poses(path: Path, frames: Sequence[Path]) -> list[Path]:
    """List the files that are read together with a file of poses: ``calib.txt`` and lists of times."""
    folders = _folders(path, frames)
    found = {calib_beside(folders), find_times([path.parent]), find_times(folders)}
    return sorted(file for file in found if file is not None)


def _folders(path: Path, frames: Sequence[Path]) -> list[Path]:
    """Return the folders of the sequence and of the poses."""
    of_frames = [frame.parent for frame in frames[:1]]
    of_sequence = [folder.parent for folder in of_frames if folder.name in _POINT_FOLDERS]
    return [*of_frames, *of_sequence, path.parent]


def _times_beside(path: Path, poses: int, frames: int) -> NDArray[np.float64] | None:
    """Return the times of poses without times of their own, from the list beside them."""
    listed = find_times([path.parent])
    if listed is None:
        return None
    times = read_times(listed)
    if len(times) == poses:
        return times
    if poses != frames:
        raise BadInputError(
            f"{path} holds {poses:,} poses and {listed} {len(times):,} times, for {frames:,} frames; there must be one "
            "time for each pose, or one pose for each frame"
        )
    return None


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


def _motions(track: PoseTrack, times: NDArray[np.float64]) -> tuple[PoseTrack, ...]:
    return tuple(track.around(time, SCAN_S) for time in times.tolist())


def _require_same_count(path: Path, poses: int, frames: int, *, with_times: bool) -> None:
    if poses == frames:
        return
    advice = "Does the file belong to another drive, or are frames missing?"
    if with_times:
        advice = "Its poses have times, but the frames have none: give them times.txt, or names that are time stamps"
    raise BadInputError(
        f"{path} holds {poses:,} poses, but there are {frames:,} frames; there must be one pose per frame, in order of "
        f"time. {advice}"
    )


def _require_cover(path: Path, track: PoseTrack, times: NDArray[np.float64], source: str) -> None:
    """Refuse frames without a pose."""
    missing = ~track.covers(times)
    if not missing.any():
        return
    first, last = float(track.times[0]), float(track.times[-1])
    spans = (
        f"the poses of {path} span {first:.3f} to {last:.3f} s, the frames {times.min():.3f} to {times.max():.3f} s "
        f"(from {source})"
    )
    if times.max() < first - NEAREST_S or times.min() > last + NEAREST_S:
        raise BadInputError(
            f"no frame has a pose: {spans}. Do they belong to different drives, or to different clocks? Give both the "
            "same clock; or, with one pose per frame in order, leave out the times of the poses (12 numbers a line)"
        )
    lost = int(missing.sum())
    outside = int(((times < first) | (times > last))[missing].sum())
    raise BadInputError(
        f"{lost:,} of {len(times):,} frames have no pose within {NEAREST_S} s: {outside:,} lie outside of the time of "
        f"the poses, {lost - outside:,} in gaps of more than {LONGEST_GAP_S} s; {spans}. Leave these frames out, the "
        f"first is number {int(missing.argmax()):,} (counted from 0), or complete the poses"
    )
