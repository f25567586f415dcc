"""A run on the workers of dask.distributed: the same steps as on one machine, each of them shared out.

First, parts of files are read: a block that no other part can reach is finished at once, the points of all others go to
packs in a folder that every worker sees. Then it is decided which points count, and the blocks that wait are finished,
some neighbours at a time. The client sees counts and names of files alone.
"""

import logging
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from shutil import rmtree
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from bumpymap.core import BadInputError, Progress, Stopwatch, UsageError, causes, decide_ground
from bumpymap.readers import ReadOptions, SurveyReader
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.harvest import Adoption, Harvest
from bumpymap.survey.engine.intake import refuse_nothing
from bumpymap.survey.engine.job import Done, Job, failures, gathered, reading_record
from bumpymap.survey.engine.parts import Rivals, cut_parts, part_points
from bumpymap.survey.engine.tasks import ALIVE, Order, PartTask, busy, count_marks, finish_group, look, read_part
from bumpymap.survey.engine.tls import plain_note, read_tls_settings
from bumpymap.survey.engine.workspace import Workspace
from bumpytiles import BLOCK_TILES, Pack, TileWindow

if TYPE_CHECKING:
    from bumpytiles import Workers

__all__ = ["ClusterRun", "Crew", "hired"]

_log = logging.getLogger(__name__)

_PATIENCE_S = 30.0
"""So long a scheduler may take to answer, and tasks of a run that was given up may take to notice."""
_POINTS, _TILES = "cluster-points", "cluster-tiles"


@dataclass(frozen=True, slots=True)
class Crew:
    """Workers, and what each of them may use."""

    workers: "Workers"
    threads: int | None
    """None: as many as each worker was started with."""


@contextmanager
def hired(
    scheduler: str | None, workers: int | None, threads: int, tls_config: Path | None = None
) -> Iterator[Crew | None]:
    """Find the workers of a scheduler, or start some here that share out the threads; None where nobody asked for any.

    Raises
    ------
    UsageError
        dask.distributed is not installed, or the scheduler does not answer or has no workers; certificates that cannot
        be used.
    """
    with ExitStack() as stack:
        try:
            crew = None
            if scheduler is not None:
                crew = _crew_of(scheduler, tls_config, stack)
            elif workers is not None:
                crew = _own_crew(workers, threads, stack)
        except ImportError as error:
            raise UsageError(
                f"`scheduler` and `workers` need dask.distributed and cryptography ({error}). Install them: "
                "pip install 'bumpymap[dask]'"
            ) from error
        yield crew


def _crew_of(scheduler: str, tls_config: Path | None, stack: ExitStack) -> Crew:
    from bumpytiles import TlsFiles, workers_at

    start = "Start it: dask scheduler on one machine, dask worker ADDRESS on others; then pass the scheduler's address"
    tls, remedy = None, f"{start}, such as tcp://10.0.0.1:8786, or tls:// where it uses TLS"
    if tls_config is not None:
        settings = read_tls_settings(tls_config)
        tls = TlsFiles(str(settings.ca), str(settings.cert), str(settings.key))
        remedy = f"Was it started with TLS and a certificate that the authority in {settings.ca} signed? {start}"
    elif (note := plain_note(scheduler)) is not None:
        _log.warning(note)
    stack.enter_context(_lost(remedy))
    return Crew(stack.enter_context(workers_at(scheduler, _PATIENCE_S, tls)), None)


def _own_crew(workers: int, threads: int, stack: ExitStack) -> Crew:
    from bumpytiles import local_workers

    each = max(1, threads // workers)
    # The LAZ decoder takes every core unless it is told otherwise.
    started = _started(local_workers(workers, {"RAYON_NUM_THREADS": str(each)}))
    return Crew(stack.enter_context(started), each)


class ClusterRun:
    """One run; see `run`.

    Parameters
    ----------
    job : Job
    space : Workspace
        In folders that every worker sees.
    budget : Budget
        Of each worker.
    told : Progress
    crew : Crew
    options : ReadOptions
        With which the readers were opened.
    versions : callable
        Gives the versions of the software where it is called.
    """

    def __init__(
        self,
        job: Job,
        space: Workspace,
        budget: Budget,
        progress: Progress,
        crew: Crew,
        options: ReadOptions,
        versions: Callable[[], Mapping[str, str]],
    ) -> None:
        self._job, self._space, self._budget, self._told = job, space, budget, progress
        self._crew, self._options, self._versions = crew, options, versions

    def run(
        self,
        readers: Sequence[SurveyReader],
        refuse: Callable[[SurveyReader, BadInputError], None],
        check_window: Callable[[TileWindow], None],
        clock: Stopwatch,
        *,
        may_skip: bool,
    ) -> Done:
        """Read and measure what is not there yet; parameters as for `LocalRun.run`.

        Raises
        ------
        BadInputError
            A bad file that may not be skipped; no point is left.
        OutputError
            A worker does not see the folders, or the disk is full.
        UsageError
            Workers died, differ from the client, or do not see the inputs.
        """
        record = self._space.remembered()
        if record is None:
            remedy = "Look at their logs. Workers that run short of memory die: give them more, or lower `memory`"
            with _lost(remedy), failures(self._budget), self._order() as order:
                record = self._read_and_measure(order, readers, refuse, check_window, clock, may_skip=may_skip)
            self._space.remember(record)
        return gathered(self._job, self._space, record)

    def _read_and_measure(
        self,
        order: Order,
        readers: Sequence[SurveyReader],
        refuse: Callable[[SurveyReader, BadInputError], None],
        check_window: Callable[[TileWindow], None],
        clock: Stopwatch,
        *,
        may_skip: bool,
    ) -> dict[str, Any]:
        with clock.stage("read"):
            harvest = self._read(order, readers, refuse, may_skip=may_skip)
        refuse_nothing(readers, harvest.tallies)
        keys = [*harvest.catalogue.keys().tolist(), *(key for pack in harvest.early for key in pack.keys)]
        rows, cols = np.array(keys).T * BLOCK_TILES
        window = TileWindow.around(cols, rows)
        check_window(TileWindow(window.col, window.row, window.cols + BLOCK_TILES - 1, window.rows + BLOCK_TILES - 1))
        with clock.stage("measure"):
            ground_only = self._decide(order, harvest)
            self._finish(order, harvest, ground_only=ground_only)
        return reading_record(harvest.tallies, harvest.skipped, ground_only=ground_only)

    def _read(
        self,
        order: Order,
        readers: Sequence[SurveyReader],
        refuse: Callable[[SurveyReader, BadInputError], None],
        *,
        may_skip: bool,
    ) -> Harvest:
        total = sum(reader.info.point_count for reader in readers)
        chunk_points = self._space.run_spec["cut"]["chunk_points"]
        parts = cut_parts(readers, chunk_points, part_points(total, self._crew.workers.count()))
        harvest = Harvest(readers, parts, self._space, order.points, self._job.kinds, refuse, may_skip=may_skip)
        rivals = Rivals(self._job.grid, parts)
        numbers = [number for number in range(len(parts)) if harvest.wanted(number)]

        def task(number: int) -> tuple[Order, PartTask]:
            part = parts[number]
            path = readers[part.file].info.path
            known = self._space.run_spec["inputs"][str(path)]
            place = path if isinstance(path, str) else path.absolute()
            identity = (known["size"], known["digest"])
            return order, PartTask(place, self._options, identity, chunk_points, part, rivals.of(number))

        self._told.start("reading points", total)
        self._told.advance(total - sum(parts[number].points for number in numbers))
        with self._done(read_part, (task(number) for number in numbers)) as results:
            for place, read in results:
                harvest.take(numbers[place], read)
                self._told.advance(parts[numbers[place]].points)
        harvest.close()
        return harvest

    def _decide(self, order: Order, harvest: Harvest) -> bool:
        """Decide as `LocalRun` does; blocks that wait are looked at only where that makes a difference."""
        ground = self._job.ground
        if ground != "auto" or not harvest.flagged:
            return decide_ground(ground, 1, int(harvest.flagged))
        marks = np.sum([(0, 0), *(pack.meta["marks"] for pack in harvest.early)], axis=0)
        with self._done(count_marks, ((order, group) for group in harvest.catalogue.groups())) as results:
            for _, counts in results:
                marks += counts
        return decide_ground(ground, int(marks[0]), int(marks[1]))

    def _finish(self, order: Order, harvest: Harvest, *, ground_only: bool) -> None:
        kind = "ground" if ground_only else "all"
        finished = {key for path in self._space.tiles(kind) for key in Pack(path).keys}
        self._told.start("measuring blocks of tiles", len(harvest.catalogue.keys()))
        self._told.advance(len(finished))
        adoption = Adoption(self._space, [kind])
        tasks = ((order, group, ground_only) for group in harvest.catalogue.groups(finished))
        with self._done(finish_group, tasks) as results:
            for _, (packs, blocks) in results:
                adoption.take([packs])
                self._told.advance(blocks)

    def _done(
        self, function: Callable[..., Any], tasks: Iterable[tuple[Any, ...]]
    ) -> "closing[Generator[tuple[int, Any], None, None]]":
        """Do tasks; leaving the ``with`` takes back those that are left."""
        return closing(self._crew.workers.run(function, tasks))

    @contextmanager
    def _order(self) -> Iterator[Order]:
        """Make the folders of this run and see that every worker sees them; tell the workers when the run ends."""
        word = uuid4().hex
        points, tiles = self._space.scratch / _POINTS, self._space.folder / _TILES
        rmtree(tiles, ignore_errors=True)  # an earlier run's; points of sound files are taken up
        for folder in (points, tiles):
            folder.mkdir(exist_ok=True)
            (folder / ALIVE).write_text(word, encoding="utf-8")
        order = Order(self._job, self._budget.memory, self._crew.threads, points.absolute(), tiles.absolute(), word)
        try:
            self._look(order)
            yield order
        finally:
            for folder in (points, tiles):
                (folder / ALIVE).unlink(missing_ok=True)
            self._wait()
            rmtree(tiles, ignore_errors=True)

    def _look(self, order: Order) -> None:
        answers = self._crew.workers.each(look, order, self._versions, self._versions())
        for address, answer in answers.items():
            if isinstance(answer, BaseException):
                raise UsageError(
                    f"the worker {address} cannot run this: {answer}. Install the same bumpymap on every worker"
                )
            if answer is not None:
                raise UsageError(f"{answer} (worker {address})")

    def _wait(self) -> None:
        """Wait until no worker is at it any more: what it writes must not come after the folders are gone."""
        from bumpytiles import ClusterError

        end = time.monotonic() + _PATIENCE_S
        with suppress(ClusterError):
            while time.monotonic() < end and any(answer is True for answer in self._crew.workers.each(busy).values()):
                time.sleep(0.1)


@contextmanager
def _started(workers: AbstractContextManager["Workers"]) -> Iterator["Workers"]:
    """Start workers here, and stop them in the end."""
    with ExitStack() as stack:
        try:
            found = stack.enter_context(workers)
        except (RuntimeError, OSError) as error:
            if any(isinstance(cause, OSError) and cause.errno is not None for cause in causes(error)):
                raise  # the system says why
            raise UsageError(
                f"the workers did not start ({error}); they may have been killed. Try again, or fewer `workers`"
            ) from error
        with _lost("Try fewer `workers`"):
            yield found


@contextmanager
def _lost(remedy: str) -> Iterator[None]:
    """Say what to do where workers cannot be had or were lost."""
    from bumpytiles import ClusterError

    try:
        yield
    except ClusterError as error:
        raise UsageError(f"{error}. {remedy}") from error
