"""Tasks of workers in a cluster: read ranges of chunks, count tiles with ground, rate blocks.

A task may run twice, even at the same time, because a worker died or was cut off. Each attempt therefore writes to its
own folders, and only files named in its result are used. A worker does one task at a time, with all its threads, so
that it needs the memory of one task.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from socket import gethostname
from threading import Lock
from uuid import uuid4

from bumpymap.core import BadInputError, OutputError, UsageError
from bumpymap.readers import Location, ReadOptions, SurveyReader, close_decoder, identity, reopen_survey
from bumpymap.survey.engine.block_work import BlockWork, engine_errors
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import BlockGroup
from bumpymap.survey.engine.chunk_stream import OpenRange
from bumpymap.survey.engine.plan import ReadTask
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpymap.survey.engine.worker import Worker, new_folder

__all__ = [
    "ALIVE",
    "FileSource",
    "RunContext",
    "busy",
    "count_marks",
    "finish_group",
    "missing_on_worker",
    "read_ranges",
]

_AT_WORK = Lock()
ALIVE = "alive"
"""Name of a file that exists while the run goes on."""


@dataclass(frozen=True, slots=True)
class RunContext:
    """What every task of a run needs."""

    work: BlockWork
    memory: int
    """Bytes, see `Budget`."""
    points: Path
    """Folder for waiting points, visible to client and workers."""
    tiles: Path
    """Folder for finished tiles, visible to client and workers."""
    run_id: str
    """Content of the file ``alive`` in both folders; unique to the run."""

    def check(self) -> None:
        """Raise OutputError if the folders are not visible, or the run has ended."""
        for folder in (self.points, self.tiles):
            try:
                found = (folder / ALIVE).read_text(encoding="utf-8")
            except OSError:
                found = ""
            if found != self.run_id:
                raise OutputError(
                    f"{folder} is not visible on {gethostname()}. `out`, and `scratch` where it is given, must be "
                    "folders that every worker sees under the same name"
                )


@dataclass(frozen=True, slots=True)
class FileSource:
    """A file that a worker opens."""

    path: Location
    options: ReadOptions
    identity: tuple[int, str]
    """Size in bytes and digest of the file, see `bumpymap.readers.source.identity`."""
    chunk_points: int


def missing_on_worker(
    context: RunContext, versions: Callable[[], Mapping[str, str]], wanted: Mapping[str, str]
) -> str | None:
    """Return what this worker lacks for a run, the same software or the folders; None if it lacks nothing."""
    here = versions()
    other = [
        f"{name} {here.get(name, 'not at all')}, not {want}" for name, want in wanted.items() if here.get(name) != want
    ]
    if other:
        return f"a worker on {gethostname()} has {'; '.join(other)}. Other versions may give other bits"
    try:
        context.check()
        for folder in (context.points, context.tiles):
            probe = folder / f"probe-{uuid4().hex}"
            probe.touch()
            probe.unlink()
    except OSError as error:
        return f"a worker on {gethostname()} cannot write to the folder of the run: {error}"
    except OutputError as error:
        return str(error)
    return None


def busy() -> bool:
    """Return whether a task is running in this process."""
    return _AT_WORK.locked()


def read_ranges(context: RunContext, sources: Sequence[FileSource], task: ReadTask, skip_bad: bool) -> list[ReadResult]:
    """Read ranges; rate blocks that no other task reaches, write the points of all others to packs.

    ``sources`` are the files of the ranges. See `Worker.read_to_disk`.
    """
    with _worker(context) as worker:
        try:
            ranges, bad = [], []
            for source, part in zip(sources, task.ranges, strict=True):
                try:
                    reader = opened(source.path, source.options, source.identity, context.run_id)
                    chunks = reader.chunks(source.chunk_points)[part.first : part.stop]
                    ranges.append(OpenRange(part, reader, chunks))
                except BadInputError as error:
                    bad.append(ReadResult(((part.file, part.first, part.stop),), error=error))
            if len(bad) == len(task.ranges) or (bad and not skip_bad):
                return bad
            good = replace(task, ranges=tuple(source.range for source in ranges))
            seen = {source.range.file: (gethostname(), source.reader.info.version) for source in ranges}
            read = worker.read_to_disk(good, ranges, skip_bad=skip_bad)
            return [*bad, *(result if result.error else replace(result, seen=seen) for result in read)]
        finally:
            close_decoder()  # opening a file starts it, even if nothing is read


def count_marks(context: RunContext, group: BlockGroup) -> tuple[int, int]:
    """Return the number of tiles with points, and of those with ground points, in some blocks."""
    with _worker(context) as worker:
        return worker.count_marks(group)


def finish_group(context: RunContext, group: BlockGroup, ground_only: bool) -> FinishedTiles:
    """Rate blocks; return the packs of their tiles."""
    with _worker(context) as worker:
        opened.cache_clear()  # nothing is read any more
        packs = [pack for tiles in worker.finish(group, ground_only=ground_only) for pack in tiles.packs]
        return FinishedTiles(tuple(packs), len(group.keys))


@contextmanager
def _worker(context: RunContext) -> Iterator[Worker]:
    from bumpytiles import threads_here

    with _AT_WORK:
        context.check()
        budget = Budget(context.memory, threads_here())
        points, tiles = new_folder(context.points), new_folder(context.tiles)
        with engine_errors(budget):
            yield Worker(context.work, budget, points, tiles, _RunCheck(context))


class _RunCheck:
    """A progress that ends the task when the run has ended."""

    def __init__(self, context: RunContext) -> None:
        self._context = context

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Raise OutputError if the run has ended."""
        self._context.check()


@lru_cache(maxsize=1)
def opened(path: Location, options: ReadOptions, known: tuple[int, str], _run_id: str) -> SurveyReader:
    """Open a file once for all its ranges; ``_run_id`` makes the next run open it again."""
    remedy = "Every worker must reach the same files under the same names: use a shared folder, or URLs"
    try:
        reader, here = reopen_survey(path, options), identity(path)
    except BadInputError as error:
        raise UsageError(f"a worker on {gethostname()} cannot open a file of the client: {error}. {remedy}") from error
    if (here["size"], here["digest"]) != known:
        raise UsageError(f"{path} on {gethostname()} differs from the file on the client. {remedy}")
    return reader
