"""Check that a survey file does not change from when it is opened until all of it has been read.

The readers of the formats do not check this. If a file is replaced meanwhile, they see parts of two versions, which at
best look like a damaged file, and at worst like a valid one.
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
    """A ``SurveyReader`` that wraps another one and checks the version of its file.

    Parameters
    ----------
    path : Path or str
    open_reader : callable
        Opens the wrapped reader, which reads the header.

    Raises
    ------
    BadInputError
        Raised here and by ``fetch``, ``convert`` and ``verify`` if the file was changed or removed.
    """

    def __init__(self, path: Location, open_reader: Callable[[], SurveyReader]) -> None:
        self._path, self._version = path, version_of(path)
        with pinned_version(path, self._version):
            self._reader = open_reader()
        super().__init__(replace(self._reader.info, version=self._version))

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file into chunks; see ``SurveyReader.chunks``."""
        return self._reader.chunks(points)

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk; see ``SurveyReader.fetch``."""
        with pinned_version(self._path, self._version):
            fetched = self._reader.fetch(chunk)
        if not is_url(self._path):  # this would cost one more request for each chunk
            require_unchanged(self._path, self._version)
        return fetched

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert a chunk to points in metres; see ``SurveyReader.convert``."""
        with pinned_version(self._path, self._version):
            return self._reader.convert(chunk, fetched)

    def verify(self, stats: PointStats) -> None:
        """Check all points against the header, and that the file is unchanged; see ``SurveyReader.verify``."""
        require_unchanged(self._path, self._version)
        self._reader.verify(stats)
