"""How far a run is, for people at a terminal, for the log of a batch system, and for machines."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Lock, Thread
from typing import Any, Protocol

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from bumpymap.cli._events import emit
from bumpymap.cli._text import complain, error_console, safe
from bumpymap.core import Progress as Told

__all__ = ["Clock", "CommandProgress", "EventProgress", "LineProgress", "show_progress"]

Clock = Callable[[], float]
_LINE_SECONDS, _EVENT_SECONDS = 30.0, 10.0


class CommandProgress(Told, Protocol):
    """Told how far a run is, and now and then what came of a step."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Say what came of a step: a line for people, an event for machines."""


class _Quiet:
    """Says nothing."""

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Do nothing."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Do nothing."""


class _Bars:
    """A bar with the time to go for each stage."""

    def __init__(self, bars: Progress) -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage: a new bar."""
        if self._bars.tasks and self._bars.tasks[-1].total is None:
            self._bars.update(self._bars.tasks[-1].id, total=1, completed=1)
        self._task = self._bars.add_task(safe(stage), total=total)

    def advance(self, steps: int) -> None:
        """Go further along the bar of this stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line above the bars."""
        complain(text)


class _Counted:
    """Counts the steps of a stage; `tick` tells of them."""

    def __init__(self, clock: Clock = time.monotonic) -> None:
        self._clock, self._begun = clock, clock()
        self._lock = Lock()
        self._stage, self._done, self._total = "", 0, None  # type: tuple[str, int, int | None]

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        with self._lock:
            self._stage, self._done, self._total = stage, 0, total

    def advance(self, steps: int) -> None:
        """Count steps."""
        with self._lock:
            self._done += steps

    def _seen(self) -> tuple[str, int, int | None, float]:
        with self._lock:
            return self._stage, self._done, self._total, self._clock() - self._begun


class LineProgress(_Counted):
    """A plain line each time it is asked: time since the run began, stage, share."""

    def tick(self) -> None:
        """Print a line."""
        stage, done, total, seconds = self._seen()
        if not stage:
            return
        minutes, seconds = divmod(int(seconds), 60)
        since = f"{minutes // 60}:{minutes % 60:02d}:{seconds:02d}"
        counted = f"{done:,}" if not total else f"{min(done / total, 1.0):.0%} ({done:,} of {total:,})"
        complain(f"{since} {stage}: {counted}")

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line."""
        complain(text)


class EventProgress(_Counted):
    """Events: one when a stage begins, one each time it is asked."""

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        super().start(stage, total)
        emit("stage", stage=stage, total=total)

    def tick(self) -> None:
        """Tell of the steps."""
        stage, done, total, seconds = self._seen()
        if stage:
            share = round(min(done / total, 1.0), 4) if total else None
            emit("progress", stage=stage, done=done, total=total, share=share, seconds=round(seconds, 1))

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Tell of the step."""
        emit(event, **facts)


@contextmanager
def show_progress(*, quiet: bool = False, as_json: bool = False) -> Iterator[CommandProgress]:
    """Give what a run tells its progress to.

    Parameters
    ----------
    quiet : bool
        Say nothing.
    as_json : bool
        Say it in events; else with bars on a terminal, and with a line now and then where standard error is none.
    """
    if quiet:
        yield _Quiet()
        return
    if as_json:
        events = EventProgress()
        with _ticking(events.tick, _EVENT_SECONDS):
            yield events
        return
    console = error_console()
    if not console.is_terminal:
        lines = LineProgress()
        with _ticking(lines.tick, _LINE_SECONDS):
            yield lines
        return
    with drawn(console) as bars:
        yield bars


@contextmanager
def drawn(console: Console) -> Iterator[_Bars]:
    name = TextColumn("{task.description}", markup=False)
    bars = Progress(name, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console)
    with suppress(RuntimeError):  # no thread to be had: the run goes on without moving bars
        bars.start()
    try:
        yield _Bars(bars)
    finally:
        bars.stop()


@contextmanager
def _ticking(tick: Callable[[], None], seconds: float) -> Iterator[None]:
    """Call something every so many seconds during the body of a ``with``, from another thread."""
    ended = Event()

    def run() -> None:
        while not ended.wait(seconds):
            tick()

    thread = Thread(target=run, daemon=True, name="progress")
    with suppress(RuntimeError):  # no thread to be had: the run goes on without a word
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
