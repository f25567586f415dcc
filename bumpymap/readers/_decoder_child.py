"""What decodes LAZ: a few functions on bytes.

The decoder is native code that others wrote. A damaged file can send it through the stack, into panics or round in
circles, and while it works it holds the interpreter's lock; so these functions are called in a process of its own
(`bumpymap.readers.decoder`), which may die. It must start in no time: nothing is imported here but lazrs, where it is
used, and a few modules of the standard library.
"""

import io
import struct
from collections.abc import Callable, Sequence
from typing import Any

__all__ = [
    "Source",
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


class Source(io.RawIOBase):
    """A file that is read by asking somebody for its bytes.

    Parameters
    ----------
    read_at : callable
        Fills a buffer with the bytes from a place on; gives how many there were.
    size : int
        Bytes of the file.
    """

    def __init__(self, read_at: Callable[[int, memoryview], int], size: int) -> None:
        self._supply, self._size, self._at = read_at, size, 0

    def readable(self) -> bool:
        """Yes."""
        return True

    def seekable(self) -> bool:
        """Yes."""
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a place."""
        start = {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        self._at = max(start + offset, 0)
        return self._at

    def readinto(self, buffer: Any) -> int:
        """Fill a buffer, as far as the file goes."""
        wanted = min(len(buffer), self._size - self._at)
        got = self._supply(self._at, memoryview(buffer)[:wanted]) if wanted > 0 else 0
        self._at += got
        return got

    def readall(self) -> bytes:
        """Read the rest, at once."""
        return self.read(max(self._size - self._at, 0)) or b""


def _fields() -> Any:
    """Choose what is decoded of point formats 6 to 10; earlier ones are decoded whole."""
    import lazrs

    return lazrs.DecompressionSelection(
        lazrs.SELECTIVE_DECOMPRESS_XY_RETURNS_CHANNEL
        | lazrs.SELECTIVE_DECOMPRESS_Z
        | lazrs.SELECTIVE_DECOMPRESS_CLASSIFICATION
        | lazrs.SELECTIVE_DECOMPRESS_FLAGS
    )


def check_record(record: bytes) -> None:
    """Raise where there is no decoder for a LASzip record."""
    import lazrs

    # An empty table of chunks: the decoder looks at the record alone.
    lazrs.LasZipDecompressor(io.BytesIO(struct.pack("<qII", 8, 0, 0)), record)


def read_chunk_table(record: bytes, data: Any) -> list[tuple[int, int]]:
    """Points and bytes of each chunk; ``data`` starts where the table does."""
    import lazrs

    table: list[tuple[int, int]] = lazrs.read_chunk_table_only(io.BytesIO(data), lazrs.LazVlr(record))
    return table


def decode_chunks(record: bytes, table: Sequence[tuple[int, int]], data: Any, out: Any) -> None:
    """Decode chunks that lie one behind the other, on all cores; ``table`` as from `read_chunk_table`."""
    import lazrs

    lazrs.decompress_points_with_chunk_table(data, record, out, list(table), _fields())


def open_stream(read_at: Callable[[int, memoryview], int], number: int, record: bytes, start: int, size: int) -> None:
    """Go through a file of ``size`` bytes in order from ``start`` on; `read_at` as of `Source`."""
    import lazrs

    stream = io.BufferedReader(Source(read_at, size), _BLOCK)
    stream.seek(start)
    _streams[number] = lazrs.LasZipDecompressor(stream, record, _fields())


def read_stream(_: object, number: int, out: Any) -> None:
    """Fill ``out`` with the points of a stream that come next."""
    _streams[number].decompress_many(out)


def close_stream(number: int) -> None:
    """Forget a stream."""
    _streams.pop(number, None)
