"""Base class of all survey readers: iterates over the chunks of a file and checks the points at the end."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from bumpymap.core import PointCloud, UsageError
from bumpymap.readers.line_sums import LineSums
from bumpymap.readers.point_stats import PointStats, verify
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, SurveyInfo

__all__ = ["SurveyBase"]


class SurveyBase(ABC):
    """A ``SurveyReader`` without checksum; subclasses for the formats split, read and convert the chunks."""

    def __init__(self, info: SurveyInfo) -> None:
        self._info = info
        self._dropped, self._line_sums = PointStats().dropped, LineSums()
        self._classes = np.zeros(256, np.int64)

    @property
    def info(self) -> SurveyInfo:
        """Contents of the header."""
        return self._info

    @property
    def dropped(self) -> dict[str, int]:
        """Number of points dropped so far, by reason."""
        return dict(self._dropped)

    @property
    def classes(self) -> dict[int, int]:
        """Number of points of each LAS class so far; see ``SurveyReader.classes``."""
        return {code: count for code, count in enumerate(self._classes.tolist()) if count}

    @property
    def lines(self) -> LineSums:
        """Sums of flight lines so far; see ``SurveyReader.lines``."""
        return self._line_sums

    @abstractmethod
    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file into chunks; see ``SurveyReader.chunks``."""

    @abstractmethod
    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk; see ``SurveyReader.fetch``."""

    @abstractmethod
    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert a chunk to points in metres; see ``SurveyReader.convert``."""

    def verify(self, stats: PointStats) -> None:
        """Check all points against the header; see ``SurveyReader.verify``."""
        verify(stats, self._info.path, self._info.point_count, self._info.bounds)

    def clouds(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Yield the points of the file; see ``SurveyReader.clouds``."""
        if points < 1:
            raise UsageError(f"chunks of {points} points were requested; a chunk must hold at least 1")
        stats, self._line_sums, self._classes = PointStats(), LineSums(), np.zeros(256, np.int64)
        for chunk in self.chunks(points):
            converted = self.convert(chunk, self.fetch(chunk))
            stats = stats.merge(converted.stats)
            self._dropped = stats.dropped
            self._line_sums = self._line_sums.merge(converted.lines)
            self._classes += converted.classes
            if not stats.bad:
                yield from _split(converted.cloud, points)
        self.verify(stats)


def _split(cloud: PointCloud, points: int) -> Iterator[PointCloud]:
    for first in range(0, cloud.easting.size, points):
        part = slice(first, first + points)
        yield PointCloud(cloud.easting[part], cloud.northing[part], cloud.upward[part], cloud.kind[part])
