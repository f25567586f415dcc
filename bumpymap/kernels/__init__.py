"""Compiled kernels, a module for each step: one calls nothing of another."""

from bumpymap.kernels.measure import LANES, SAMPLE, SUMS, fill_holes, measure_tiles
from bumpymap.kernels.rate import rate_tiles

__all__ = ["LANES", "SAMPLE", "SUMS", "fill_holes", "measure_tiles", "rate_tiles"]
