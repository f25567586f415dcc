"""How far a run is, and how long its stages took."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

__all__ = ["Progress", "SilentProgress", "Stopwatch"]


class Progress(Protocol):
    """Told how far a run is."""

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage of ``total`` steps; None where the number is not known."""

    def advance(self, steps: int) -> None:
        """Go so many steps further."""


class SilentProgress:
    """Tells nobody."""

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Do nothing."""


class Stopwatch:
    """Wall time by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        """Stage -> seconds, in the order of the stages."""

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Measure the body of a ``with``."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - begin, 3)
