"""Child processes: native code that may crash, hang or hold the interpreter's lock works in one of these.

A child is a fresh interpreter that calls functions of one module by name, as its parent requests; its loop is
`bumpymap.core._child`. It is not started through `multiprocessing.Process`: that starts a second process to track
resources, imports the user's main module again, and is forbidden in the workers of Dask. Messages are those of
`multiprocessing.connection`; large arrays lie in memory that both sides see (`bumpymap.core.shared_memory`).

A child ends with its parent, in whatever way that ends, since then the socket between them is closed. It never receives
SIGINT and SIGTERM, which are for the parent.
"""

import os
import signal
import subprocess
import sys
import weakref
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from importlib.util import find_spec
from multiprocessing import Pipe
from pathlib import Path
from typing import Any, NoReturn

from bumpymap.core.errors import UsageError
from bumpymap.core.shared_memory import SharedBytes, SharedMemory
from bumpytiles import blocked_signals

__all__ = [
    "Child",
    "ChildDiedError",
    "ChildError",
    "can_start",
    "folder_of",
    "free_memory",
    "take_memory",
]

Supply = Callable[[int, memoryview], int]
"""Fills a buffer from a place on; gives how many bytes there were."""

_SCRIPT = Path(__file__).with_name("_child.py")
_MOST_WAIT_S = 10.0
"""A child that has closed its socket ends soon."""


class ChildError(Exception):
    """A function raised in a child. The text is that of its exception."""


class ChildDiedError(Exception):
    """A child ended before it answered. The text says how.

    Parameters
    ----------
    code : int
        Its exit status, or the negative number of the signal that ended it.
    """

    def __init__(self, code: int) -> None:
        self.code = code
        self.signal = signal.Signals(-code).name if code < 0 else ""
        super().__init__(f"was ended by {self.signal}" if code < 0 else f"ended by itself (code {code})")


MEMORY = SharedMemory()
"""What this process and its children share."""


def take_memory(size: int) -> SharedBytes:
    """Give memory that can be handed to children; see `SharedMemory`."""
    return MEMORY.take(size)


def free_memory() -> None:
    """Give the memory back that nobody uses."""
    MEMORY.trim()


def can_start() -> bool:
    """Whether children can be started: not on Windows, and not where the executable is no Python (a frozen program)."""
    return os.name == "posix" and bool(sys.executable) and not getattr(sys, "frozen", False)


def folder_of(module: str) -> str:
    """Folder in which a module or package is found; UsageError where it is not installed."""
    found = find_spec(module)
    if found is None or found.origin is None:
        raise UsageError(f"{module} is not installed in this environment. Install it, and run again")
    return str(Path(found.origin).parents[1 if found.submodule_search_locations else 0])


class Child:
    """A process that does one request after the other.

    Parameters
    ----------
    purpose : str
        What it is for, as in "cannot start a process to decode LAZ".
    module : str
        Module whose functions it calls.
    folders : sequence of str, optional
        Where the module, and what it imports, are found beside the standard library: the child then runs nothing else
        (no site-packages as a whole, no environment variables of Python) and prints nothing. None: it finds modules as
        this process does.
    environment : mapping, optional
        Environment variables beside those of this process.

    Raises
    ------
    UsageError
        It cannot be started.
    """

    def __init__(
        self,
        purpose: str,
        module: str,
        folders: Sequence[str] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        if not can_start():
            raise UsageError(f"cannot start a process {purpose} on this system or from a frozen program")
        alone = folders is not None
        flags = ("-I", "-S") if alone else ("-P",)
        output = subprocess.DEVNULL if alone else None
        self.link, theirs = Pipe()
        handed = theirs.fileno(), MEMORY.descriptor
        with theirs, blocked_signals():
            try:
                self.process = subprocess.Popen(  # noqa: S603 (this Python, and a script of this package)
                    [sys.executable, *flags, str(_SCRIPT), *map(str, handed)],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    pass_fds=handed,
                    env={**os.environ, **(environment or {})},
                    start_new_session=True,
                )
            except OSError as error:
                self.link.close()
                raise UsageError(
                    f"cannot start a process {purpose} ({error.strerror}). End other programs, and run again"
                ) from error
        _children.add(self)
        with suppress(OSError):  # whoever asks first is told that it died
            self.link.send((not alone, sys.path if folders is None else folders, module))

    @property
    def runs(self) -> bool:
        """Whether it can be asked."""
        return self.process.poll() is None

    def ask(
        self,
        function: str,
        *arguments: Any,
        shared: Sequence[SharedBytes] = (),
        seconds: float = 0.0,
        supply: Supply | None = None,
    ) -> Any:
        """Have a function called and give its result; see `begin` for the parameters."""
        self.begin(function, *arguments, shared=shared, seconds=seconds, asks=supply is not None)
        return self.finish(supply)

    def begin(
        self,
        function: str,
        *arguments: Any,
        shared: Sequence[SharedBytes] = (),
        seconds: float = 0.0,
        asks: bool = False,
    ) -> None:
        """Have a function called, and do not wait for it.

        Parameters
        ----------
        function : str
            Name in the child's module.
        *arguments
            Whatever can be pickled.
        shared : sequence of SharedBytes
            Memory that it is given as further arguments, writable memoryviews.
        seconds : float
            Processor time after which the system ends the child (SIGPROF); 0: as long as it takes.
        asks : bool
            Its first argument is a function that asks `supply` of this process.
        """
        places = [(memory.start, memory.data.size) for memory in shared]
        try:
            self.link.send((function, arguments, places, MEMORY.size, seconds, asks))
        except OSError:
            self._raise_child_died()

    def finish(self, supply: Supply | None = None) -> Any:
        """Wait for the result of what was begun.

        Raises
        ------
        ChildError
            The function raised.
        ChildDiedError
            The child is no more.
        """
        while True:
            try:
                kind, value = self.link.recv()
            except (EOFError, OSError):
                self._raise_child_died()
            if kind == "question" and supply is not None:
                start, size = value
                buffer = memoryview(bytearray(size))
                found = supply(start, buffer)
                with suppress(OSError):  # then there is no answer either
                    self.link.send_bytes(buffer[:found])
            elif kind == "error":
                raise ChildError(value)
            else:
                return value

    def close(self) -> None:
        """End it, at once."""
        self.link.close()
        if self.process.returncode is None:
            self.process.kill()
            self.process.wait()

    def abandon(self) -> None:
        """After a fork, in the new process: the child belongs to the old one."""
        self.link.close()
        self.process.returncode = 0  # nothing to wait for

    def _raise_child_died(self) -> NoReturn:
        try:
            code = self.process.wait(_MOST_WAIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        raise ChildDiedError(code) from None


_children: "weakref.WeakSet[Child]" = weakref.WeakSet()


def _abandon_children() -> None:
    global MEMORY  # noqa: PLW0603 (the old process goes on with its own)
    MEMORY = SharedMemory()
    for child in _children:
        child.abandon()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_abandon_children)
