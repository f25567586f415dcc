"""What workers do: read a part of a file, count marks, finish blocks.

A task may be done twice, even at the same time, because a worker died or was cut off. Each attempt therefore writes to
folders of its own, and only the files that its result names count. A worker does one task at a time, with all its
threads, so that its memory is that of one task.
"""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from shutil import rmtree
from socket import gethostname
from threading import Lock
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, OutputError, UsageError
from bumpymap.readers import (
    Location,
    PointStats,
    ReadOptions,
    SurveyReader,
    Version,
    close as close_decoder,
    identity,
    reopen_survey,
)
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.catalogue import Group
from bumpymap.survey.engine.coming import Coming
from bumpymap.survey.engine.intake import Intake, Lot
from bumpymap.survey.engine.job import Job, failures
from bumpymap.survey.engine.parts import Part
from bumpymap.survey.engine.sink import TileSink
from bumpytiles import BlockKey, Bounds, MemoryLimits, Pack, TileBuckets

__all__ = ["Order", "PartRead", "PartTask", "busy", "count_marks", "finish_group", "look", "read_part"]

_AT_WORK = Lock()
ALIVE = "alive"
"""Name of a file that is there as long as the run goes on."""


@dataclass(frozen=True, slots=True)
class Order:
    """What every task of a run must know."""

    job: Job
    memory: int
    """Bytes, see `Budget`."""
    threads: int | None
    """None: as many as the worker was started with."""
    points: Path
    """Folder for points that wait; client and workers see it."""
    tiles: Path
    """Folder for finished tiles, the same."""
    word: str
    """What the file ``alive`` holds in both folders; no other run has the same."""

    def check(self) -> None:
        """Raise OutputError where the folders are not to be seen, or the run has ended."""
        for folder in (self.points, self.tiles):
            try:
                word = (folder / ALIVE).read_text(encoding="utf-8")
            except OSError:
                word = ""
            if word != self.word:
                raise OutputError(
                    f"{folder} is not visible on {gethostname()}. `out`, and `scratch` where it is given, must be "
                    "folders that every worker sees under the same name"
                )


@dataclass(frozen=True, slots=True)
class PartTask:
    """A part of a file, as a worker must know it."""

    path: Location
    options: ReadOptions
    identity: tuple[int, str]
    """Bytes and digest of the file, see `bumpymap.readers.source.identity`."""
    chunk_points: int
    part: Part
    rivals: tuple[Bounds, ...] | None
    """See `Rivals`."""


@dataclass(frozen=True, slots=True)
class PartRead:
    """What came of a part: counts and names of files, no points."""

    tally: PointStats
    flagged: bool = False
    """Whether any point is ground."""
    packs: tuple[tuple[Path, NDArray[np.int64]], ...] = ()
    """Packs of points that wait, and what they hold: (n, 3) row, column, points of each block."""
    tiles: tuple[tuple[Path, ...], ...] = ()
    """Packs of finished tiles; those of each `Job.kinds` together."""
    error: BadInputError | None = None
    """Why the file is bad."""
    seen: tuple[str, Version | None] | None = None
    """Which machine read it, and which version of the file is there; None where it could not be read."""


def look(order: Order, versions: Callable[[], Mapping[str, str]], wanted: Mapping[str, str]) -> str | None:
    """Say what a worker lacks for a run, if it does: the folders, or the same software."""
    here = versions()
    other = [
        f"{name} {here.get(name, 'not at all')}, not {want}" for name, want in wanted.items() if here.get(name) != want
    ]
    if other:
        return f"a worker on {gethostname()} has {'; '.join(other)}. Other versions may give other bits"
    try:
        order.check()
        for folder in (order.points, order.tiles):
            probe = folder / f"probe-{uuid4().hex}"
            probe.touch()
            probe.unlink()
    except OSError as error:
        return f"a worker on {gethostname()} cannot write to the folder of the run: {error}"
    except OutputError as error:
        return str(error)
    return None


def busy() -> bool:
    """Whether a task is under way in this process."""
    return _AT_WORK.locked()


def read_part(order: Order, task: PartTask) -> PartRead:
    """Read a part of a file; finish the blocks that no other part reaches, keep the points of all others in packs."""
    with _at_work(order) as budget:
        points, tiles = (_own_folder(folder) for folder in (order.points, order.tiles))
        try:
            return _Reading(order, task, budget, points, tiles).run()
        except BadInputError as error:
            for folder in (points, tiles):
                rmtree(folder, ignore_errors=True)
            return PartRead(PointStats(), error=error)
        finally:
            close_decoder()  # opening a file starts it, even where nothing is read then


def count_marks(order: Order, group: Group) -> tuple[int, int]:
    """Count the tiles with points, and those with ground points, in some blocks."""
    with _at_work(order) as budget:
        buckets = _waiting(order, group, budget)
        marks = np.sum([buckets.marks(key) for key in group.keys], axis=0)
        return int(marks[0]), int(marks[1])


def finish_group(order: Order, group: Group, ground_only: bool) -> tuple[list[Path], int]:
    """Finish blocks; gives the packs of their tiles, and how many blocks it were."""
    with _at_work(order) as budget:
        _opened.cache_clear()  # nothing is read any more
        folder = _own_folder(order.tiles)
        sink = TileSink(folder, "ground" if ground_only else "all", order.job.columns, 0)
        buckets = _waiting(order, group, budget)
        for key, columns in order.job.finish(buckets, group.keys, budget.threads, ground_only=ground_only):
            sink.add(key, columns)
            order.check()
        sink.flush()
        return sorted(folder.iterdir()), len(group.keys)


class _Reading:
    """One attempt at a part."""

    def __init__(self, order: Order, task: PartTask, budget: Budget, points: Path, tiles: Path) -> None:
        self._order, self._task, self._budget, self._tiles = order, task, budget, tiles
        reader = _opened(task.path, task.options, task.identity, order.word)
        self._version = reader.info.version
        chunks = reader.chunks(task.chunk_points)[task.part.first : task.part.stop]
        # None is the last of its file: the client judges the file by the tallies of all its parts.
        lots = [Lot(0, chunk, last=False) for chunk in chunks]
        self._intake = Intake([reader], lots, order.job.grid, _refuse, may_skip=False)
        self._alone = _alone(order, task)
        job, kinds = order.job, order.job.kinds
        self._sinks = {kind: TileSink(tiles, f"{kind}-early", job.columns, 0) for kind in kinds}
        self._buckets = TileBuckets(
            job.grid,
            MemoryLimits(
                points=budget.waiting_points,
                block_points=budget.block_points,
                scratch=points,
                note=self._intake.note,
                complete=lambda key: self._alone.complete(key) and self._intake.complete(key),
                finish=self._finish,
            ),
        )

    def run(self) -> PartRead:
        buckets, intake = self._buckets, self._intake
        intake.read(buckets, 0, self._budget.threads, _Watch(self._order))
        ready = [key for key in buckets.keys() if self._alone.complete(key)]  # noqa: SIM118 (no mapping)
        self._finish(ready)
        buckets.done.update(ready)
        buckets.flush()
        packs = tuple((pack.path, blocks) for pack in buckets.packs if len(blocks := self._left(pack)))
        for pack in buckets.packs:
            if all(pack.path != path for path, _ in packs):
                pack.path.unlink()
        tiles = tuple(tuple(sorted(self._tiles.glob(f"tiles-{kind}-early-*.pack"))) for kind in self._sinks)
        return PartRead(intake.tallies[0], intake.flagged, packs, tiles, seen=(gethostname(), self._version))

    def _finish(self, keys: list[BlockKey]) -> None:
        self._order.check()
        self._order.job.finish_early(self._buckets, keys, self._budget.threads, self._sinks)

    def _left(self, pack: Pack) -> NDArray[np.int64]:
        """Row, column and points of a pack's blocks that are not finished."""
        keys = [key for key in pack.keys if key not in self._buckets.done]
        return np.array([(*key, pack.rows(key)) for key in keys], np.int64).reshape(-1, 3)


class _Watch:
    """Told how far the reading is; ends it where the run has ended."""

    def __init__(self, order: Order) -> None:
        self._order = order

    def start(self, stage: str, total: int | None) -> None:
        """Do nothing."""

    def advance(self, steps: int) -> None:
        """Look whether the run goes on."""
        self._order.check()


def _alone(order: Order, task: PartTask) -> Coming:
    """Tell which blocks no other part reaches: those that are complete once this one is read."""
    if task.rivals is None:
        return Coming(order.job.grid, [None])
    alone = Coming(order.job.grid, [task.part.bounds, *task.rivals])
    alone.read(0)
    return alone


def _waiting(order: Order, group: Group, budget: Budget) -> TileBuckets:
    room = MemoryLimits(points=budget.waiting_points, block_points=budget.block_points, scratch=order.points)
    return TileBuckets(order.job.grid, room, [Pack(path) for path in group.packs])


def _own_folder(parent: Path) -> Path:
    folder = parent / uuid4().hex
    folder.mkdir()
    return folder


@contextmanager
def _at_work(order: Order) -> Iterator[Budget]:
    from bumpytiles import threads_here

    with _AT_WORK:
        order.check()
        budget = Budget(order.memory, order.threads or threads_here())
        with failures(budget):
            yield budget


@lru_cache(maxsize=1)
def _opened(path: Location, options: ReadOptions, known: tuple[int, str], _word: str) -> SurveyReader:
    """Open a file once for all its parts; the word is that of the run, so that the next run opens it anew."""
    remedy = "Every worker must reach the same files under the same names: use a shared folder, or URLs"
    try:
        reader, here = reopen_survey(path, options), identity(path)
    except BadInputError as error:
        raise UsageError(f"a worker on {gethostname()} cannot open a file of the client: {error}. {remedy}") from error
    if (here["size"], here["digest"]) != known:
        raise UsageError(f"{path} on {gethostname()} differs from the file on the client. {remedy}")
    return reader


def _refuse(_: SurveyReader, error: BadInputError) -> None:
    raise error
