"""Checkpoints of a run: finished tiles, and records of the chunks that are read.

A record lists chunks of which every point is on disk: in a pack of waiting points, or in finished tiles. Records are
stored in the folder of the points.
"""

import json
import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import CHECKSUM_METHOD, atomic, parse_json
from bumpymap.readers import LineSums, PointStats
from bumpymap.survey.engine.results import ReadResult
from bumpymap.survey.engine.workspace import Workspace
from bumpytiles import Pack

__all__ = ["Checkpoints"]


class Checkpoints:
    """Saves results as checkpoints, and loads those of an earlier run.

    Parameters
    ----------
    space : Workspace
    kinds : sequence of str
        `BlockWork.kinds`: what is measured of blocks that are finished while points are read.
    """

    def __init__(self, space: Workspace, kinds: Sequence[str]) -> None:
        self._space, self._kinds = space, [f"{kind}-early" for kind in kinds]
        self.early: list[Pack] = []
        """Packs, of the first kind, of blocks that were finished while points were read."""

    def load_results(self) -> list[ReadResult]:
        """Return what an earlier run has read; delete files that no complete record lists."""
        early = self._complete_early()
        records = {path: parse_json(path.read_text("utf-8")) for path in self._space.records()}
        # Later packs leave out the points of blocks that were finished: if such tiles are lost, so are these points.
        lost = {number for record in records.values() for number in record["early"]} - early
        whole = {path: record for path, record in records.items() if not lost and self._has_packs(record)}
        self._clear(early, whole)
        self.early = [Pack(self._space.tile_pack(self._kinds[0], number)) for number in sorted(early)]
        self._next = {self._kinds[0]: 1 + max(early, default=-1)}
        self._next_record = 1 + max((int(path.stem[-6:]) for path in whole), default=-1)
        return [self._result(record) for record in whole.values()]

    def save(self, result: ReadResult) -> None:
        """Save finished tiles; record that chunks are read, unless some of their points are only in memory."""
        early = self._number_packs(result.tiles, self._kinds)
        self.early += [Pack(self._space.tile_pack(self._kinds[0], number)) for number in early]
        if result.in_memory is not None:
            return
        folder = self._space.points_folder
        self._write(
            {
                "spans": result.spans,
                "stats": {str(file): stats.to_record() for file, stats in result.stats.items()},
                "flagged": result.flagged,
                "lines": result.lines.to_record(),
                CHECKSUM_METHOD: {
                    str(file): [(n, digests.hex()) for n, digests in own] for file, own in result.hashed.items()
                },
                "packs": [[str(path.relative_to(folder)), blocks.tolist()] for path, blocks in result.packs],
                "early": early,
                "seen": {str(file): seen for file, seen in result.seen.items()},
            }
        )

    def save_tiles(self, kind: str, packs: Sequence[Path]) -> None:
        """Save packs of finished tiles."""
        self._number_packs([packs], [kind])

    def _number_packs(self, packs: Sequence[Sequence[Path]], kinds: Sequence[str]) -> list[int]:
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

    def _complete_early(self) -> set[int]:
        """Return the numbers of early packs that exist for every kind: a run may have been killed between two kinds."""
        return set.intersection(*({int(path.stem[-6:]) for path in self._space.tiles(kind)} for kind in self._kinds))

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

    def _write(self, record: Mapping[str, Any]) -> None:
        with atomic(self._space.record(self._next_record)) as temporary:
            temporary.write_text(json.dumps(record), encoding="utf-8")
        self._next_record += 1

    def _has_packs(self, record: Mapping[str, Any]) -> bool:
        return all(self._points(path).exists() for path, _ in record["packs"])

    def _points(self, path: str) -> Path:
        return self._space.points_folder / path

    def _result(self, record: Mapping[str, Any]) -> ReadResult:
        return ReadResult(
            tuple((file, first, stop) for file, first, stop in record["spans"]),
            {int(file): PointStats.from_record(stats) for file, stats in record["stats"].items()},
            record["flagged"],
            LineSums.from_record(record["lines"]),
            {
                int(file): tuple((first, bytes.fromhex(digests)) for first, digests in own)
                for file, own in record.get(CHECKSUM_METHOD, {}).items()  # digests by another method are no use
            },
            tuple((self._points(path), np.array(blocks, np.int64)) for path, blocks in record["packs"]),
            seen={int(file): (host, version) for file, (host, version) in record["seen"].items()},
        )
