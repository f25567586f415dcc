"""How far a run is, and how long its stages took."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

__all__ = ["Progress", "SilentProgress", "Steps", "Stopwatch", "counted"]

Item = TypeVar("Item")


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


class Steps:
    """Turns how far a stage is into steps of it."""

    def __init__(self, progress: Progress, each: int = 1) -> None:
        self._told, self._each, self._told_of = progress, each, 0

    def __call__(self, done: int, total: int) -> None:
        """Take the number of things that are done; ``each`` of them are one step."""
        steps = done // self._each
        self._told.advance(steps - self._told_of)
        self._told_of = steps


def counted(items: Iterable[Item], progress: Progress) -> Iterator[Item]:
    """Hand out things; each is a step of the stage, once it is done with."""
    for item in items:
        yield item
        progress.advance(1)


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
