"""The site of the sample survey: where it lies, and the tiles of each symbol in the samples' map of zones."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpytiles import Bounds

_WEST, _SOUTH = 512_340.0, 5_403_210.0
BOUNDS = Bounds(_WEST, _SOUTH, _WEST + 126.0, _SOUTH + 102.0)


def tiles_of(symbol: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns and rows (k,) of the 3 m tiles with a symbol in the map of zones of the samples' README."""
    text = (Path(__file__).resolve().parents[2] / "sample_data" / "README.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in text.partition("## Map of zones")[2].splitlines() if line.startswith("    ")]
    from_north, from_west = np.nonzero(np.array([list(line) for line in lines]) == symbol)
    return from_west + round(BOUNDS.west / 3), round(BOUNDS.north / 3) - 1 - from_north
