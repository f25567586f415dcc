"""Write gathered.laz: the points of all frames of a drive, accumulated in the world frame as one survey."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import BadInputError, ClassedSectors, Scan

__all__ = ["AccumulatedSurvey", "ground_points", "open_accumulated"]

_SCALE_M = 0.001
_GROUND, _UNCLASSIFIED = 2, 1
"""LAS classification codes."""


class AccumulatedSurvey:
    """Writer of the accumulated survey; holds at most one frame in memory."""

    def __init__(self, writer: laspy.LasWriter) -> None:
        self._writer = writer
        self.points = 0
        """Points written so far."""
        self.ground = 0
        """Those of them in traversable sectors."""

    def record(self) -> dict[str, int]:
        """Return the numbers of points for scan.json."""
        return {"points": self.points, "ground": self.ground}

    def add(self, scan: Scan, pose: NDArray[np.float64], classed: ClassedSectors) -> None:
        """Append the points of a frame: class 2 (ground) in traversable sectors, class 1 elsewhere.

        Parameters
        ----------
        scan : Scan
        pose : (4, 4) float64
            Transform from the sensor frame to the world frame, m.
        classed : ClassedSectors

        Raises
        ------
        BadInputError
            The frame lies too far from the first one.
        """
        self.add_points(scan.name, scan.points, pose, ground_points(classed))

    def add_points(
        self, name: str, points: NDArray[np.float32], pose: NDArray[np.float64], is_ground: NDArray[np.bool_]
    ) -> None:
        """Append points (n, 3) in the sensor frame, m; ``is_ground`` (n,) marks those of class 2."""
        if not len(points):
            return
        world = points.astype(np.float64) @ pose[:3, :3].T + pose[:3, 3]
        record = laspy.ScaleAwarePointRecord.zeros(len(world), header=self._writer.header)
        try:
            record.x, record.y, record.z = world.T
        except OverflowError as error:
            raise BadInputError(
                f"according to its pose, the frame {name} lies more than 2,000 km from the first one. Are they from "
                "one drive?"
            ) from error
        record.classification = np.where(is_ground, _GROUND, _UNCLASSIFIED).astype(np.uint8)
        record.return_number = record.number_of_returns = np.ones(len(world), np.uint8)
        self._writer.write_points(record)
        self.points += len(world)
        self.ground += int(is_ground.sum())


def ground_points(classed: ClassedSectors) -> NDArray[np.bool_]:
    """Return which points of a scan, (n,), lie in traversable sectors."""
    return np.append(classed.sectors.traversable, False)[classed.sectors.point_sector]


@contextmanager
def open_accumulated(path: Path, first: NDArray[np.float64], crs: CRS | None) -> Iterator[AccumulatedSurvey]:
    """Open gathered.laz for writing: LAZ 1.4, point format 6, scale 1 mm, offset near the first pose.

    Parameters
    ----------
    path : Path
    first : (4, 4) float64
        Pose of the first frame, m.
    crs : CRS, optional
        CRS of the world frame; None: the file gets none.
    """
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, _SCALE_M), np.round(first[:3, 3])
    header.creation_date = None  # the same drive gives the same bytes on any day
    header.generating_software = "bumpymap scan"
    if crs is not None:
        header.add_crs(crs)
    with path.open("w+b") as stream:
        writer = laspy.LasWriter(stream, header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs, closefd=False)
        yield AccumulatedSurvey(writer)
        writer.close()
