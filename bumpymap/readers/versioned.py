"""A survey that must stay the same from the moment it is opened to the end of its reading.

Formats know nothing of it: what they were given may have come from two versions of a file, which look like a damaged
one at best, and like a sound one at worst.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from bumpymap.readers.base import SurveyBase
from bumpymap.readers.point_stats import PointStats
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints, SurveyReader
from bumpymap.readers.source import Location, is_url, pinned_version, require_unchanged, version_of

__all__ = ["VersionedSurvey"]


class VersionedSurvey(SurveyBase):
    """A ``SurveyReader`` around another one.

    Parameters
    ----------
    path : Path or str
    open_reader : callable
        Opens it: reads the header.

    Raises
    ------
    BadInputError
        Here, or from ``fetch`` and ``verify``: the file was changed, or is gone.
    """

    def __init__(self, path: Location, open_reader: Callable[[], SurveyReader]) -> None:
        self._path, self._version = path, version_of(path)
        with pinned_version(path, self._version):
            self._reader = open_reader()
        super().__init__(replace(self._reader.info, version=self._version))

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut the file; see ``SurveyReader.pieces``."""
        return self._reader.chunks(points)

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode; see ``SurveyReader.fetch``."""
        with pinned_version(self._path, self._version):
            fetched = self._reader.fetch(chunk)
        if not is_url(self._path):  # a server would be asked once more for each piece
            require_unchanged(self._path, self._version)
        return fetched

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Points that count, in metres; see ``SurveyReader.convert``."""
        with pinned_version(self._path, self._version):
            return self._reader.convert(chunk, fetched)

    def verify(self, stats: PointStats) -> None:
        """Hold all points to the header, and the file to what it was; see ``SurveyReader.verify``."""
        require_unchanged(self._path, self._version)
        self._reader.verify(stats)
