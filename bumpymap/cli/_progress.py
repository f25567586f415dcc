"""Progress of a run: bars on a terminal, lines in the log of a batch system, or JSON events."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from threading import Event, Lock, Thread
from typing import TYPE_CHECKING, Any, Protocol

from bumpymap.cli._text import emit, error_console, is_plain, print_error
from bumpymap.core import Progress as BaseProgress, SilentProgress, escape_controls

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress, TaskID

Clock = Callable[[], float]
_LINE_SECONDS, _EVENT_SECONDS = 30.0, 10.0
"""Time between two lines of progress without a terminal, and between two JSON events, s."""


class CommandProgress(BaseProgress, Protocol):
    """A progress that can also report the result of a step."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Report the result of a step, as a line of text or as an event."""


class _Quiet(SilentProgress):
    """Prints nothing."""

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Do nothing."""


class _Bars:
    """One bar per stage, with the remaining time."""

    def __init__(self, bars: "Progress") -> None:
        self._bars = bars
        self._task: TaskID | None = None

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage: a new bar."""
        if self._bars.tasks and self._bars.tasks[-1].total is None:
            self._bars.update(self._bars.tasks[-1].id, total=1, completed=1)
        self._task = self._bars.add_task(escape_controls(stage), total=total)

    def advance(self, steps: int) -> None:
        """Advance the bar of this stage."""
        if self._task is not None:
            self._bars.advance(self._task, steps)

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line above the bars."""
        print_error(text)


class TickedProgress:
    """Counts the steps of a stage; each `tick` prints a line with the time since the run began, or an event."""

    def __init__(self, clock: Clock = time.monotonic, *, as_json: bool = False) -> None:
        self._clock, self._begun, self._as_json = clock, clock(), as_json
        self._lock = Lock()
        self._stage, self._done, self._total = "", 0, None  # type: tuple[str, int, int | None]

    def start(self, stage: str, total: int | None) -> None:
        """Begin a stage."""
        with self._lock:
            self._stage, self._done, self._total = stage, 0, total
        if self._as_json:
            emit("stage", stage=stage, total=total)

    def advance(self, steps: int) -> None:
        """Count steps."""
        with self._lock:
            self._done += steps

    def tick(self) -> None:
        """Print what is being done."""
        if not self._stage:
            return
        with self._lock:
            stage, done, total, seconds = self._stage, self._done, self._total, self._clock() - self._begun
        share = min(done / total, 1.0) if total else None
        shown = f"{done:,}" if share is None else f"{share:.0%} ({done:,} of {total:,})"
        facts = {"done": done, "total": total, "share": share and round(share, 4), "seconds": round(seconds, 1)}
        hours, minutes = divmod(int(seconds) // 60, 60)
        text = f"{hours}:{minutes:02d}:{int(seconds) % 60:02d} {stage}: {shown}"
        self.note(text, "progress", stage=stage, **facts)

    def note(self, text: str, event: str, **facts: Any) -> None:
        """Print a line, or an event."""
        if self._as_json:
            emit(event, **facts)
        else:
            print_error(text)


@contextmanager
def show_progress(*, quiet: bool = False, as_json: bool = False) -> Iterator[CommandProgress]:
    """Yield the progress to pass to a run.

    ``quiet``: print nothing; ``as_json``: print events; otherwise show bars on a terminal, and print lines if standard
    error is not a terminal.
    """
    if quiet:
        yield _Quiet()
    elif as_json or is_plain(error=True):
        ticked = TickedProgress(as_json=as_json)
        every = _EVENT_SECONDS if as_json else _LINE_SECONDS
        with _calling_every(ticked.tick, every):
            yield ticked
    else:
        with moving_bars(error_console()) as bars:
            yield bars


@contextmanager
def moving_bars(console: "Console") -> Iterator[_Bars]:
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    name = TextColumn("{task.description}", markup=False)
    bars = Progress(name, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn(), console=console)
    with suppress(RuntimeError):  # no thread can be started: the run goes on with still bars
        bars.start()
    try:
        yield _Bars(bars)
    finally:
        bars.stop()


@contextmanager
def _calling_every(tick: Callable[[], None], seconds: float) -> Iterator[None]:
    """Call ``tick`` at this interval, from another thread, during the body of the ``with``."""
    ended = Event()

    def run() -> None:
        while not ended.wait(seconds):
            tick()

    thread = Thread(target=run, daemon=True, name="progress")
    with suppress(RuntimeError):  # no thread can be started: the run goes on without progress
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if thread.ident is not None:
            thread.join()
