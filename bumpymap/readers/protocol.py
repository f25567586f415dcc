"""What every reader takes and gives: options, what a header says, pieces of points."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from bumpymap.core import Georeference, PointCloud, ZUnit
from bumpymap.readers.point_stats import PointStats
from bumpymap.readers.source import Location, Version
from bumpytiles import Bounds

__all__ = ["CHUNK_POINTS", "Chunk", "ChunkPoints", "ReadOptions", "SurveyInfo", "SurveyReader"]

CHUNK_POINTS = 500_000
"""Points of a piece: enough to keep a decoder busy, few enough to be held by the dozen."""


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """What the user says about the files; it wins over what the files say."""

    crs: str | None = None
    """Anything PROJ understands, such as ``EPSG:32614``; None: believe the file."""
    z_unit: ZUnit | None = None
    """Unit of the heights; None: believe the file."""
    trust_points: bool = False
    """Ignore the extent that a header claims; the points' own counts."""
    memory: int = 1 << 30
    """What unpacking a file may take that cannot be read in pieces (compressed PCD), bytes."""


@dataclass(frozen=True, slots=True)
class SurveyInfo:
    """What is known of a file before its points are read."""

    path: Location
    """A path, or the text of a URL."""
    format: str
    """Such as ``LAS 1.2, point format 3``."""
    size_bytes: int
    point_count: int
    """Promised by the header."""
    georeference: Georeference
    bounds: Bounds | None
    """What the header claims, m; None where the format has no such header, or it is not to be believed."""
    has_classes: bool | None
    """Whether points carry a class; None: the format has the field, only the points tell whether it is used."""
    notes: tuple[str, ...]
    """What a user should know, one sentence each."""
    version: Version | None = None
    """Which version of the file is read, see `bumpymap.readers.source.version_of`; None where nobody watches it."""
    sequential: bool = False
    """Whether the points can only be decoded from the start of the file on."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """A part of a file that can be read by itself: points ``first`` to ``first + points`` in reading order."""

    index: int
    """0, 1, 2, ... in reading order."""
    first: int
    """Points before it in reading order."""
    points: int
    """As the header or the table of the file promises."""
    bounds: Bounds | None = None
    """Extent in m. `verify` raises if a point lies more than 1 m outside it. None if only the bounds of the whole file
    are known."""


@dataclass(frozen=True, slots=True)
class ChunkPoints:
    """The points of a piece."""

    cloud: PointCloud
    """Those that count, in metres; none where ``stats.bad``."""
    stats: PointStats
    """Of all of them."""


class SurveyReader(Protocol):
    """One point cloud file, read in pieces: ``fetch``, then ``convert`` each, ``verify`` the sum of their tallies."""

    @property
    def info(self) -> SurveyInfo:
        """What the header says."""

    @property
    def dropped(self) -> dict[str, int]:
        """How many points did not count, by reason; complete once ``chunks`` is used up."""

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Cut the file into pieces of about so many points; the same number gives the same pieces on any machine.

        Where the file is an octree (COPC), pieces go through space in order, so that places are complete early.
        """

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a piece. From one thread at a time, in any order; in order is fastest.

        Raises
        ------
        BadInputError
            The piece is damaged.
        """

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Turn what ``fetch`` gave into metres and keep the points that count. From any thread.

        ``fetched`` is used up.
        """

    def verify(self, stats: PointStats) -> None:
        """Hold the points of all pieces to what the header said.

        Raises
        ------
        BadInputError
            The header and the points disagree, or points are off_earth.
        """

    def clouds(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Give the points that count, in metres, in reading order, at most ``points`` at a time.

        Raises
        ------
        BadInputError
            As ``fetch`` and ``verify`` do; what concerns all points is known, and raised, at the end.
        """
