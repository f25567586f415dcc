"""What one file of a drive holds, before the files are joined to a drive."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PlaceTrack, WheelTrack

__all__ = ["DriveSignals", "Floats", "Signal"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Signal:
    """Samples of one sensor."""

    time: Floats
    """(n,) s, increasing."""
    values: Floats
    """(n, k), finite."""


@dataclass(frozen=True, slots=True)
class DriveSignals:
    """The samples of one file, or of one bag."""

    source: str
    """Name of the file, for messages."""
    rate: Signal | None = None
    """Angular rates about x, y, z, rad/s."""
    acceleration: Signal | None = None
    """Specific force along x, y, z, m/s2."""
    attitude: Signal | None = None
    """Quaternions x, y, z, w that turn vectors of the sensor's axes into those of a fixed frame."""
    places: PlaceTrack | None = None
    wheels: WheelTrack | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    """Quantity -> column or topic."""
    notes: tuple[str, ...] = ()
    listing: str = ""
    """What the file holds, for the message that something is missing."""
