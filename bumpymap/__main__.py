"""The command as a process of its own: before and after its run too, Ctrl-C ends it without a traceback."""

import atexit
import gc
import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

__all__ = ["run"]

_OBJECTS = 200_000
"""New objects after which unused cycles of objects are looked for. At Python's 700, that was a quarter of the time that
imports take, and at 50,000 still 0.04 s, to find 1,700 objects: a map holds 75,000 at its end, most of them of imports.
What a run leaves in cycles are classes and functions, no arrays (measured)."""

_ENVIRONMENT = {"OPENBLAS_THREAD_TIMEOUT": "4"}
"""For libraries that are imported later, unless the user has set it. Threads of OpenBLAS, numpy's linear algebra, spin
for 2^26 processor cycles when they are made and after every task; 2^4 are the fewest. Results stay the same bits."""


def run() -> None:
    """Run the command line. Until it listens, and after it has ended, SIGINT does what SIGTERM does by itself."""
    gc.set_threshold(_OBJECTS)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bumpymap.cli import main

    try:
        main()
    except SystemExit as end:
        if isinstance(end.code, int):
            _leave(end.code)
        raise


def _leave(code: int) -> NoReturn:
    """End the process when its output is flushed, its files are closed and its functions for the end have run.

    Python would take every object and library apart first, for nothing: 0.05 to 0.1 s.
    """
    atexit._run_exitfuncs()  # noqa: SLF001 (there is no public name; what os._exit alone would leave out)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # the command has reported a lost output
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    run()
