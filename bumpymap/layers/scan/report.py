"""Counts of a classed frame, for scan.json and for the printed summary."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np

from bumpymap.core import CLASSES, NOT_TRAVERSABLE, ClassedSectors, Dropped, Scan, point_classes
from bumpymap.layers.manifest import describe_input
from bumpymap.layers.scan.names import Frame
from bumpymap.layers.scan.style import SCAN_CLASS_NAMES, SECTOR_STATES, sector_states

__all__ = ["FrameReport", "explain_empty_scan", "report_frame"]


_RIDE_CLASSES = ("0", "1", "2", "3", "unknown")


@dataclass(frozen=True, slots=True)
class FrameReport:
    """The file of a frame, and numbers of its points and sectors."""

    frame: Frame
    bytes: int
    """Size of its file or message."""
    sha256: str | None
    """Of its file; None for a message."""
    points: int
    """Points that were kept."""
    dropped: Dropped
    """Returns that were dropped, by reason."""
    azimuth_start_rad: float
    """Where sector 0 of every zone starts."""
    sectors: tuple[int, ...]
    """(4,) sectors of class 0 to 2, then not traversable."""
    states: tuple[int, ...]
    """(4,) sectors by ``SECTOR_STATES``."""
    classed_points: tuple[int, ...]
    """(4,) points of class 0 to 2, then of no class."""
    ride_classes: tuple[int, ...] | None
    """(5,) traversable sectors of class 0 to 3 for the vehicle, then unknown; None without a vehicle."""
    seconds: float
    """Wall time from reading the file to classed sectors."""

    @classmethod
    def of(cls, frame: Frame, record: Mapping[str, Any]) -> Self:
        """Restore a report from its `record`."""
        return cls(
            frame,
            record["bytes"],
            record["sha256"],
            record["points"],
            Dropped(**record["dropped"]),
            record["azimuth_start_rad"],
            tuple(record["sectors"].values()),
            tuple(record["sector_states"].values()),
            tuple(record["points_by_class"].values()),
            None if record["sectors_by_ride"] is None else tuple(record["sectors_by_ride"].values()),
            record["seconds"],
        )

    def record(self) -> dict[str, Any]:
        """Return the entry of the frame in scan.json."""
        return {
            "name": self.frame.name,
            "path": str(self.frame.path),
            "message": None if self.frame.message is None else asdict(self.frame.message),
            "bytes": self.bytes,
            "sha256": self.sha256,
            "pose": self.frame.pose,
            "points": self.points,
            "dropped": asdict(self.dropped),
            "azimuth_start_rad": self.azimuth_start_rad,
            "sectors": dict(zip(SCAN_CLASS_NAMES, self.sectors, strict=True)),
            "sector_states": dict(zip(SECTOR_STATES, self.states, strict=True)),
            "points_by_class": dict(zip([*SCAN_CLASS_NAMES[:CLASSES], "no class"], self.classed_points, strict=True)),
            "sectors_by_ride": None
            if self.ride_classes is None
            else dict(zip(_RIDE_CLASSES, self.ride_classes, strict=True)),
            "seconds": self.seconds,
        }


def report_frame(
    frame: Frame, version: Mapping[str, Any] | None, scan: Scan, classed: ClassedSectors, seconds: float
) -> FrameReport:
    """Count the points and sectors of a frame.

    Parameters
    ----------
    frame : Frame
    version : mapping or None
        ``size`` and ``mtime_ns`` of its file before it was read; not needed for a message.
    scan : Scan
    classed : ClassedSectors
    seconds : float

    Raises
    ------
    BadInputError
        The file is missing, or has changed since it was read.
    """
    sectors, points = (
        tuple(np.bincount(np.where(class_id == NOT_TRAVERSABLE, CLASSES, class_id), minlength=CLASSES + 1).tolist())
        for class_id in (classed.class_id, point_classes(scan, classed))
    )
    file: Mapping[str, Any]
    if frame.message is not None:
        file = {"bytes": frame.message.bytes, "sha256": None}
    else:
        known = version or {}
        file = describe_input({"path": frame.path, "bytes": known.get("size"), "mtime_ns": known.get("mtime_ns")})
    return FrameReport(
        frame,
        file["bytes"],
        file["sha256"],
        len(scan.points),
        scan.dropped,
        classed.sectors.azimuth_start_rad,
        sectors,
        tuple(np.bincount(sector_states(classed), minlength=len(SECTOR_STATES)).tolist()),
        points,
        _count_rides(classed),
        round(seconds, 4),
    )


def _count_rides(classed: ClassedSectors) -> tuple[int, ...] | None:
    if classed.ride is None:
        return None
    unknown = len(_RIDE_CLASSES) - 1
    class_id = np.minimum(classed.ride.class_id[classed.sectors.traversable], unknown)
    return tuple(np.bincount(class_id, minlength=unknown + 1).tolist())


def explain_empty_scan(scan: Scan, classed: ClassedSectors) -> str:
    """Explain why a scan has no sectors or no traversable ones; return an empty string if it has."""
    stack, settings = classed.sectors, classed.sectors.settings
    if len(stack.zone):
        if stack.traversable.any():
            return ""
        return f"none of its {len(stack.zone):,} sectors is traversable. Does its z axis point up?"
    if not len(scan.points):
        lost = scan.dropped
        return (
            f"it holds no points: {lost.no_return:,} returns at (0, 0, 0) or NaN, {lost.not_finite:,} not finite, "
            f"{lost.on_robot:,} on the robot"
        )
    near, far = settings.zone_starts_m[0], settings.end_m
    distance = np.hypot(*scan.points[:, :2].T.astype(np.float64))
    inside = int(((distance >= near) & (distance < far)).sum())
    return (
        f"none of its sectors holds more than {settings.least_points} points: {inside:,} of {len(scan.points):,} "
        f"points lie {near:g} to {far:g} m from the sensor"
    )
