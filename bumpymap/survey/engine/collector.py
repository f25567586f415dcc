"""Collects the results of tasks and records them: the chunks that are read, the good files, the packs with points.

A record lists chunks of which every point is on disk, in a pack of waiting points or in finished tiles; records lie in
the folder of the points. Results cannot be taken apart again: without a file that was found bad, all are read anew.
"""

import json
import os
import shutil
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, atomic, parse_json
from bumpymap.readers import LineSums, PointStats, SurveyReader, Version, file_changed
from bumpymap.survey.engine.block_work import blocks_around
from bumpymap.survey.engine.budget import Workspace
from bumpytiles import BLOCK_TILES, BlockKey, Bounds, Pack, TileWindow, key_codes

_SIDE = 8
"""Blocks along a side of the squares that groups are formed from: neighbouring blocks are in the same packs."""
MOST_BLOCKS = 64
"""Most blocks in a group; they hold at most 16,384 tiles: one pack."""
_MOST_POINTS = 20_000_000
"""Points of a group at most: a task of some seconds."""


@dataclass(frozen=True, slots=True)
class BlockGroup:
    """Blocks that one task finishes, and the packs that hold their points on disk."""

    keys: tuple[BlockKey, ...]
    packs: tuple[Path, ...]
    """Also those of the blocks around them."""
    tiles: tuple[Path, ...] = ()
    """Packs of finished tiles around them, measured from all points."""


class BlockCatalogue:
    """Knows which packs hold points, or tiles, of each block; takes 40 bytes for each block of each pack."""

    def __init__(self) -> None:
        self._paths: list[Path | None] = []
        self._entries: list[NDArray[np.int64]] = []
        self._sorted: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None

    def add(self, path: Path | None, blocks: NDArray[np.int64]) -> None:
        """Add the blocks of a pack, or of the memory of this process (``path`` None).

        ``blocks`` (n, 3) holds row, column and number of points of each block; a block may occur several times.
        """
        number = np.full((len(blocks), 1), len(self._paths), np.int64)
        self._paths.append(path)
        self._entries.append(np.hstack([blocks.reshape(-1, 3), number]))
        self._sorted = None

    def keys(self) -> NDArray[np.int64]:
        """Rows and columns of all blocks, (n, 2), each once."""
        return np.unique(self._all()[:, :2], axis=0)

    def packs(self, keys: Collection[BlockKey]) -> tuple[Path, ...]:
        """Return the packs that hold something of blocks."""
        if self._sorted is None:
            entries = self._all()
            codes = key_codes(entries)
            order = np.argsort(codes, kind="stable")
            self._sorted = codes[order], entries[order, 3]
        codes, numbers = self._sorted
        wanted = key_codes(np.array(sorted(keys), np.int64).reshape(-1, 2))
        first, last = (np.searchsorted(codes, wanted, side).tolist() for side in ("left", "right"))
        found = {number for start, stop in zip(first, last, strict=True) for number in numbers[start:stop].tolist()}
        return tuple(path for number in sorted(found) if (path := self._paths[number]) is not None)

    def groups(
        self, skip: Collection[BlockKey] = (), tiles: "BlockCatalogue | None" = None, *, single: bool = False
    ) -> Iterator[BlockGroup]:
        """Yield groups of neighbouring blocks, without those in ``skip``; one group of all of them if ``single``.

        ``tiles`` knows the packs of finished tiles.
        """
        entries = self._all()
        row, col = entries[:, 0], entries[:, 1]
        entries = entries[np.lexsort((col, row, col // _SIDE, row // _SIDE))]
        starts = np.flatnonzero(np.any(np.diff(entries[:, :2], axis=0, prepend=entries[:1, :2] - 1), axis=1))
        points = np.diff(np.append(0, np.cumsum(entries[:, 2]))[np.append(starts, len(entries))])
        keys: list[BlockKey] = []
        total = 0
        for start, count in zip(starts.tolist(), points.tolist(), strict=True):
            key = (int(entries[start, 0]), int(entries[start, 1]))
            if key in skip:
                continue
            if keys and not single and (len(keys) == MOST_BLOCKS or total + count > _MOST_POINTS):
                yield self._group(keys, tiles)
                keys, total = [], 0
            keys.append(key)
            total += count
        if keys:
            yield self._group(keys, tiles)

    def _group(self, keys: Sequence[BlockKey], tiles: "BlockCatalogue | None") -> BlockGroup:
        near = {beside for key in keys for beside in blocks_around(key)}
        return BlockGroup(tuple(keys), self.packs(near), () if tiles is None else tiles.packs(near))

    def _all(self) -> NDArray[np.int64]:
        return np.concatenate([np.empty((0, 4), np.int64), *self._entries])


@dataclass(frozen=True, slots=True)
class ChunkRange:
    """Consecutive chunks of a file."""

    file: int
    """Index of its reader."""
    first: int
    """Its first chunk."""
    stop: int
    """Its last chunk + 1."""
    points: int
    bounds: Bounds | None
    """Bounds of its points, m; None if they are not known."""
    is_whole: bool
    """True if the range is the whole file."""


Span = tuple[int, int, int]
"""Index of the file, first chunk, last chunk + 1."""


@dataclass(frozen=True, slots=True, eq=False)
class ReadResult:
    """The result of reading some chunks."""

    spans: tuple[Span, ...]
    stats: dict[int, PointStats] = field(default_factory=dict)
    """Statistics by file."""
    flagged: bool = False
    """True if any point is ground."""
    lines: LineSums = LineSums()  # noqa: RUF009 (frozen)
    """Sums to compare flight lines."""
    packs: tuple[tuple[Path, NDArray[np.int64]], ...] = ()
    """Packs of waiting points, each with the row, column and number of points of its blocks, (n, 3)."""
    tiles: tuple[tuple[Path, ...], ...] = ()
    """Packs of finished tiles, grouped by `BlockWork.kinds`."""
    in_memory: NDArray[np.int64] | None = None
    """Blocks, as in ``packs``, whose points are only in the memory of this process: they cannot be resumed."""
    error: BadInputError | None = None
    """Why the file is bad."""
    seen: Mapping[int, tuple[str, Version]] = field(default_factory=dict)
    """By file, the name of the machine that read the chunks, and the version there; without those of this process."""

    @classmethod
    def of_bad(cls, part: ChunkRange, error: BadInputError) -> "ReadResult":
        """Return the result for a range of a file that turned out to be bad."""
        return cls(((part.file, part.first, part.stop),), error=error)

    @classmethod
    def merged(cls, results: Iterable["ReadResult"]) -> "ReadResult":
        """Return one result for the chunks of several, without packs, tiles and errors."""
        spans: list[Span] = []
        stats: dict[int, PointStats] = {}
        flagged, lines = False, LineSums()
        for result in results:
            for file, first, stop in result.spans:
                follows = spans and spans[-1][0] == file and spans[-1][2] == first
                spans.append((file, spans.pop()[1] if follows else first, stop))
            for file, own in result.stats.items():
                stats[file] = stats.get(file, PointStats()).merge(own)
            flagged |= result.flagged
            lines = lines.merge(result.lines)
        return cls(tuple(spans), stats, flagged, lines)


class Checkpoints:
    """Saves results as checkpoints, and loads those of an earlier run.

    ``kinds``: `BlockWork.kinds`: what is measured of blocks that are finished while points are read.
    """

    def __init__(self, space: Workspace, kinds: Sequence[str]) -> None:
        self._space, self._kinds = space, [f"{kind}-early" for kind in kinds]
        self.early: list[Pack] = []
        """Packs, of the first kind, of blocks that were finished while points were read."""

    def load_results(self) -> list[ReadResult]:
        """Return what an earlier run has read; delete files that no complete record lists."""
        early = set.intersection(*({int(path.stem[-6:]) for path in self._space.tiles(kind)} for kind in self._kinds))
        records = {path: parse_json(path.read_text("utf-8")) for path in self._space.records()}
        # Later packs leave out the points of blocks that were finished: if such tiles are lost, so are these points.
        lost = {number for record in records.values() for number in record["early"]} - early
        whole = {
            path: record
            for path, record in records.items()
            if not lost and all((self._space.points_folder / path).exists() for path, _ in record["packs"])
        }
        self._clear(early, whole)
        self.early = [Pack(self._space.tile_pack(self._kinds[0], number)) for number in sorted(early)]
        self._next = {self._kinds[0]: 1 + max(early, default=-1)}
        self._next_record = 1 + max((int(path.stem[-6:]) for path in whole), default=-1)
        return [self._result(record) for record in whole.values()]

    def save(self, result: ReadResult) -> None:
        """Save finished tiles; record that chunks are read, unless some of their points are only in memory."""
        early = self.number_packs(result.tiles, self._kinds)
        self.early += [Pack(self._space.tile_pack(self._kinds[0], number)) for number in early]
        if result.in_memory is not None:
            return
        folder = self._space.points_folder
        record = {
            "spans": result.spans,
            "stats": {str(file): stats.to_record() for file, stats in result.stats.items()},
            "flagged": result.flagged,
            "lines": result.lines.to_record(),
            "packs": [[str(path.relative_to(folder)), blocks.tolist()] for path, blocks in result.packs],
            "early": early,
            "seen": {str(file): seen for file, seen in result.seen.items()},
        }
        with atomic(self._space.record(self._next_record)) as temporary:
            temporary.write_text(json.dumps(record), encoding="utf-8")
        self._next_record += 1

    def number_packs(self, packs: Sequence[Sequence[Path]], kinds: Sequence[str]) -> list[int]:
        """Move packs, as many of each kind, to their numbered names; return the numbers."""
        if kinds[0] not in self._next:
            taken = (int(path.stem[-6:]) for path in self._space.tiles(kinds[0]))
            self._next[kinds[0]] = 1 + max(taken, default=-1)
        first = number = self._next[kinds[0]]
        for alike in zip(*packs, strict=True):
            for kind, path in zip(kinds, alike, strict=True):
                os.replace(path, self._space.tile_pack(kind, number))  # noqa: PTH105 (the name says that it replaces)
            number += 1
        self._next[kinds[0]] = number
        return list(range(first, number))

    def _clear(self, early: set[int], records: Mapping[Path, Mapping[str, Any]]) -> None:
        """Delete early tiles, records and folders of points that are not part of a checkpoint."""
        for path in self._space.tiles("*-early"):
            if int(path.stem[-6:]) not in early:
                path.unlink()
        for path in set(self._space.records()).difference(records):
            path.unlink()
        folders = {Path(path).parts[0] for record in records.values() for path, _ in record["packs"]}
        for folder in self._space.points_folder.iterdir():
            if folder.is_dir() and folder.name not in folders:
                shutil.rmtree(folder, ignore_errors=True)

    def _result(self, record: Mapping[str, Any]) -> ReadResult:
        return ReadResult(
            tuple((file, first, stop) for file, first, stop in record["spans"]),
            {int(file): PointStats.from_record(stats) for file, stats in record["stats"].items()},
            record["flagged"],
            LineSums.from_record(record["lines"]),
            tuple((self._space.points_folder / path, np.array(blocks, np.int64)) for path, blocks in record["packs"]),
            seen={int(file): (host, version) for file, (host, version) in record["seen"].items()},
        )


class ResultCollector:
    """Collects the results of tasks; starts with those of an earlier run. See the module.

    ``chunks``: number of chunks of each file; ``refuse``: called with the reader of a bad file and the error; raises
    it, or records that the file is skipped.
    """

    def __init__(
        self,
        readers: Sequence[SurveyReader],
        chunks: Sequence[int],
        checkpoints: Checkpoints,
        refuse: Callable[[SurveyReader, BadInputError], None],
    ) -> None:
        self._readers, self._chunks, self._checkpoints, self._refuse = readers, chunks, checkpoints, refuse
        self.catalogue = BlockCatalogue()
        """Where the waiting points are."""
        self.stats = [PointStats() for _ in readers]
        """For each file, once it is read completely and found good."""
        self.flagged = False
        """True if any point used is ground."""
        self.lines = LineSums()
        """Sums to compare the flight lines of the points used."""
        self._results: dict[int, list[tuple[int, int, ReadResult]]] = {file: [] for file in range(len(readers))}
        """By file, its chunks that are read (first, last + 1), and what is known of them, without their points."""
        for result in checkpoints.load_results():
            self._note_results(result)
            self._count(result)
        self.all_good = self._judge(self._results)
        """False once a file was found bad that may be skipped."""

    def read_spans(self) -> dict[int, list[tuple[int, int]]]:
        """Return the chunks of each file that are read, as (first, last + 1)."""
        return {file: [(first, stop) for first, stop, _ in parts] for file, parts in self._results.items()}

    @property
    def finished(self) -> set[BlockKey]:
        """Blocks that were finished while points were read."""
        return {key for pack in self._checkpoints.early for key in pack.keys}

    @property
    def marks(self) -> dict[BlockKey, NDArray[np.uint8]]:
        """Marks of the tiles of the finished blocks, (256,) each, see `tile_marks`."""
        noted = [(pack.keys, pack.meta["marks"]) for pack in self._checkpoints.early]
        return {
            k: np.frombuffer(bytes.fromhex(m), np.uint8) for keys, own in noted for k, m in zip(keys, own, strict=True)
        }

    def window(self) -> TileWindow:
        """Return the smallest window of whole blocks around all blocks (at least one)."""
        keys = [*self.catalogue.keys().tolist(), *self.finished]
        rows, cols = np.array(keys).T
        around = TileWindow.around(cols, rows)
        return TileWindow(*(side * BLOCK_TILES for side in (around.col, around.row, around.cols, around.rows)))

    def add(self, result: ReadResult) -> None:
        """Add the result of reading some chunks; without effect but for ``all_good`` if a file was found bad.

        Raises BadInputError: the file is bad and may not be skipped.
        """
        self._note_results(result)
        self.all_good = self._judge([file for file, _, _ in result.spans])
        if self.all_good:
            self._checkpoints.save(result)
            self._count(result)

    def add_tiles(self, kind: str, packs: Sequence[Path]) -> None:
        """Save packs of finished tiles."""
        self._checkpoints.number_packs([packs], [kind])

    def _note_results(self, result: ReadResult) -> None:
        known = ReadResult(result.spans, result.stats, error=result.error, seen=result.seen)
        for file, first, stop in result.spans:
            self._results[file].append((first, stop, known))

    def _judge(self, files: Iterable[int]) -> bool:
        """Return whether no error is known of files, and those that are read completely are good."""
        for file in dict.fromkeys(files):
            error = next((part.error for _, _, part in self._results[file] if part.error is not None), None)
            read = sum(stop - first for first, stop, _ in self._results[file])
            if error is None and read == self._chunks[file]:
                stats, versions = PointStats(), dict[str, Version]()
                try:
                    for _, _, part in sorted(self._results[file], key=lambda part: part[0]):
                        stats = stats.merge(part.stats.get(file, PointStats()))
                        # Copies on several machines may differ in their modification time.
                        host, version = part.seen.get(file, ("", {}))
                        if versions.setdefault(host, version) != version:
                            where = f"workers on {host} saw several versions of it"
                            raise file_changed(self._readers[file].info.path, where)
                    if self._chunks[file]:
                        self._readers[file].verify(stats)
                    self.stats[file] = stats
                except BadInputError as found:
                    error = found
            if error is not None:
                self._refuse(self._readers[file], error)
                return False
        return True

    def _count(self, result: ReadResult) -> None:
        self.flagged |= result.flagged
        self.lines = self.lines.merge(result.lines)
        for path, blocks in result.packs:
            self.catalogue.add(path, blocks)
        if result.in_memory is not None:
            self.catalogue.add(None, result.in_memory)
