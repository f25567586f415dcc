"""Progress of a run, and how SIGINT and SIGTERM end it: by an exception that is raised once, so that it can clean up.

Python calls a signal handler between any two bytecodes of the main thread. An exception that it raises inside
``__del__`` or a callback of a weak reference or C library is lost: the interpreter prints a traceback and the run
continues. Such an exception is therefore raised again a moment later. If a library turned it into an error of its own
(some do while they are imported), that error ends the run as the signal would. Once the exception has been raised, the
next two signals are ignored, since they would interrupt the cleanup.
"""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any, Protocol, TypeVar

_AGAIN_S = 0.01
"""Time after which an exception is raised again that a library has swallowed, s."""
_IGNORED = 2
"""Signals that come while the first one is dealt with and are not raised again; the next one is."""


class Interrupted(KeyboardInterrupt):
    """SIGINT: Ctrl-C."""


class Terminated(KeyboardInterrupt):
    """SIGTERM, which batch systems send before they kill; a run cleans up as after Ctrl-C."""


_KINDS: dict[int, type[KeyboardInterrupt]] = {signal.SIGINT: Interrupted, signal.SIGTERM: Terminated}


class _SignalState:
    """Signals that this process has received, and which exception was raised for them."""

    def __init__(self) -> None:
        self.pid = os.getpid()
        self.shields = 0
        self.pending: int | None = None
        """Number of a signal whose exception is still to be raised: after `shielded`, or because it was lost."""
        self.raised: KeyboardInterrupt | None = None
        self.ignored = 0

    def handle(self, number: int, _: FrameType | None = None) -> None:
        """Raise the exception of a signal, unless it was raised before or must wait."""
        if os.getpid() != self.pid:  # a forked child takes the default action
            signal.signal(number, signal.SIG_DFL)
            os.kill(os.getpid(), number)
        else:
            if self.raised is not None:
                self.ignored += 1
                if self.ignored > _IGNORED:
                    self.raised, self.ignored = None, 0
            self.pending = self.pending or number
            self.raise_pending()

    def raise_pending(self) -> None:
        """Raise the exception of a pending signal, once."""
        if self.pending is not None and self.raised is None and not self.shields:
            self.raised = _KINDS[self.pending]()
            raise self.raised


_state: _SignalState | None = None
"""None outside of `interruptible`: the caller handles signals."""


@contextmanager
def interruptible() -> Iterator[None]:
    """Let SIGINT and SIGTERM raise `Interrupted` and `Terminated` in the body, unless the caller has set a handler."""
    global _state  # noqa: PLW0603 (signals belong to the whole process)
    defaults = {signal.SIGINT: (signal.default_int_handler, signal.SIG_DFL), signal.SIGTERM: (signal.SIG_DFL,)}
    ours = {number: signal.getsignal(number) for number, known in defaults.items() if signal.getsignal(number) in known}
    if threading.current_thread() is not threading.main_thread() or _state is not None or not ours:
        yield
        return
    state = _state = _SignalState()
    hook, alarm = sys.unraisablehook, signal.getsignal(signal.SIGALRM)

    def ignore_lost(unraisable: Any) -> None:
        if state.raised is None or unraisable.exc_value is not state.raised:
            hook(unraisable)
        else:  # it was raised, and lost
            state.raised = None
            signal.signal(signal.SIGALRM, lambda *_: state.raise_pending())
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)

    sys.unraisablehook = ignore_lost
    for number in ours:
        signal.signal(number, state.handle)
    try:
        yield
    except Exception as error:
        if state.raised is not None:
            raise state.raised from error
        raise
    finally:
        state.shields += 1  # the run is over: later signals have nothing to interrupt
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, before in {**ours, signal.SIGALRM: alarm}.items():
            signal.signal(number, before)
        sys.unraisablehook = hook
        _state = None


@contextmanager
def shielded() -> Iterator[None]:
    """Defer signals until the body is done, for steps that must not be interrupted halfway."""
    state = _state if threading.current_thread() is threading.main_thread() else None
    if state is None:
        yield
        return
    state.shields += 1
    try:
        yield
    finally:
        state.shields -= 1
        state.raise_pending()


Item = TypeVar("Item")


class Progress(Protocol):
    """Receives the progress of a run."""

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage of ``total`` steps; None if the number is not known."""

    def advance(self, steps: int) -> None:
        """Report that ``steps`` more steps are done."""


class SilentProgress:
    """Ignores all progress."""

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Do nothing."""


def counted(items: Iterable[Item], progress: Progress) -> Iterator[Item]:
    """Yield the items, and advance the progress by one step after each."""
    for item in items:
        yield item
        progress.advance(1)


class Stopwatch:
    """Wall time by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        """Stage -> seconds, in the order of the stages."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the wall time of the body."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - begin, 3)
