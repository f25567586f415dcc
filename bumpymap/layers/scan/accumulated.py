"""Write gathered.laz: the merged points of the frames of a drive, in the world frame, as one survey."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

__all__ = ["AccumulatedSurvey", "open_accumulated"]

_SCALE_M = 0.001
_GROUND, _UNCLASSIFIED = 2, 1
"""LAS classification codes."""


class AccumulatedSurvey:
    """Writer of the accumulated survey."""

    def __init__(self, writer: laspy.LasWriter) -> None:
        self._writer = writer

    def add_points(self, world: NDArray[np.float64], is_ground: NDArray[np.bool_]) -> None:
        """Append points (n, 3) in the frame of the world, m: class 2 where ``is_ground`` (n,), else class 1."""
        if not len(world):
            return
        record = laspy.ScaleAwarePointRecord.zeros(len(world), header=self._writer.header)
        record.x, record.y, record.z = world.T
        record.classification = np.where(is_ground, _GROUND, _UNCLASSIFIED).astype(np.uint8)
        record.return_number = record.number_of_returns = np.ones(len(world), np.uint8)
        self._writer.write_points(record)


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
