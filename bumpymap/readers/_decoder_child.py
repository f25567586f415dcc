"""The functions of the LAZ decoder process, which call lazrs.

lazrs is native code. A damaged file can make it overflow the stack, panic or loop forever, and it holds the GIL all the
time; so these functions are called in a child process (`bumpymap.readers.decoder`), which may crash. The process must
start quickly: only a few modules of the standard library are imported at the top, and lazrs where it is used.
"""

import io
import struct
from collections.abc import Sequence
from typing import Any


def check_record(record: bytes) -> None:
    """Raise an exception if lazrs cannot decode data with this LASzip record."""
    import lazrs

    # With an empty chunk table, only the record is checked.
    lazrs.LasZipDecompressor(io.BytesIO(struct.pack("<qII", 8, 0, 0)), record)


def read_chunk_table(record: bytes, data: Any) -> list[tuple[int, int]]:
    """Return number of points and bytes of each LAZ chunk; ``data`` begins at the start of the chunk table."""
    import lazrs

    return list(lazrs.read_chunk_table_only(io.BytesIO(data), lazrs.LazVlr(record)))


def decode_chunks(record: bytes, table: Sequence[tuple[int, int]], colour: bool, data: Any, out: Any) -> None:
    """Decode adjacent LAZ chunks on all cores; ``table`` is as from `read_chunk_table`."""
    import lazrs

    # Of point formats 6 to 10; earlier formats are always decoded completely.
    fields = lazrs.DecompressionSelection(
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        | lazrs.SELECTIVE_DECOMPRESS_Z
        | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
        | lazrs.SELECTIVE_DECOMPRESS_FLAGS
        | lazrs.SELECTIVE_DECOMPRESS_POINT_SOURCE_ID
        | (lazrs.SELECTIVE_DECOMPRESS_RGB if colour else 0)
    )
    lazrs.decompress_points_with_chunk_table(data, record, out, list(table), fields)
