"""The readers of surveys: options, header information, chunks of points, the version and the checksum of the file."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import GROUND_CLASSES, BadInputError, Georeference, GivenCrs, PointCloud, UsageError
from bumpymap.readers.point_stats import LineSums, PointStats, header_doubt, kinds_of, likely_feet, verify
from bumpymap.readers.source import Location, Version, hash_survey, pinned_version, require_unchanged, version_of
from bumpytiles import Bounds, Grid, GroupedPoints, ScaledPoints, group_points, group_scaled_points

_SAMPLE = 10_000
"""Points of each of the chunks that tell whether coordinates look like feet, at least; LAZ chunks are read whole."""
CHUNK_POINTS = 500_000
"""Default points of a chunk: enough to keep the decoder busy, few enough to hold dozens of chunks in memory."""


@dataclass(frozen=True, slots=True)
class ReadOptions(GivenCrs):
    """Settings of the user that add to what the files state, or override it."""

    trust_points: bool = False
    """Ignore the extent in the header and use that of the points."""
    memory: int = 1 << 30
    """Memory limit, in bytes, for unpacking a file that cannot be read in chunks (compressed PCD)."""
    lines: bool = False
    """True if sums are made to compare the heights of flight lines."""
    ground_classes: tuple[int, ...] = GROUND_CLASSES
    """LAS classes that are ground."""
    keep_classes: bool = False
    """True if the kind of a point is its class."""
    colour: bool = False
    """True if the colours of points are read, where a file has some."""
    dtm: bool = False
    """True if a pixel of a raster of heights is ground; else it is the highest surface there."""
    pixel_m: float = math.inf
    """Side of the pixels that points are for, m: files whose coordinates are too coarse for them are refused."""

    @property
    def kinds(self) -> NDArray[np.uint8]:
        """The kind of the points of each LAS class, (256,)."""
        return np.arange(256, dtype=np.uint8) if self.keep_classes else kinds_of(self.ground_classes)


_COARSE = 0.25 * (1.0 + 1e-9)
"""Largest step between coordinates, as a share of a pixel: a pixel has 4 x 4 places or more, but for rounding."""


def refuse_coarse(path: Location, step_m: float, why: str, options: ReadOptions) -> None:
    """Raise BadInputError if eastings or northings lie on steps that are too large for pixels; ``why`` they do."""
    if step_m > _COARSE * options.pixel_m:
        raise BadInputError(
            f"the coordinates of {path} lie on steps of {step_m:g} m, because {why}. That is over a quarter of a pixel "
            f"({options.pixel_m:g} m): points beside each other fall into one place, and rough ground would look "
            "smooth. Export it again from the original, with double coordinates, with float coordinates from a local "
            "origin (offset or shift), or as LAS with a scale of 0.001"
        )


@dataclass(frozen=True, slots=True)
class SurveyInfo:
    """Facts about a file before its points are read."""

    path: Location
    format: str
    """For example ``LAS 1.2, point format 3``."""
    size_bytes: int
    point_count: int
    """As declared in the header."""
    georeference: Georeference
    bounds: Bounds | None
    """Bounds in the header, m; None if the format has none, or they are to be ignored."""
    has_classes: bool | None
    """True if points have a class; None: the format has the field, but it is unknown whether it is used."""
    notes: tuple[str, ...]
    """Notes for the user, one sentence each."""
    version: Version = field(default_factory=dict)
    """Version of the file that is read, see `bumpymap.readers.source.version_of`."""
    sequential: bool = False
    """True if the points can only be decoded sequentially from the start of the file."""
    parallel: bool = False
    """True if several threads may fetch chunks at once, because one small chunk cannot keep all cores busy."""
    heights: tuple[float, float] | None = None
    """Lowest and highest in the header, m; None if the format has none, or they are to be ignored."""
    class_names: Mapping[int, str] = field(default_factory=dict)
    """Names that the file gives to classes."""
    most_seen: float = math.inf
    """Points per m2 of which more show nothing more: many pixels of a raster are interpolated."""
    header_date: date | None = None
    """Date in the header of a LAS file: often that of the flight or of processing. None if there is no valid one."""


@dataclass(frozen=True, slots=True)
class Chunk:
    """A part of a file that can be read on its own: points ``first`` to ``first + points`` in reading order."""

    index: int
    """0, 1, 2, ... in reading order."""
    first: int
    """Number of points before it in reading order."""
    points: int
    """Number of points, as declared in the header or the chunk table."""
    window: tuple[int, int, int, int] = (0, 0, 0, 0)
    """Of a raster: first column and row, number of columns and rows."""


@dataclass(frozen=True, slots=True)
class ChunkPoints:
    """The points of a chunk."""

    points: PointCloud | ScaledPoints
    """In metres or on the grid of the file, without dropped ones; empty if ``stats.bad``."""
    stats: PointStats
    """Statistics of all points of the chunk, dropped ones included."""
    lines: LineSums = LineSums()  # noqa: RUF009 (frozen)
    """Sums to compare flight lines, if `ReadOptions.lines` asks for them and the file names lines."""

    @property
    def cloud(self) -> PointCloud:
        """The points in metres."""
        points = self.points
        if isinstance(points, ScaledPoints):
            return PointCloud(*points.coordinates(), points.flag, points.colour)
        return points

    def grouped(self, grid: Grid) -> GroupedPoints:
        """Return the points grouped by block of tiles, in as few bytes as is exact."""
        points = self.points
        if isinstance(points, ScaledPoints):
            return group_scaled_points(grid, points)
        return group_points(grid, points.easting, points.northing, points.upward, points.kind, points.colour)


class SurveyReader(ABC):
    """A point cloud file that is read in chunks: ``fetch`` and ``convert`` each, then ``verify`` their merged stats.

    Every call checks that the file is still of the version that was opened. Subclasses for the formats read the header
    (`_open`), split the file, and read and convert chunks.

    Raises BadInputError: here and in ``fetch``, ``convert`` and ``verify``: the file is not what it
    must be, or was changed or removed.
    """

    def __init__(self, path: Location, options: ReadOptions) -> None:
        self._path, self._version = path, version_of(path)
        with pinned_version(path, self._version):
            info = self._open(options)
        self._info = replace(info, version=self._version)
        self._dropped, self._line_sums = PointStats().dropped, LineSums()

    @abstractmethod
    def _open(self, options: ReadOptions) -> SurveyInfo:
        """Read the header."""

    @abstractmethod
    def _fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk."""

    @abstractmethod
    def _convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert the result of ``_fetch``."""

    @property
    def info(self) -> SurveyInfo:
        """Contents of the header."""
        return self._info

    def note_likely_feet(self) -> None:
        """Add a note if nothing states the unit, and a sample of the points looks as if they were in feet."""
        if not self._info.georeference.assumed:
            return
        every, clouds = self.chunks(_SAMPLE), list[PointCloud]()
        with suppress(BadInputError), pinned_version(self._path, self._version):  # reported when the points are read
            for at in {0} if self._info.sequential else {0, len(every) // 2, len(every) - 1}:
                clouds.append(self._convert(every[at], self._fetch(every[at])).cloud)
        if why := likely_feet(clouds):
            note = f"{why}: are its coordinates in feet? Then pass `xy_unit='ft'` or `xy_unit='us-ft'`"
            self._info = replace(self._info, notes=(*self._info.notes, note))

    @property
    def has_colour(self) -> bool:
        """True if `ReadOptions.colour` asks for colours and a sample of the points has some."""
        return bool(getattr(self, "_colours", None))

    @property
    def dropped(self) -> dict[str, int]:
        """Number of dropped points, by reason; complete when ``clouds`` is exhausted."""
        return dict(self._dropped)

    @property
    def lines(self) -> LineSums:
        """Sums to compare flight lines; complete when ``clouds`` is exhausted."""
        return self._line_sums

    def checksum(self) -> str:
        """Read the file once more for its checksum, see `bumpymap.core.file_checksum`.

        Raises BadInputError: the file was changed or removed since it was opened.
        """
        with pinned_version(self._path, self._version):
            return hash_survey(self._path)

    @abstractmethod
    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file into chunks of about ``points`` points; the result is the same on every machine."""

    def fetch(self, chunk: Chunk) -> Any:
        """Read and decode a chunk, in any order; reading order is fastest.

        Call it from one thread at a time, unless ``SurveyInfo.parallel`` is set.

        Raises BadInputError: the chunk is damaged.
        """
        with pinned_version(self._path, self._version):
            return self._fetch(chunk)

    def convert(self, chunk: Chunk, fetched: Any) -> ChunkPoints:
        """Convert the result of ``fetch`` to points in metres and drop some. Thread-safe; overwrites ``fetched``."""
        with pinned_version(self._path, self._version):
            return self._convert(chunk, fetched)

    def verify(self, stats: PointStats) -> None:
        """Check the merged statistics of all chunks against the header, and that the file is unchanged.

        Raises BadInputError: the header and the points disagree, or points are not on Earth.
        """
        require_unchanged(self._path, self._version)
        verify(stats, self._info.path, self._info.point_count, self._info.bounds)

    def header_doubt(self, stats: PointStats) -> str:
        """Return where the extent in the header is not that of the points; empty if it is, or nobody measured it."""
        return header_doubt(stats, self._info.bounds, self._info.heights)

    def clouds(self, points: int = 1_000_000) -> Iterator[PointCloud]:
        """Yield the points, in metres, in reading order, at most ``points`` at a time.

        Raises BadInputError: as ``fetch`` and ``verify``; the errors of ``verify`` are raised at
        the end.
        """
        stats, self._line_sums = PointStats(), LineSums()
        for chunk in self.chunks(points):
            converted = self.convert(chunk, self.fetch(chunk))
            stats = stats.merge(converted.stats)
            self._dropped = stats.dropped
            self._line_sums = self._line_sums.merge(converted.lines)
            for first in range(0, 0 if stats.bad else converted.cloud.easting.size, points):
                part, cloud = slice(first, first + points), converted.cloud
                yield PointCloud(cloud.easting[part], cloud.northing[part], cloud.upward[part], cloud.kind[part])
        self.verify(stats)
        self._info = replace(self._info, notes=(*self._info.notes, *filter(None, [self.header_doubt(stats)])))


_MOST_BYTES = 1 << 26
"""Bytes of a chunk in memory at most, unless a single LAZ chunk is larger."""
MOST_LAZ_CHUNKS = 1000
"""LAZ chunks of a chunk at most: each may take bytes beside its points."""


def chunk_capacity(points: int, point_size: int) -> int:
    """Return how many points of ``point_size`` bytes a chunk may hold: at most ``points``, which must be 1 or more."""
    if points < 1:
        raise UsageError(f"chunks of {points} points were requested; a chunk must hold at least 1")
    return max(min(points, _MOST_BYTES // point_size), 1)


def split_rows(total: int, points: int, point_size: int) -> list[Chunk]:
    """Return the chunks of a file that can be split between any two points."""
    step = chunk_capacity(points, point_size)
    return [Chunk(index, first, min(step, total - first)) for index, first in enumerate(range(0, total, step))]


def group_laz_chunks(ends: NDArray[np.int64], points: int, point_size: int) -> list[Chunk]:
    """Return chunks made of whole LAZ chunks, with at most ``points`` points or a single LAZ chunk each.

    ``ends`` int64 (n,): number of points in the file up to the end of each LAZ chunk;
    ``point_size``: bytes of a point.
    """
    step = chunk_capacity(points, point_size)
    chunks: list[Chunk] = []
    first, before = 0, 0
    while first < ends.size:
        last = int(np.searchsorted(ends, before + step, side="right"))
        last = max(min(last, first + MOST_LAZ_CHUNKS), first + 1)
        end = int(ends[last - 1])
        chunks.append(Chunk(len(chunks), before, end - before))
        first, before = last, end
    return chunks
