"""Signals that are for the main process alone, while it starts or stops others."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["blocked_signals"]


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait until the body is done; threads and processes that it starts never hear them.

    They reach every process of a terminal or a batch job: the main one alone shall answer, and end its workers. One
    that is hit while it imports, or is half begun or half closed, ends with a traceback.
    """
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
