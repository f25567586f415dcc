"""What the writers of routes need of a map: `bumpymap.layers` reads it from folders, tests make it up."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TileField
from bumpytiles import TileWindow

__all__ = ["MapSource"]


class MapSource(Protocol):
    """A map whose windows can be read."""

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folders with its layers; none if it was made up."""
        ...

    @property
    def manifests(self) -> tuple[dict[str, Any], ...]:
        """The content of run.json in each folder."""
        ...

    def read(self, window: TileWindow, bands: Sequence[str] = ...) -> TileField:
        """Read the tiles of a window, which may extend beyond the map; bands that are not asked for are NaN."""
        ...

    def relief(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Read the heights of a window at the resolution of ``shape``, north row first, m; NaN where there is none."""
        ...
