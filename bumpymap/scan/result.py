"""The classified ground of one scan, in arrays."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
    NOT_TRAVERSABLE,
    ClassedSectors,
    ScanMethod,
    SectorBounds,
    SectorRide,
    sector_bounds,
)

__all__ = ["ScanResult"]

_NAMES = {**dict(enumerate(CLASS_NAMES[:CLASSES])), NOT_TRAVERSABLE: "not traversable"}


@dataclass(frozen=True, slots=True, repr=False)
class ScanResult:
    """The classified ground of one scan: arrays with one row per point, and arrays with one row per sector."""

    points: NDArray[np.float32]
    """(n, 3) m. The given points (not copied if they are float32); of a file, those without returns on the robot."""
    point_class: NDArray[np.uint8]
    """(n,) 0 smooth, 1 fair, 2 rough; 255 not traversable, or in no measured sector."""
    point_sector: NDArray[np.int32]
    """(n,) row of the point's sector in the arrays of sectors; -1 if it is in no measured sector."""
    sectors: ClassedSectors
    """All measures of the sectors; the most important ones are also properties of this object. Where returns were left
    out (not finite, on the robot), its arrays with a row per point have no rows for them."""

    @property
    def class_names(self) -> dict[int, str]:
        """Name of each class: 0 to 2, and 255."""
        return dict(_NAMES)

    @property
    def method(self) -> ScanMethod:
        """How the classes were found: ``learned`` or ``filter``."""
        return self.sectors.method

    @property
    def sector_class(self) -> NDArray[np.uint8]:
        """(m,) class of each sector: 0 to 2, or 255 where it is not traversable."""
        return self.sectors.class_id

    @property
    def sector_confidence(self) -> NDArray[np.float32]:
        """(m,) probability of the class; NaN where the sector is not traversable, everywhere by the filter method."""
        confidence = self.sectors.confidence
        return np.full(len(self.sector_class), np.nan, np.float32) if confidence is None else confidence

    @property
    def sector_c_r(self) -> NDArray[np.float32]:
        """(m,) C_r of the vehicle, rad/m, as in a survey's map; NaN where unknown, everywhere without a vehicle."""
        return self._ride.c_r

    @property
    def sector_c_r_low(self) -> NDArray[np.float32]:
        """(m,) lower end of the 80 % interval of ``sector_c_r``, rad/m."""
        return self._ride.c_r_low

    @property
    def sector_c_r_high(self) -> NDArray[np.float32]:
        """(m,) upper end, rad/m."""
        return self._ride.c_r_high

    @property
    def sector_ride_class(self) -> NDArray[np.uint8]:
        """(m,) class for the vehicle, 0 (flattest) to 3 (roughest), as in a survey's map; 255 where unknown."""
        return self._ride.class_id

    @property
    def _ride(self) -> SectorRide:
        return self.sectors.ride or SectorRide.unknown(len(self.sector_class))

    @property
    def sector_bounds(self) -> SectorBounds:
        """``near`` and ``far`` (distance from the sensor, m), ``right`` and ``left`` (azimuth, rad), (m,) each."""
        return sector_bounds(self.sectors.sectors)

    @property
    def sector_points(self) -> NDArray[np.int32]:
        """(m,) number of points in each sector."""
        return self.sectors.sectors.count

    @property
    def point_confidence(self) -> NDArray[np.float32]:
        """(n,) confidence of each point's sector; NaN if it is in none."""
        padded: NDArray[np.float32] = np.append(self.sector_confidence, np.float32(np.nan))
        return padded[self.point_sector]

    def __repr__(self) -> str:
        counts = {name: int((self.sector_class == value).sum()) for value, name in _NAMES.items()}
        shares = ", ".join(f"{name} {count}" for name, count in counts.items())
        return (
            f"<ScanResult: {len(self.points):,} points, {len(self.sector_class):,} sectors: {shares} ({self.method})>"
        )
