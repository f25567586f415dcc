"""The results of tasks: counts and file names, no points."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PieceRuns
from bumpymap.readers import LineSums, PointStats, Version

__all__ = ["FinishedTiles", "ReadResult", "Span"]

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
