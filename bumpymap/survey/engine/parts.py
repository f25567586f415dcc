"""Parts of files: what one worker reads at a time, and which blocks no other part can reach."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bumpymap.readers import Chunk, SurveyReader
from bumpytiles import BLOCK_TILES, Bounds, Grid

__all__ = ["Part", "Rivals", "cut_parts", "part_points"]

_LEAST, _MOST = 2_000_000, 256_000_000
_PARTS_A_WORKER = 4
"""At the end of reading some workers have nothing left to do: a quarter of a worker's share at most."""
_MARGIN = 1.01
"""As in `Coming`: so far outside its bounds a point may lie, m."""


@dataclass(frozen=True, slots=True)
class Part:
    """Some pieces of a file that follow each other."""

    file: int
    """Which reader."""
    first: int
    """Its first piece."""
    stop: int
    """The piece behind its last one."""
    points: int
    bounds: Bounds | None
    """Where its points lie, m; None where that is not known."""


def part_points(points: int, workers: int) -> int:
    """Most points of a part, where so many points are shared out among so many workers."""
    return max(_LEAST, min(_MOST, points // (_PARTS_A_WORKER * workers)))


def cut_parts(readers: Sequence[SurveyReader], chunk_points: int, most: int) -> list[Part]:
    """Cut files into parts of whole pieces, of at most about ``most`` points each; a small file is one part."""
    parts = []
    for file, reader in enumerate(readers):
        chunks = reader.chunks(chunk_points)
        first = 0
        for stop in _stops(chunks, most):
            own = chunks[first:stop]
            bounds = _around([chunk.bounds for chunk in own]) or reader.info.bounds
            parts.append(Part(file, first, stop, sum(chunk.points for chunk in own), bounds))
            first = stop
    return parts


def _stops(chunks: Sequence[Chunk], most: int) -> Iterator[int]:
    held = 0
    for number, chunk in enumerate(chunks):
        if held and held + chunk.points > most:
            yield number
            held = 0
        held += chunk.points
    yield len(chunks)


def _around(boxes: Sequence[Bounds | None]) -> Bounds | None:
    known = [box for box in boxes if box is not None]
    if not known or len(known) < len(boxes):
        return None
    return Bounds(
        min(box.west for box in known),
        min(box.south for box in known),
        max(box.east for box in known),
        max(box.north for box in known),
    )


class Rivals:
    """Tells which parts may have points in the same blocks.

    Parameters
    ----------
    grid : Grid
    parts : sequence of Part
    """

    def __init__(self, grid: Grid, parts: Sequence[Part]) -> None:
        self._parts = parts
        self._known = all(part.bounds for part in parts)
        boxes = [part.bounds or Bounds(0, 0, 0, 0) for part in parts]
        self._sides = np.array([(box.west, box.south, box.east, box.north) for box in boxes]).reshape(-1, 4).T
        self._reach = BLOCK_TILES * grid.tile_size + 2 * _MARGIN

    def of(self, number: int) -> tuple[Bounds, ...] | None:
        """Give the bounds of the other parts near a part; None where it shares every block that it may have."""
        box = self._parts[number].bounds
        if not self._known or box is None:
            return None
        west, south, east, north = self._sides
        reach = self._reach
        near = (west <= box.east + reach) & (east >= box.west - reach)
        near &= (south <= box.north + reach) & (north >= box.south - reach)
        near[number] = False
        around = near & (west <= box.west) & (south <= box.south) & (east >= box.east) & (north >= box.north)
        if around.any():
            return None
        return tuple(bounds for k in np.flatnonzero(near).tolist() if (bounds := self._parts[k].bounds) is not None)
