"""Signals that end a run: each raises one exception, once, where the run can clear up after it.

Python runs a handler between any two steps of the main thread. What it raises there is lost where the interpreter
cannot pass it on: in ``__del__``, in a callback of a weak reference or of a C library. The interpreter prints a
traceback and the run goes on, deaf. So an exception that was lost is raised again a moment later; and where a library
made an error of its own of it, as the import of some do, that error ends the run as the signal would. Once it has been
raised, the next two signals do nothing: they would break the clearing up that the first one began.
"""

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

__all__ = ["Interrupted", "Terminated", "interruptible", "shielded"]

_AGAIN_S = 0.01
_IGNORED = 2


class Interrupted(KeyboardInterrupt):
    """SIGINT: Ctrl-C."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems send before they kill; a run clears up after it as after Ctrl-C."""


_KINDS: dict[int, type[KeyboardInterrupt]] = {signal.SIGINT: Interrupted, signal.SIGTERM: Terminated}


class _Ending:
    """What is known of the end of this process's run."""

    def __init__(self) -> None:
        self.own = os.getpid()
        self.shields = 0
        self.came: int | None = None
        """A signal that waits for the end of a shield, or was lost."""
        self.raised: KeyboardInterrupt | None = None
        self.ignored = 0

    def handle(self, number: int, _: FrameType | None = None) -> None:
        """Raise what belongs to a signal, unless that was done, or must wait."""
        if os.getpid() != self.own:  # a forked child ends as any process does
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        else:
            if self.raised is not None:
                self.ignored += 1
                if self.ignored > _IGNORED:
                    self.raised, self.ignored = None, 0
            self.came = self.came or number
            self.end()

    def end(self) -> None:
        """Raise what belongs to the signal that came, if one did, once."""
        if self.came is not None and self.raised is None and not self.shields:
            self.raised = _KINDS[self.came]()
            raise self.raised

    def lost(self, value: BaseException | None) -> bool:
        """Whether this is what was raised, and was lost; then it is raised again soon."""
        if value is None or value is not self.raised or os.name != "posix":
            return False
        self.raised = None
        signal.signal(signal.SIGALRM, lambda *_: self.end())
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
        return True


_ending: _Ending | None = None
"""None: signals are the business of the caller."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGINT and SIGTERM raise `Interrupted` and `Terminated` in the body, but those that the caller handles."""
    global _ending  # noqa: PLW0603 (signals are of the whole process)
    defaults = {signal.SIGINT: (signal.default_int_handler, signal.SIG_DFL), signal.SIGTERM: (signal.SIG_DFL,)}
    ours = {number: signal.getsignal(number) for number, known in defaults.items() if signal.getsignal(number) in known}
    if threading.current_thread() is not threading.main_thread() or _ending is not None or not ours:
        yield
        return
    ending = _ending = _Ending()
    hook, alarm = sys.unraisablehook, signal.getsignal(signal.SIGALRM) if os.name == "posix" else None

    def without_what_was_lost(unraisable: Any) -> None:
        if not ending.lost(unraisable.exc_value):
            hook(unraisable)

    sys.unraisablehook = without_what_was_lost
    for number in ours:
        signal.signal(number, ending.handle)
    try:
        yield
    except Exception as error:
        if ending.raised is not None:
            raise ending.raised from error
        raise
    finally:
        ending.shields += 1  # it is over: what comes now has nothing to end
        if os.name == "posix":
            signal.setitimer(signal.ITIMER_REAL, 0)
            ours[signal.SIGALRM] = alarm
        for number, before in ours.items():
            signal.signal(number, before)
        sys.unraisablehook = hook
        _ending = None


@contextmanager
def shielded() -> Iterator[None]:
    """Let a signal wait until the body is done: for what must not be cut in two."""
    ending = _ending if threading.current_thread() is threading.main_thread() else None
    if ending is None:
        yield
        return
    ending.shields += 1
    try:
        yield
    finally:
        ending.shields -= 1
        ending.end()
