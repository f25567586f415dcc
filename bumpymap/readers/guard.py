"""Parsers run in a child process: a damaged file may crash one, or make it run or allocate without end."""

import sys
from collections.abc import Callable, Sequence
from typing import Any, NoReturn

from bumpymap.core import Child, ChildDiedError, ChildError, SharedBytes, UsageError

__all__ = ["DecoderError", "Guard"]

_FROM_OUTSIDE = ("SIGKILL", "SIGTERM", "SIGHUP", "SIGINT")


class DecoderError(Exception):
    """The decoder cannot decode the data. The text says why."""


class Guard:
    """Calls functions in a child process, which is started when it is needed and replaced when it has died.

    It is not thread-safe.

    Parameters
    ----------
    start : callable
        Starts a child.
    task : str
        What it does, for messages: "decodes LAZ".
    library : str
        The library that it needs, for messages.
    """

    def __init__(self, start: Callable[[], Child], task: str, library: str) -> None:
        self._start, self._task, self._library = start, task, library
        self.child: Child | None = None
        """The process, once there is one."""

    def call(
        self,
        function: str,
        *arguments: Any,
        shared: Sequence[SharedBytes] = (),
        seconds: float = 0.0,
        memory: int = 0,
        read_at: Callable[[int, memoryview], int] | None = None,
    ) -> Any:
        """Call a function in the child and return its result; see `Child.begin` for the parameters.

        Raises
        ------
        DecoderError
            The function raised, crashed, or took longer than allowed.
        UsageError
            The child cannot be started, or was killed.
        """
        try:
            child = self.live_child()
            return child.call(function, *arguments, shared=shared, seconds=seconds, memory=memory, read_at=read_at)
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
        """Whether the child is running."""
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
