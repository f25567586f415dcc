"""Collects what workers hand back: which chunks are read, which files are sound, and where points wait.

Where bad files end the run, each result counts at once. Where they are skipped, a result counts when its files are
whole and found sound; those of a bad file never do.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from bumpymap.core import BadInputError
from bumpymap.readers import PointStats, SurveyReader, Version, file_changed
from bumpymap.survey.engine.catalogue import BlockCatalogue
from bumpymap.survey.engine.checkpoints import Checkpoints
from bumpymap.survey.engine.results import FinishedTiles, ReadResult
from bumpytiles import BLOCK_TILES, BlockKey, TileWindow

__all__ = ["ResultCollector"]


@dataclass(frozen=True, slots=True)
class _Part:
    """What a result says of one file."""

    first: int
    stop: int
    stats: PointStats
    error: BadInputError | None
    seen: tuple[str, Version | None] | None


class ResultCollector:
    """Takes the results of tasks; see the module. What an earlier run has read is among them from the start.

    Parameters
    ----------
    readers : sequence of SurveyReader
    chunks : sequence of int
        Number of chunks of each file.
    checkpoints : Checkpoints
    refuse : callable
        Called with a bad file and why; raises, or notes that it is skipped.
    skip_bad : bool
        Whether ``refuse`` may return.
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
        """Of the points that wait."""
        self.stats = [PointStats() for _ in readers]
        """Of each file that is whole and sound."""
        self.flagged = False
        """Whether any point that counts is ground."""
        self.skipped: set[int] = set()
        self._parts: dict[int, list[_Part]] = {file: [] for file in range(len(readers))}
        self._held: list[ReadResult] = []
        self._sound: set[int] = set()
        self._bad: dict[int, BadInputError] = {}
        self._answered = 0
        for result in checkpoints.take_up():
            self._note_parts(result)
            self._count(result)
        self._judge(self._parts)

    def read_spans(self) -> dict[int, list[tuple[int, int]]]:
        """Chunks of each file that are read: first, and the one behind the last."""
        return {file: [(part.first, part.stop) for part in parts] for file, parts in self._parts.items()}

    @property
    def finished(self) -> set[BlockKey]:
        """Blocks that were finished while points were read."""
        return {key for pack in self._checkpoints.early for key in pack.keys}

    @property
    def marks(self) -> tuple[int, int]:
        """Tiles of these blocks, and those of them with ground points."""
        marks = np.sum([(0, 0), *(pack.meta["marks"] for pack in self._checkpoints.early)], axis=0)
        return int(marks[0]), int(marks[1])

    def window(self) -> TileWindow:
        """Rectangle of tiles in which all blocks lie (there must be some)."""
        keys = [*self.catalogue.keys().tolist(), *self.finished]
        rows, cols = np.array(keys).T
        around = TileWindow.around(cols, rows)
        return TileWindow(*(side * BLOCK_TILES for side in (around.col, around.row, around.cols, around.rows)))

    def add(self, result: ReadResult) -> None:
        """Take what came of some chunks.

        Raises
        ------
        BadInputError
            The file is bad and may not be skipped.
        """
        files = [file for file, _, _ in result.spans]
        if result.error is not None and not self._skip_bad:
            self._refuse(self._readers[files[0]], result.error)
        self._note_parts(result)
        if self._skip_bad:
            self._held.append(result)
        else:
            self._keep(result)
        self._judge(files)
        self._keep_sound()

    def add_tiles(self, kind: str, tiles: FinishedTiles) -> None:
        """Take finished tiles."""
        self._checkpoints.save_tiles(kind, tiles.packs)

    def _note_parts(self, result: ReadResult) -> None:
        for file, first, stop in result.spans:
            stats = result.stats.get(file, PointStats())
            self._parts[file].append(_Part(first, stop, stats, result.error, result.seen))

    def _judge(self, files: Iterable[int]) -> None:
        """Judge files that are whole; skip bad ones in the order of files, once all before them are judged."""
        for file in files:
            parts = sorted(self._parts[file], key=lambda part: part.first)
            if file in self._sound | self._bad.keys() or sum(p.stop - p.first for p in parts) < self._chunks[file]:
                continue
            try:
                self.stats[file] = self._judged(file, parts)
                self._sound.add(file)
            except BadInputError as error:
                self._bad[file] = error
        while self._answered in self._sound | self._bad.keys():
            if self._answered in self._bad:
                self._refuse(self._readers[self._answered], self._bad[self._answered])
                self.skipped.add(self._answered)
            self._answered += 1

    def _judged(self, file: int, parts: Sequence[_Part]) -> PointStats:
        stats = PointStats()
        seen: dict[str, Version | None] = {}
        for part in parts:
            if part.error is not None:
                raise part.error
            stats = stats.merge(part.stats)
            # Copies on several machines may differ in the time of their writing.
            if part.seen is not None and seen.setdefault(*part.seen) != part.seen[1]:
                where = f"workers on {part.seen[0]} saw several versions of it"
                raise file_changed(self._readers[file].info.path, where)
        if self._chunks[file]:
            self._readers[file].verify(stats)
        return stats

    def _keep_sound(self) -> None:
        """Keep what came of files that are sound by now; drop what came of bad ones."""
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
        for path, blocks in result.packs:
            self.catalogue.add(path, blocks)
        if result.in_memory is not None:
            self.catalogue.add(None, result.in_memory)
