"""Write a COG of one band that is mostly empty: only blocks with values are made, overviews included.

GDAL's COG driver visits every pixel, empty or not, several times: 400 million pixels of 10,000 scattered tiles took it
25 s of CPU time as float32 and 7 s as uint8. Here nothing is done for an empty pixel: the raster is cut into squares,
and the known pixels of each, as line, column and value, are put together to blocks and halved for the overviews. The
blocks wait in a side file until all are known, because a COG has its small overviews first. GDAL writes the tags (CRS,
metadata, colours) of a raster of one pixel, which are copied. The file is a BigTIFF (TIFF 6.0 with 8-byte offsets).
"""

import struct
import zlib
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.io import MemoryFile

from bumpymap.layers.placement import Placement, RasterSpec, RasterWindow, create_raster
from bumpytiles import TileWindow

_BLOCK = 128
"""Side of a block of the file, pixels: smaller ones leave more of the raster out."""
_HALVINGS = 5
_SQUARE = _BLOCK << (_HALVINGS - 1)
"""Side of the squares whose pixels are in memory at once: the smallest overview made of one square is one block."""
_SMALLEST = 512
"""Overviews end when both sides are at most this, pixels."""
_MOST_PIECES = 8
"""Most pieces with values of which a block is made; with more, compressing it as a whole is faster."""
_LAYOUT = (
    b"LAYOUT=IFDS_BEFORE_DATA\nBLOCK_ORDER=ROW_MAJOR\nBLOCK_LEADER=SIZE_AS_UINT4\n"
    b"BLOCK_TRAILER=LAST_4_BYTES_REPEATED\nKNOWN_INCOMPATIBLE_EDITION=NO\n "
)
"""Bytes that GDAL's COG driver writes after the header: readers over a network then need fewer requests."""
_FIRST_DIRECTORY = 16 + ((43 + len(_LAYOUT) + 7) & ~7)
_EVERYWHERE = {320, 42113}
"""Tags copied from GDAL's raster to all levels: colours, nodata."""
_KEPT = _EVERYWHERE | {33550, 33922, 34264, 34735, 34736, 34737, 42112}
"""Tags copied to the full level: also scale, tie point, transformation, geographic keys, metadata."""
_ADLER = 65521
"""The prime of Adler-32."""
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 11: 4, 12: 8, 13: 4, 16: 8}

Tag = tuple[int, int, bytes]
"""A field of a TIFF directory: number, type, values."""
Pieces = Callable[[RasterWindow], tuple[NDArray[np.int64], NDArray[np.int64], NDArray[Any]]]
"""Returns line and column, in the window, of the tiles in a window, (n,), and their values, (n, pixels, pixels)."""


class _Pixels(NamedTuple):
    """The known pixels of a part of a raster, in reading order."""

    line: NDArray[np.int64]
    column: NDArray[np.int64]
    value: NDArray[Any]


@dataclass(slots=True)
class _Level:
    """One resolution of the raster and the blocks that hold values."""

    width: int
    height: int
    blocks: dict[int, tuple[int, int]] = field(default_factory=dict)
    """Number of the block, row by row -> offset in the side file and size, bytes."""

    @property
    def across(self) -> int:
        return -(-self.width // _BLOCK)

    @property
    def count(self) -> int:
        return self.across * -(-self.height // _BLOCK)


@dataclass(slots=True)
class _Statistics:
    """Statistics of the values, as GDAL computes them."""

    count: int = 0
    low: float = np.inf
    high: float = -np.inf
    mean: float = 0.0
    squares: float = 0.0

    def add(self, values: NDArray[Any]) -> None:
        some = values.astype(np.float64)
        mean, total = float(some.mean()), self.count + len(some)
        step = mean - self.mean
        self.squares += float(((some - mean) ** 2).sum()) + step**2 * self.count * len(some) / total
        self.mean += step * len(some) / total
        self.low, self.high, self.count = min(self.low, float(some.min())), max(self.high, float(some.max())), total

    def tags(self, pixels: int) -> dict[str, str]:
        if not self.count:
            return {}
        named = {"MAXIMUM": self.high, "MEAN": self.mean, "MINIMUM": self.low}
        named |= {"STDDEV": (self.squares / self.count) ** 0.5}
        share = {"STATISTICS_VALID_PERCENT": f"{100 * self.count / pixels:.4g}"}
        return {f"STATISTICS_{name}": f"{value:.14g}" for name, value in named.items()} | share


def write_sparse_cog(
    path: Path, placement: Placement, spec: RasterSpec, pieces: Pieces, gdal: AbstractContextManager[Any]
) -> Iterator[NDArray[Any]]:
    """Write a COG of one float32 or uint8 band; time and memory do not grow with its empty parts.

    Parameters
    ----------
    path, placement, spec
        Those of `write_cog`. An overview pixel is the mean of the known pixels among four, or the first value of
        ``spec.worst`` among them.
    pieces : callable
        Returns line and column, in a window, of its tiles, (n,), and their values, (n, pixels, pixels).
    gdal : lock
        Held while GDAL makes the tags.

    Yields
    ------
    array (n,)
        Values of known pixels, each pixel once. The file is complete when there are no more.
    """
    width, height = (side * spec.pixels for side in (placement.window.cols, placement.window.rows))
    levels = [_Level(width, height)]
    while max(levels[-1].width, levels[-1].height) > _SMALLEST:
        levels.append(_Level(-(-levels[-1].width // 2), -(-levels[-1].height // 2)))
    statistics, waiting = _Statistics(), path.with_name(f"{path.name}.blocks")
    rests: list[_Pixels] = []
    pack = _BlockPacker(spec)
    with waiting.open("wb+") as side:
        for square in _squares(placement, spec, pieces):
            statistics.add(square.value)
            yield square.value
            pixels = square
            for level in levels[:_HALVINGS]:
                _keep(level, pixels, side, spec, pack)
                pixels = _halved(pixels, spec)
            rests.append(pixels)
        if rests and len(levels) > _HALVINGS:
            rest = _in_order(*(np.concatenate(part) for part in zip(*rests, strict=True)))
            for level in levels[_HALVINGS:]:
                _keep(level, rest, side, spec, pack)
                rest = _halved(rest, spec)
        with gdal:
            tags = _tags_of(placement, spec, statistics.tags(width * height))
        with path.open("wb") as file:
            _assemble(file, levels, tags, side, spec)
    waiting.unlink()


def _squares(placement: Placement, spec: RasterSpec, pieces: Pieces) -> Iterator[_Pixels]:
    """Yield the known pixels of each square that has some, north-west first."""
    whole, px = placement.window, spec.pixels
    for top in range(0, whole.rows * px, _SQUARE):
        for left in range(0, whole.cols * px, _SQUARE):
            line, column = top // px, left // px
            lines = min(-(-(top + _SQUARE) // px), whole.rows) - line
            columns = min(-(-(left + _SQUARE) // px), whole.cols) - column
            tiles = TileWindow(whole.col + column, whole.row + whole.rows - line - lines, columns, lines)
            down, across, values = pieces(RasterWindow(tiles, line, column))
            tile, y, x = np.nonzero(values == values if np.isnan(spec.nodata) else values != spec.nodata)  # noqa: PLR0124
            y, x, value = (line + down[tile]) * px + y, (column + across[tile]) * px + x, values[tile, y, x]
            inside = (y >= top) & (y < top + _SQUARE) & (x >= left) & (x < left + _SQUARE)
            if inside.any():
                yield _in_order(y[inside], x[inside], value[inside])


def _in_order(line: NDArray[np.int64], column: NDArray[np.int64], value: NDArray[Any]) -> _Pixels:
    order = np.argsort((line << 32) | column)
    return _Pixels(line[order], column[order], value[order])


def _halved(pixels: _Pixels, spec: RasterSpec) -> _Pixels:
    """Return one pixel for each 2 x 2 that hold a known one: their mean, or the worst value."""
    code = ((pixels.line >> 1) << 32) | (pixels.column >> 1)
    order = np.argsort(code, kind="stable")
    code, value = code[order], pixels.value[order]
    new = np.concatenate(([True], code[1:] != code[:-1]))
    first = np.flatnonzero(new)
    line, column = code[first] >> 32, code[first] & 0xFFFFFFFF
    if spec.worst:
        place = np.full(256, len(spec.worst))
        place[list(spec.worst)] = np.arange(len(spec.worst))
        worst = np.minimum.reduceat(place[value], first)
        return _Pixels(line, column, np.array(spec.worst, value.dtype)[worst])
    group = np.cumsum(new) - 1
    mean = np.bincount(group, value.astype(np.float64)) / np.bincount(group)
    return _Pixels(line, column, mean.astype(value.dtype))


def _keep(level: _Level, pixels: _Pixels, side: BinaryIO, spec: RasterSpec, pack: "_BlockPacker") -> None:
    """Compress the blocks that hold some pixels, and append them to the side file."""
    block = (pixels.line // _BLOCK) * level.across + pixels.column // _BLOCK
    order = np.argsort(block, kind="stable")
    block, line, column = block[order], pixels.line[order] % _BLOCK, pixels.column[order] % _BLOCK
    row = block * _BLOCK + line
    new = np.concatenate(([True], row[1:] != row[:-1]))
    lines = np.full((np.count_nonzero(new), _BLOCK), spec.nodata, spec.dtype)
    lines[np.cumsum(new) - 1, column] = pixels.value[order]
    row, block = row[new], block[new]
    # Runs of adjacent lines of a block, and which runs make up each block.
    runs = _changes((block[1:] != block[:-1]) | (row[1:] != row[:-1] + 1))
    first, stored = row[runs[:-1]] % _BLOCK, _predicted(lines)
    pieces = list(zip(first.tolist(), runs[:-1].tolist(), runs[1:].tolist(), strict=True))
    owner = block[runs[:-1]]
    at = side.tell()
    for start, stop in pairwise(_changes(owner[1:] != owner[:-1]).tolist()):
        data = pack(pieces[start:stop], stored)
        level.blocks[int(owner[start])] = (at, len(data))
        at += side.write(data)


def _changes(differ: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return where runs of equal neighbours start, and the end, of what changes where neighbours ``differ``."""
    return np.concatenate(([0], np.flatnonzero(differ) + 1, [len(differ) + 1]))


class _BlockPacker:
    """Compresses blocks of which few lines hold values; runs of empty lines are compressed once for all blocks.

    Pieces of a deflate stream that end with a full flush do not refer to each other, so they can be joined (RFC 1951).
    """

    def __init__(self, spec: RasterSpec) -> None:
        self._level = spec.level
        self._empty = np.repeat(_predicted(np.full((1, _BLOCK), spec.nodata, spec.dtype)), _BLOCK, axis=0)
        self._width = self._empty.shape[1]
        self._runs = [b"", *(self._piece(self._empty[:count]) for count in range(1, _BLOCK + 1))]
        self._sums = [zlib.adler32(self._empty[:count].data) for count in range(_BLOCK + 1)]

    def __call__(self, pieces: Sequence[tuple[int, int, int]], lines: NDArray[np.uint8]) -> bytes:
        """Return the bytes of a block; of each piece: its first line in it, its start and stop in ``lines``."""
        if len(pieces) < _MOST_PIECES:
            return self._joined(pieces, lines)
        whole = self._empty.copy()
        for first, start, stop in pieces:
            whole[first : first + stop - start] = lines[start:stop]
        return zlib.compress(whole.data, self._level)

    def _joined(self, pieces: Sequence[tuple[int, int, int]], lines: NDArray[np.uint8]) -> bytes:
        parts, end, total = [b"\x78\x01"], 0, 1
        for first, start, stop in pieces:
            some = lines[start:stop]
            parts += [self._runs[first - end], self._piece(some)]
            total = _joined_sum(total, self._sums[first - end], (first - end) * self._width)
            total = zlib.adler32(some.data, total)
            end = first + stop - start
        total = _joined_sum(total, self._sums[_BLOCK - end], (_BLOCK - end) * self._width)
        parts += [self._runs[_BLOCK - end], b"\x03\x00", struct.pack(">I", total)]
        return b"".join(parts)

    def _piece(self, lines: NDArray[np.uint8]) -> bytes:
        stream = zlib.compressobj(self._level, wbits=-15)
        return stream.compress(lines.data) + stream.flush(zlib.Z_FULL_FLUSH)


def _joined_sum(one: int, other: int, size: int) -> int:
    """Return the Adler-32 of two texts, joined, from those of each and the size of the second, bytes (RFC 1950)."""
    low = (one & 0xFFFF) + (other & 0xFFFF) - 1
    high = (one >> 16) + (other >> 16) + size * ((one & 0xFFFF) - 1)
    return (high % _ADLER) << 16 | low % _ADLER


def _predicted(lines: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of some lines as predictor 3 (floats, most significant bytes first) or 2 stores them."""
    size = lines.itemsize
    planes = lines.astype(lines.dtype.newbyteorder(">")).view(np.uint8).reshape(-1, _BLOCK, size)
    steps = planes.transpose(0, 2, 1).reshape(-1, size * _BLOCK)
    steps[:, 1:] = np.diff(steps, axis=1)
    return steps


def _tags_of(placement: Placement, spec: RasterSpec, statistics: dict[str, str]) -> list[Tag]:
    """Return the tags that GDAL writes for the CRS, position and metadata of the raster."""
    with MemoryFile(ext=".tif") as memory:
        with create_raster(memory.name, placement, spec, (1, 1), bigtiff="YES") as file:
            file.update_tags(1, **statistics)
        data = bytes(memory.getbuffer())
    (start,) = struct.unpack_from("<Q", data, 8)
    (entries,) = struct.unpack_from("<Q", data, start)
    tags = []
    for at in range(start + 8, start + 8 + 20 * entries, 20):
        tag, kind, count = struct.unpack_from("<HHQ", data, at)
        if tag in _KEPT:
            size = count * _SIZES[kind]
            place = at + 12 if size <= 8 else struct.unpack_from("<Q", data, at + 12)[0]
            tags.append((tag, kind, data[place : place + size]))
    return tags


def _assemble(file: BinaryIO, levels: list[_Level], tags: list[Tag], side: BinaryIO, spec: RasterSpec) -> None:
    """Write header, directories, then the blocks, smallest overview first."""
    sizes = [_size(_fields(level, tags, spec, number > 0)) for number, level in enumerate(levels)]
    starts = np.cumsum([_FIRST_DIRECTORY, *sizes]).tolist()
    layout = b"GDAL_STRUCTURAL_METADATA_SIZE=%06d bytes\n" % len(_LAYOUT) + _LAYOUT
    file.write((struct.pack("<2sHHHQ", b"II", 43, 8, 0, starts[0]) + layout).ljust(_FIRST_DIRECTORY, b"\0"))
    end = starts[-1]
    offsets: list[NDArray[np.uint64]] = []
    for level in reversed(levels):
        places = np.zeros((2, level.count), np.uint64)
        for number, (_, size) in sorted(level.blocks.items()):
            places[:, number] = end + 4, size
            end += 4 + size + 4
        offsets.insert(0, places)
    for number, (level, places) in enumerate(zip(levels, offsets, strict=True)):
        link = starts[number + 1] if number + 1 < len(levels) else 0
        file.write(_directory(_fields(level, tags, spec, number > 0, places), starts[number], link))
    for level in reversed(levels):
        for _, (place, size) in sorted(level.blocks.items()):
            side.seek(place)
            data = side.read(size)
            file.write(struct.pack("<I", size) + data + data[-4:])


def _fields(
    level: _Level, tags: list[Tag], spec: RasterSpec, overview: bool, places: NDArray[np.uint64] | None = None
) -> list[Tag]:
    where = np.zeros((2, level.count), np.uint64) if places is None else places
    kind = np.dtype(spec.dtype)
    photometric, predictor, sample = (
        3 if spec.colours else 1,
        3 if kind.kind == "f" else 2,
        3 if kind.kind == "f" else 1,
    )
    numbers = {254: (4, int(overview)), 256: (4, level.width), 257: (4, level.height), 258: (3, 8 * kind.itemsize)}
    numbers |= {259: (3, 8), 262: (3, photometric), 277: (3, 1), 284: (3, 1), 317: (3, predictor)}
    numbers |= {322: (3, _BLOCK), 323: (3, _BLOCK), 339: (3, sample)}
    fields = [(tag, kind, struct.pack("<H" if kind == 3 else "<I", value)) for tag, (kind, value) in numbers.items()]
    fields += [(324, 16, where[0].tobytes()), (325, 16, where[1].tobytes())]
    return sorted(fields + [tag for tag in tags if not overview or tag[0] in _EVERYWHERE])


def _size(fields: list[Tag]) -> int:
    return 16 + 20 * len(fields) + sum((len(data) + 7) & ~7 for _, _, data in fields if len(data) > 8)


def _directory(fields: list[Tag], start: int, link: int) -> bytes:
    """Return a directory that begins at byte ``start`` of the file, followed by its longer values."""
    end = start + 16 + 20 * len(fields)
    entries, values = [struct.pack("<Q", len(fields))], []
    for tag, kind, data in fields:
        head = struct.pack("<HHQ", tag, kind, len(data) // _SIZES[kind])
        if len(data) <= 8:
            entries.append(head + data.ljust(8, b"\0"))
            continue
        entries.append(head + struct.pack("<Q", end))
        values.append(data.ljust((len(data) + 7) & ~7, b"\0"))
        end += len(values[-1])
    return b"".join([*entries, struct.pack("<Q", link), *values])
