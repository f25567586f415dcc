"""The frames of a scan run and their names."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PoseTrack

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
    pose: NDArray[np.float64] | None = None
    """(4, 4) transform from the sensor frame to the world frame, m; None if unknown."""
    motion: PoseTrack | None = None
    """Poses around the frame, at times relative to it; None if unknown."""


def name_frames(
    paths: Sequence[Path],
    poses: NDArray[np.float64] | None = None,
    motions: Sequence[PoseTrack | None] | None = None,
) -> list[Frame]:
    """Give each frame a unique name.

    Returns
    -------
    list of Frame
        Named by the stems of their files. In a stem that is not valid UTF-8, every byte beyond ASCII becomes ``%`` and
        two hex digits (``caf%E9``), because names are written to Parquet and to file names. If two stems are equal
        (ignoring case, as some file systems do), all names start with the number of the frame in the run:
        ``000000_STEM``, ``000001_STEM``.
    """
    names = [_as_text(path.stem) for path in paths]
    if len({name.casefold() for name in names}) < len(names):
        names = [f"{number:06d}_{name}" for number, name in enumerate(names)]
    places = [None] * len(names) if poses is None else list(poses)
    moving = [None] * len(names) if motions is None else list(motions)
    return [Frame(*known) for known in zip(names, paths, places, moving, strict=True)]


def _as_text(stem: str) -> str:
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
