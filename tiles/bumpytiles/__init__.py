"""The tiling engine: points in, tiles out. It does not know what roughness is."""

from bumpytiles.grid import Bounds, Grid, TileWindow

__all__ = ["Bounds", "Grid", "TileWindow"]
