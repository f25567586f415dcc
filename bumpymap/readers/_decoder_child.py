"""What decodes LAZ: a few functions on bytes, and the loop of a process that does nothing else.

The decoder is native code that others wrote. A damaged file can send it through the stack, into panics or round in
circles, and while it works it holds the interpreter's lock; so it works in a process of its own, which may die. That
process must start in no time: nothing is imported here but lazrs, where it is used, and a few modules of the standard
library.

Parent and child share memory (`bumpymap.readers.shared`) and speak through two pipes, in records of fixed size. A
*span* is a place in the shared memory: where it starts, and how many bytes.
"""

import io
import mmap
import os
import signal
import struct
import sys
from collections.abc import Callable, Sequence
from typing import Any

__all__ = [
    "ANSWER",
    "CHECK",
    "CHUNKS",
    "CLOSE",
    "DONE",
    "OPEN",
    "READ",
    "REQUEST",
    "TABLE",
    "WANTED",
    "WRONG",
    "Source",
    "check_record",
    "decode_chunks",
    "open_stream",
    "read_chunk_table",
    "serve",
]

REQUEST = struct.Struct("<12q")
"""What to do, number of the stream, bytes shared by now, most microseconds of processor time, spans: record, table,
data, out."""
CHECK, TABLE, CHUNKS, OPEN, READ, CLOSE = range(6)
ANSWER = struct.Struct("<4q")
"""What came of it, two numbers, bytes of text that follow."""
DONE, WRONG, WANTED = range(3)
"""WANTED: a stream wants bytes of its file, from one place on and so many. They come as the data of one more request,
which means nothing else."""

_BLOCK = 1 << 18
"""Bytes of a file that a stream asks for at once."""
_LONGEST_TEXT = 1000


class Source(io.RawIOBase):
    """A file that is read by asking somebody for its bytes.

    Parameters
    ----------
    supply : callable
        Fills a buffer with the bytes from a place on; gives how many there were.
    size : int
        Bytes of the file.
    """

    def __init__(self, supply: Callable[[int, memoryview], int], size: int) -> None:
        self._supply, self._size, self._at = supply, size, 0

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


def open_stream(record: bytes, source: Source, start: int) -> Any:
    """Give a decoder that goes through a file in order; its ``decompress_many`` fills a buffer with points."""
    import lazrs

    stream = io.BufferedReader(source, _BLOCK)
    stream.seek(start)
    return lazrs.LasZipDecompressor(stream, record, _fields())


class _Server:
    """Does what the parent asks for, one thing after the other.

    Parameters
    ----------
    shared : int
        Descriptor of the shared memory.
    """

    def __init__(self, shared: int) -> None:
        self._shared = shared
        self._map = mmap.mmap(-1, 1)
        self._streams: dict[int, Any] = {}
        self._do = {CHECK: self._check, TABLE: self._table, CHUNKS: self._chunks, OPEN: self._open, READ: self._read}

    def run(self) -> None:
        """Work until the parent closes its end, in whatever way it ends."""
        # A batch system tells the whole group to end; that is for the parent, which then closes its end.
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        while request := self._next():
            what, number, _, most_us, *_ = request
            if what == CLOSE:
                self._streams.pop(number, None)
                _answer(DONE)
                continue
            # Whoever takes too long is ended by the system, even in the middle of native code. Processor time, since
            # time on the wall would depend on what else the machine does.
            signal.setitimer(signal.ITIMER_PROF, most_us / 1e6)
            try:
                _answer(DONE, self._do[what](request))
            except BaseException as error:  # noqa: BLE001 (a panic in Rust is no Exception)
                text = (str(error).strip() or type(error).__name__).encode("utf-8", "replace")[:_LONGEST_TEXT]
                _answer(WRONG, text=text)
            signal.setitimer(signal.ITIMER_PROF, 0)

    def _next(self) -> tuple[int, ...]:
        data = _received(REQUEST.size)
        if len(data) < REQUEST.size:
            return ()
        request = REQUEST.unpack(data)
        if request[2] > len(self._map):
            self._map = mmap.mmap(self._shared, request[2])
        return request

    def _span(self, start: int, size: int) -> memoryview:
        return memoryview(self._map)[start : start + size]

    def _check(self, request: tuple[int, ...]) -> int:
        check_record(bytes(self._span(*request[4:6])))
        return 0

    def _table(self, request: tuple[int, ...]) -> int:
        table = read_chunk_table(bytes(self._span(*request[4:6])), self._span(*request[8:10]))
        # No more than there is room for: the parent counts them.
        place = self._span(*request[10:12]).cast("q")
        for index, value in enumerate(value for pair in table[: len(place) // 2] for value in pair):
            place[index] = value
        return len(table)

    def _chunks(self, request: tuple[int, ...]) -> int:
        numbers = self._span(*request[6:8]).cast("q").tolist()
        table = list(zip(numbers[::2], numbers[1::2], strict=True))
        record = bytes(self._span(*request[4:6]))
        decode_chunks(record, table, self._span(*request[8:10]), self._span(*request[10:12]))
        return 0

    def _open(self, request: tuple[int, ...]) -> int:
        # The span of data is that of the file here.
        number, (start, size) = request[1], request[8:10]
        self._streams[number] = open_stream(bytes(self._span(*request[4:6])), Source(self._wanted, size), start)
        return 0

    def _read(self, request: tuple[int, ...]) -> int:
        self._streams[request[1]].decompress_many(self._span(*request[10:12]))
        return 0

    def _wanted(self, start: int, buffer: memoryview) -> int:
        """Ask the parent for bytes of the file that a stream goes through."""
        _answer(WANTED, start, len(buffer))
        request = self._next()
        if not request:
            sys.exit()
        got = request[9]
        buffer[:got] = self._span(request[8], got)
        return got


def _received(size: int) -> bytes:
    data = b""
    while len(data) < size:
        more = os.read(0, size - len(data))
        if not more:
            break
        data += more
    return data


def _answer(kind: int, first: int = 0, second: int = 0, text: bytes = b"") -> None:
    os.write(1, ANSWER.pack(kind, first, second, len(text)) + text)


def serve(shared: int) -> None:
    """Be the child."""
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        _Server(shared).run()
    except BrokenPipeError:
        # The parent is gone, and with it everyone who could be told.
        os._exit(1)
