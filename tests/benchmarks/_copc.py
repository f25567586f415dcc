"""Write a synthetic site as COPC, node by node, without holding more than a few nodes in memory.

The position of a point follows from its number, so the points of a square of ground can be made by themselves. Squares
are made along a Z-order curve. Three of four points stay in the node of their square; the others go to its ancestors,
so that all nodes have about as many points. A node is written when the curve has left it.
"""

import itertools
import math
import os
import struct
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import BinaryIO

import laspy
import lazrs
import numpy as np
from _ground import SCALE, SPACING, SWATH, fill_records, levels_above
from numpy.typing import NDArray

__all__ = ["write_copc"]

_POINTS_PER_SQUARE = 75_000
_BOTTOM = -16_000
"""Lower bound of the root node, in steps of ``SCALE``."""
_AT_ONCE = 32
"""Squares that are made before their nodes are written."""
_ENTRY = struct.Struct("<4iQ2i")
_INFO = struct.Struct("<5d2Q2d88x")


@dataclass(frozen=True, slots=True)
class _Octree:
    """Nodes of a site: squares of whole steps of ``SCALE``."""

    points: int
    lines: int
    seed: int

    @property
    def _swaths(self) -> int:
        return math.ceil(self.points / (SWATH * self.lines))

    @property
    def depth(self) -> int:
        """Level of the smallest nodes."""
        return max(0, round(math.log2(self._extent / math.sqrt(_POINTS_PER_SQUARE) / (SPACING / SCALE))))

    @property
    def _extent(self) -> float:
        return max(self._swaths * SWATH, self.lines) * SPACING / SCALE

    @property
    def side(self) -> int:
        """Side of the smallest nodes, in steps; the root encloses all heights too."""
        return math.ceil(max(self._extent + 1, -2 * _BOTTOM) / 2**self.depth)

    def squares(self) -> Iterator[tuple[int, int]]:
        """Yield column and row of the smallest nodes along a Z-order curve."""
        for place in range(4**self.depth):
            bits = [(place >> (2 * level) & 1, place >> (2 * level + 1) & 1) for level in range(self.depth)]
            yield tuple(sum(pair[axis] << level for level, pair in enumerate(bits)) for axis in (0, 1))

    def make(self, square: tuple[int, int], dtype: np.dtype[np.void]) -> NDArray[np.void]:
        """Return the points of a square, sorted by number; a point on a border belongs to the east and the north."""
        columns, lines = (
            np.arange(max(0, self._cell(at * self.side) - 1), min(most, self._cell((at + 1) * self.side) + 2))
            for at, most in zip(square, (self._swaths * SWATH, self.lines), strict=True)
        )
        swath, across = columns // SWATH, columns % SWATH
        numbers = ((swath * self.lines)[:, None] + lines) * SWATH + across[:, None]
        numbers = np.sort(numbers[numbers < self.points])
        records = np.zeros(len(numbers), dtype)
        fill_records(numbers, self.lines, self.seed, records)
        inside = (records["X"] // self.side == square[0]) & (records["Y"] // self.side == square[1])
        return records[inside]

    @staticmethod
    def _cell(at: int) -> int:
        return int(at * SCALE / SPACING)


class _NodeWriter:
    """Compresses nodes, each as a chunk, and remembers their keys."""

    def __init__(self, stream: BinaryIO, header: laspy.LasHeader, record: lazrs.LazVlr) -> None:
        self._header = header
        self._compressor = lazrs.ParLasZipCompressor(stream, record)
        self._compressor.reserve_offset_to_chunk_table()
        self._waiting: list[NDArray[np.void]] = []
        self.keys: list[tuple[int, int, int, int]] = []
        self.times = (math.inf, -math.inf)

    def add(self, key: tuple[int, int, int, int], records: NDArray[np.void]) -> None:
        self.keys.append(key)
        self._waiting.append(records)
        times = records["gps_time"]
        self.times = min(self.times[0], float(times.min())), max(self.times[1], float(times.max()))
        header = self._header
        header.grow(laspy.ScaleAwarePointRecord(records, header.point_format, header.scales, header.offsets))

    def flush(self) -> None:
        """Compress what waits on all cores."""
        if self._waiting:
            self._compressor.compress_chunks([np.ascontiguousarray(each).view(np.uint8) for each in self._waiting])
            self._waiting.clear()

    def close(self) -> None:
        self.flush()
        self._compressor.done()


def write_copc(stream: BinaryIO, header: laspy.LasHeader, site: tuple[int, int, int]) -> None:
    """Write a site of ``site``: number of points, lines of a swath, seed."""
    tree = _Octree(*site)
    record = lazrs.LazVlr.new_for_compression(header.point_format.id, 0, use_variable_size_chunks=True)
    info = laspy.VLR("copc", 1, "", bytes(_INFO.size))
    header.vlrs.insert(0, info)
    header.vlrs.append(laspy.VLR("laszip encoded", 22204, "", record.record_data()))
    header.are_points_compressed = True
    header.partial_reset()  # no points yet: bounds that any point enlarges
    header.write_to(stream)
    start = stream.tell()
    writer = _NodeWriter(stream, header, record)
    _write_nodes(tree, writer, header.point_format.dtype())
    writer.close()
    stream.seek(start)
    chunks = lazrs.read_chunk_table(stream, record)
    page = _page(writer.keys, chunks, start + 8)
    header.start_of_first_evlr, header.number_of_evlrs = stream.seek(0, os.SEEK_END), 1
    stream.write(struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(page), b"") + page)
    half = tree.side * 2**tree.depth * SCALE / 2
    centre = header.offsets + np.array([half, half, half + _BOTTOM * SCALE])
    at = header.start_of_first_evlr + 60
    info.record_data = _INFO.pack(*centre, half, 2 * half / 128, at, len(page), *writer.times)
    stream.seek(0)
    header.write_to(stream, ensure_same_size=True)


def _write_nodes(tree: _Octree, writer: _NodeWriter, dtype: np.dtype[np.void]) -> None:
    """Write all nodes, children before their parents."""
    waiting: list[list[NDArray[np.void]]] = [[] for _ in range(tree.depth + 1)]
    with ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool:
        rest = tree.squares()
        while squares := list(itertools.islice(rest, _AT_ONCE)):
            for square, records in zip(squares, pool.map(lambda each: tree.make(each, dtype), squares), strict=True):
                up = levels_above(records["gps_time"], tree.depth)
                for above in range(tree.depth + 1):
                    waiting[above].append(records[up == above])
                for above in range(tree.depth + 1):
                    last = 2**above - 1
                    if square[0] & last != last or square[1] & last != last:
                        break
                    _write_column(tree, writer, (above, square), np.concatenate(waiting[above]))
                    waiting[above].clear()
            writer.flush()


def _write_column(
    tree: _Octree, writer: _NodeWriter, place: tuple[int, tuple[int, int]], records: NDArray[np.void]
) -> None:
    """Write the nodes above one square of ground, one for each layer of heights."""
    above, square = place
    layer = (records["Z"] - _BOTTOM) // (tree.side << above)
    for z in np.unique(layer):
        key = (tree.depth - above, square[0] >> above, square[1] >> above, int(z))
        writer.add(key, records[layer == z])


def _page(keys: list[tuple[int, int, int, int]], chunks: list[tuple[int, int]], at: int) -> bytes:
    """Return the hierarchy: one page with all nodes."""
    entries = []
    for key, (points, size) in zip(keys, chunks, strict=True):
        entries.append(_ENTRY.pack(*key, at, size, points))
        at += size
    return b"".join(entries)
