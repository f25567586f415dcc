"""The part that all readers share: pieces one after the other as chunks of points, and the verdict at the end."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from typing import Any

from bumpymap.errors import UsageError
from bumpymap.readers.protocol import PIECE_POINTS, Batch, Piece, SurveyInfo
from bumpymap.readers.tally import Tally, judge
from bumpymap.types import PointCloud

__all__ = ["Survey"]


class Survey(ABC):
    """A ``SurveyReader``; a format adds how its pieces are cut, read and converted."""

    def __init__(self, info: SurveyInfo) -> None:
        self._info = info
        self._dropped = Tally().dropped

    @property
    def info(self) -> SurveyInfo:
        """What the header says."""
        return self._info

    @property
    def dropped(self) -> dict[str, int]:
        """Points that did not count so far, by reason."""
        return dict(self._dropped)

    @abstractmethod
    def pieces(self, points: int = PIECE_POINTS) -> Sequence[Piece]:
        """Cut the file; see ``SurveyReader.pieces``."""

    @abstractmethod
    def fetch(self, piece: Piece) -> Any:
        """Read and decode; see ``SurveyReader.fetch``."""

    @abstractmethod
    def convert(self, piece: Piece, fetched: Any) -> Batch:
        """Points that count, in metres; see ``SurveyReader.convert``."""

    def judge(self, tally: Tally) -> None:
        """Hold all points to the header; see ``SurveyReader.judge``."""
        judge(tally, self._info.path, self._info.point_count, self._info.bounds)

    def chunks(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Give the points that count; see ``SurveyReader.chunks``."""
        if points < 1:
            raise UsageError(f"a chunk of {points} points was asked for; it must hold at least 1")
        tally = Tally()
        for piece in self.pieces(points):
            batch = self.convert(piece, self.fetch(piece))
            tally = tally.merge(batch.tally)
            self._dropped = tally.dropped
            if not tally.bad:
                yield from _split(batch.cloud, points)
        self.judge(tally)


def _split(cloud: PointCloud, points: int) -> Iterator[PointCloud]:
    for first in range(0, cloud.easting.size, points):
        part = slice(first, first + points)
        yield PointCloud(cloud.easting[part], cloud.northing[part], cloud.upward[part], cloud.is_ground[part])
