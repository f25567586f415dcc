"""The tiling engine: points in, tiles out. It does not know what roughness is."""

from bumpytiles.grid import Bounds, Grid, TileWindow
from bumpytiles.mosaic import Mosaic
from bumpytiles.pack import BlockKey, Column, MemoryPack, Pack, PackError, PackWriter
from bumpytiles.run import run_blocks
from bumpytiles.split import BLOCK_TILES, TileBuckets, TilePoints

__all__ = [
    "BLOCK_TILES",
    "BlockKey",
    "Bounds",
    "Column",
    "Grid",
    "MemoryPack",
    "Mosaic",
    "Pack",
    "PackError",
    "PackWriter",
    "TileBuckets",
    "TilePoints",
    "TileWindow",
    "run_blocks",
]
