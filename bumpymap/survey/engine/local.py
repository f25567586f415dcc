"""A run on one machine: read, decide which points count, finish every block, keep all that in packs."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Progress, Stopwatch, decide_ground
from bumpymap.readers import SurveyReader
from bumpymap.survey.engine.budget import Budget
from bumpymap.survey.engine.intake import Intake, cut, refuse_nothing
from bumpymap.survey.engine.job import Done, Job, failures, gathered, reading_record
from bumpymap.survey.engine.sink import TileSink
from bumpymap.survey.engine.workspace import Workspace
from bumpytiles import BlockKey, MemoryLimits, Pack, TileBuckets, TileWindow, run_blocks

__all__ = ["LocalRun"]


class LocalRun:
    """One run; see `run`.

    Parameters
    ----------
    job : Job
    space : Workspace
    budget : Budget
    told : Progress
    """

    def __init__(self, job: Job, space: Workspace, budget: Budget, progress: Progress) -> None:
        self._job, self._space, self._budget, self._told = job, space, budget, progress
        early, self._rest, self._marks = _taken_up(space, job.kinds)
        self._finished = set().union(*(pack.keys for pack in early))
        number = 1 + max((int(pack.path.stem[-6:]) for pack in early), default=-1)
        self._early = {kind: TileSink(space.folder, f"{kind}-early", job.columns, number) for kind in job.kinds}

    def run(
        self,
        readers: Sequence[SurveyReader],
        refuse: Callable[[SurveyReader, BadInputError], None],
        check_window: Callable[[TileWindow], None],
        clock: Stopwatch,
        *,
        may_skip: bool,
    ) -> Done:
        """Read and measure what is not there yet.

        Parameters
        ----------
        readers : sequence of SurveyReader
        refuse : callable
            Told of a bad file; raises, or notes that it is skipped.
        check_window : callable
            Raises where a map of that window cannot be made.
        clock : Stopwatch
        may_skip : bool

        Raises
        ------
        BadInputError
            A bad file that may not be skipped; no point is left.
        OutputError
            The disk is full.
        """
        record = self._space.remembered()
        if record is None:
            with failures(self._budget):
                record = self._read_and_measure(readers, refuse, check_window, clock, may_skip=may_skip)
            self._space.remember(record)
        return gathered(self._job, self._space, record)

    def _read_and_measure(
        self,
        readers: Sequence[SurveyReader],
        refuse: Callable[[SurveyReader, BadInputError], None],
        check_window: Callable[[TileWindow], None],
        clock: Stopwatch,
        *,
        may_skip: bool,
    ) -> dict[str, Any]:
        intake = Intake(
            readers,
            cut(readers, self._space.run_spec["cut"]["chunk_points"]),
            self._job.grid,
            refuse,
            may_skip=may_skip,
        )
        packs = self._space.points()
        room = MemoryLimits(
            points=self._budget.waiting_points,
            block_points=self._budget.block_points,
            scratch=self._space.scratch,
            note=intake.note,
            complete=intake.complete,
            finish=lambda keys: self._finish_early(buckets, keys),
        )
        buckets = TileBuckets(self._job.grid, room, packs)
        buckets.done |= self._finished
        with clock.stage("read"):
            start = intake.restore(packs)
            self._told.start("reading points", sum(reader.info.point_count for reader in readers))
            self._told.advance(sum(tally.points for tally in intake.tallies))
            intake.read(buckets, start, self._budget.threads, self._told)
        refuse_nothing(readers, intake.tallies)
        check_window(buckets.window())
        with clock.stage("measure"):
            ground_only = self._decide(buckets, flagged=intake.flagged)
            self._finish_rest(buckets, ground_only=ground_only)
        return reading_record(intake.tallies, intake.skipped, ground_only=ground_only)

    def _finish_early(self, buckets: TileBuckets, keys: list[BlockKey]) -> None:
        """Finish complete blocks while others are still read: both ways, where it is not known yet what counts."""
        keys = [key for key in keys if key not in self._finished]
        self._job.finish_early(buckets, keys, self._budget.threads, self._early)
        self._finished |= set(keys)

    def _finish_rest(self, buckets: TileBuckets, *, ground_only: bool) -> None:
        keys = [key for key in buckets.keys() if key not in self._rest]  # noqa: SIM118 (a property)
        self._told.start("measuring blocks of tiles", len(keys))
        kind = "ground" if ground_only else "all"
        sink = TileSink(self._space.folder, kind, self._job.columns, len(self._space.tiles()))
        for key, columns in self._job.finish(buckets, keys, self._budget.threads, ground_only=ground_only):
            sink.add(key, columns)
            self._told.advance(1)
        sink.flush()

    def _decide(self, buckets: TileBuckets, *, flagged: bool) -> bool:
        marks = self._marks.copy()
        keys = buckets.keys() if flagged and self._job.ground in {"auto", "class"} else []
        for counts in run_blocks(buckets.marks, keys, self._budget.threads):
            marks += counts
        return decide_ground(self._job.ground, int(marks[0]), int(marks[1]))


def _taken_up(space: Workspace, kinds: Sequence[str]) -> tuple[list[Pack], set[BlockKey], NDArray[np.int64]]:
    """Give what an earlier run has finished: packs made early, other finished blocks, and the marks of the early ones.

    Early blocks were measured in every way that may be wanted, in packs of one number; where one of these is missing,
    the run was broken off between them, and they are made again.
    """
    by_kind = {kind: {path.stem[-6:]: path for path in space.tiles(f"{kind}-early")} for kind in kinds}
    whole = set.intersection(*(set(paths) for paths in by_kind.values()))
    for paths in by_kind.values():
        for number, path in paths.items():
            if number not in whole:
                path.unlink()
    early = [Pack(path) for paths in by_kind.values() for number, path in paths.items() if number in whole]
    rest = set().union(*(Pack(path).keys for kind in kinds for path in space.tiles(kind)))
    marks = [pack.meta["marks"] for pack in early if pack.meta["kind"] == f"{kinds[0]}-early"]
    return early, rest, np.sum(marks or [(0, 0)], axis=0)
