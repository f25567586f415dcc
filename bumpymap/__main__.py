"""The command as a process of its own: before and after its run too, Ctrl-C ends it without a traceback."""

import gc
import signal

__all__ = ["run"]

_OBJECTS = 50_000
"""New objects after which unused cycles of objects are looked for. At Python's 700, that was a quarter of the time that
imports take; what a run leaves in cycles are classes and functions, no arrays (measured)."""


def run() -> None:
    """Run the command line. Until it listens, and after it has ended, SIGINT does what SIGTERM does by itself."""
    gc.set_threshold(_OBJECTS)
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bumpymap.cli import main

    try:
        main()
    finally:
        # Python would look for cycles among all objects once more before the process ends: 0.05 s.
        gc.freeze()


if __name__ == "__main__":
    run()
