"""What workers hand back: counts and names of files, no points."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError
from bumpymap.readers import PointStats, Version

__all__ = ["FinishedTiles", "ReadResult", "Span"]

Span = tuple[int, int, int]
"""File, first chunk, and the chunk behind the last."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadResult:
    """What came of some chunks."""

    spans: tuple[Span, ...]
    stats: dict[int, PointStats] = field(default_factory=dict)
    """By file."""
    flagged: bool = False
    """Whether any point is ground."""
    packs: tuple[tuple[Path, NDArray[np.int64]], ...] = ()
    """Packs of points that wait, and what they hold: (n, 3) row, column, points of each block."""
    tiles: tuple[tuple[Path, ...], ...] = ()
    """Packs of finished tiles; those of each `BlockWork.kinds` together."""
    in_memory: NDArray[np.int64] | None = None
    """Blocks as in ``packs`` whose points wait in the memory of this process: nothing of this outlives it."""
    error: BadInputError | None = None
    """Why the file is bad."""
    seen: tuple[str, Version | None] | None = None
    """Which machine read it, and which version of the file is there; None where this process did."""


@dataclass(frozen=True, slots=True)
class FinishedTiles:
    """Packs of finished tiles, and how many blocks they hold."""

    packs: tuple[Path, ...]
    blocks: int
