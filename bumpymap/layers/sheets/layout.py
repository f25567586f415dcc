"""Where sheets lie: squares of whole blocks, anchored at the CRS origin, so that two surveys of a site share them."""

import math
from dataclasses import dataclass

import numpy as np

from bumpymap.core import BadInputError, UsageError
from bumpymap.layers.placement import MAX_PIXELS, MAX_SIDE, MAX_TILES
from bumpytiles import BLOCK_TILES, Grid, TileTable, TileWindow

__all__ = ["SheetLayout", "SheetPlace", "suggested_sheets"]

MAX_SHEETS = 10_000
"""Most sheets in the bounding window of a survey: a virtual raster lists every sheet in each of its bands."""
_FARTHEST = 20_000_000.0
"""m: no coordinate of a projected CRS is larger, so names of sheets have as many digits as this needs."""
_LEAST_DIGITS = 4

SheetPlace = tuple[int, int]
"""Column and row of a sheet; rows grow to the north, and the CRS origin is the south-west corner of sheet (0, 0)."""


def suggested_sheets(grid: Grid) -> float:
    """Return a usual side of sheets, km: 5, less where tiles or pixels are small, more where a block is larger."""
    most = _most_blocks(grid) * BLOCK_TILES * grid.tile_size / 1000.0
    digit = 10.0 ** math.floor(math.log10(most))
    return max(min(5.0, math.floor(most / digit) * digit), BLOCK_TILES * grid.tile_size / 1000.0)


def _most_blocks(grid: Grid) -> int:
    return min(MAX_SIDE, math.isqrt(MAX_TILES), math.isqrt(MAX_PIXELS) // grid.pixels) // BLOCK_TILES


@dataclass(frozen=True, slots=True)
class SheetLayout:
    """The squares that a map is cut into."""

    grid: Grid
    side: int
    """Tiles along a side, a multiple of a block's."""

    @classmethod
    def of(cls, grid: Grid, kilometres: float) -> "SheetLayout":
        """Return sheets of about this size: rounded to whole blocks, at least one.

        Raises
        ------
        UsageError
            Sheets are smaller than a block, or larger than the largest map.
        """
        block, most = BLOCK_TILES * grid.tile_size / 1000.0, _most_blocks(grid)
        blocks = round(kilometres / block)
        if not 1 <= blocks <= most:
            raise UsageError(
                f"`sheets` is {kilometres:g} km; with tiles of {grid.tile_size:g} m and {grid.pixels} pixels a sheet "
                f"has a side of at least {block:g} km (one block of {BLOCK_TILES} x {BLOCK_TILES} tiles) and at most "
                f"{most * block:g} km, the largest map. Give `sheets={suggested_sheets(grid):g}` or another number "
                "between them"
            )
        return cls(grid, blocks * BLOCK_TILES)

    @property
    def kilometres(self) -> float:
        """Side of a sheet, km."""
        return self.side * self.grid.tile_size / 1000.0

    def count(self, window: TileWindow) -> tuple[int, int]:
        """Return the columns and rows of sheets that a window of tiles overlaps."""
        spans = ((window.col, window.cols), (window.row, window.rows))
        cols, rows = ((start + length - 1) // self.side - start // self.side + 1 for start, length in spans)
        return cols, rows

    def check_whole(self, window: TileWindow) -> None:
        """Raise BadInputError if a survey with these tiles would have too many sheets."""
        cols, rows = self.count(window)
        if cols * rows <= MAX_SHEETS:
            return
        width, height = (side * self.grid.tile_size / 1000 for side in (window.cols, window.rows))
        needed = self.kilometres * math.sqrt(cols * rows / MAX_SHEETS) * 1.1
        raise BadInputError(
            f"the survey spans {width:,.1f} km x {height:,.1f} km: {cols:,} x {rows:,} sheets of "
            f"{self.kilometres:g} km, and there may be {MAX_SHEETS:,}. Give larger ones, such as "
            f"`sheets={math.ceil(needed)}`; if the survey is smaller, look for points far outside it"
        )

    def places(self, tiles: TileTable) -> list[SheetPlace]:
        """Return the sheets that hold tiles, west column first, then south row first."""
        keys = np.array(list(tiles.pack_of), np.int64) // (self.side // BLOCK_TILES)
        return [(col, row) for col, row in np.unique(keys[:, ::-1], axis=0).tolist()]

    def window(self, place: SheetPlace) -> TileWindow:
        """Return the tiles of a sheet."""
        return TileWindow(place[0] * self.side, place[1] * self.side, self.side, self.side)

    def name(self, place: SheetPlace) -> str:
        """Return the name of a sheet's folder, such as ``e0102_n0842``: its column and row; west and south below 0.

        Sheets of one size have names of one length.
        """
        digits = max(_LEAST_DIGITS, len(str(math.ceil(_FARTHEST / (self.side * self.grid.tile_size)))))
        (col, row), letters = place, ("we"[place[0] >= 0], "sn"[place[1] >= 0])
        return f"{letters[0]}{abs(col):0{digits}d}_{letters[1]}{abs(row):0{digits}d}"
