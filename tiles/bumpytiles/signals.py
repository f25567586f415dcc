"""Blocking of signals while the main process starts or stops others."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["blocked_signals"]


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM during the body; threads and processes that it starts keep them blocked.

    Both signals reach every process of a terminal or a batch job, but only the main process handles them, and stops
    its workers. A process that receives one while it imports, starts or stops would end with a traceback.
    """
    if os.name != "posix":
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
