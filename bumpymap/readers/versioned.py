"""Check that a survey file does not change from when it is opened until all of it has been read.

The readers of the formats do not check this. If a file is replaced meanwhile, they see parts of two versions, which at
best look like a damaged file, and at worst like a valid one.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from bumpymap.core import BadInputError, FileHash, PieceRuns
from bumpymap.readers.base import SurveyBase
from bumpymap.readers.point_stats import PointStats
from bumpymap.readers.protocol import CHUNK_POINTS, Chunk, ChunkPoints
from bumpymap.readers.source import Location, is_url, pinned_version, read_range, require_unchanged, version_of

__all__ = ["VersionedSurvey"]

_MOST_HELD = 1 << 25
"""Bytes of a chunk that are kept until they are hashed."""


class VersionedSurvey(SurveyBase):
    """A ``SurveyReader`` that wraps another one, checks the version of its file, and makes its checksum.

    Parameters
    ----------
    path : Path or str
    open_reader : callable
        Opens the wrapped reader, which reads the header.
    checksum : bool
        Whether the checksum of the file is made from what is read; there is none for a URL.

    Raises
    ------
    BadInputError
        Raised here and by ``fetch``, ``convert`` and ``verify`` if the file was changed or removed.
    """

    def __init__(self, path: Location, open_reader: Callable[[], SurveyBase], *, checksum: bool = False) -> None:
        self._path, self._version = path, version_of(path)
        self._hash = FileHash(self._version["size"]) if checksum and not is_url(path) else None
        with pinned_version(path, self._version, None if self._hash is None else self._hash.add):
            self._reader = open_reader()
        if self._hash is not None:
            self._hash.drop_copies()  # thousands of files may be open
        super().__init__(replace(self._reader.info, version=self._version))

    @property
    def checksum(self) -> str | None:
        """See ``SurveyReader.checksum``."""
        return None if self._hash is None else self._hash.checksum

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file into chunks; see ``SurveyReader.chunks``."""
        return self._reader.chunks(points)

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk; see ``SurveyReader.fetch``. What was read for it is hashed by ``convert``."""
        unhashed = None if self._hash is None else _Unhashed(self._hash)
        with self._may_be_bad(), pinned_version(self._path, self._version, None if unhashed is None else unhashed.add):
            fetched = self._reader.fetch(chunk)
        self._require_unchanged()
        return fetched if unhashed is None else (fetched, unhashed)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert a chunk to points in metres; see ``SurveyReader.convert``."""
        add = None
        if self._hash is not None:
            fetched, unhashed = fetched
            unhashed.finish()
            add = self._hash.add
        with self._may_be_bad(), pinned_version(self._path, self._version, add):
            converted = self._reader.convert(chunk, fetched)
        self._require_unchanged()
        return converted

    def verify(self, stats: PointStats) -> None:
        """Check all points against the header, and that the file is unchanged; see ``SurveyReader.verify``.

        Bytes that no reader has read are read here, for the checksum.
        """
        with self._may_be_bad():
            require_unchanged(self._path, self._version)
            self._reader.verify(stats)
            if self._hash is not None and self._hash.checksum is None:
                with pinned_version(self._path, self._version):
                    self._hash.finish(lambda start, size: read_range(self._path, start, size))
                require_unchanged(self._path, self._version)

    def take_hashed(self) -> PieceRuns:
        """See ``SurveyReader.take_hashed``."""
        return () if self._hash is None else self._hash.take()

    def put_hashed(self, pieces: PieceRuns) -> None:
        """See ``SurveyReader.put_hashed``."""
        if self._hash is not None:
            self._hash.put(pieces)

    def _require_unchanged(self) -> None:
        """Check the version of a local file; for a URL this would cost one more request for each chunk."""
        if not is_url(self._path):
            require_unchanged(self._path, self._version)

    @contextmanager
    def _may_be_bad(self) -> Iterator[None]:
        """Free memory if the file turns out to be bad."""
        try:
            yield
        except BadInputError:
            if self._hash is not None:
                self._hash.drop_copies()
            raise


class _Unhashed:
    """Bytes that were read for a chunk and are hashed later, by another thread, up to a limit."""

    def __init__(self, file_hash: FileHash) -> None:
        self._hash, self._size = file_hash, 0
        self._held: list[tuple[int, Any]] = []

    def add(self, start: int, data: Any) -> None:
        """Keep bytes, or hash them now if too many are kept."""
        self._size += len(data)
        if self._size > _MOST_HELD:
            self._hash.add(start, data)
        else:
            self._held.append((start, data))

    def finish(self) -> None:
        """Hash what is kept."""
        for start, data in self._held:
            self._hash.add(start, data)
