"""Collects the results of tasks: which chunks are read, which files are good, and which packs hold points.

If a bad file ends the run, each result is saved at once. If bad files are skipped, a result is saved when its files
have been read completely and found good; results of a bad file are discarded.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bumpymap.core import BadInputError
from bumpymap.readers import LineSums, PointStats, SurveyReader, Version, file_changed
from bumpymap.survey.engine.catalogue import BlockCatalogue
from bumpymap.survey.engine.checkpoints import Checkpoints
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpytiles import BLOCK_TILES, BlockKey, TileWindow

__all__ = ["ResultCollector"]


@dataclass(frozen=True, slots=True)
class _FileResult:
    """The part of a result that concerns one file."""

    first: int
    stop: int
    stats: PointStats
    error: BadInputError | None
    seen: tuple[str, Version | None] | None


class ResultCollector:
    """Collects the results of tasks; starts with those of an earlier run. See the module.

    Parameters
    ----------
    readers : sequence of SurveyReader
    chunks : sequence of int
        Number of chunks of each file.
    checkpoints : Checkpoints
    refuse : callable
        Called with the reader of a bad file and the error; raises it, or records that the file is skipped.
    skip_bad : bool
        Whether bad files are skipped.
    """

    def __init__(
        self,
        readers: Sequence[SurveyReader],
        chunks: Sequence[int],
        checkpoints: Checkpoints,
        refuse: Callable[[SurveyReader, BadInputError], None],
        *,
        skip_bad: bool,
    ) -> None:
        self._readers, self._chunks, self._checkpoints = readers, chunks, checkpoints
        self._refuse, self._skip_bad = refuse, skip_bad
        self.catalogue = BlockCatalogue()
        """Where the waiting points are."""
        self.stats = [PointStats() for _ in readers]
        """For each file, once it is read completely and found good."""
        self.flagged = False
        """Whether any point used is ground."""
        self.lines = LineSums()
        """Sums to compare the flight lines of the points used."""
        self.skipped: set[int] = set()
        self._results: dict[int, list[_FileResult]] = {file: [] for file in range(len(readers))}
        self._held: list[ReadResult] = []
        self._sound: set[int] = set()
        self._bad: dict[int, BadInputError] = {}
        self._decided = 0
        for result in checkpoints.load_results():
            self._note_results(result)
            self._count(result)
        self._judge(self._results)

    def read_spans(self) -> dict[int, list[tuple[int, int]]]:
        """Return the chunks of each file that are read, as (first, last + 1)."""
        return {file: [(part.first, part.stop) for part in parts] for file, parts in self._results.items()}

    @property
    def finished(self) -> set[BlockKey]:
        """Blocks that were finished while points were read."""
        return {key for pack in self._checkpoints.early for key in pack.keys}

    @property
    def marks(self) -> tuple[int, int]:
        """Number of tiles in the finished blocks, and of those with ground points."""
        marks = np.sum([(0, 0), *(pack.meta["marks"] for pack in self._checkpoints.early)], axis=0)
        return int(marks[0]), int(marks[1])

    def window(self) -> TileWindow:
        """Return the smallest window of whole blocks around all blocks (at least one)."""
        keys = [*self.catalogue.keys().tolist(), *self.finished]
        rows, cols = np.array(keys).T
        around = TileWindow.around(cols, rows)
        return TileWindow(*(side * BLOCK_TILES for side in (around.col, around.row, around.cols, around.rows)))

    def add(self, result: ReadResult) -> None:
        """Add the result of reading some chunks.

        Raises
        ------
        BadInputError
            The file is bad and may not be skipped.
        """
        files = [file for file, _, _ in result.spans]
        if result.error is not None and not self._skip_bad:
            self._refuse(self._readers[files[0]], result.error)
        self._note_results(result)
        if self._skip_bad:
            self._held.append(result)
        else:
            self._keep(result)
        self._judge(files)
        self._keep_sound()

    def add_tiles(self, kind: str, tiles: FinishedTiles) -> None:
        """Save finished tiles."""
        self._checkpoints.save_tiles(kind, tiles.packs)

    def _note_results(self, result: ReadResult) -> None:
        for file, first, stop in result.spans:
            stats = result.stats.get(file, PointStats())
            self._results[file].append(_FileResult(first, stop, stats, result.error, result.seen.get(file)))
        for file, pieces in result.hashed.items():
            self._readers[file].put_hashed(pieces)

    def _judge(self, files: Iterable[int]) -> None:
        """Judge files that are read completely; skip bad ones in file order, so that messages come in that order."""
        for file in files:
            parts = sorted(self._results[file], key=lambda part: part.first)
            if file in self._sound | self._bad.keys() or sum(p.stop - p.first for p in parts) < self._chunks[file]:
                continue
            try:
                self.stats[file] = self._merged_stats(file, parts)
                self._sound.add(file)
            except BadInputError as error:
                self._bad[file] = error
        while self._decided in self._sound | self._bad.keys():
            if self._decided in self._bad:
                self._refuse(self._readers[self._decided], self._bad[self._decided])
                self.skipped.add(self._decided)
            self._decided += 1

    def _merged_stats(self, file: int, parts: Sequence[_FileResult]) -> PointStats:
        stats = PointStats()
        seen: dict[str, Version | None] = {}
        for part in parts:
            if part.error is not None:
                raise part.error
            stats = stats.merge(part.stats)
            # Copies on several machines may differ in their modification time.
            if part.seen is not None and seen.setdefault(*part.seen) != part.seen[1]:
                where = f"workers on {part.seen[0]} saw several versions of it"
                raise file_changed(self._readers[file].info.path, where)
        if self._chunks[file]:
            self._readers[file].verify(stats)
        return stats

    def _keep_sound(self) -> None:
        """Save the results of files that were found good; discard those of bad ones."""
        waiting = []
        for result in self._held:
            files = {file for file, _, _ in result.spans}
            if files <= self._sound:
                self._keep(result)
            elif not files & self._bad.keys():
                waiting.append(result)
        self._held = waiting

    def _keep(self, result: ReadResult) -> None:
        self._checkpoints.save(result)
        self._count(result)

    def _count(self, result: ReadResult) -> None:
        self.flagged |= result.flagged
        self.lines = self.lines.merge(result.lines)
        for path, blocks in result.packs:
            self.catalogue.add(path, blocks)
        if result.in_memory is not None:
            self.catalogue.add(None, result.in_memory)
