"""The command as a process of its own: before and after its run too, Ctrl-C ends it without a traceback.

Nothing is imported here before `run` has seen to that. ``python -m bumpymap`` has the current folder on its path, and
all that Python imports to find this file may come from there; from here on, nothing does.
"""

import sys

if __name__ == "__main__" and not sys.flags.safe_path:
    del sys.path[0]

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import NoReturn

_OBJECTS = 200_000
"""New objects after which unused cycles of objects are looked for. At Python's 700, that was a quarter of the time that
imports take, and at 50,000 still 0.04 s, to find 1,700 objects: a map holds 75,000 at its end, most of them of imports.
What a run leaves in cycles are classes and functions, no arrays (measured)."""

_ENVIRONMENT = {"OPENBLAS_THREAD_TIMEOUT": "4", "PYTHONSAFEPATH": "1"}
"""For libraries that are imported later, and for processes, unless the user has set it. Threads of OpenBLAS, numpy's
linear algebra, spin for 2^26 processor cycles when they are made and after every task; 2^4 are the fewest. Results stay
the same bits. With the other, no Python that is started imports from the current folder."""


def run() -> None:
    """Run the command line. Until it listens, and after it has ended, SIGINT does what SIGTERM does by itself."""
    import _signal  # type: ignore[import-not-found, unused-ignore]  # built in: `signal` would import others first

    if _signal.getsignal(_signal.SIGINT) is _signal.default_int_handler:
        _signal.signal(_signal.SIGINT, _signal.SIG_DFL)
    import gc
    import os

    gc.set_threshold(_OBJECTS)
    for name, value in _ENVIRONMENT.items():
        os.environ.setdefault(name, value)
    from bumpymap.cli import main

    try:
        main()
    except SystemExit as end:
        if isinstance(end.code, int):
            _leave(end.code)
        raise


def _leave(code: int) -> "NoReturn":
    """End the process when its output is flushed, its files are closed and its functions for the end have run.

    Python would take every object and library apart first, for nothing: 0.05 to 0.1 s.
    """
    import atexit
    import os
    from contextlib import suppress

    atexit._run_exitfuncs()  # noqa: SLF001 (there is no public name; what os._exit alone would leave out)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):  # the command has reported a lost output
            stream.flush()
    os._exit(code)


if __name__ == "__main__":
    run()
