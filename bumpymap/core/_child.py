"""The loop of a child process: answer requests until the parent closes the connection or ends.

`bumpymap.core.processes` starts this file as a script, outside of its package. The LAZ decoder process must start
quickly, so only the standard library is imported here. The first message holds the ``sys.path`` and the name of the
module whose functions later messages call.
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

_LONGEST_TEXT = 1000
"""Characters of an error that a child passes on."""


def serve(socket: int, memory: int) -> None:
    """Handle requests until the parent closes the connection.

    ``socket`` and ``memory``: descriptors of the socket to the parent and of the shared memory.
    """
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    link, shared = Connection(socket), _Shared(memory)
    threading.Thread(target=_end_with_parent, args=(socket,), daemon=True).start()
    try:
        replace, folders, module = link.recv()
        sys.path[:] = folders if replace else sys.path + folders
        functions = import_module(module)
        while True:
            link.send_bytes(_handle(shared, functions, link.recv_bytes()))
    except (EOFError, ConnectionError):
        os._exit(0)


class _Shared:
    """The shared memory; mapped again when it has grown."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._map: mmap.mmap | bytes = b""

    def views(self, places: list[tuple[int, int]]) -> list[memoryview]:
        """Return views of the given places (start, length) of the memory."""
        if max((start + length for start, length in places), default=0) > len(self._map):
            # All there is now: other threads of the parent let it grow, and shrink down to the places in use.
            self._map = mmap.mmap(self._descriptor, 0)
        return [memoryview(self._map)[start : start + length] for start, length in places]


def _end_with_parent(socket: int) -> None:
    """Exit, even in the middle of a request, when the other end of the socket is closed."""
    hung_up = select.poll()
    hung_up.register(socket, 0)
    hung_up.poll()
    os._exit(0)


def _handle(shared: _Shared, functions: Any, request: bytes) -> bytes:
    """Call one function; return its pickled result, or the text of the exception that it raised."""
    try:
        name, arguments, places, limits = pickle.loads(request)  # noqa: S301 (from the parent)
        seconds, memory = limits
        views = shared.views(places)
        # The system ends a call that takes too long, even inside native code. CPU time is measured, since wall time
        # would depend on other programs.
        signal.setitimer(signal.ITIMER_PROF, seconds)
        before = soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
        if memory and (soft == resource.RLIM_INFINITY or memory < soft):  # 0: as many bytes as before
            resource.setrlimit(resource.RLIMIT_DATA, (memory, hard))
        try:
            result = getattr(functions, name)(*arguments, *views)
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
            resource.setrlimit(resource.RLIMIT_DATA, before)
        return pickle.dumps(("result", result))
    except BaseException as error:  # noqa: BLE001 (a panic in Rust is not an Exception)
        return pickle.dumps(("error", (str(error).strip() or type(error).__name__)[:_LONGEST_TEXT]))


if __name__ == "__main__":
    serve(*map(int, sys.argv[1:]))
