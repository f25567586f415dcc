"""The part that all readers share: raw chunks are watched, points that do not count are left out and counted."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from bumpymap.errors import UsageError
from bumpymap.readers.checks import PointWatch, RawPoints
from bumpymap.readers.protocol import DROPPED, SurveyInfo
from bumpymap.types import PointCloud

__all__ = ["GROUND", "Survey"]

GROUND = 2
"""ASPRS class of the ground."""
_NOISE = (7, 18)
"""ASPRS classes of low and high noise."""


class Survey(ABC):
    """A ``SurveyReader``; a format adds how raw points are read."""

    nan_is_no_return = False
    """Whether a row with NaN coordinates is a beam without return, as in PCD, or a fault."""

    def __init__(self, info: SurveyInfo) -> None:
        self._info = info
        self._dropped = dict.fromkeys(DROPPED, 0)

    @property
    def info(self) -> SurveyInfo:
        """What the header says."""
        return self._info

    @property
    def dropped(self) -> dict[str, int]:
        """Points that did not count so far, by reason."""
        return dict(self._dropped)

    @abstractmethod
    def raw(self, points: int) -> Iterator[RawPoints]:
        """Give every point of the file in metres, at most ``points`` at a time."""

    def chunks(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Give the points that count; see ``SurveyReader.chunks``."""
        if points < 1:
            raise UsageError(f"a chunk of {points} points was asked for; it must hold at least 1")
        self._dropped = dict.fromkeys(DROPPED, 0)
        info = self._info
        watch = PointWatch(info.path, info.point_count, info.bounds, nan_is_no_return=self.nan_is_no_return)
        for raw in self.raw(points):
            if watch.see(raw):
                cloud = self._counting(raw)
                if cloud.easting.size:
                    yield cloud
        watch.finish()

    def _counting(self, raw: RawPoints) -> PointCloud:
        no_return = self._no_return(raw)
        flags: list[tuple[str, NDArray[np.bool_] | None]] = [
            ("not_a_number", no_return),
            ("withheld", raw.withheld),
            ("noise", None if raw.klass is None else (raw.klass == _NOISE[0]) | (raw.klass == _NOISE[1])),
        ]
        keep = np.ones(raw.easting.size, dtype=np.bool_)
        for reason, flag in flags:
            if flag is not None:
                self._dropped[reason] += int((keep & flag).sum())
                keep &= ~flag
        ground = np.zeros(raw.easting.size, dtype=np.bool_) if raw.klass is None else raw.klass == GROUND
        if keep.all():
            return PointCloud(raw.easting, raw.northing, raw.upward, ground)
        return PointCloud(raw.easting[keep], raw.northing[keep], raw.upward[keep], ground[keep])

    def _no_return(self, raw: RawPoints) -> NDArray[np.bool_] | None:
        if not self.nan_is_no_return:
            return None
        return np.isnan(raw.easting) | np.isnan(raw.northing) | np.isnan(raw.upward)
