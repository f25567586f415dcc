"""The pixels that hold a point, in a sample of the tiles of a survey, and the rules that need them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DENSE_COVERAGE, THIN_PARTS, THIN_SEEN, FeatureSettings
from bumpytiles import Grid

__all__ = ["PixelSample", "Rule", "dense_rule", "thin_rule"]

Rule = Callable[[NDArray[np.bool_]], NDArray[np.bool_]]
"""Pixels that hold a point, (n, pixels, pixels), in; whether a tile can be rated, (n,), out."""
MOST_PIXELS = 500_000
"""Pixels of the sample at most: more than 2,000 tiles of 15 x 15."""
GROUP_PIXELS = 4_000_000
_INDEX_MASK = (1 << 23) - 1
"""Tile indices are reduced to 23 bits: unique within 25,000 km for 3 m tiles."""
_MIX = np.uint64(0x9E3779B97F4A7C15)


class PixelSample:
    """The pixels that hold a point, in one of ``step`` tiles; ``step`` is a power of two that grows with the survey."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._parts: list[NDArray[np.int64]] = []
        """Codes of pixels: column and row of the tile in 23 bits each, then the pixel index in 16 bits."""
        self._waiting = 0
        self.step = 1

    def add_points(self, keys: NDArray[np.int64], easting: NDArray[np.float64], northing: NDArray[np.float64]) -> None:
        """Add points by the keys of their tiles and their coordinates [m]."""
        codes = _codes(keys)
        chosen = _sampled(codes, self.step)
        pixel = self._pixel(easting[chosen]) * self._grid.pixels + self._pixel(northing[chosen])
        self._add(_distinct((codes[chosen] << 16) | pixel))

    def merge(self, other: "PixelSample") -> None:
        """Add the pixels of another sample, on the same grid."""
        self.step = max(self.step, other.step)
        self._add(other.merged())

    def _add(self, places: NDArray[np.int64]) -> None:
        self._parts.append(places)
        self._waiting += places.size
        if self._waiting > 3 * MOST_PIXELS:
            self._parts, self._waiting = [self.merged()], 0

    def merged(self) -> NDArray[np.int64]:
        """Merge the parts, and reduce the sample until it has few enough pixels."""
        places = _distinct(np.concatenate([np.zeros(0, np.int64), *self._parts]))
        places = places[_sampled(places >> 16, self.step)]
        while places.size > MOST_PIXELS and places[0] >> 16 != places[-1] >> 16:
            self.step *= 2
            places = places[_sampled(places >> 16, self.step)]
        return places

    def _pixel(self, axis: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the column or row of the pixel within its tile."""
        offset = (axis / self._grid.tile_size - self._grid.index(axis)) * self._grid.pixels
        return np.clip(offset.astype(np.int64), 0, self._grid.pixels - 1)

    def share_unknown(self, keys: NDArray[np.int64], *rules: Rule) -> float:
        """Return the share of these tiles, of those in the sample, that fulfil none of the rules."""
        px, size = self._grid.pixels, self._grid.pixels**2
        places = self.merged()
        tiles = np.intersect1d(_distinct(places >> 16), _codes(keys), assume_unique=True)
        bad, group = 0, max(1, GROUP_PIXELS // size)
        for first in range(0, tiles.size, group):
            part = tiles[first : first + group]
            mine = places[np.isin(places >> 16, part)]
            known = np.zeros((part.size, size), np.bool_)
            known[np.searchsorted(part, mine >> 16), mine & 0xFFFF] = True
            maps = known.reshape(-1, px, px)
            bad += part.size - int(np.logical_or.reduce([rule(maps) for rule in rules]).sum())
        return bad / tiles.size if tiles.size else 0.0


def dense_rule(settings: FeatureSettings, pixel_size: float) -> Rule:
    """Return the rule of heightmaps: enough pixels hold a point, and none is far from all of these.

    Parameters
    ----------
    settings : FeatureSettings
    pixel_size : float
        m.
    """
    depth = max(1, round(settings.max_hole / pixel_size))
    return lambda known: (known.mean(axis=(1, 2)) >= settings.min_coverage) & _filled(known, depth)


def thin_rule(known: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return which tiles (n, pixels, pixels) fulfil the rule of thin ones: their points span them.

    The same as the measure ``seen`` of `bumpymap.patches.measure_thin`, from pixels instead of points, which differ
    where a part of the tile is no whole number of pixels.
    """
    pixels = known.shape[1]
    first = [-(-pixels * part // THIN_PARTS) for part in range(THIN_PARTS)]
    seen = np.logical_or.reduceat(np.logical_or.reduceat(known, first, axis=1), first, axis=2)
    squares = seen[:, 1:, 1:] | seen[:, 1:, :-1] | seen[:, :-1, 1:] | seen[:, :-1, :-1]
    spanned = (seen.mean(axis=(1, 2)) >= THIN_SEEN) & squares.all(axis=(1, 2))
    return np.asarray(spanned & (known.mean(axis=(1, 2)) < DENSE_COVERAGE))


def _filled(known: NDArray[np.bool_], depth: int) -> NDArray[np.bool_]:
    """Return in which tiles (n, pixels, pixels) each pixel has a known one within ``depth`` pixels (Chebyshev)."""
    for axis in (1, 2):
        lines = np.moveaxis(known, axis, 1)
        near = lines.copy()
        for step in range(1, min(depth, lines.shape[1] - 1) + 1):
            near[:, step:] |= lines[:, :-step]
            near[:, :-step] |= lines[:, step:]
        known = np.moveaxis(near, 1, axis)
    return np.asarray(known.all(axis=(1, 2)))


def _codes(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return 46-bit codes of tile keys: column and row in 23 bits each."""
    rows = ((keys + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
    codes: NDArray[np.int64] = (((keys - rows) >> 32 & _INDEX_MASK) << 23) | (rows & _INDEX_MASK)
    return codes


def _distinct(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the sorted unique values; ``np.unique`` hashes, which is ten times slower if most values differ."""
    ordered = np.sort(values)
    return ordered[np.diff(ordered, prepend=-1) > 0]


def _sampled(codes: NDArray[np.int64], step: int) -> NDArray[np.bool_]:
    """Return which tiles are in a sample of one in ``step``, by a hash of their codes."""
    mixed = (codes.astype(np.uint64) * _MIX) >> np.uint64(40)
    chosen: NDArray[np.bool_] = (mixed & np.uint64(step - 1)) == 0
    return chosen
