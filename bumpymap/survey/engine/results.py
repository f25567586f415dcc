"""Results of tasks, counts and file names without points; and the packs that hold the points of each block."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PieceRuns
from bumpymap.readers import LineSums, PointStats, Version
from bumpytiles import BlockKey

__all__ = ["BlockCatalogue", "BlockGroup", "FinishedTiles", "ReadResult", "Span"]

_SIDE = 8
"""Blocks along a side of the squares that groups are formed from: neighbouring blocks are in the same packs."""
MOST_BLOCKS = 64
"""Most blocks in a group; they hold at most 16,384 tiles: one pack."""
_MOST_POINTS = 20_000_000


@dataclass(frozen=True, slots=True)
class BlockGroup:
    """Blocks that one task finishes, and the packs that hold their points on disk."""

    keys: tuple[BlockKey, ...]
    packs: tuple[Path, ...]


class BlockCatalogue:
    """Knows which packs hold points of each block; takes 32 bytes for each block of each pack."""

    def __init__(self) -> None:
        self._paths: list[Path | None] = []
        self._entries: list[NDArray[np.int64]] = []

    def add(self, path: Path | None, blocks: NDArray[np.int64]) -> None:
        """Add the blocks of a pack, or of the memory of this process (``path`` None).

        ``blocks`` (n, 3) holds row, column and number of points of each block; a block may occur several times.
        """
        number = np.full((len(blocks), 1), len(self._paths), np.int64)
        self._paths.append(path)
        self._entries.append(np.hstack([blocks.reshape(-1, 3), number]))

    def keys(self) -> NDArray[np.int64]:
        """Rows and columns of all blocks, (n, 2), each once."""
        return np.unique(self._all()[:, :2], axis=0)

    def groups(self, skip: Collection[BlockKey] = (), *, single: bool = False) -> Iterator[BlockGroup]:
        """Yield groups of neighbouring blocks, without those in ``skip``; one group of all of them if ``single``."""
        entries = self._all()
        row, col = entries[:, 0], entries[:, 1]
        entries = entries[np.lexsort((col, row, col // _SIDE, row // _SIDE))]
        starts = np.flatnonzero(np.any(np.diff(entries[:, :2], axis=0, prepend=entries[:1, :2] - 1), axis=1))
        stops = np.append(starts, len(entries))[1:]
        points = np.diff(np.append(0, np.cumsum(entries[:, 2]))[np.append(starts, len(entries))])
        held: list[NDArray[np.int64]] = []
        keys: list[BlockKey] = []
        total = 0
        for start, stop, count in zip(starts.tolist(), stops.tolist(), points.tolist(), strict=True):
            key = (int(entries[start, 0]), int(entries[start, 1]))
            if key in skip:
                continue
            if keys and not single and (len(keys) == MOST_BLOCKS or total + count > _MOST_POINTS):
                yield self._group(keys, held)
                held, keys, total = [], [], 0
            held.append(entries[start:stop, 3])
            keys.append(key)
            total += count
        if keys:
            yield self._group(keys, held)

    def _group(self, keys: Sequence[BlockKey], packs: Sequence[NDArray[np.int64]]) -> BlockGroup:
        found = (self._paths[number] for number in np.unique(np.concatenate(packs)).tolist())
        return BlockGroup(tuple(keys), tuple(path for path in found if path is not None))

    def _all(self) -> NDArray[np.int64]:
        return np.concatenate([np.empty((0, 4), np.int64), *self._entries])


Span = tuple[int, int, int]
"""Index of the file, first chunk, last chunk + 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadResult:
    """The result of reading some chunks."""

    spans: tuple[Span, ...]
    stats: dict[int, PointStats] = field(default_factory=dict)
    """Statistics by file."""
    flagged: bool = False
    """Whether any point is ground."""
    lines: LineSums = LineSums()  # noqa: RUF009 (frozen)
    """Sums to compare flight lines."""
    hashed: dict[int, PieceRuns] = field(default_factory=dict)
    """What has been computed of the checksum of each file, see `SurveyReader.take_hashed`."""
    packs: tuple[tuple[Path, NDArray[np.int64]], ...] = ()
    """Packs of waiting points, each with the row, column and number of points of its blocks, (n, 3)."""
    tiles: tuple[tuple[Path, ...], ...] = ()
    """Packs of finished tiles, grouped by `BlockWork.kinds`."""
    in_memory: NDArray[np.int64] | None = None
    """Blocks, as in ``packs``, whose points are only in the memory of this process: they cannot be resumed."""
    error: BadInputError | None = None
    """Why the file is bad."""
    seen: Mapping[int, tuple[str, Version | None]] = field(default_factory=dict)
    """By file, the name of the machine that read the chunks, and the version there; without those of this process."""


@dataclass(frozen=True, slots=True)
class FinishedTiles:
    """Packs of finished tiles, and the number of blocks in them."""

    packs: tuple[Path, ...]
    blocks: int
