"""The LAZ decoder. It runs in child processes, since a damaged file may crash it.

A child handles one request at a time, on all cores. A request for few LAZ chunks cannot use them all, so LAZ chunks
that another thread requests meanwhile are decoded by a further child. If a child crashes, the file is refused, and the
next request starts a new child. If no child can be started, the same functions run in this process.
"""

import itertools
import os
import threading
from atexit import register as at_exit
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    Child,
    DecoderError,
    Guard,
    SharedBytes,
    UsageError,
    allocate_shared,
    can_start_children,
    module_folder,
    trim_shared,
)
from bumpymap.readers import _decoder_child

__all__ = [
    "Decoder",
    "LocalDecoder",
    "StreamLostError",
    "close_decoder",
    "decoder",
    "start_decoder",
]

Bytes = NDArray[np.uint8]
ReadAt = Callable[[int, Bytes], int]
"""Called with a byte offset and an array: reads bytes of the file into the array and returns how many there were."""
Table = Sequence[tuple[int, int]]
"""Number of points and bytes of each LAZ chunk."""

SECONDS, SECONDS_PER_BYTE = 4.0, 1e-7
"""CPU time limit of a request, and for each byte of input and output: ten times what real files need."""
_MOST_FURTHER = 7
_MALLOC = {"MALLOC_TRIM_THRESHOLD_": str(1 << 26), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)}
"""Makes glibc keep the memory that lazrs allocates for each LAZ chunk; else it comes from the system each time."""


_numbers = itertools.count(1)
"""Numbers of streams: a stream of another decoder, such as that of the process before a fork, is lost, not mistaken."""


class StreamLostError(Exception):
    """The stream was lost for a reason unrelated to its file; open a new one."""


class Decoder:
    """Calls lazrs in child processes. Thread-safe. Methods except ``allocate`` and ``close`` may raise DecoderError.

    Parameters
    ----------
    further : int
        Number of further children that may decode LAZ chunks while the first one is busy.
    """

    def __init__(self, further: int = _MOST_FURTHER) -> None:
        self._lock = threading.Lock()
        self.guard = Guard(_start, "decodes LAZ", "lazrs")
        """Its process decodes all streams."""
        self._streams: set[int] = set()
        """Open streams of the running child."""
        self._further, self._adding = further, threading.Lock()
        self._next: Decoder | None = None
        """A decoder with a child of its own, for LAZ chunks that are requested while this one is busy."""

    def start(self) -> None:
        """Start the child now, so that it is ready when it is needed; a failure shows in the first request."""
        with self._lock, suppress(UsageError, OSError):
            self._live()

    def allocate(self, size: int) -> SharedBytes:
        """Allocate memory for bytes that the decoder will read."""
        return allocate_shared(size)

    def check(self, record: bytes) -> None:
        """Raise DecoderError if lazrs cannot decode data with this LASzip record."""
        with self._lock:
            self._call("check_record", record)

    def chunk_table(self, record: bytes, data: SharedBytes, chunks: int) -> Table:
        """Decode the first ``chunks`` entries of a chunk table; ``data`` begins where the table does in the file."""
        with self._lock:
            table: Table = self._call("read_chunk_table", record, shared=(data,))
        return table[:chunks]

    def chunks(self, record: bytes, table: Table, data: SharedBytes, size: int) -> Bytes:
        """Decode adjacent LAZ chunks to ``size`` bytes."""
        if not self._lock.acquire(blocking=not self._further):
            return self._another().chunks(record, table, data, size)
        try:
            out = self.allocate(size)
            self._call("decode_chunks", record, table, shared=(data, out))
        finally:
            self._lock.release()
        return out.data

    def open_stream(self, record: bytes, read_at: ReadAt, start: int, file_size: int) -> int:
        """Open a stream that decodes a file sequentially from offset ``start``; return its number."""
        number = next(_numbers)
        with self._lock:
            self._call("open_stream", number, record, start, file_size, read_at=read_at)
            self._streams.add(number)
        return number

    def read_stream(self, number: int, read_at: ReadAt, size: int) -> Bytes:
        """Decode the next ``size`` bytes of points of a stream. May also raise StreamLostError."""
        out = self.allocate(size)
        with self._lock:
            if number not in self._streams or not self._is_alive():
                raise StreamLostError
            self._call("read_stream", number, shared=(out,), read_at=read_at)
        return out.data

    def close_stream(self, number: int) -> None:
        """Close a stream."""
        with self._lock:
            if number in self._streams and self._is_alive():
                self._call("close_stream", number)
            self._streams.discard(number)

    def close(self) -> None:
        """End the children and free unused memory, until the next request. Arrays in use stay valid."""
        if self._next is not None:
            self._next.close()
        with self._lock:
            self._end()
            trim_shared()

    def _another(self) -> "Decoder":
        with self._adding:
            if self._next is None:
                self._next = Decoder(self._further - 1)
            return self._next

    def _call(
        self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = (), read_at: ReadAt | None = None
    ) -> Any:
        """Call a function in the child; the caller holds the lock."""
        seconds = SECONDS + SECONDS_PER_BYTE * sum(memory.data.size for memory in shared)
        fill = None if read_at is None else partial(_fill, read_at)
        self._live()
        return self.guard.call(function, *arguments, shared=shared, seconds=seconds, read_at=fill)

    def _is_alive(self) -> bool:
        return self.guard.is_alive

    def _live(self) -> None:
        """Start the child if there is none; streams of an earlier one are lost."""
        if not self.guard.is_alive:
            self._streams.clear()
            self.guard.live_child()

    def _end(self) -> None:
        self._streams.clear()
        self.guard.end()


class LocalDecoder(Decoder):
    """A decoder that runs in this process."""

    def __init__(self) -> None:
        super().__init__(further=0)  # lazrs holds the GIL

    def start(self) -> None:
        """Do nothing: there is no child."""

    def _call(
        self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = (), read_at: ReadAt | None = None
    ) -> Any:
        """Call a function in this process."""
        callbacks = () if read_at is None else (partial(_fill, read_at),)
        try:
            return getattr(_decoder_child, function)(*callbacks, *arguments, *(memory.data for memory in shared))
        except (KeyboardInterrupt, SystemExit, MemoryError):
            raise
        except BaseException as error:
            # A panic in Rust is not an Exception.
            raise DecoderError(str(error).strip() or type(error).__name__) from error

    def _is_alive(self) -> bool:
        return True

    def _end(self) -> None:
        """Do nothing: there is no child."""


def _start() -> Child:
    # Not all of site-packages: its .pth files would run at every start.
    folders = [str(Path(__file__).parent), module_folder("lazrs")]
    return Child("to decode LAZ", "_decoder_child", folders, _MALLOC)


def _fill(read_at: ReadAt, start: int, buffer: memoryview) -> int:
    return read_at(start, np.frombuffer(buffer, np.uint8))


_lock = threading.Lock()
current: Decoder | None = None
"""The decoder of this process, see `decoder`."""


def decoder() -> Decoder:
    """Return the decoder of this process."""
    global current  # noqa: PLW0603 (one for all readers: they share its children)
    with _lock:
        if current is None:
            current = Decoder() if can_start_children() else LocalDecoder()
        return current


def start_decoder(surveys: Iterable[Path | str]) -> None:
    """Start the decoder's child process if some surveys look like LAZ files; it starts while other things are done."""
    if any(str(survey).lower().endswith(".laz") for survey in surveys):
        decoder().start()


def close_decoder() -> None:
    """End the decoder's child process and free its memory; the next request starts it again."""
    if current is not None:
        current.close()


def _reset_after_fork() -> None:
    global _lock, current
    _lock, current = threading.Lock(), None


at_exit(close_decoder)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_reset_after_fork)
