"""The decoder of LAZ as readers see it: a child process that may die, or the same functions in this process."""

import os
import sys
import threading
from atexit import register as at_exit
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import numpy as np

from bumpymap.readers.shared import Block, Bytes

__all__ = ["Decoder", "DecoderError", "LocalDecoder", "Stream", "StreamLostError", "Supply", "Table", "decoder", "rest"]

Supply = Callable[[int, Bytes], int]
"""Fills an array with the bytes of a file from a place on; gives how many there were."""
Table = Sequence[tuple[int, int]]
"""Points and bytes of chunks."""


class DecoderError(Exception):
    """The decoder cannot cope with what it was given. The text says why."""


class StreamLostError(Exception):
    """What went through a file is gone, through no fault of the file: open a stream again."""


class Stream(Protocol):
    """Points of a file in order."""

    def read(self, size: int) -> Bytes:
        """Bytes of the points that come next. Raises StreamLostError too."""

    def close(self) -> None:
        """Forget the place."""


class Decoder(Protocol):
    """What lazrs does for readers. Every method but ``take`` raises DecoderError. From any thread."""

    def take(self, size: int) -> Block:
        """Room for bytes that the decoder will read."""

    def check(self, record: bytes) -> None:
        """Raise where there is no decoder for a LASzip record."""

    def chunk_table(self, record: bytes, data: Block, chunks: int) -> Table:
        """Points and bytes of ``chunks`` chunks; ``data`` starts where the table of the file does."""

    def chunks(self, record: bytes, table: Table, data: Block, size: int) -> Bytes:
        """Decode chunks that lie one behind the other; ``size`` bytes come out."""

    def stream(self, record: bytes, supply: Supply, start: int, file_size: int) -> Stream:
        """Go through a file from ``start`` on."""

    def rest(self) -> None:
        """Give back memory and processes until the next request. Arrays that were given out stay."""

    def abandon(self) -> None:
        """After a fork, in the new process: leave to the old one what is its own."""


class LocalDecoder:
    """Decodes in this process: where there are no children that could share memory."""

    def __init__(self) -> None:
        from bumpymap.readers import _decoder_child

        self._here = _decoder_child

    def take(self, size: int) -> Block:
        """See ``Decoder``."""
        return Block(0, np.empty(size, np.uint8))

    def check(self, record: bytes) -> None:
        """See ``Decoder``."""
        _guarded(lambda: self._here.check_record(record))

    def chunk_table(self, record: bytes, data: Block, chunks: int) -> Table:
        """See ``Decoder``."""
        table: Table = _guarded(lambda: self._here.read_chunk_table(record, data.data))
        return table

    def chunks(self, record: bytes, table: Table, data: Block, size: int) -> Bytes:
        """See ``Decoder``."""
        out = np.empty(size, np.uint8)
        _guarded(lambda: self._here.decode_chunks(record, table, data.data, out))
        return out

    def stream(self, record: bytes, supply: Supply, start: int, file_size: int) -> Stream:
        """See ``Decoder``."""
        source = self._here.Source(lambda at, buffer: supply(at, np.frombuffer(buffer, np.uint8)), file_size)
        return _LocalStream(_guarded(lambda: self._here.open_stream(record, source, start)))

    def rest(self) -> None:
        """See ``Decoder``."""

    def abandon(self) -> None:
        """See ``Decoder``."""


class _LocalStream:
    def __init__(self, decoder: Any) -> None:
        self._decoder = decoder

    def read(self, size: int) -> Bytes:
        out = np.empty(size, np.uint8)
        _guarded(lambda: self._decoder.decompress_many(out))
        return out

    def close(self) -> None:
        self._decoder = None


def _guarded(work: Callable[[], Any]) -> Any:
    try:
        return work()
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:
        # A panic in Rust is no Exception.
        raise DecoderError(str(error).strip() or type(error).__name__) from error


_lock = threading.Lock()
_current: Decoder | None = None


def decoder() -> Decoder:
    """Give the decoder of this process."""
    global _current  # noqa: PLW0603 (one for all readers: it uses every core by itself)
    with _lock:
        if _current is None:
            # No pass_fds on Windows; a frozen program's executable is no Python.
            alone = os.name == "posix" and sys.executable and not getattr(sys, "frozen", False)
            if alone:
                from bumpymap.readers.decoder_process import ChildDecoder

                _current = ChildDecoder()
            else:
                _current = LocalDecoder()
        return _current


def rest() -> None:
    """Give back what the decoder holds; the next request takes it again."""
    if _current is not None:
        _current.rest()


def _forget() -> None:
    global _lock, _current  # noqa: PLW0603 (as above)
    _lock = threading.Lock()
    held, _current = _current, None
    if held is not None:
        held.abandon()


at_exit(rest)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
