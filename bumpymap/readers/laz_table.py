"""Checks on LAZ data before the decoder sees it.

lazrs reserves memory for as many chunks as the chunk table claims; a claim that no machine can meet ends the process,
so it is held against the size of the file first.
"""

import os
import struct
from pathlib import Path
from typing import Any, BinaryIO

import lazrs

from bumpymap.errors import BadInputError
from bumpymap.readers.checks import decoding, refuse_count
from bumpymap.readers.las_header import RawHeader

__all__ = ["check_laz"]

_NOT_CHUNKED = 1
"""Value of the "compressor" word of the LASzip record for one stream without a chunk table."""
_CUT = "truncated? Copy or download it again"


def check_laz(stream: BinaryIO, path: Path, header: RawHeader) -> None:
    """Hold the LASzip record and the chunk table against header and file.

    Raises
    ------
    BadInputError
        No LASzip record, a codec that lazrs does not know, a table that the file cannot hold or that has fewer points
        than the header promises.
    """
    record = header.find(b"laszip encoded", 22204)
    if record is None or len(record) < 34:
        raise BadInputError(f"{path} is compressed and has no LASzip record to decode it by. Copy or download it again")
    with decoding(path, "the LASzip record"):
        vlr = lazrs.LazVlr(record)
    if vlr.item_size() != header.point_size:
        raise BadInputError(
            f"{path} gives a point {header.point_size} bytes in its header and {vlr.item_size()} in its LASzip record: "
            "the file is damaged. Copy or download it again"
        )
    if struct.unpack_from("<H", record)[0] != _NOT_CHUNKED:
        _check_table(stream, path, header, vlr)
    stream.seek(header.offset_to_points)
    try:
        lazrs.LasZipDecompressor(stream, record)
    except lazrs.LazrsError as error:
        raise BadInputError(
            f"{path} is compressed in a way that cannot be decoded here ({error}). Write it again with the usual "
            "codec, such as with: pdal translate IN OUT.laz"
        ) from error


def _check_table(stream: BinaryIO, path: Path, header: RawHeader, vlr: Any) -> None:
    """Hold the chunk table against the file and the number of points that the header promises."""
    table_at = _table_place(stream, path, header)
    stream.seek(header.offset_to_points)
    with decoding(path, "the LAZ chunk table"):
        table = lazrs.read_chunk_table(stream, vlr)
    data_bytes = sum(size for _, size in table)
    if header.offset_to_points + 8 + data_bytes > table_at:
        raise BadInputError(
            f"the LAZ chunks of {path} need {data_bytes:,} bytes, more than lie before their table: {_CUT}"
        )
    held = sum(points for points, _ in table) if vlr.uses_variable_size_chunks() else len(table) * vlr.chunk_size()
    refuse_count(path, header.point_count, held)


def _table_place(stream: BinaryIO, path: Path, header: RawHeader) -> int:
    """Where the chunk table is, once its place and its length are known to fit."""
    size = os.fstat(stream.fileno()).st_size
    place = _word(stream, header.offset_to_points, size)
    if place == -1:
        # A writer that could not seek back leaves the place in the last eight bytes.
        place = _word(stream, size - 8, size)
    if place is None or not header.offset_to_points + 8 <= place <= size - 8:
        raise BadInputError(f"{path} has no LAZ chunk table where its header says (byte {place} of {size:,}): {_CUT}")
    stream.seek(place + 4)
    (chunks,) = struct.unpack("<I", stream.read(4))
    # A compressed chunk takes more than a byte; the header and the first point alone take twenty.
    if chunks > place - header.offset_to_points or (chunks == 0 and header.point_count):
        raise BadInputError(f"{path} promises {chunks:,} LAZ chunks, which the file cannot hold: damaged or {_CUT}")
    return place


def _word(stream: BinaryIO, place: int, size: int) -> int | None:
    if place + 8 > size:
        return None
    stream.seek(place)
    word: int = struct.unpack("<q", stream.read(8))[0]
    return word
