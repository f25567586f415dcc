"""The functions of the LAZ decoder process, which call lazrs.

lazrs is native code. A damaged file can make it overflow the stack, panic or loop forever, and it holds the GIL all the
time; so these functions are called in a child process (`bumpymap.readers.decoder`), which may crash. The process must
start quickly: only a few modules of the standard library are imported at the top, and lazrs where it is used.
"""

import io
import struct
from collections.abc import Callable, Sequence
from typing import Any

__all__ = [
    "CallbackFile",
    "check_record",
    "close_stream",
    "decode_chunks",
    "open_stream",
    "read_chunk_table",
    "read_stream",
]

_BLOCK = 1 << 18
"""Bytes of a file that a stream requests at once."""
_streams: dict[int, Any] = {}


class CallbackFile(io.RawIOBase):
    """A raw stream whose bytes come from a callback.

    Parameters
    ----------
    read_at : callable
        Called with a byte offset and a buffer: reads bytes into the buffer and returns how many there were.
    size : int
        Size of the file in bytes.
    """

    def __init__(self, read_at: Callable[[int, memoryview], int], size: int) -> None:
        self._supply, self._size, self._at = read_at, size, 0

    def readable(self) -> bool:
        """Return True."""
        return True

    def seekable(self) -> bool:
        """Return True."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Set the position, and return it."""
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(start + offset, 0)
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Read bytes into a buffer, up to the end of the file; return how many."""
        wanted = min(len(buffer), self._size - self._at)
        got = self._supply(self._at, memoryview(buffer)[:wanted]) if wanted > 0 else 0
        self._at += got
        return got

    def readall(self) -> bytes:
        """Read the rest of the file in one call."""
        return self.read(max(self._size - self._at, 0)) or b""


def _fields() -> Any:
    """Return the fields to decode of point formats 6 to 10; earlier formats are always decoded completely."""
    import lazrs

    return lazrs.DecompressionSelection(
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        | lazrs.SELECTIVE_DECOMPRESS_Z
        | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
        | lazrs.SELECTIVE_DECOMPRESS_FLAGS
        | lazrs.SELECTIVE_DECOMPRESS_POINT_SOURCE_ID
    )


def check_record(record: bytes) -> None:
    """Raise an exception if lazrs cannot decode data with this LASzip record."""
    import lazrs

    # With an empty chunk table, only the record is checked.
    lazrs.LasZipDecompressor(io.BytesIO(struct.pack("<qII", 8, 0, 0)), record)


def read_chunk_table(record: bytes, data: Any) -> list[tuple[int, int]]:
    """Return number of points and bytes of each LAZ chunk; ``data`` begins at the start of the chunk table."""
    import lazrs

    table: list[tuple[int, int]] = lazrs.read_chunk_table_only(io.BytesIO(data), lazrs.LazVlr(record))
    return table


def decode_chunks(record: bytes, table: Sequence[tuple[int, int]], data: Any, out: Any) -> None:
    """Decode adjacent LAZ chunks on all cores; ``table`` is as from `read_chunk_table`."""
    import lazrs

    lazrs.decompress_points_with_chunk_table(data, record, out, list(table), _fields())


def open_stream(read_at: Callable[[int, memoryview], int], number: int, record: bytes, start: int, size: int) -> None:
    """Open stream ``number`` on a file of ``size`` bytes at offset ``start``; ``read_at`` is that of `CallbackFile`."""
    import lazrs

    stream = io.BufferedReader(CallbackFile(read_at, size), _BLOCK)
    stream.seek(start)
    _streams[number] = lazrs.LasZipDecompressor(stream, record, _fields())


def read_stream(_: object, number: int, out: Any) -> None:
    """Fill ``out`` with the next points of a stream."""
    _streams[number].decompress_many(out)


def close_stream(number: int) -> None:
    """Close a stream."""
    _streams.pop(number, None)
