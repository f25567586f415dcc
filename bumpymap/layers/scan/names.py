"""The frames of a run and what they are called."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["FRAME_FILES", "FRAME_FOLDER", "Frame", "name_frames", "sample_evenly"]

FRAME_FOLDER = "frames"
FRAME_FILES = {"polygons": ".json", "cloud": ".ply", "picture": ".png"}
"""Ending of what is written of each frame."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame of a run, before it is read."""

    name: str
    """Of its files; no other frame of the run has it."""
    path: Path
    pose: NDArray[np.float64] | None = None
    """(4, 4) takes the sensor's frame to the world's, m; None where nobody said."""


def name_frames(paths: Sequence[Path], poses: NDArray[np.float64] | None = None) -> list[Frame]:
    """Give each frame a name of its own.

    Returns
    -------
    list of Frame
        Named by the stems of their files; of one that is no text in the encoding of file names, every byte beyond ASCII
        becomes ``%`` and two digits (``caf%E9``), since names stand in Parquet and in the names of products. Where two
        stems are equal (on some disks ``a`` and ``A`` are), every name starts with the frame's number in the run:
        ``000000_STEM``, ``000001_STEM``.
    """
    names = [_as_text(path.stem) for path in paths]
    if len({name.casefold() for name in names}) < len(names):
        names = [f"{number:06d}_{name}" for number, name in enumerate(names)]
    places = [None] * len(names) if poses is None else list(poses)
    return [Frame(*known) for known in zip(names, paths, places, strict=True)]


def _as_text(stem: str) -> str:
    try:
        stem.encode()
    except UnicodeEncodeError:
        return "".join(chr(byte) if byte < 128 else f"%{byte:02X}" for byte in os.fsencode(stem))
    return stem


def sample_evenly(frames: Sequence[Frame], most: int) -> list[Frame]:
    """Return at most so many frames, evenly spread, the first and the last among them."""
    if len(frames) <= most:
        return list(frames)
    return [frames[place] for place in np.linspace(0, len(frames) - 1, most).round().astype(int)]
