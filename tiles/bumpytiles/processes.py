"""Processes that are started without what strangers may have put in the current folder, and without their signals.

Python puts the current folder, where strangers' files may lie, on the path of ``python -c`` and so of what
`multiprocessing` starts. No process that is started here has it there, nor has any that those start.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any


def start_python(
    arguments: Sequence[str], *, isolated: bool = False, environment: Mapping[str, str] | None = None, **settings: Any
) -> "subprocess.Popen[bytes]":
    """Start this Python without input; its path is the same but for the current folder.

    Parameters
    ----------
    arguments : sequence of str
    isolated : bool
        Leave out site-packages and Python's environment variables too.
    environment : mapping, optional
        Environment variables to add to those of this process.
    **settings
        Those of `subprocess.Popen`.
    """
    flags = ("-I", "-S") if isolated else ("-P",)
    return subprocess.Popen(  # noqa: S603 (this Python)
        [sys.executable, *flags, *arguments],
        stdin=subprocess.DEVNULL,
        env={**os.environ, "PYTHONSAFEPATH": "1", **(environment or {})},
        **settings,
    )


@contextmanager
def blocked_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM during the body; threads and processes that it starts keep them blocked.

    Both signals reach every process of a terminal or a batch job, but only the main process handles them, and stops
    its workers. A process that receives one while it imports, starts or stops would end with a traceback.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
