"""Run drive jobs in processes, and record them in a progress file.

The physics engine holds the interpreter lock, so jobs run in processes. A job has its own random streams, so neither
the number of workers nor an interruption changes a bit of the results. The file holds one line of JSON for each job.
"""

import errno
import json
import logging
import os
import stat
from collections.abc import Callable, Generator, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar

from bumpymap.core import (
    BumpymapError,
    ChildDiedError,
    ChildError,
    OutputError,
    Progress,
    SilentProgress,
    atomic,
    call_in_children,
    parse_json,
)

_FORMAT = "bumpymap-drives-progress"
_LOG = logging.getLogger(__name__)

Key = tuple[str | int, ...]
"""Identifies a patch in a run."""

Record = TypeVar("Record")


class Journal(Generic[Record]):
    """The file of finished jobs. The first line holds the settings; drives with other settings are not reused.

    Only settings and versions are compared, so a code change that does not affect the numbers keeps the journal valid.
    ``settings`` are plain JSON; ``read`` makes a record, a dataclass, from the dict of its fields, and raises
    ValueError, KeyError or TypeError if it cannot.
    """

    def __init__(self, path: Path, settings: dict[str, Any], read: Callable[[dict[str, Any]], Record]) -> None:
        self._path = path
        self._read = read
        self._header = json.dumps({"format": _FORMAT, "settings": settings}, sort_keys=True)

    def resume(self, *, discard_other: bool) -> dict[Key, Record]:
        """Open the file and return the patches that an earlier run with the same settings drove.

        An incomplete line, for example after a power cut, is dropped with all lines that follow it. Raises OutputError
        if the file has other settings and ``discard_other`` is False, or the folder cannot be written.
        """
        try:
            lines: list[str] = []
            with suppress(FileNotFoundError), self._open_file(os.O_RDONLY) as file:
                lines = file.read().splitlines()
            if lines and lines[0] != self._header:
                if not discard_other:
                    raise OutputError(
                        f"{self._path} holds the progress of a run with other settings or versions; "
                        "use those settings, or start again with --overwrite"
                    )
                lines = []
            driven = self._records(lines[1:])
            kept = [self._header, *(_line(key, drives) for key, drives in driven.items())]
            with atomic(self._path) as temporary:  # a full disk must not lose driven patches
                temporary.write_text("\n".join(kept) + "\n", encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise OutputError(f"cannot use the progress file {self._path}: {error}") from error
        if driven:
            _LOG.info("continuing with %d driven patches of %s", len(driven), self._path)
        return driven

    def add(self, key: Key, drives: Record) -> None:
        """Append a driven patch and flush it to disk."""
        try:
            with self._open_file(os.O_WRONLY | os.O_APPEND) as file:
                file.write(_line(key, drives) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"cannot write the progress file {self._path}: {error}") from error

    def remove(self) -> None:
        """Delete the file: the run is complete."""
        self._path.unlink(missing_ok=True)

    def _open_file(self, flags: int) -> TextIO:
        """Open the file; raise OutputError for a link, because its target would be overwritten."""
        try:
            descriptor = os.open(self._path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
        except OSError as error:
            if error.errno != errno.ELOOP:
                raise
            raise OutputError(
                f"{self._path} is a link and was not touched: the run would write its progress there. Remove it, or "
                "choose another --out"
            ) from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise OutputError(f"{self._path} is not a file. Remove it, or choose another --out")
        return os.fdopen(descriptor, "a" if flags & os.O_APPEND else "r", encoding="utf-8")

    def _records(self, lines: list[str]) -> dict[Key, Record]:
        driven: dict[Key, Record] = {}
        for line in lines:
            try:
                fields = parse_json(line)
                key = tuple(fields.pop("patch"))
                driven[key] = self._read(fields)
            except (ValueError, KeyError, TypeError, AttributeError):
                text = "the progress file ends in a damaged line; %d driven patches before it are kept"
                _LOG.warning(text, len(driven))
                break
        return driven


def _line(key: Key, drives: Any) -> str:
    return json.dumps({"patch": key, **asdict(drives)}, allow_nan=False)


@dataclass(frozen=True, slots=True)
class DriveJob:
    """Drives over one patch."""

    key: Key
    """Names the job in a journal."""
    starts: int
    """Number of drives that it counts for in the progress."""


Task = TypeVar("Task")
Result = TypeVar("Result")


def drive_jobs(
    task: Callable[[DriveJob], Result],
    jobs: Sequence[DriveJob],
    progress: Progress | None = None,
    *,
    workers: int = 1,
    journal: Journal[Result] | None = None,
    discard_other: bool = False,
) -> dict[Key, Result]:
    """Drive all jobs that are not in the journal yet; return the drives by the key of their job, in that order.

    ``task`` runs one job; it and the jobs must be picklable. ``progress`` counts drives, those of the journal at the
    start and others after every job. The result does not depend on the number of ``workers``, processes.
    ``discard_other``: discard a journal written with other settings instead of raising an error.
    """
    driven = journal.resume(discard_other=discard_other) if journal else {}
    left = [job for job in jobs if job.key not in driven]
    total, progress = sum(job.starts for job in jobs), progress or SilentProgress()
    progress.start("driving", total)
    progress.advance(total - sum(job.starts for job in left))
    workers = min(workers, len(left))
    alone = workers <= 1
    with nullcontext(enumerate(map(task, left))) if alone else closing(run_in_processes(task, left, workers)) as ends:
        for number, drives in ends:
            job = left[number]
            driven[job.key] = drives
            if journal:
                journal.add(job.key, drives)
            progress.advance(job.starts)
    return {job.key: driven[job.key] for job in jobs}


def run_in_processes(
    task: Callable[[Task], Result], jobs: Sequence[Task], workers: int
) -> Generator[tuple[int, Result], None, None]:
    """Run jobs in child processes and yield their numbers and results as they end; an idle worker gets the next job.

    Closing the generator ends the workers. ``task``, jobs and results must be picklable; what ``task`` raises is raised
    here, and BumpymapError if a worker died.
    """
    calls = call_in_children("for the simulation", __name__, "attempt", ((task, job) for job in jobs), workers)
    # Results of running jobs are no longer needed after an error, and the jobs would go on for many seconds.
    with closing(calls) as ends:
        for number, _, end in ends:
            if isinstance(end, ChildDiedError):
                raise BumpymapError(
                    f"a simulation process {end}, perhaps because memory ran out; run the same command again to "
                    "continue, with fewer --jobs if it happens again"
                ) from end
            if isinstance(end, ChildError):
                raise end
            result, error = end
            if error is not None:
                raise error
            yield number, result


def attempt(task: Callable[[Task], Result], job: Task) -> tuple[Result | None, Exception | None]:
    """Run a job in a worker; return its result, or the exception for the parent to raise."""
    try:
        return task(job), None
    except Exception as error:  # noqa: BLE001 (the parent raises it)
        return None, error
