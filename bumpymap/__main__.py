"""The command as a process of its own: before and after its run too, Ctrl-C ends it without a traceback."""

import signal

__all__ = ["run"]


def run() -> None:
    """Run the command line. Until it listens, and after it has ended, SIGINT does what SIGTERM does by itself."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    from bumpymap.cli import main

    main()


if __name__ == "__main__":
    run()
