"""Formats of exports for robots, as settings and the command line name them."""

from typing import Literal

__all__ = ["ExportFormat", "ExportResolution"]

ExportFormat = Literal["nav2", "gridmap", "graph", "plan", "cost"]
"""Maps and masks for Nav2; a grid_map message; a graph for Nav2's route server; a mission for QGroundControl."""
ExportResolution = Literal["tile", "pixel"]
"""One cell a tile, or one a pixel of the heightmap, which shows obstacles."""
