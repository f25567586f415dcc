"""Begin early what a run will need: its decoder, and libraries that are slow to import."""

import threading
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from bumpymap.core import Progress

__all__ = ["ImportsAhead", "start_ahead"]


def start_ahead(surveys: Iterable[Path | str]) -> None:
    """Start the process that decodes LAZ, if there are such surveys: it starts on another core."""
    from bumpymap.readers import start_decoder

    start_decoder(surveys)


class ImportsAhead:
    """A `Progress` that imports in a thread what rates tiles and writes layers, when its first stage begins.

    Before that the interpreter is busy; from then on it mostly waits for decoder and compiled code. pandas is hidden,
    see `import_without_pandas`, so this is for a process that only runs one command.
    """

    def __init__(self, progress: Progress) -> None:
        self._progress, self._begun = progress, False

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        if not self._begun:
            self._begun = True
            with suppress(RuntimeError):  # no thread can be started: they are imported when they are needed
                threading.Thread(target=_import, name="imports").start()
        self._progress.start(stage, total)

    def advance(self, steps: int) -> None:
        """Report that ``steps`` more steps are done."""
        self._progress.advance(steps)


def _import() -> None:
    with suppress(Exception):  # whoever needs it tries again, and says what is wrong
        from bumpymap.core import onnx_runtime
        from bumpymap.layers import import_without_pandas

        onnx_runtime()
        import_without_pandas("pyogrio.raw", "bumpymap.layers.folder")
