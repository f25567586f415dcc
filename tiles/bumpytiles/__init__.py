"""The tiling engine: points in, tiles out. It does not know what roughness is."""

from bumpytiles.buckets import Room, TileBuckets, TooManyPointsError
from bumpytiles.grid import Bounds, Grid, TileWindow
from bumpytiles.mosaic import Mosaic
from bumpytiles.pack import BlockKey, Column, MemoryPack, Pack, PackError, PackWriter
from bumpytiles.run import run_blocks
from bumpytiles.split import BLOCK_TILES, Run, TilePoints, group_points

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
    "Room",
    "Run",
    "TileBuckets",
    "TilePoints",
    "TileWindow",
    "TooManyPointsError",
    "group_points",
    "run_blocks",
]
