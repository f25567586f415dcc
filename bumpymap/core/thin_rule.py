"""Which tiles can be rated from their points although their heightmap is full of holes: the rule of thin tiles.

A run, its forecast and its advice share it; ``docs/pages/thin-surveys.md`` explains it.
"""

__all__ = ["DENSE_COVERAGE", "HOLE_POINTS", "HOLE_SHARE", "THIN_PARTS", "THIN_POINTS", "THIN_SEEN"]

THIN_POINTS = 15
"""A thin tile with fewer points is unknown."""
THIN_PARTS = 3
"""Parts along a side of a tile, of which each block of 2 x 2 must hold a point."""
THIN_SEEN = 5 / THIN_PARTS**2
"""Least share of these parts that hold a point."""
DENSE_COVERAGE = 0.75
"""Tiles with at least this share of pixels with points are rated from their heightmap alone (35 points per m2, if they
are spread at random)."""
HOLE_POINTS = 64
"""From this number of points on a tile has holes for a reason, if it has too many."""
HOLE_SHARE = 0.7
"""Its holes are chance where it has at least this share of the coverage that its points would have at random."""
