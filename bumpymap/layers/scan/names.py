"""The frames of a scan run and their names."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BagMessage, FrameSource, PoseTrack

__all__ = ["FRAME_FILES", "FRAME_FOLDER", "Frame", "name_frames", "sample_evenly"]

FRAME_FOLDER = "frames"
FRAME_FILES = {"polygons": ".json", "cloud": ".ply", "picture": ".png"}
"""File suffix of each product that is written per frame."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a run, before it is read."""

    name: str
    """Stem of its output files, unique in the run."""
    path: Path
    """File of the scan; or the bag that holds it."""
    pose: NDArray[np.float64] | None = None
    """(4, 4) transform from the sensor frame to the world frame, m; None if unknown."""
    motion: PoseTrack | None = None
    """Poses around the frame, at times relative to it; None if unknown."""
    message: BagMessage | None = None
    """Its place in a bag; None if it has a file of its own."""

    @property
    def origin(self) -> str:
        """The file; or the bag, topic and number of the message."""
        where = "" if self.message is None else f", message {self.message.number} of {self.message.topic}"
        return f"{self.path}{where}"


def name_frames(sources: Sequence[FrameSource]) -> list[Frame]:
    """Give each frame a unique name.

    Returns
    -------
    list of Frame
        Named by the stems of their files; those in a bag by their time, seconds and nanoseconds
        (``1700000000_250000000``). In a stem that is not valid UTF-8, every byte beyond ASCII becomes ``%`` and two hex
        digits (``caf%E9``), because names are written to Parquet and to file names. If two stems are equal (ignoring
        case, as some file systems do), all names start with the number of the frame in the run: ``000000_STEM``,
        ``000001_STEM``.
    """
    names = [_stem(source) for source in sources]
    if len({name.casefold() for name in names}) < len(names):
        names = [f"{number:06d}_{name}" for number, name in enumerate(names)]
    return [
        Frame(name, source.path, source.pose, source.motion, source.message)
        for name, source in zip(names, sources, strict=True)
    ]


def _stem(source: FrameSource) -> str:
    if source.message is not None:
        return "{}_{:09d}".format(*divmod(source.message.stamp_ns, 1_000_000_000))
    stem = source.path.stem
    try:
        stem.encode()
    except UnicodeEncodeError:
        return "".join(chr(byte) if byte < 128 else f"%{byte:02X}" for byte in os.fsencode(stem))
    return stem


def sample_evenly(frames: Sequence[Frame], most: int) -> list[Frame]:
    """Return at most ``most`` frames at even intervals, including the first and the last."""
    if len(frames) <= most:
        return list(frames)
    return [frames[place] for place in np.linspace(0, len(frames) - 1, most).round().astype(int)]
