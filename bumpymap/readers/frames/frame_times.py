"""The time of each frame: from its name, from the list of times of its sequence, or from its points."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers.frames.find import find_frames
from bumpymap.readers.frames.table import read_start
from bumpymap.readers.frames.time_text import seconds_of_names, seconds_of_words
from bumpymap.readers.source import open_source

__all__ = ["find_times", "frame_times", "read_times"]

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
    starts = _starts(frames)
    return starts, "the times of their points" if starts is not None else ""


def _starts(frames: Sequence[Path]) -> NDArray[np.float64] | None:
    starts = []
    for frame in frames:
        start = None if frame.suffix.lower() == ".bin" else read_start(frame)
        if start is None:
            return None
        starts.append(start)
    return np.array(starts)


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
