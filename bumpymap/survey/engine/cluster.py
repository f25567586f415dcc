"""A run on the workers of a dask scheduler: any worker may do any task.

Workers exchange points and finished tiles as files in folders that all of them see; the client receives only counts and
file names. A task may run twice, even at the same time, because a worker died or was cut off. Each attempt therefore
writes to its own folders, and only files named in its result are used. A worker does one task at a time, with all its
threads, so that it needs the memory of one task.
"""

import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from ipaddress import ip_address
from itertools import chain
from pathlib import Path
from socket import gethostname
from threading import Lock
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, OutputError, Progress, SilentProgress, UsageError, install_command
from bumpymap.readers import Location, ReadOptions, SurveyReader, close_decoder, identity, reopen_survey
from bumpymap.survey.engine.block_work import BlockWork, engine_errors
from bumpymap.survey.engine.budget import Budget, Workspace
from bumpymap.survey.engine.collector import BlockGroup, ChunkRange, ReadResult
from bumpymap.survey.engine.reading import OpenRange, ReadTask, range_points, shared_tasks
from bumpymap.survey.engine.run import ReadPlan, Worker, new_folder
from bumpytiles import BlockKey

if TYPE_CHECKING:
    from bumpytiles import Workers

_AT_WORK = Lock()
ALIVE = "alive"
"""Name of a file that exists while the run goes on."""


@dataclass(frozen=True, slots=True)
class RunContext:
    """Data that every task of a run needs."""

    work: BlockWork
    memory: int
    """Bytes, see `Budget`."""
    points: Path
    """Folder for waiting points, visible to client and workers."""
    tiles: Path
    """Folder for finished tiles, visible to client and workers."""
    run_id: str
    """Content of the file ``alive`` in both folders; unique to the run."""
    options: ReadOptions
    """With which files are opened."""
    chunk_points: int
    """Points of a chunk, at most."""

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


FileSource = tuple[Location, tuple[int, str]]
"""A file that a worker opens: its place, its size in bytes and its digest, see `bumpymap.readers.identity`."""


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


def read_ranges(context: RunContext, sources: Sequence[FileSource], task: ReadTask) -> ReadResult:
    """Read ranges; rate blocks that no other task reaches, write the points of all others to packs.

    ``sources`` are the files of the ranges. See `Worker.read_to_disk`.
    """
    with _worker(context) as worker:
        try:
            ranges = []
            for (path, known), part in zip(sources, task.ranges, strict=True):
                try:
                    reader = opened(path, context.options, known, context.run_id)
                    chunks = reader.chunks(context.chunk_points)[part.first : part.stop]
                except BadInputError as error:
                    return ReadResult.of_bad(part, error)
                ranges.append(OpenRange(part, reader, chunks))
            seen = {source.range.file: (gethostname(), source.reader.info.version) for source in ranges}
            return replace(worker.read_to_disk(task, ranges), seen=seen)
        finally:
            close_decoder()  # opening a file starts it, even if nothing is read


def mark_tiles(context: RunContext, group: BlockGroup) -> dict[BlockKey, NDArray[np.uint8]]:
    """Return the marks of the tiles of some blocks, see `tile_marks`."""
    with _worker(context) as worker:
        return worker.mark_tiles(group)


def finish_group(context: RunContext, group: BlockGroup, kinds: Sequence[str]) -> tuple[list[list[Path]], int]:
    """Rate blocks; return the packs of their tiles, for each kind, and how many blocks these are."""
    with _worker(context) as worker:
        opened.cache_clear()  # nothing is read any more
        packs = [[*chain.from_iterable(alike)] for alike in zip(*worker.finish(group, kinds), strict=True)]
        return packs, len(group.keys)


@contextmanager
def _worker(context: RunContext) -> Iterator[Worker]:
    from bumpytiles import threads_here

    with _AT_WORK:
        context.check()
        budget = Budget(context.memory, threads_here())
        points, tiles = new_folder(context.points), new_folder(context.tiles)
        with engine_errors(budget):
            yield Worker(context.work, budget, points, tiles, _RunCheck(context))


class _RunCheck(SilentProgress):
    """A progress that ends the task when the run has ended."""

    def __init__(self, context: RunContext) -> None:
        self._context = context

    def advance(self, steps: int) -> None:
        """Raise OutputError if the run has ended."""
        self._context.check()


@lru_cache(maxsize=1)
def opened(path: Location, options: ReadOptions, known: tuple[int, str], _run_id: str) -> SurveyReader:
    """Open a file once for all its ranges; ``_run_id`` makes the next run open it again."""
    remedy = "Every worker must reach the same files under the same names: use a shared folder"
    try:
        reader, here = reopen_survey(path, options), identity(path)
    except BadInputError as error:
        raise UsageError(f"a worker on {gethostname()} cannot open a file of the client: {error}. {remedy}") from error
    if (here["size"], here["digest"]) != known:
        raise UsageError(f"{path} on {gethostname()} differs from the file on the client. {remedy}")
    return reader


_log = logging.getLogger(__name__)

_TIMEOUT_S = 30.0
"""How long a scheduler may take to answer, and tasks of a cancelled run may take to end, s."""
_REMEDY = "Look at their logs. Workers that run short of memory die: give them more, or lower `memory`"


@contextmanager
def connect(scheduler: str | None) -> Iterator["Workers | None"]:
    """Connect to the workers of a scheduler; yield None if there is none.

    Raises UsageError: dask.distributed is not installed, or the scheduler does not answer or has no workers.
    """
    if scheduler is None:
        yield None
        return
    try:
        from bumpytiles import workers_at
    except ImportError as error:
        raise UsageError(
            f"`scheduler` needs dask.distributed ({error}). Install it: {install_command('dask')}"
        ) from error
    _warn_without_tls(scheduler)
    remedy = (
        "Start it: dask scheduler on one machine, dask worker ADDRESS on others; then pass the scheduler's address, "
        "such as tcp://10.0.0.1:8786, or tls:// if it uses TLS: dask's configuration then names the certificates "
        "(distributed.comm.tls)"
    )
    with _worker_errors(remedy), workers_at(scheduler, _TIMEOUT_S) as workers:
        yield workers


def _warn_without_tls(address: str) -> None:
    """Warn if a scheduler on another machine is used without TLS."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    host = parts.hostname or ""
    try:
        is_here = ip_address(host).is_loopback
    except ValueError:
        is_here = host == "localhost"
    if parts.scheme != "tls" and not is_here:
        _log.warning(
            f"{address} is used without TLS: whoever reaches that port can run programs as the user of the scheduler "
            "and the workers, and read and change what they are sent. On a network that others use too, start them "
            "with TLS and give a tls:// address"
        )


@contextmanager
def _worker_errors(remedy: str) -> Iterator[None]:
    """Turn the loss of workers into a UsageError that says what to do."""
    from bumpytiles import ClusterError

    try:
        yield
    except ClusterError as error:
        raise UsageError(f"{error}. {remedy}") from error


class ClusterExecutor:
    """Distributes tasks among workers; points that wait for other tasks are in packs.

    ``space``: in folders that every worker sees; ``budget``: of each worker; ``options``: the settings that the readers
    were opened with; ``versions``: returns the versions of the software on the machine that calls it.
    """

    one_group = False

    def __init__(
        self,
        work: BlockWork,
        space: Workspace,
        budget: Budget,
        progress: Progress,
        workers: "Workers",
        options: ReadOptions,
        versions: Callable[[], Mapping[str, str]],
    ) -> None:
        self._space, self._progress, self._workers = space, progress, workers
        self._versions = versions
        folders, chunk_points = (space.points_folder, space.new_tiles), space.run_spec["cut"]["chunk_points"]
        self._context = RunContext(work, budget.memory, *folders, uuid4().hex, options, chunk_points)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Check that every worker has the same software and sees the folders; tell the workers when the run ends."""
        folders = (self._context.points, self._context.tiles)
        for folder in folders:
            (folder / ALIVE).write_text(self._context.run_id, encoding="utf-8")
        with _worker_errors(_REMEDY):
            try:
                answers = self._workers.each(missing_on_worker, self._context, self._versions, self._versions())
                for address, answer in answers.items():
                    if isinstance(answer, BaseException):
                        raise UsageError(
                            f"the worker {address} cannot run this: {answer}. Install the same bumpymap on every worker"
                        )
                    if answer is not None:
                        raise UsageError(f"{answer} (worker {address})")
                yield
            finally:
                for folder in folders:
                    (folder / ALIVE).unlink(missing_ok=True)
                self._wait_until_idle()

    def range_points(self, points: int) -> int | None:
        """Return the most points of a range, so that every worker gets several ranges."""
        return range_points(points, self._workers.count())

    def read(self, plan: ReadPlan) -> Generator[ReadResult, None, None]:
        """Read all ranges that are unread."""
        workers = self._workers.count()
        shared = list(shared_tasks(plan.unread, plan.read, plan.finished, workers, plan.tiles))
        inputs = self._space.run_spec["inputs"]

        def source(part: ChunkRange) -> FileSource:
            path = plan.readers[part.file].info.path
            known = inputs[str(path)]
            return path.absolute(), (known["size"], known["digest"])

        tasks = ((self._context, [source(part) for part in task.ranges], task) for task in shared)
        with closing(self._workers.run(read_ranges, tasks)) as results:
            for number, read in results:
                yield read
                self._progress.advance(sum(part.points for part in shared[number].ranges))

    def mark_tiles(self, groups: Iterator[BlockGroup]) -> Generator[dict[BlockKey, NDArray[np.uint8]], None, None]:
        """Yield the marks of the tiles of each block of each group."""
        yield from self._run_tasks(mark_tiles, ((self._context, group) for group in groups))

    def finish(self, groups: Iterator[BlockGroup], kinds: Sequence[str]) -> Generator[list[list[Path]], None, None]:
        """Rate the blocks of each group; yield packs of their tiles, for each kind."""
        tasks = ((self._context, group, kinds) for group in groups)
        for packs, blocks in self._run_tasks(finish_group, tasks):
            yield packs
            self._progress.advance(blocks)

    def _run_tasks(self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        with closing(self._workers.run(function, tasks)) as results:
            for _, result in results:
                yield result

    def _wait_until_idle(self) -> None:
        """Wait until no worker is busy with the run: it must not write after the folders are removed."""
        from bumpytiles import ClusterError

        end = time.monotonic() + _TIMEOUT_S
        with suppress(ClusterError):
            while time.monotonic() < end and any(answer is True for answer in self._workers.each(busy).values()):
                time.sleep(0.1)
