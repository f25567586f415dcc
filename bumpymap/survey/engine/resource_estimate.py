"""What a run will take, told before it: memory and disk at most, time about.

Bounds follow from how the engine works; rates and what lies outside the budget were measured on two cores of an AMD
EPYC server, on made-up surveys of 1 to 20 million points and on real ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from bumpymap.core import tile_columns
from bumpymap.readers import SurveyInfo
from bumpymap.survey.engine.budget import POINT_BYTES, Budget
from bumpytiles import BLOCK_TILES, Bounds, Grid

__all__ = ["Estimate", "estimate", "most_tiles"]

_READING_BASE = 330 << 20
"""Interpreter, libraries and decoder while points are read and measured, bytes."""
_WRITING_BASE = 620 << 20
"""The same while layers are written, with the caches of the libraries that write them, bytes."""
_STRIP_COPIES = 2
"""Heightmaps of a row of blocks are held so often while layers are written."""

_PACK_BYTES, _ENTRY_BYTES = 8192, 32
"""Head of a pack, and what it notes of each block."""
_LAYER_HEIGHTS, _LAYER_NUMBERS = 8, 300
"""Layers: bytes a pixel of a heightmap (it is stored twice), and bytes a tile beside that; before compression."""

_START_S = 1.6
"""Imports, checks and what every run writes, s."""
_POINT_NS = {"LAZ": 330.0, "COPC": 330.0, "LAS": 130.0, "PLY": 180.0, "PCD": 100.0}
"""Processor time a point by format: decoding, grouping, measuring, ns."""
_TEXT_POINT_NS = 600.0
_SPILLED_POINT_NS = 100.0
"""To write a point to disk and read it again, ns."""
_TILE_NS = 30_000.0
"""Processor time a tile: classifying it and writing it, ns."""
_WRITERS = 2
"""Cores that writing layers keeps busy."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What ``map`` will take on one machine."""

    points: int
    """As the headers promise."""
    tiles: int | None
    """At most; None where nothing is known of where the points lie."""
    memory: int
    """Resident at most, helper processes included, bytes."""
    scratch: int
    """Points on disk at most, bytes; less where blocks are complete early."""
    out: int | None
    """In the folder of the layers: finished tiles and the layers made from them, at most, bytes."""
    seconds: float
    """About."""


def estimate(infos: Sequence[SurveyInfo], grid: Grid, budget: Budget, tiles: int | None = None) -> Estimate:
    """Estimate a run.

    Parameters
    ----------
    infos : sequence of SurveyInfo
        What the headers of its files say (at least one).
    grid : Grid
    budget : Budget
    tiles : int, optional
        Tiles that hold points, where they were counted.
    """
    points = sum(info.point_count for info in infos)
    boxes = [info.bounds for info in infos]
    most = tiles if tiles is not None else most_tiles(boxes, points, grid)
    blocks = most_tiles(boxes, points, Grid(grid.tile_size * BLOCK_TILES, grid.pixels))
    scratch = _scratch(points, blocks if blocks is not None else most, len(infos), budget)
    cols = max((_sides(box, grid)[0] for box in _around(boxes)), default=0)
    strip = _STRIP_COPIES * BLOCK_TILES * grid.pixels**2 * 4 * min(cols, points)
    tile_bytes = 2 * sum(column.row_bytes for column in tile_columns(grid.pixels))  # measured both ways, at worst
    tile_bytes += _LAYER_HEIGHTS * grid.pixels**2 + _LAYER_NUMBERS
    return Estimate(
        points=points,
        tiles=most,
        memory=max(_READING_BASE + budget.most_bytes(points), _WRITING_BASE + strip),
        scratch=scratch,
        out=None if most is None else most * tile_bytes,
        seconds=_seconds(infos, scratch // POINT_BYTES, most or 0, budget.threads),
    )


def most_tiles(boxes: Sequence[Bounds | None], points: int, grid: Grid) -> int | None:
    """Count the tiles that points in these boxes can fall into at most; None where a box is not known."""
    total = 0
    for box in boxes:
        if box is None:
            return None
        cols, rows = _sides(box, grid)
        total += cols * rows
    return min(total, points)


def _around(boxes: Sequence[Bounds | None]) -> list[Bounds]:
    """Give the box around all boxes that are known; nothing where none is."""
    known = [box for box in boxes if box is not None]
    if not known:
        return []
    west, south = min(box.west for box in known), min(box.south for box in known)
    return [Bounds(west, south, max(box.east for box in known), max(box.north for box in known))]


def _sides(box: Bounds, grid: Grid) -> tuple[int, int]:
    """Columns and rows of tiles that a box touches."""
    cols = int(box.east // grid.tile_size) - int(box.west // grid.tile_size) + 1
    rows = int(box.north // grid.tile_size) - int(box.south // grid.tile_size) + 1
    return cols, rows


def _scratch(points: int, blocks: int | None, files: int, budget: Budget) -> int:
    """Bytes of the packs of points, were every block to wait until the end; nothing where memory holds all points."""
    if points <= budget.waiting_points:
        return 0
    # Each pack holds half of what may wait, but for the last one of each file.
    packs = 2 * points // budget.waiting_points + 1 + files
    entries = points if blocks is None else min(points, packs * blocks)
    return points * POINT_BYTES + packs * (_PACK_BYTES + files * _ENTRY_BYTES) + entries * _ENTRY_BYTES


def _seconds(infos: Sequence[SurveyInfo], spilled: int, tiles: int, cores: int) -> float:
    work = sum(info.point_count * _point_ns(info.format) for info in infos) + spilled * _SPILLED_POINT_NS
    return _START_S + 1e-9 * (work / cores + tiles * _TILE_NS / min(cores, _WRITERS))


def _point_ns(kind: str) -> float:
    text = "text" in kind or "ascii" in kind
    return _TEXT_POINT_NS if text else _POINT_NS[kind[:4].rstrip(" ,")]
