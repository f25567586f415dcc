"""Where a scan of a run comes from: a file of its own, or a message in a bag."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.pose_track import PoseTrack

__all__ = ["BagMessage", "FrameSource"]


@dataclass(frozen=True, slots=True)
class BagMessage:
    """The place of a scan in a bag."""

    topic: str
    number: int
    """Position among the messages of the topic, from 0."""
    time_ns: int
    """Time under which the bag stores the message."""
    place: int
    """Position among those messages of the topic that have the same ``time_ns``, from 0."""
    stamp_ns: int
    """Time of the measurement, from the header of the message; ``time_ns`` if the header has none."""
    frame_id: str
    """Coordinate frame of the points."""
    bytes: int
    """Size of the message."""


@dataclass(frozen=True, slots=True)
class FrameSource:
    """A scan that was found, before it is read."""

    path: Path
    """File of the scan; or the bag, a file or a folder."""
    message: BagMessage | None = None
    """None if ``path`` is a file of its own."""
    pose: NDArray[np.float64] | None = None
    """(4, 4) transform from the sensor frame to the world frame, m; None if unknown."""
    motion: PoseTrack | None = None
    """Poses around the frame, at times relative to it; None if unknown."""
