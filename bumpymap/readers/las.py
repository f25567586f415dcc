"""The reader of LAS, LAZ and COPC. lazrs decodes only the fields that bumpymap needs.

LAZ chunks are found by their chunk table and checked before they are decoded; those of COPC are nodes of its octree.
laspy is not used: it creates a Python object for each chunk.
"""

import math
import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import BinaryIO, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, DecoderError, Georeference, Place, allocate_shared, georeference, loops
from bumpymap.readers.decoder import decoder
from bumpymap.readers.las_header import LAYERED, RawHeader, read_raw_header, statement_of_las
from bumpymap.readers.point_stats import EARTH_LIMIT, OUTSIDE, LinedPoints, LineSums, PointStats
from bumpymap.readers.protocol import (
    CHUNK_POINTS,
    Chunk,
    ChunkPoints,
    ReadOptions,
    SurveyInfo,
    SurveyReader,
    group_laz_chunks,
    refuse_coarse,
    split_rows,
)
from bumpymap.readers.source import TRUST, Location, box_text, decoding, open_source, read_into, refuse_count
from bumpytiles import DECIMALS, Bounds, ScaledPoints, Scaling

_NOT_CHUNKED = 1
"""Value of the "compressor" word of the LASzip record for data without a chunk table (LASzip 1)."""
_LARGEST_CHUNK = 1 << 28
"""Decoded bytes of a LAZ chunk at most."""
_ITEMS = (
    (6, 20, 0, range(6)),
    (7, 8, 0, (1, 3, 4, 5)),
    (8, 6, 0, (2, 3, 5)),
    (9, 29, 0, (4, 5)),
    (10, 30, 9, range(6, 11)),
    (11, 6, 1, (7,)),
    (12, 8, 2, (8, 10)),
    (13, 29, 1, (9, 10)),
)
"""Items that points consist of: type, bytes, layers in a LAZ chunk, point formats. Extra bytes are one more item."""
_EXTRA, _EXTRA_LAYERED = 0, 14
"""LASzip's numbers of the item of extra bytes, point formats 0 to 5 and 6 to 10."""
_DENSEST = 4096
"""Points per byte at most: the cheapest symbol of LASzip's models takes 0.003 bits, and each point has at least one."""
_ANY_SIZE = 0xFFFFFFFF
"""Chunk size in a LASzip record if the sizes are in the chunk table."""
_ENTRY_BYTES = 16
"""Limit of a chunk table entry: two numbers, which take less than eight bytes each when encoded."""
_TRUNCATED = "truncated? Copy or download it again"
_WRITE_AGAIN = "Write it again with the usual codec, such as with: pdal translate IN OUT.laz"


ChunkTable: TypeAlias = NDArray[np.void]
"""The LAZ chunks of a file in reading order, without empty ones, (n,) rows: ``counts``, number of points; ``starts``,
offset in the file, and ``sizes``, bytes."""


def laz_record(path: Location, header: RawHeader) -> bytes:
    """Return the LASzip record, after checking that it matches the point format and that lazrs supports it."""
    record = header.records.get((b"laszip encoded", 22204), b"")
    if len(record) < 34:
        raise BadInputError(f"{path} is compressed and has no LASzip record to decode it by. Copy or download it again")
    (count,) = struct.unpack_from("<H", record, 32)
    items = [struct.unpack_from("<HH", record, at) for at in range(34, len(record) - 5, 6)][:count]
    layered, extra = header.point_format >= LAYERED, header.extra_bytes
    wanted = [(kind, size) for kind, size, _, formats in _ITEMS if header.point_format in formats]
    wanted += [(_EXTRA_LAYERED if layered else _EXTRA, extra)] * (extra > 0)
    if items != wanted:
        raise BadInputError(
            f"the LASzip record of {path} does not go with its points of format {header.point_format} and "
            f"{header.point_size} bytes: the file is damaged. Copy or download it again"
        )
    if struct.unpack_from("<H", record)[0] == _NOT_CHUNKED:
        raise BadInputError(f"{path} is compressed in one stream without chunks, which is not read. {_WRITE_AGAIN}")
    try:
        decoder().check(record)
    except DecoderError as error:
        raise BadInputError(
            f"{path} is compressed in a way that cannot be decoded here ({error}). {_WRITE_AGAIN}"
        ) from error
    return record


def read_table(stream: BinaryIO, path: Location, header: RawHeader, record: bytes) -> ChunkTable:
    """Read the chunk table and check it against the size of the file and the point count in the header."""
    table_at, chunks = _table_place(stream, path, header)
    encoded = allocate_shared(min(header.size - table_at, 8 + _ENTRY_BYTES * (chunks + 1)))
    stream.seek(table_at)
    data = stream.read(encoded.data.size)
    refuse_count(path, encoded.data.size, len(data), "bytes of a LAZ chunk table")
    encoded.data[:] = np.frombuffer(data, np.uint8)
    with decoding(path, "the LAZ chunk table"):
        table = decoder().chunk_table(record, encoded, chunks)
    data_bytes = sum(size for _, size in table)
    if header.offset_to_points + 8 + data_bytes > table_at:
        raise BadInputError(
            f"the LAZ chunks of {path} need {data_bytes:,} bytes, more than lie before their table: {_TRUNCATED}"
        )
    (chunk,) = struct.unpack_from("<I", record, 12)
    # If all LAZ chunks have one size, the table does not contain it.
    counts = [points if chunk == _ANY_SIZE else chunk for points, _ in table]
    refuse_count(path, header.point_count, sum(counts))
    sizes = np.array([size for _, size in table], np.int64)
    starts = header.offset_to_points + 8 + np.cumsum(sizes) - sizes
    # The last LAZ chunk is shorter; points beyond the header's count are ignored.
    ends = np.cumsum([min(count, header.point_count) for count in counts], dtype=np.int64)
    held = np.diff(np.minimum(ends, header.point_count), prepend=0)
    found: ChunkTable = np.rec.fromarrays(
        [held, starts, sizes], dtype=[(name, np.int64) for name in ("counts", "starts", "sizes")]
    )[held > 0]
    refuse_sizes(path, header, found)
    return found


def refuse_sizes(path: Location, header: RawHeader, table: ChunkTable) -> None:
    """Refuse LAZ chunks that declare more points than their bytes can hold, or than can be decoded at once."""
    counts, sizes = table["counts"], table["sizes"]
    dense = counts - _DENSEST * sizes
    if (dense > 0).any():
        worst = int(np.argmax(dense))
        raise BadInputError(
            f"{path} declares {counts[worst]:,} points in {sizes[worst]:,} compressed bytes, which is "
            f"impossible: damaged or {_TRUNCATED}"
        )
    largest = int(counts.max(initial=0))
    decoded = largest * header.point_size
    if decoded > _LARGEST_CHUNK:
        raise BadInputError(
            f"a LAZ chunk of {path} holds {largest:,} points, {decoded / 1e6:,.0f} MB when decoded; "
            f"at most {_LARGEST_CHUNK / 1e6:,.0f} MB are decoded at once. {_WRITE_AGAIN}"
        )


def check_layers(path: Location, header: RawHeader, chunk: NDArray[np.uint8], points: int) -> None:
    """Check the head of a layered LAZ chunk against its size in bytes and its points in the chunk table.

    A layered chunk starts with its first point, its number of points and the sizes of its layers, which fill the rest:
    a layer with a wrong size would be skipped, or include bytes of the next. Chunks of point formats 0 to 5 have no
    such head.
    """
    if header.point_format < LAYERED:
        return
    layers = header.extra_bytes + sum(count for *_, count, formats in _ITEMS if header.point_format in formats)
    head = header.point_size + 4 * (layers + 1)
    size = chunk.size
    if size < head:
        raise BadInputError(f"a LAZ chunk of {path} takes {size:,} bytes and must take at least {head:,}: {_TRUNCATED}")
    held, *layer_bytes = struct.unpack(f"<{layers + 1}I", chunk[header.point_size : head].tobytes())
    refuse_count(path, points, held, "points in a LAZ chunk")
    if head + sum(layer_bytes) != size:
        raise BadInputError(
            f"the layers of a LAZ chunk of {path} take {head + sum(layer_bytes):,} bytes, and it has {size:,}: damaged "
            f"or {_TRUNCATED}"
        )


def _table_place(stream: BinaryIO, path: Location, header: RawHeader) -> tuple[int, int]:
    """Return the offset of the chunk table and its number of entries, after checking both against the file size."""
    size, place = header.size, -1
    # A writer that cannot seek stores -1 there, and the offset in the last eight bytes of the file.
    for at in (header.offset_to_points, size - 8):
        if place == -1 and header.offset_to_points <= at <= size - 8:
            stream.seek(at)
            (place,) = struct.unpack("<q", stream.read(8))
    if not header.offset_to_points + 8 <= place <= size - 8:
        raise BadInputError(
            f"{path} has no LAZ chunk table where its header says (byte {place} of {size:,}): {_TRUNCATED}"
        )
    stream.seek(place + 4)
    (chunks,) = struct.unpack("<I", stream.read(4))
    # A LAZ chunk holds its first point uncompressed.
    room = (place - header.offset_to_points) // header.point_size
    if chunks > room or (chunks == 0 and header.point_count):
        raise BadInputError(
            f"{path} declares {chunks:,} LAZ chunks, which the file cannot hold: damaged or {_TRUNCATED}"
        )
    return place, chunks


Records = NDArray[np.uint8]
"""Point records, (n, bytes of a point)."""
_PIECE_BYTES = 1 << 20
"""Bytes of uncompressed points that are read at a time, at most."""
_COARSE_HEIGHT_M = 0.1
"""Steps between heights from which on a note is made, m."""
_LOWEST, _HIGHEST = -(1 << 31), (1 << 31) - 1
"""Of the integers of 32 bits that LAS holds coordinates in."""
_COLOUR_AT = {2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30}
"""Point format -> first byte of red, green and blue."""
_SAMPLE = 10_000
"""Points of each of three places, at least, that tell what the colours of a file are; LAZ chunks are read whole."""


def _read_pieces(path: Location, header: RawHeader, chunk: Chunk) -> Iterator[Records]:
    """Yield the uncompressed records of a chunk, piece by piece in one buffer; each is valid until the next is taken.

    A piece is still in the processor's cache when it is used, and memory for the whole chunk is not needed.
    """
    size = header.point_size
    at = header.offset_to_points + chunk.first * size
    end = at + chunk.points * size
    buffer = np.empty(max(_PIECE_BYTES // size, 1) * size, np.uint8)
    while at < end:
        piece = buffer[: end - at]
        held = read_into(path, at, piece)
        at += held
        if held < piece.size:
            refuse_count(path, header.point_count, (at - header.offset_to_points) // size)
        yield piece.reshape(-1, size)


def _integers_between(scaling: Scaling, axis: int, low: float, high: float) -> tuple[int, int]:
    """Return the lowest and the highest integer whose coordinate lies between two others; low > high: none does."""

    def first(is_past: Callable[[float], bool]) -> int:
        """Return the first integer whose coordinate passes a test that holds for all after it."""
        integers = range(_LOWEST, _HIGHEST + 1)
        return _LOWEST + bisect_left(integers, True, key=lambda at: is_past(float(scaling.coordinates(axis, at))))

    if scaling.scales[axis] > 0:
        return first(lambda place: place >= low), first(lambda place: place > high) - 1
    return first(lambda place: place <= high), first(lambda place: place < low) - 1


class LasSurvey(SurveyReader):
    """A LAS, LAZ or COPC file.

    A coordinate is ``integer * scale + offset``, rounded to 1e-8 of the file's unit and then converted to metres. The
    rounding removes the last bits of the floating-point sum, which depend on the offset that a writer chose: a survey
    that is split into files with different offsets gives bit-identical points. 1e-8 is far below the resolution of LAS
    files (about 1e-3) and above that of float64 up to 6.7e7 units, so coordinates are not changed otherwise.
    """

    def _open(self, options: ReadOptions) -> SurveyInfo:
        path = self._path
        with decoding(path, "the header"), open_source(path) as stream:
            self._raw = raw = read_raw_header(stream, path)
            statement = statement_of_las(raw)
            _refuse_numbers(path, raw)
            x, y, z = (first / 2 + last / 2 for first, last in zip(raw.mins, raw.maxs, strict=True))
            has_middle = not options.trust_points and np.isfinite([x, y, z]).all()
            middle = Place(path, (x, y, z) if has_middle else None)
            place, notes = georeference(middle, statement, options)
            bounds = None if options.trust_points else _bounds(path, raw, place)
            self._table: ChunkTable | None = None
            if raw.compressed:
                self._laszip = laz_record(path, raw)
                self._table = read_table(stream, path, raw, self._laszip)
                self._ends = np.cumsum(self._table["counts"])
        units = (place.metres_per_unit, place.metres_per_unit, place.metres_per_unit_z)
        east, north, up = (abs(scale) * unit for scale, unit in zip(raw.scales, units, strict=True))
        refuse_coarse(path, max(east, north), "its header has so large a scale", options)
        if up >= _COARSE_HEIGHT_M:
            notes += (f"its heights lie on steps of {up:g} m, by the scale in its header: fine relief is lost",)
        self._scaling = Scaling(raw.scales, raw.offsets, units)
        # Records are held to LAS 1.4 R15, tables 7 and 10; the flight line of points that name none is the file's id.
        line, limits = raw.source_id, ((-math.inf, math.inf),) * 2
        fields = [16, 255, 15, 4, 20, line] if raw.point_format >= LAYERED else [15, 31, 15, 128, 18, line]
        if bounds is not None:
            limits = ((bounds.west - OUTSIDE, bounds.east + OUTSIDE), (bounds.south - OUTSIDE, bounds.north + OUTSIDE))
        box = [_integers_between(self._scaling, axis, *ends) for axis, ends in enumerate(limits)]
        # Byte and mask of the class, and of the withheld flag, first byte of the flight line, and the line where that
        # is 0; integers of x and y that lie in the box; the kind of each class.
        self._rules = np.array(fields), np.array(box).reshape(-1), options.kinds
        self._lines = options.lines
        self._colours = self._find_colours() if options.colour else None
        kind = f"{'LAZ' if raw.compressed else 'LAS'} {raw.version}, point format {raw.point_format}"
        kind = f"COPC ({kind})" if raw.is_copc else kind
        notes += _degrees_note(place, raw)
        if raw.surplus:
            notes += (
                f"it has room for {raw.surplus:,} more points than the {raw.point_count:,} that its header counts",
            )
        info = SurveyInfo(path, kind, raw.size, raw.point_count, place, bounds, None, notes)
        low, high = (end * place.metres_per_unit_z for end in (raw.mins[2], raw.maxs[2]))
        heights = None if bounds is None else (low, high)
        return replace(
            info, parallel=raw.compressed, header_date=raw.created, heights=heights, class_names=raw.class_names
        )

    def _find_colours(self) -> tuple[int, int] | None:
        """Return first byte and shift of the colours, from points at the start, middle and end; None without any."""
        at = _COLOUR_AT.get(self._raw.point_format, 0)
        if not at or not self._raw.point_count:
            return None
        self._colours = (at, 0)  # so that they are decoded
        every = self.chunks(_SAMPLE)
        highest = 0
        for chunk in (every[0], every[len(every) // 2], every[-1]):
            try:
                fetched = self._fetch(chunk)
                for piece in (fetched,) if isinstance(fetched, np.ndarray) else fetched:
                    highest = max(highest, int(np.ascontiguousarray(piece[:, at : at + 6]).view("<u2").max(initial=0)))
            except BadInputError:  # reported when the points are read
                return None
            if highest > 255:
                break
        # Colours have 16 bits, but many writers leave 8-bit values as they are.
        return None if not highest else (at, 8) if highest > 255 else (at, 0)

    def chunks(self, points: int = CHUNK_POINTS) -> Sequence[Chunk]:
        """Split the file between points, or between LAZ chunks."""
        raw = self._raw
        if self._table is None:
            return split_rows(raw.point_count, points, raw.point_size)
        return group_laz_chunks(self._ends, points, raw.point_size)

    def _fetch(self, chunk: Chunk) -> Records | Iterator[Records]:
        """Return the records of a chunk; uncompressed ones are read when they are converted."""
        if self._table is None:
            return _read_pieces(self._path, self._raw, chunk)
        # The LAZ chunks of a chunk lie one after the other: they are read with one request, and decoded on all cores.
        last = chunk.first + chunk.points - 1
        first, end = np.searchsorted(self._ends, (chunk.first, last), side="right").tolist()
        part = self._table[first : end + 1]
        compressed = allocate_shared(int(part["sizes"].sum()))
        held = read_into(self._path, int(part["starts"][0]), compressed.data)
        refuse_count(self._path, compressed.data.size, held, "bytes of LAZ chunks")
        table = list(zip(part["counts"].tolist(), part["sizes"].tolist(), strict=True))
        at = 0
        for points, size in table:
            check_layers(self._path, self._raw, compressed.data[at : at + size], points)
            at += size
        size, colour = self._raw.point_size, self._colours is not None
        with decoding(self._path, "LAZ chunks"):
            records = decoder().chunks(self._laszip, table, compressed, chunk.points * size, colour=colour)
        return records.reshape(chunk.points, size)

    def _convert(self, chunk: Chunk, fetched: Records | Iterator[Records]) -> ChunkPoints:
        x, y, z = (np.empty(chunk.points, np.int32) for _ in range(3))
        out = LinedPoints(x, y, z, np.empty(chunk.points, np.uint8), np.empty(chunk.points, np.uint16))
        extremes, counts = np.array([_HIGHEST, _LOWEST] * 3), np.zeros(4, np.int64)
        colour, scaling = None if self._colours is None else np.empty(chunk.points, np.uint32), self._scaling
        number = 0
        for records in (fetched,) if isinstance(fetched, np.ndarray) else fetched:
            if colour is not None and self._colours is not None:
                loops.read_colours(records, self._rules[0], *self._colours, colour[counts[3] :])
            loops.filter_records(records, *self._rules, out, extremes, counts)
            number += len(records)
        withheld, noise, outside, kept = counts.tolist()
        some = 0 if colour is None else int(np.count_nonzero(colour[:kept]))
        stats = PointStats()
        if number:
            # Coordinates grow, or fall, with their integers: the ends are enough.
            ends = [sorted(scaling.coordinates(axis, extremes[2 * axis : 2 * axis + 2])) for axis in range(3)]
            dropped = {"withheld": withheld, "noise": noise, "outside": outside}
            stats = PointStats.within(ends, number, **dropped, coloured=some)
        kept = 0 if stats.bad else kept
        x, y, z, kind, line = out.x[:kept], out.y[:kept], out.z[:kept], out.kind[:kept], out.line[:kept]
        colour = None if colour is None else colour[:kept]
        sums = LineSums.of(LinedPoints(x, y, z, kind, line), scaling) if self._lines else LineSums()
        if kept < number // 2:
            # A view would keep the memory of the dropped points.
            x, y, z, kind = x.copy(), y.copy(), z.copy(), kind.copy()
            colour = None if colour is None else colour.copy()
        return ChunkPoints(ScaledPoints(x, y, z, kind, scaling, colour), stats, sums)


def _refuse_numbers(path: Location, raw: RawHeader) -> None:
    """Refuse scales and offsets that do not make finite coordinates of all integers."""
    scaling = Scaling(raw.scales, raw.offsets, (1.0, 1.0, 1.0))
    ends = [scaling.coordinates(axis, np.array([_LOWEST, _HIGHEST])) for axis in range(3)]
    if not np.isfinite(ends).all() or 0 in raw.scales:
        shown = ["; ".join(f"{value:g}" for value in values) for values in (raw.scales, raw.offsets)]
        raise BadInputError(
            f"the header of {path} gives the scale of x, y and z as {shown[0]} and the offset as {shown[1]}; scales "
            "must be other than 0, and coordinates finite. The file is damaged; export it again"
        )


def _bounds(path: Location, raw: RawHeader, place: Georeference) -> Bounds:
    """Return the extent in the header, m; raise BadInputError if it is not finite, not on Earth or inverted."""
    with np.errstate(over="ignore", invalid="ignore"):
        sides = np.round(np.array([*raw.mins[:2], *raw.maxs[:2]]), DECIMALS) * place.metres_per_unit
    bounds = Bounds(*sides.tolist())
    if not (np.abs(sides) <= EARTH_LIMIT).all() or bounds.west > bounds.east or bounds.south > bounds.north:
        raise BadInputError(f"the header of {path} gives an impossible extent: {box_text(bounds)}. {TRUST}")
    return bounds


def _degrees_note(place: Georeference, raw: RawHeader) -> tuple[str, ...]:
    """Return a note if a file without CRS may be in degrees: scale below 1e-6, extent within 180 x 90."""
    inside = max(map(abs, (raw.mins[0], raw.maxs[0]))) <= 180 and max(map(abs, (raw.mins[1], raw.maxs[1]))) <= 90
    if place.crs is not None or not inside or max(raw.scales[:2]) > 1e-6:
        return ()
    return (
        "its coordinates look like degrees; if they are, pass `crs='EPSG:4326'` for the command that reprojects it",
    )
