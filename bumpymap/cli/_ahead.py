"""Begin early what a run will need: its decoder, and libraries that are slow to import."""

import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

__all__ = ["import_ahead", "start_ahead"]


def start_ahead(surveys: Iterable[Path | str]) -> None:
    """Start the process that decodes LAZ, if there are such surveys: it starts on another core."""
    from bumpymap.readers import start_decoder

    start_decoder(surveys)


def import_ahead() -> None:
    """Import in a thread what rates tiles and writes layers: a run mostly waits for its decoder meanwhile.

    pandas is hidden, see `import_without_pandas`, so this is for a process that only runs this command.
    """
    with suppress(RuntimeError):  # no thread can be started: they are imported when they are needed
        threading.Thread(target=_import, name="imports").start()


def _import() -> None:
    with suppress(Exception):  # whoever needs it tries again, and says what is wrong
        from bumpymap.core import onnx_runtime
        from bumpymap.layers import import_without_pandas

        onnx_runtime()
        import_without_pandas("pyogrio.raw", "bumpymap.layers.folder")
