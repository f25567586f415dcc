"""Child processes for native code that may crash, hang or hold the GIL.

A child is a new interpreter that calls functions of one module by name, as its parent requests; its loop is in
`bumpymap.core._child`. It is not started through `multiprocessing.Process`, which starts a second process to track
resources, imports the user's main module again, and is not allowed in Dask workers. Messages go through
`multiprocessing.connection`; large arrays lie in shared memory. That is one anonymous file that every child maps once:
with one file for each array, mapping and clearing them would take a tenth of the decoding time.
``multiprocessing.shared_memory`` needs space in ``/dev/shm``, which containers limit to 64 MB, and starts a process to
clean up there.

A child ends when its parent ends, even if the parent is killed, because the socket between them is then closed. SIGINT
and SIGTERM go to the parent only.
"""

import mmap
import os
import signal
import subprocess
import sys
import threading
import weakref
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing import Pipe
from multiprocessing.connection import wait
from pathlib import Path
from time import perf_counter
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.errors import UsageError
from bumpymap.core.interrupts import shielded
from bumpytiles import blocked_signals, start_python

_PAGE = 4096
"""Allocations are whole multiples of this, bytes."""
_GROWTH = 1 << 22
"""The memory grows in multiples of this, bytes."""


@dataclass(frozen=True, slots=True)
class SharedBytes:
    """A range of bytes of the shared memory."""

    start: int
    """Offset of the first byte."""
    data: NDArray[np.uint8]
    """(n,)"""


class SharedMemory:
    """First-fit allocator of shared memory. Thread-safe."""

    def __init__(self) -> None:
        self.descriptor = os.memfd_create("bumpymap")
        # Arrays may be garbage-collected at any moment, so their offsets are recorded without a lock.
        self._freed: deque[int] = deque()
        self._ends: dict[int, int] = {}
        self._lock = threading.Lock()
        self._map: mmap.mmap | None = None
        self.size = 0
        """Current size, bytes."""

    def allocate(self, size: int) -> SharedBytes:
        """Allocate ``size`` uninitialized bytes, which are freed when the last array that uses them is deleted."""
        length = max(-(-size // _PAGE), 1) * _PAGE
        with self._lock:
            self._collect()
            start = self._first_gap(length)
            if start + length > self.size or self._map is None:
                grown = -(-(start + length) // _GROWTH) * _GROWTH
                os.ftruncate(self.descriptor, grown)
                # Arrays in use keep the map that they were created from. Where no memory is left for a larger one,
                # nothing has changed.
                self._map = mmap.mmap(self.descriptor, grown)
                self.size = grown
            self._ends[start] = start + length
            whole = np.frombuffer(self._map, np.uint8, length, start)
        weakref.finalize(whole, self._freed.append, start).atexit = False
        return SharedBytes(start, whole[:size])

    def trim(self) -> None:
        """Return all memory to the operating system, if no array is in use."""
        with self._lock:
            self._collect()
            if not self._ends:
                self._map, self.size = None, 0
                os.ftruncate(self.descriptor, 0)

    def _collect(self) -> None:
        while self._freed:
            del self._ends[self._freed.popleft()]

    def _first_gap(self, length: int) -> int:
        at = 0
        for start in sorted(self._ends):
            if start - at >= length:
                break
            at = self._ends[start]
        return at


_SCRIPT = Path(__file__).with_name("_child.py")
_FROM_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")
_MOST_WAIT_S = 10.0
"""Seconds to wait for the end of a child that has closed its socket."""


class ChildError(Exception):
    """A function raised an exception in a child process. The text is that of the exception."""


class ChildDiedError(Exception):
    """A child process ended before it returned a result. The text says how.

    ``code``: its exit status, or the negative number of the signal that ended it.
    """

    def __init__(self, code: int) -> None:
        self.code = code
        self.signal = signal.Signals(-code).name if code < 0 else ""
        super().__init__(f"was ended by {self.signal}" if code < 0 else f"ended by itself (code {code})")


MEMORY = SharedMemory()
"""State that this process and its children share."""


def allocate_shared(size: int) -> SharedBytes:
    """Allocate memory that child processes can access; see `SharedMemory`."""
    return MEMORY.allocate(size)


def trim_shared() -> None:
    """Return unused shared memory to the operating system."""
    MEMORY.trim()


def module_folder(module: str) -> str:
    """Return the folder that a module or package is imported from; raise UsageError if it is not installed."""
    found = find_spec(module)
    if found is None or found.origin is None:
        raise UsageError(f"{module} is not installed in this environment. Install it, and run again")
    return str(Path(found.origin).parents[1 if found.submodule_search_locations else 0])


class DecoderError(Exception):
    """The decoder cannot decode the data. The text says why."""


class Child:
    """A child process that handles one request at a time.

    ``purpose``: for messages, such as "to decode LAZ" in "cannot start a process to decode LAZ"; ``module``: name of
    the module whose functions it calls; ``folders``: folders of the module and of what it imports. The child then
    imports from these and the standard library only (it ignores site-packages and Python's environment variables) and
    prints nothing. None: the child has the ``sys.path`` of this process. ``environment``: environment variables to add
    to those of this process. Raises UsageError: the process cannot be started.
    """

    def __init__(
        self,
        purpose: str,
        module: str,
        folders: Sequence[str] | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        isolated = folders is not None
        output = subprocess.DEVNULL if isolated else None
        self.link, theirs = Pipe()
        handed = theirs.fileno(), MEMORY.descriptor
        with theirs, blocked_signals():
            try:
                self.process = start_python(
                    [str(_SCRIPT), *map(str, handed)],
                    isolated=isolated,
                    environment=environment,
                    stdout=output,
                    stderr=output,
                    pass_fds=handed,
                    start_new_session=True,
                )
            except OSError as error:
                self.link.close()
                raise UsageError(
                    f"cannot start a process {purpose} ({error.strerror}). End other programs, and run again"
                ) from error
        _children.add(self)
        with suppress(OSError):  # the first call reports that it died
            self.link.send((not isolated, sys.path if folders is None else folders, module))

    @property
    def is_alive(self) -> bool:
        """True while the process is running."""
        return self.process.poll() is None

    def call(self, function: str, *arguments: Any, **limits: Any) -> Any:
        """Call a function in the child and return its result; see `begin` for the parameters."""
        self.begin(function, *arguments, **limits)
        return self.finish()

    def begin(
        self, function: str, *arguments: Any, shared: Sequence[SharedBytes] = (), seconds: float = 0.0, memory: int = 0
    ) -> None:
        """Start a function call in the child and return at once.

        ``function``: name of a function of the child's module; ``*arguments``: arguments that can be pickled;
        ``shared``: memory that is passed as further arguments, as writable memoryviews; ``seconds``: CPU time after
        which the system ends the child (SIGPROF); 0: no limit; ``memory``: bytes that the child may hold during the
        call, on Linux; what asks for more raises MemoryError. 0: no limit.
        """
        places = [(each.start, each.data.size) for each in shared]
        try:
            self.link.send((function, arguments, places, (seconds, memory)))
        except OSError:
            self._raise_child_died()

    def finish(self) -> Any:
        """Wait for the result of the call that `begin` started.

        Raises ChildError: the function raised; ChildDiedError: the child has ended.
        """
        try:
            kind, value = self.link.recv()
        except (EOFError, OSError):
            self._raise_child_died()
        if kind == "error":
            raise ChildError(value)
        return value

    def close(self) -> None:
        """Kill the child process."""
        self.link.close()
        if self.process.returncode is None:
            self.process.kill()
            self.process.wait()

    def _raise_child_died(self) -> NoReturn:
        try:
            code = self.process.wait(_MOST_WAIT_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            code = self.process.wait()
        raise ChildDiedError(code) from None


def call_in_children(
    purpose: str, module: str, function: str, calls: Iterable[tuple[Any, ...]], most: int
) -> Generator[tuple[int, float, Any], None, None]:
    """Call a function of a module with each of some arguments, in up to ``most`` child processes at a time.

    Calls are begun in their order; an idle child gets the next one, and one that has died is replaced. This process
    uses no threads, because a thread would outlive an interruption and print a message. Closing the generator ends
    the children, whatever they do. ``purpose``: as for `Child`. Yields, as soon as a call has ended, its number, how
    long it took, s, and its result: what it returned, or the ChildError or ChildDiedError that ended it. Raises
    UsageError: no process can be started.
    """
    waiting, idle = deque(enumerate(calls)), list[Child]()
    busy: dict[Any, tuple[Child, int, float]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < most:
                number, arguments = waiting.popleft()
                idle = [child for child in idle if child.is_alive]
                with shielded():
                    child = idle.pop() if idle else Child(purpose, module)
                    busy[child.link] = child, number, perf_counter()
                with suppress(ChildDiedError):  # `finish` says so
                    child.begin(function, *arguments)
            for link in wait(list(busy)):
                child, number, begun = busy[link]
                try:
                    result = child.finish()
                    idle.append(child)
                except (ChildDiedError, ChildError) as error:
                    child.close()
                    result = error
                del busy[link]
                yield number, perf_counter() - begun, result
    finally:
        with shielded():
            for child in (*(child for child, _, _ in busy.values()), *idle):
                child.close()


class Guard:
    """Calls functions in a child process, which is started when it is needed and replaced when it has died.

    It is not thread-safe. ``start``: starts a child; ``task``: what it does, for messages: "decodes LAZ"; ``library``:
    the library that it needs, for messages.
    """

    def __init__(self, start: Callable[[], Child], task: str, library: str) -> None:
        self._start, self._task, self._library = start, task, library
        self.child: Child | None = None
        """The process, once there is one."""

    def call(self, function: str, *arguments: Any, **limits: Any) -> Any:
        """Call a function in the child and return its result; see `Child.begin` for the parameters.

        Raises DecoderError: the function raised, crashed, or took longer than allowed; UsageError: the child cannot be
        started, or was killed.
        """
        try:
            return self.live_child().call(function, *arguments, **limits)
        except ChildError as error:
            raise DecoderError(str(error)) from error
        except ChildDiedError as error:
            self.end()
            self._raise_child_died(error)
        except BaseException:
            # The result of an interrupted call would be taken for that of the next one.
            self.end()
            raise

    @property
    def is_alive(self) -> bool:
        """True if the child is running."""
        return self.child is not None and self.child.is_alive

    def live_child(self) -> Child:
        """Return the child, started if there is none."""
        child = self.child if self.is_alive else None
        if child is None:
            self.end()
            child = self.child = self._start()
        return child

    def end(self) -> None:
        """End the child."""
        child, self.child = self.child, None
        if child is not None:
            child.close()

    def _raise_child_died(self, error: ChildDiedError) -> NoReturn:
        """Raise the error for a dead child: DecoderError if the file crashed it, else UsageError."""
        if not error.signal:
            raise UsageError(
                f"the process that {self._task} {error}: is {self._library} installed correctly? Try: "
                f"{sys.executable} -c 'import {self._library}'"
            ) from error
        if error.signal in _FROM_OUTSIDE:
            raise UsageError(
                f"the process that {self._task} was killed ({error.signal}), perhaps for lack of memory. Lower "
                "`memory`, or end other programs, and run again"
            ) from error
        if error.signal == "SIGPROF":
            raise DecoderError("the decoder did not finish") from error
        raise DecoderError(f"the decoder crashed ({error.signal})") from error


_children: "weakref.WeakSet[Child]" = weakref.WeakSet()


def _abandon_children() -> None:
    global MEMORY  # noqa: PLW0603 (the old process keeps its own)
    MEMORY = SharedMemory()
    for child in _children:  # they belong to the old process
        child.link.close()
        child.process.returncode = 0  # nothing to wait for


os.register_at_fork(after_in_child=_abandon_children)
