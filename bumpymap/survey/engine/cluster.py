"""A run on the workers of a dask scheduler: any worker may do any task.

Workers exchange points and finished tiles as files in folders that all of them see. This process receives only counts
and file names.
"""

import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from ipaddress import ip_address
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit
from uuid import uuid4

from bumpymap.core import Progress, UsageError
from bumpymap.readers import ReadOptions
from bumpymap.survey.engine.block_work import BlockWork
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import BlockGroup
from bumpymap.survey.engine.plan import ChunkRange, range_points, shared_tasks
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpymap.survey.engine.run import ReadPlan
from bumpymap.survey.engine.tasks import (
    ALIVE,
    FileSource,
    RunContext,
    busy,
    count_marks,
    finish_group,
    missing_on_worker,
    read_ranges,
)
from bumpymap.survey.engine.workspace import Workspace

if TYPE_CHECKING:
    from bumpytiles import Workers

__all__ = ["ClusterExecutor", "connect"]

_log = logging.getLogger(__name__)

_TIMEOUT_S = 30.0
"""How long a scheduler may take to answer, and tasks of a cancelled run may take to end, s."""
_REMEDY = "Look at their logs. Workers that run short of memory die: give them more, or lower `memory`"


@contextmanager
def connect(scheduler: str | None) -> Iterator["Workers | None"]:
    """Connect to the workers of a scheduler; yield None if there is none.

    Raises
    ------
    UsageError
        dask.distributed is not installed, or the scheduler does not answer or has no workers.
    """
    if scheduler is None:
        yield None
        return
    try:
        from bumpytiles import workers_at
    except ImportError as error:
        raise UsageError(
            f"`scheduler` needs dask.distributed ({error}). Install it: pip install 'bumpymap[dask]'"
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

    Parameters
    ----------
    work : BlockWork
    space : Workspace
        In folders that every worker sees.
    budget : Budget
        Of each worker.
    progress : Progress
    workers : Workers
    options : ReadOptions
        The settings that the readers were opened with.
    versions : callable
        Returns the versions of the software on the machine that calls it.
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
        self._options, self._versions = options, versions
        self._context = RunContext(work, budget.memory, space.points_folder, space.new_tiles, uuid4().hex)

    @contextmanager
    def running(self) -> Iterator[None]:
        """Check that every worker has the same software and sees the folders; tell the workers when the run ends."""
        folders = (self._context.points, self._context.tiles)
        for folder in folders:
            (folder / ALIVE).write_text(self._context.run_id, encoding="utf-8")
        with _worker_errors(_REMEDY):
            try:
                self._check_workers()
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
        shared = list(shared_tasks(self._context.work.grid, plan.unread, plan.read, plan.finished, workers))
        tasks = (
            (self._context, [self._source(plan, part) for part in task.ranges], task, plan.skip_bad) for task in shared
        )
        with closing(self._workers.run(read_ranges, tasks)) as results:
            for number, read in results:
                yield from read
                self._progress.advance(sum(part.points for part in shared[number].ranges))

    def count_marks(self, groups: Iterator[BlockGroup]) -> Generator[tuple[int, int], None, None]:
        """Yield the number of tiles, and of those with ground points, for each group."""
        yield from self._run_tasks(count_marks, ((self._context, group) for group in groups))

    def finish(self, groups: Iterator[BlockGroup], *, ground_only: bool) -> Generator[FinishedTiles, None, None]:
        """Rate the blocks of each group."""
        tasks = ((self._context, group, ground_only) for group in groups)
        for tiles in self._run_tasks(finish_group, tasks):
            yield tiles
            self._progress.advance(tiles.blocks)

    def _run_tasks(self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]) -> Generator[Any, None, None]:
        with closing(self._workers.run(function, tasks)) as results:
            for _, result in results:
                yield result

    def _source(self, plan: ReadPlan, part: ChunkRange) -> FileSource:
        path = plan.readers[part.file].info.path
        known = self._space.run_spec["inputs"][str(path)]
        place = path if isinstance(path, str) else path.absolute()
        chunk_points = self._space.run_spec["cut"]["chunk_points"]
        return FileSource(place, self._options, (known["size"], known["digest"]), chunk_points)

    def _check_workers(self) -> None:
        """Raise UsageError if a worker lacks something that the run needs."""
        answers = self._workers.each(missing_on_worker, self._context, self._versions, self._versions())
        for address, answer in answers.items():
            if isinstance(answer, BaseException):
                raise UsageError(
                    f"the worker {address} cannot run this: {answer}. Install the same bumpymap on every worker"
                )
            if answer is not None:
                raise UsageError(f"{answer} (worker {address})")

    def _wait_until_idle(self) -> None:
        """Wait until no worker is busy with the run: it must not write after the folders are removed."""
        from bumpytiles import ClusterError

        end = time.monotonic() + _TIMEOUT_S
        with suppress(ClusterError):
            while time.monotonic() < end and any(answer is True for answer in self._workers.each(busy).values()):
                time.sleep(0.1)
