"""The LAZ decoder. It runs in child processes, since a damaged file may crash it.

A child handles one request at a time, on all cores. A request for few LAZ chunks cannot use them all, so what another
thread requests meanwhile is decoded by a further child. If a child crashes, the file is refused, and the next request
starts a new child.
"""

import os
from atexit import register as at_exit
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from queue import Empty, LifoQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Child, Guard, SharedBytes, UsageError, allocate_shared, module_folder, trim_shared

Bytes = NDArray[np.uint8]
Table = Sequence[tuple[int, int]]
"""Number of points and bytes of each LAZ chunk."""

SECONDS, SECONDS_PER_BYTE = 4.0, 1e-7
"""CPU time limit of a request, and for each byte of input and output: ten times what real files need."""
_MOST_CHILDREN = 8
"""Decoder processes at most. Chosen: as many requests as there are at once."""
_MALLOC = {"MALLOC_TRIM_THRESHOLD_": str(1 << 26), "MALLOC_MMAP_THRESHOLD_": str(1 << 25)}
"""Makes glibc keep the memory that lazrs allocates for each LAZ chunk; else it comes from the system each time."""


class Decoder:
    """Calls lazrs. Thread-safe. Methods except ``start`` and ``close`` may raise DecoderError."""

    def __init__(self) -> None:
        self.guards = [Guard(_start, "decodes LAZ", "lazrs") for _ in range(_MOST_CHILDREN)]
        """Of the children; the last one is used first."""
        # Last in, first out: what one child can do does not start another.
        self._free: LifoQueue[Guard] = LifoQueue()
        for guard in self.guards:
            self._free.put(guard)

    def start(self) -> None:
        """Start a child now, so that it is ready when it is needed; a failure shows in the first request."""
        guard = self._free.get()
        try:
            with suppress(UsageError, OSError):
                guard.live_child()
        finally:
            self._free.put(guard)

    def check(self, record: bytes) -> None:
        """Raise DecoderError if lazrs cannot decode data with this LASzip record."""
        self._call("check_record", record)

    def chunk_table(self, record: bytes, data: SharedBytes, chunks: int) -> Table:
        """Decode the first ``chunks`` entries of a chunk table; ``data`` begins where the table does in the file."""
        table: Table = self._call("read_chunk_table", record, shared=(data,))
        return table[:chunks]

    def chunks(self, record: bytes, table: Table, data: SharedBytes, size: int, *, colour: bool = False) -> Bytes:
        """Decode adjacent LAZ chunks to ``size`` bytes; without the colour of point formats 6 to 10 unless asked."""
        out = allocate_shared(size)
        self._call("decode_chunks", record, table, colour, shared=(data, out))
        return out.data

    def close(self) -> None:
        """End the children that have nothing to do and free unused memory. Arrays in use stay valid.

        It waits for no request: what other threads use is closed by them.
        """
        idle: list[Guard] = []
        with suppress(Empty):
            while True:
                idle.append(self._free.get_nowait())
        for guard in reversed(idle):
            guard.end()
            self._free.put(guard)
        trim_shared()

    def _call(self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = ()) -> Any:
        """Call a function in a child that has nothing to do."""
        guard = self._free.get()
        try:
            seconds = SECONDS + SECONDS_PER_BYTE * sum(memory.data.size for memory in shared)
            return guard.call(function, *arguments, shared=shared, seconds=seconds)
        finally:
            self._free.put(guard)


def _start() -> Child:
    # Not all of site-packages: its .pth files would run at every start.
    folders = [str(Path(__file__).parent), module_folder("lazrs")]
    return Child("to decode LAZ", "_decoder_child", folders, _MALLOC)


current = Decoder()
"""The decoder of this process, see `decoder`."""


def decoder() -> Decoder:
    """Return the decoder of this process."""
    return current


def start_decoder(surveys: Iterable[Path]) -> None:
    """Start the decoder's child process if some surveys look like LAZ files; it starts while other work goes on."""
    if any(str(survey).lower().endswith(".laz") for survey in surveys):
        decoder().start()


def close_decoder() -> None:
    """End the decoder's child process and free its memory; the next request starts it again."""
    current.close()


def _reset_after_fork() -> None:
    global current  # noqa: PLW0603 (one for all readers: they share its children)
    current = Decoder()


at_exit(close_decoder)
os.register_at_fork(after_in_child=_reset_after_fork)
