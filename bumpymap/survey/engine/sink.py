"""Finished blocks on their way to disk: collected into packs of some megabytes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from bumpytiles import BlockKey, Column, PackWriter

__all__ = ["TileSink"]

_PACK_TILES = 16_384
"""Tiles in a pack: 17 MB at 15 x 15 pixels. What a killed run has to do again is no more than that."""


class TileSink:
    """Takes finished blocks and writes packs ``tiles-KIND-NUMBER.pack``.

    Parameters
    ----------
    folder : Path
    kind : str
        What was measured, such as ``all`` points, or ``ground-early``: ground alone, while others were still read.
    columns : sequence of Column
    """

    def __init__(self, folder: Path, kind: str, columns: Sequence[Column]) -> None:
        self._folder, self._kind, self._columns, self._number = folder, kind, tuple(columns), 0
        self._written: list[Path] = []
        self._held: dict[BlockKey, Mapping[str, NDArray[Any]]] = {}
        self._tiles = 0
        self._marks = [0, 0]

    def add(self, key: BlockKey, columns: Mapping[str, NDArray[Any]], marks: tuple[int, int] = (0, 0)) -> None:
        """Take a block; ``marks`` counts its tiles with points, and those with flagged points, where that is known."""
        self._held[key] = columns
        self._tiles += len(columns["col"])
        self._marks = [mine + more for mine, more in zip(self._marks, marks, strict=True)]
        if self._tiles >= _PACK_TILES:
            self.flush()

    def flush(self) -> None:
        """Write what is held."""
        if not self._held:
            return
        path = self._folder / f"tiles-{self._kind}-{self._number:06d}.pack"
        with PackWriter(path, self._columns, {"kind": self._kind, "marks": self._marks}) as writer:
            for key, columns in self._held.items():
                writer.add(key, len(columns["col"]), {name: [array] for name, array in columns.items()})
        self._written.append(path)
        self._number += 1
        self._held, self._tiles, self._marks = {}, 0, [0, 0]

    def new_packs(self) -> list[Path]:
        """Give the packs that were written since this was asked last."""
        new, self._written = self._written, []
        return new
