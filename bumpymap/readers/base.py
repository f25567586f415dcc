"""The part that all readers share: pieces one after the other as chunks of points, and the verdict at the end."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

from bumpymap.core import PointCloud, UsageError
from bumpymap.readers.point_stats import PointStats, verify
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, SurveyInfo

__all__ = ["SurveyBase"]


class SurveyBase(ABC):
    """A ``SurveyReader``; a format adds how its pieces are cut, read and converted."""

    def __init__(self, info: SurveyInfo) -> None:
        self._info = info
        self._dropped = PointStats().dropped

    @property
    def info(self) -> SurveyInfo:
        """What the header says."""
        return self._info

    @property
    def dropped(self) -> dict[str, int]:
        """Points that did not count so far, by reason."""
        return dict(self._dropped)

    @abstractmethod
    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut the file; see ``SurveyReader.pieces``."""

    @abstractmethod
    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode; see ``SurveyReader.fetch``."""

    @abstractmethod
    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Points that count, in metres; see ``SurveyReader.convert``."""

    def verify(self, stats: PointStats) -> None:
        """Hold all points to the header; see ``SurveyReader.verify``."""
        verify(stats, self._info.path, self._info.point_count, self._info.bounds)

    def clouds(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Give the points that count; see ``SurveyReader.chunks``."""
        if points < 1:
            raise UsageError(f"a chunk of {points} points was asked for; it must hold at least 1")
        stats = PointStats()
        for chunk in self.chunks(points):
            batch = self.convert(chunk, self.fetch(chunk))
            stats = stats.merge(batch.stats)
            self._dropped = stats.dropped
            if not stats.bad:
                yield from _split(batch.cloud, points)
        self.verify(stats)


def _split(cloud: PointCloud, points: int) -> Iterator[PointCloud]:
    for first in range(0, cloud.easting.size, points):
        part = slice(first, first + points)
        yield PointCloud(cloud.easting[part], cloud.northing[part], cloud.upward[part], cloud.is_ground[part])
