"""The loop of a child process: answer requests until the parent closes the connection or ends.

`bumpymap.core.processes` starts this file as a script, outside of its package: the process that decodes LAZ must start
quickly, so nothing is imported here but the standard library. The first message says where modules are found, and
which of them holds the functions that later messages call by name.
"""

import mmap
import os
import pickle
import resource
import select
import signal
import sys
import threading
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

__all__ = ["serve"]

_LONGEST_TEXT = 1000


def serve(socket: int, memory: int) -> None:
    """Answer requests; the arguments are descriptors of a socket and of shared memory."""
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    link, shared = Connection(socket), _Shared(memory)
    threading.Thread(target=_end_with_parent, args=(socket,), daemon=True).start()
    try:
        replace, folders, module = link.recv()
        sys.path[:] = folders if replace else sys.path + folders
        functions = import_module(module)
        while True:
            link.send_bytes(_answer(link, shared, functions, link.recv_bytes()))
    except (EOFError, ConnectionError):
        os._exit(0)


class _Shared:
    """The shared memory, as far as it was mapped."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._map = mmap.mmap(-1, 1)

    def views(self, places: list[tuple[int, int]], size: int) -> list[memoryview]:
        """Give the bytes at places (start, length) of a memory that has ``size`` bytes by now."""
        if size > len(self._map):
            self._map = mmap.mmap(self._descriptor, size)
        return [memoryview(self._map)[start : start + length] for start, length in places]


def _end_with_parent(socket: int) -> None:
    """End even in the middle of a request when the other end of the socket is closed, in whatever way."""
    hung_up = select.poll()
    hung_up.register(socket, 0)
    hung_up.poll()
    os._exit(0)


def _answer(link: Connection, shared: _Shared, functions: Any, request: bytes) -> bytes:
    """Call one function; give its result, or the text of what it raised."""
    try:
        name, arguments, places, size, seconds, takes_read_at = pickle.loads(request)  # noqa: S301 (from the parent)
        views = shared.views(places, size)
        questions = [_read_at_parent(link)] * takes_read_at
        # Whoever takes too long is ended by the system, even in the middle of native code. Processor time, since time
        # on the wall would depend on what else the machine does.
        signal.setitimer(signal.ITIMER_PROF, seconds)
        try:
            result = getattr(functions, name)(*questions, *arguments, *views)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        return pickle.dumps(("result", result))
    except BaseException as error:  # noqa: BLE001 (a panic in Rust is no Exception)
        return pickle.dumps(("error", (str(error).strip() or type(error).__name__)[:_LONGEST_TEXT]))


def _read_at_parent(link: Connection) -> Any:
    """Give a function that takes_read_at the parent to fill a buffer from a place on."""

    def read_at(start: int, buffer: memoryview) -> int:
        link.send(("question", (start, len(buffer))))
        return link.recv_bytes_into(buffer)

    return read_at


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
