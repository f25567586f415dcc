"""The decoder of LAZ as readers see it: it works in a child process, which may die of a damaged file.

It serves one request after the other, since it uses every core by itself. Where it dies, the file is refused, and the
next request starts another. Where no child can be started, the same functions work in this process.
"""

import itertools
import os
import sys
import threading
from atexit import register as at_exit
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    Child,
    ChildDiedError,
    ChildError,
    SharedBytes,
    UsageError,
    can_start,
    folder_of,
    free_memory,
    take_memory,
)
from bumpymap.readers import _decoder_child

__all__ = ["Decoder", "DecoderError", "LocalDecoder", "Stream", "StreamLostError", "close_decoder", "decoder"]

Bytes = NDArray[np.uint8]
Supply = Callable[[int, Bytes], int]
"""Fills an array with the bytes of a file from a place on; gives how many there were."""
Table = Sequence[tuple[int, int]]
"""Points and bytes of chunks."""

SECONDS, SECONDS_PER_BYTE = 4.0, 1e-7
"""Processor time that a request may take, and for each byte that goes in or comes out: ten times what files take."""
_FROM_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")


class DecoderError(Exception):
    """The decoder cannot cope with what it was given. The text says why."""


class StreamLostError(Exception):
    """What went through a file is gone, through no fault of the file: open a stream again."""


class Decoder:
    """What lazrs does for readers. Every method but ``take`` and ``close`` raises DecoderError. From any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.child: Child | None = None
        """The process that decodes, once there is one."""
        self._numbers = itertools.count(1)
        self._streams: set[int] = set()
        """Of the child that runs."""

    def take(self, size: int) -> SharedBytes:
        """Memory for bytes that the decoder will read."""
        return take_memory(size)

    def check(self, record: bytes) -> None:
        """Raise where there is no decoder for a LASzip record."""
        with self._lock:
            self._ask("check_record", record)

    def chunk_table(self, record: bytes, data: SharedBytes, chunks: int) -> Table:
        """Points and bytes of ``chunks`` chunks; ``data`` starts where the table of the file does."""
        with self._lock:
            table: Table = self._ask("read_chunk_table", record, shared=(data,))
        return table[:chunks]

    def chunks(self, record: bytes, table: Table, data: SharedBytes, size: int) -> Bytes:
        """Decode chunks that lie one behind the other; ``size`` bytes come out."""
        out = self.take(size)
        with self._lock:
            self._ask("decode_chunks", record, table, shared=(data, out))
        return out.data

    def stream(self, record: bytes, supply: Supply, start: int, file_size: int) -> "Stream":
        """Go through a file from ``start`` on."""
        number = next(self._numbers)
        with self._lock:
            self._ask("open_stream", number, record, start, file_size, supply=supply)
            self._streams.add(number)
        return Stream(self, number, supply)

    def read_stream(self, number: int, supply: Supply, size: int) -> Bytes:
        """Bytes of the points of a stream that come next."""
        out = self.take(size)
        with self._lock:
            if number not in self._streams or not self._runs():
                raise StreamLostError
            self._ask("read_stream", number, shared=(out,), supply=supply)
        return out.data

    def close_stream(self, number: int) -> None:
        """Forget a stream."""
        with self._lock:
            if number in self._streams and self._runs():
                self._ask("close_stream", number)
            self._streams.discard(number)

    def close(self) -> None:
        """Give back memory and the child until the next request. Arrays that were given out stay."""
        with self._lock:
            self._end()
            free_memory()

    def _ask(
        self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = (), supply: Supply | None = None
    ) -> Any:
        """Have something done by a child; the caller holds the lock."""
        seconds = SECONDS + SECONDS_PER_BYTE * sum(memory.data.size for memory in shared)
        fill = None if supply is None else partial(_fill, supply)
        try:
            child = self._running()
            return child.ask(function, *arguments, shared=shared, seconds=seconds, supply=fill)
        except ChildError as error:
            raise DecoderError(str(error)) from error
        except ChildDiedError as error:
            self._end()
            _raise_child_died(error)
        except BaseException:
            # Whatever it was, nobody waits for the answer any more.
            self._end()
            raise

    def _runs(self) -> bool:
        return self.child is not None and self.child.runs

    def _running(self) -> Child:
        if self.child is None or not self.child.runs:
            self._end()
            # Without site-packages as a whole: what people put there is run at every start.
            folders = [str(Path(__file__).parent), folder_of("lazrs")]
            self.child = Child("to decode LAZ", "_decoder_child", folders)
        return self.child

    def _end(self) -> None:
        child, self.child = self.child, None
        self._streams.clear()
        if child is not None:
            child.close()


class LocalDecoder(Decoder):
    """Decodes in this process."""

    def _ask(
        self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = (), supply: Supply | None = None
    ) -> Any:
        """Have something done here."""
        questions = () if supply is None else (partial(_fill, supply),)
        try:
            return getattr(_decoder_child, function)(*questions, *arguments, *(memory.data for memory in shared))
        except (KeyboardInterrupt, SystemExit, MemoryError):
            raise
        except BaseException as error:
            # A panic in Rust is no Exception.
            raise DecoderError(str(error).strip() or type(error).__name__) from error

    def _runs(self) -> bool:
        return True

    def _end(self) -> None:
        """There is nothing to end."""


class Stream:
    """Points of a file in order."""

    def __init__(self, owner: Decoder, number: int, supply: Supply) -> None:
        self._owner, self._number, self._supply = owner, number, supply

    def read(self, size: int) -> Bytes:
        """Bytes of the points that come next. Raises StreamLostError too."""
        return self._owner.read_stream(self._number, self._supply, size)

    def close(self) -> None:
        """Forget the place."""
        self._owner.close_stream(self._number)


def _fill(supply: Supply, start: int, buffer: memoryview) -> int:
    return supply(start, np.frombuffer(buffer, np.uint8))


def _raise_child_died(error: ChildDiedError) -> NoReturn:
    """Say what the child died of: the file, or something else."""
    if not error.signal:
        raise UsageError(
            f"the process that decodes LAZ {error}: is lazrs installed as it should be? Try: "
            f"{sys.executable} -c 'import lazrs'"
        ) from error
    if error.signal in _FROM_OUTSIDE:
        raise UsageError(
            f"the process that decodes LAZ was killed ({error.signal}), for want of memory? Lower `memory`, or end "
            "other programs, and run again"
        ) from error
    if error.signal == "SIGPROF":
        raise DecoderError("the decoder did not finish") from error
    raise DecoderError(f"the decoder crashed ({error.signal})") from error


_lock = threading.Lock()
current: Decoder | None = None
"""The decoder of this process, see `decoder`."""


def decoder() -> Decoder:
    """Give the decoder of this process."""
    global current  # noqa: PLW0603 (one for all readers: it uses every core by itself)
    with _lock:
        if current is None:
            current = Decoder() if can_start() else LocalDecoder()
        return current


def close_decoder() -> None:
    """Give back what the decoder holds; the next request takes it again."""
    if current is not None:
        current.close()


def _forget() -> None:
    global _lock, current
    _lock, current = threading.Lock(), None


at_exit(close_decoder)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
