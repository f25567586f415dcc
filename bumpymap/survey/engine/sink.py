"""Collecting finished blocks into packs of some megabytes."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpytiles import BlockKey, Column, PackWriter

__all__ = ["TileSink"]

_PACK_TILES = 16_384
"""Tiles in a pack: 22 MB at 15 x 15 pixels. A killed run loses no more than that."""

_GROUP_TILES = 1024
"""Most tiles that are written at once: 2 MB."""


class TileSink:
    """Writes finished blocks to packs ``tiles-KIND-NUMBER.pack``.

    Parameters
    ----------
    folder : Path
    kind : str
        What was measured, such as ``all`` points, or ``ground-early``: only ground, before reading was complete.
    columns : sequence of Column
    """

    def __init__(self, folder: Path, kind: str, columns: Sequence[Column]) -> None:
        self._folder, self._kind, self._columns, self._number = folder, kind, tuple(columns), 0
        self._written: list[Path] = []
        self._held: dict[BlockKey, Mapping[str, NDArray[Any]]] = {}
        self._tiles = 0
        self._marks = [0, 0]

    def add(self, key: BlockKey, columns: Mapping[str, NDArray[Any]], marks: tuple[int, int] = (0, 0)) -> None:
        """Add a block; ``marks`` are the numbers of its tiles with points and with flagged points, if counted."""
        self._held[key] = columns
        self._tiles += len(columns["col"])
        self._marks = [mine + more for mine, more in zip(self._marks, marks, strict=True)]
        if self._tiles >= _PACK_TILES:
            self.flush()

    def flush(self) -> None:
        """Write the blocks that are not written yet."""
        if not self._held:
            return
        path = self._folder / f"tiles-{self._kind}-{self._number:06d}.pack"
        with PackWriter(path, self._columns, {"kind": self._kind, "marks": self._marks}) as writer:
            for keys in self._groups():
                parts = [self._held[key] for key in keys]
                if len(keys) == 1:
                    writer.add(keys[0], len(parts[0]["col"]), {name: [array] for name, array in parts[0].items()})
                    continue
                joined = {
                    column.name: np.concatenate([part[column.name] for part in parts]) for column in self._columns
                }
                writer.add_blocks(keys, [len(part["col"]) for part in parts], joined)
        self._written.append(path)
        self._number += 1
        self._held, self._tiles, self._marks = {}, 0, [0, 0]

    def _groups(self) -> Iterator[list[BlockKey]]:
        """Yield the held blocks, those with few tiles in groups: the fixed time of a write counts once for many."""
        group: list[BlockKey] = []
        tiles = 0
        for key, columns in self._held.items():
            if group and tiles + len(columns["col"]) > _GROUP_TILES:
                yield group
                group, tiles = [], 0
            group.append(key)
            tiles += len(columns["col"])
        yield group

    def new_packs(self) -> list[Path]:
        """Return the packs that were written since the last call."""
        new, self._written = self._written, []
        return new
