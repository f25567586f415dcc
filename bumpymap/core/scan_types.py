"""The vocabulary of dynamic scenes: one scan, the polar grid over it, what was measured in its sectors, their classes.

A scan lives in the sensor's frame: x forward, y to the left, z up, metres. Azimuth runs from x towards y, in radians.
One row of a ``SectorStack`` is one sector that holds enough points; its arrays have the same length.
"""

import math
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.errors import UsageError

__all__ = [
    "CLASSES",
    "NOT_TRAVERSABLE",
    "ClassedSectors",
    "Dropped",
    "PolarSettings",
    "Scan",
    "ScanMethod",
    "SectorStack",
    "point_classes",
]

ScanMethod = Literal["filter", "learned"]
CLASSES = 3
"""Class 0 (smooth) to 2 (rough) of a scan's sectors."""
NOT_TRAVERSABLE = 255
"""Class of a sector whose points do not lie like ground, and of a point in no classed sector."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """Returns of a file that are no points of the scan, by reason."""

    no_return: int = 0
    """At (0, 0, 0): the beam hit nothing."""
    not_finite: int = 0
    """With a coordinate that is not a number or infinite."""
    on_robot: int = 0
    """On the robot that carries the sensor."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn of a LiDAR, in the sensor's frame."""

    points: NDArray[np.float32]
    """(n, 3) x forward, y left, z up, m; finite."""
    intensity: NDArray[np.float32] | None = None
    """(n,) as the file has it; None where it has none."""
    label: NDArray[np.uint16] | None = None
    """(n,) semantic ids; None where nobody labelled the scan."""
    name: str = ""
    """What the frame is called: the stem of its file."""
    dropped: Dropped = Dropped()
    """Returns that were left out."""

    def __post_init__(self) -> None:
        count = len(self.points)
        if self.points.shape != (count, 3):
            raise ValueError(f"points are {self.points.shape}; a scan has (n, 3)")
        for name in ("intensity", "label"):
            values = getattr(self, name)
            if values is not None and values.shape != (count,):
                raise ValueError(f"{name} is {values.shape}; the scan has {count} points")


@dataclass(frozen=True, slots=True)
class PolarSettings:
    """The concentric-zone polar grid. The defaults are the paper's."""

    zone_starts_m: tuple[float, ...] = (4.0, 12.0, 28.0, 60.0)
    """Where each zone begins, horizontal distance from the sensor, m."""
    end_m: float = 100.0
    """Where the last zone ends, m."""
    sectors: tuple[int, ...] = (24, 32, 48, 32)
    """Sectors around each zone."""
    rings: tuple[int, ...] = (4, 4, 4, 2)
    """Rings of each zone, of equal width."""
    least_points: int = 30
    """A sector is measured where it has more points than this."""
    pixels: int = 15
    """Rows and columns of a sector's heightmap."""
    least_normal_z: float = math.cos(math.radians(45.0))
    """A sector is traversable where abs(n_z) of its principal normal is at least this: 45 degrees, the limit at which
    published ground segmentation on the same grid takes a sector for a wall."""
    overhead_m: float = 2.0
    """A sector whose plane passes more than this above the sensor is seen from below: a ceiling or a canopy, no ground.
    The margin allows for frames whose origin lies at the robot's foot."""
    anchored: bool = True
    """Sector 0 starts where the scan's points say, so that the grid turns with the ground; False: at the x axis."""

    def __post_init__(self) -> None:
        edges = (*self.zone_starts_m, self.end_m)
        if not len(self.zone_starts_m) == len(self.sectors) == len(self.rings) > 0:
            raise UsageError(
                f"a polar grid has a start, sectors and rings for each zone; {len(self.zone_starts_m)} starts, "
                f"{len(self.sectors)} sectors and {len(self.rings)} rings were given"
            )
        if not all(math.isfinite(e) for e in edges) or edges[0] < 0.0 or any(np.diff(edges) <= 0.0):
            raise UsageError(f"zones must start at 0 m or further out and grow outwards; {edges} m were given")
        if min(*self.sectors, *self.rings) < 1 or min(self.sectors) < 3:
            raise UsageError(
                f"a zone has 3 sectors or more and 1 ring or more; {self.sectors} and {self.rings} were given"
            )
        if (
            self.least_points < 3
            or not 3 <= self.pixels <= 64
            or not 0.0 <= self.least_normal_z <= 1.0
            or math.isnan(self.overhead_m)
        ):
            raise UsageError(
                f"least_points is {self.least_points} (3 or more), pixels {self.pixels} (3 to 64), least_normal_z "
                f"{self.least_normal_z} (0 to 1), overhead_m {self.overhead_m} (a number)"
            )


@dataclass(frozen=True, slots=True)
class SectorStack:
    """Measured sectors of one scan: one row each, only sectors with more than ``least_points`` points."""

    settings: PolarSettings
    azimuth_start_rad: float
    """Where sector 0 of every zone starts, counter-clockwise from the x axis."""
    zone: NDArray[np.int16]
    """(n,) 0 is the innermost; rows are sorted by zone, ring, sector."""
    ring: NDArray[np.int16]
    """(n,) inside the zone, 0 is the innermost."""
    sector: NDArray[np.int16]
    """(n,) around the zone, counter-clockwise from ``azimuth_start_rad``."""
    count: NDArray[np.int32]
    """(n,) points."""
    normal: NDArray[np.float32]
    """(n, 3) axis of the least spread of the points, sensor frame, n_z >= 0."""
    traversable: NDArray[np.bool_]
    """(n,) True where the normal is close enough to vertical, and the surface is not seen from below."""
    heights: NDArray[np.float32]
    """(n, pixels, pixels) mean z above the sector's plane, m. Rows go outwards with the distance, columns
    counter-clockwise with the azimuth, both in equal steps of the sector; empty pixels are filled."""
    coverage: NDArray[np.float32]
    """(n,) share of the pixels that hold a point, 0..1."""
    variance: NDArray[np.float32]
    """(n,) population variance of z over the sector's points, m^2."""
    residual: NDArray[np.float32]
    """(n,) mean perpendicular distance of all the sector's points to the plane that RANSAC found, m."""
    label: NDArray[np.int16]
    """(n,) most frequent label of the points (the smallest of equals); -1 where the scan has no labels."""
    point_sector: NDArray[np.int32]
    """(m,) row of the sector that holds each point of the scan, -1 where none does."""

    def __post_init__(self) -> None:
        count = len(self.zone)
        for field in fields(self)[2:-1]:
            if len(getattr(self, field.name)) != count:
                raise ValueError(f"{field.name} has {len(getattr(self, field.name))} rows; the stack has {count}")


@dataclass(frozen=True, slots=True)
class ClassedSectors:
    """Sectors and their classes."""

    sectors: SectorStack
    class_id: NDArray[np.uint8]
    """(n,) 0 smooth .. 2 rough; ``NOT_TRAVERSABLE`` where the gate refuses the sector."""
    stripes: NDArray[np.float32] | None
    """(n,) stripe count of the filter method; None from the learned one."""
    method: ScanMethod
    """How they were found."""
    confidence: NDArray[np.float32] | None = None
    """(n,) probability of the class by the learned method, NaN where not traversable; None from the filter method."""


def point_classes(scan: Scan, classed: ClassedSectors) -> NDArray[np.uint8]:
    """Give every point the class of its sector.

    Returns
    -------
    (m,) uint8
        0 to 2; ``NOT_TRAVERSABLE`` where the sector is not, or where no sector holds the point.
    """
    place = classed.sectors.point_sector
    if len(place) != len(scan.points):
        raise ValueError(f"the sectors are those of a scan of {len(place)} points; this one has {len(scan.points)}")
    padded = np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE))
    class_id: NDArray[np.uint8] = padded[place]
    return class_id
