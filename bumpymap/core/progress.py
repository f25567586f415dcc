"""Progress of a run, and wall time of its stages."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Protocol, TypeVar

__all__ = ["Progress", "SilentProgress", "Steps", "Stopwatch", "counted"]

Item = TypeVar("Item")


class Progress(Protocol):
    """Receives the progress of a run."""

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage of ``total`` steps; None if the number is not known."""

    def advance(self, steps: int) -> None:
        """Report that ``steps`` more steps are done."""


class SilentProgress:
    """Ignores all progress."""

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Do nothing."""


class Steps:
    """Callback that turns a count of finished items into steps of a stage."""

    def __init__(self, progress: Progress, each: int = 1) -> None:
        self._progress, self._each, self._reported = progress, each, 0

    def __call__(self, done: int, total: int) -> None:
        """Report that ``done`` items are finished; ``each`` items are one step."""
        steps = done // self._each
        self._progress.advance(steps - self._reported)
        self._reported = steps


def counted(items: Iterable[Item], progress: Progress) -> Iterator[Item]:
    """Yield the items, and advance the progress by one step after each."""
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
        """Measure the wall time of the body."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = round(time.perf_counter() - begin, 3)
