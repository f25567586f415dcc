"""Worker processes of a batch: each maps one survey after another, so that Python and its libraries start once.

Processes, not threads: a survey that crashes native code, or takes the last memory, ends its worker alone, and another
is started. Everything else that a survey can cause is in its row of the results.
"""

import logging
import time
import traceback
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from bumpymap.core import (
    BumpymapError,
    Child,
    ChildDiedError,
    ChildError,
    Holder,
    MapConfig,
    OutputError,
    TooUnknownError,
    count_text,
    lock_for,
    locked,
    missing_resource,
    refused_write,
)
from bumpymap.layers import (
    REPORT_NAME,
    SurveyRow,
    SurveyStatus,
    import_without_pandas,
    map_facts,
)
from bumpymap.survey.pipeline import map_surveys
from bumpymap.survey.run_record import WarningCollector
from bumpymap.views import SurveyView, read_thumbnail
from bumpytiles import compile_loaded

_MOST_WAIT_S = 5.0


@dataclass(frozen=True, slots=True)
class MapTask:
    """One survey to map."""

    name: str
    config: MapConfig
    """Its settings, with its share of threads and memory."""
    thumbnail: int = 0
    """Most characters of the picture of the map."""
    started_by: Holder | None = None
    """The batch, for whoever finds the folder locked."""


@dataclass(frozen=True, slots=True)
class TaskEnd:
    """Result of mapping one survey."""

    row: SurveyRow
    view: SurveyView = field(default_factory=SurveyView)
    traceback: str = ""
    """Of an unexpected error."""


def map_one(task: MapTask) -> TaskEnd:
    """Map a survey, continue its interrupted run, or find that it is done; in a process that does nothing else."""
    begin = time.perf_counter()
    import_without_pandas("pyogrio.raw")
    view, trace = SurveyView(), ""
    lock_for(task.started_by)
    with _collected_warnings() as said:
        try:
            row = _mapped(task)
            view = look_at(task.config.out, task.thumbnail)
        except Exception as error:  # noqa: BLE001 (the other surveys are mapped all the same)
            row = _failed(task, error, time.perf_counter() - begin)
            if not isinstance(error, BumpymapError):
                trace = traceback.format_exc()
    return TaskEnd(replace(row, warnings=tuple(dict.fromkeys([*row.warnings, *said]))), view, trace)


def look_at(folder: Path, most: int) -> SurveyView:
    """Return what the page of a batch shows of a complete map, with a picture of at most ``most`` characters."""
    return SurveyView(read_thumbnail(folder, most), (folder / REPORT_NAME).is_file())


def _mapped(task: MapTask) -> SurveyRow:
    from bumpymap.survey.advice import require_known

    out = task.config.out
    if out.is_symlink():
        raise OutputError(f"{out} is a link, which is not followed. Remove it")
    # A worker of a batch that was killed takes a moment to end.
    end = time.monotonic() + _MOST_WAIT_S
    while out.is_dir() and time.monotonic() < end:
        try:
            with locked(out):
                break
        except OutputError:
            time.sleep(_MOST_WAIT_S / 50)
    result = map_surveys(task.config, in_batch=True)
    message = ""
    status: SurveyStatus = "incomplete" if result.skipped else "already done" if result.already_done else "done"
    if result.skipped:
        path, why = next(iter(result.skipped.items()))
        message = f"{count_text(len(result.skipped), 'file was', 'files were')} skipped, such as {path}: {why}"
    try:
        require_known(result, task.config)
    except TooUnknownError as error:
        message, status = f"{message} {error}".strip(), "incomplete"
    return SurveyRow(task.name, status, message, survey=_survey(task), **map_facts(out))


def _failed(task: MapTask, error: Exception, seconds: float) -> SurveyRow:
    what, full = missing_resource(error), refused_write(error)
    message = str(error) if isinstance(error, BumpymapError) else f"{type(error).__name__}: {error}"
    if full and not isinstance(error, BumpymapError):
        message = f"{message} ({full})"
    if what:
        message = f"the machine has no {what} left for this: give fewer `jobs` or less `memory`. {message}"
    return _failed_row(task, message, seconds)


def _failed_row(task: MapTask, message: str, seconds: float) -> SurveyRow:
    return SurveyRow(task.name, "failed", message, seconds=round(seconds, 3), survey=_survey(task))


def _survey(task: MapTask) -> str:
    return " ".join(map(str, task.config.surveys))


@contextmanager
def _collected_warnings() -> Iterator[list[str]]:
    """Collect the warnings of bumpymap and its engine during the body, instead of printing them."""
    collector = WarningCollector(every_thread=True)
    loggers = [logging.getLogger(name) for name in ("bumpymap", "bumpytiles")]
    before = [(logger.handlers, logger.propagate) for logger in loggers]
    for logger in loggers:
        logger.handlers, logger.propagate = [collector], False
    try:
        yield collector.kept
    finally:
        for logger, (handlers, propagate) in zip(loggers, before, strict=True):
            logger.handlers, logger.propagate = handlers, propagate


_MODULE = "bumpymap.survey.batch.one_survey"


def map_tasks(tasks: Sequence[MapTask], jobs: int) -> Generator[TaskEnd, None, None]:
    """Map surveys, up to ``jobs`` at a time; yield the result of each as soon as it is known.

    Parameters
    ----------
    tasks : sequence of MapTask
        They are begun in this order.
    jobs : int

    Raises
    ------
    UsageError
        No process can be started.
    """
    compile_loaded()  # all of a map; here it is shown, and not done by each worker
    waiting, idle = deque(tasks), list[Child]()
    busy: dict[Any, tuple[Child, MapTask, float]] = {}
    try:
        while waiting or busy:
            while waiting and len(busy) < jobs:
                task = waiting.popleft()
                idle = [child for child in idle if child.is_alive]
                child = idle.pop() if idle else Child("to map surveys", _MODULE)
                busy[child.link] = child, task, time.perf_counter()
                with suppress(ChildDiedError):  # `finish` says so
                    child.begin("map_one", task)
            for link in wait(list(busy)):
                child, task, begun = busy.pop(link)
                try:
                    end: TaskEnd = child.finish()
                    idle.append(child)
                except (ChildDiedError, ChildError) as error:
                    child.close()
                    message = (
                        f"its process {error}. If memory ran out, give fewer `jobs` or less `memory`; the next start "
                        "continues this survey"
                    )
                    end = TaskEnd(_failed_row(task, message, time.perf_counter() - begun))
                yield end
    finally:
        # A run that is under way is ended as by a kill; the next start continues it.
        for child in (*(child for child, _, _ in busy.values()), *idle):
            child.close()
