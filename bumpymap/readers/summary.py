"""Summarize the points of a survey: number, extent, density, and how many tiles cannot be rated.

All points are read once. Points are counted in every tile. Which pixels hold a point is only recorded for a sample of
the tiles, chosen by a hash of their indices; the sample is halved whenever it grows too large.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DENSE_COVERAGE, THIN_PARTS, THIN_POINTS, THIN_SEEN, FeatureSettings, PointCloud, Reason
from bumpymap.readers.point_stats import LineSums
from bumpymap.readers.protocol import SurveyReader
from bumpytiles import Bounds, Grid

__all__ = ["PointSummary", "PointSummaryBuilder", "thin_rule"]

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


MERGE_AT = 4_000_000


@dataclass(frozen=True, slots=True)
class PointSummary:
    """Statistics of the points (without dropped ones) and of the tiles that hold them."""

    points: int
    bounds: Bounds
    """Extent of the points, m."""
    z_min: float
    z_max: float
    """Lowest and highest point, m."""
    tiles: int
    """Tiles that hold a point."""
    density: float
    """Points per square metre in the median tile."""
    points_per_tile: float
    """Median over all tiles that hold a point."""
    ground_points_per_tile: float
    """Ground points, median over the same tiles."""
    ground_share: float
    """Share of the points that are ground, 0..1."""
    ground_tiles: int
    """Tiles that hold a ground point."""
    unknown: dict[Reason, float]
    """Number of tiles that cannot be rated from all points, by reason; those with holes are estimated from a sample."""
    ground_unknown: dict[Reason, float]
    """The same if only ground points are measured."""


class PointSummaryBuilder:
    """Counts points by tile; memory grows with the number of tiles, not of points.

    Parameters
    ----------
    grid : Grid
    settings : FeatureSettings
        Decides when a heightmap cannot be rated.
    thin : bool
        Thin tiles are rated from their points, as with ``rating = "ride"`` and a calibration that has ``thin``.
    """

    def __init__(self, grid: Grid, settings: FeatureSettings, *, thin: bool = True) -> None:
        self._grid, self._settings, self._thin = grid, settings, thin
        self.all_points, self.ground = _Counts(), _Counts()
        self.all_pixels, self.ground_pixels = PixelSample(grid), PixelSample(grid)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.lines = LineSums()
        """Sums to compare flight lines, if the readers make them."""

    def read(self, reader: SurveyReader, advance: Callable[[int], None] = lambda _: None) -> Self:
        """Count all points of a file; ``advance`` is called after each chunk with its number of points.

        Raises
        ------
        BadInputError
            As ``reader.clouds``.
        """
        for cloud in reader.clouds():
            axes = (cloud.easting, cloud.northing, cloud.upward)
            self.low = np.minimum(self.low, [axis.min() for axis in axes])
            self.high = np.maximum(self.high, [axis.max() for axis in axes])
            keys, ground = _keys(cloud, self._grid), cloud.is_ground
            self.all_points.add(keys)
            self.ground.add(keys[ground])
            self.all_pixels.add_points(keys, cloud.easting, cloud.northing)
            if ground.any():
                self.ground_pixels.add_points(keys[ground], cloud.easting[ground], cloud.northing[ground])
            advance(cloud.easting.size)
        self.lines = self.lines.merge(reader.lines)
        return self

    def merge(self, other: "PointSummaryBuilder") -> None:
        """Add the points of another file, on the same grid."""
        for mine, theirs in ((self.all_points, other.all_points), (self.ground, other.ground)):
            mine.merge(theirs)
        for sample, its in ((self.all_pixels, other.all_pixels), (self.ground_pixels, other.ground_pixels)):
            sample.merge(its)
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        self.lines = self.lines.merge(other.lines)

    def summary(self) -> PointSummary | None:
        """Return the summary; None if there are no points."""
        keys, counts = self.all_points.total()
        if counts.size == 0:
            return None
        ground_keys, ground_counts = self.ground.total()
        median, points, low, high = float(np.median(counts)), int(counts.sum()), self.low, self.high
        without = counts.size - ground_counts.size
        return PointSummary(
            points=points,
            bounds=Bounds(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
            z_min=float(low[2]),
            z_max=float(high[2]),
            tiles=counts.size,
            density=median / self._grid.tile_size**2,
            points_per_tile=median,
            ground_points_per_tile=float(np.median(np.pad(ground_counts, (0, without)))),
            ground_share=int(ground_counts.sum()) / points,
            ground_tiles=ground_counts.size,
            unknown=self._unknown(keys, counts, self.all_pixels),
            ground_unknown={Reason.NO_GROUND: float(without)}
            | self._unknown(ground_keys, ground_counts, self.ground_pixels),
        )

    def _unknown(self, keys: NDArray[np.int64], counts: NDArray[np.int64], pixels: PixelSample) -> dict[Reason, float]:
        """Count tiles with too few points; estimate from the sample how many others have holes."""
        dense_enough = counts >= self._settings.min_points
        thin_enough = (counts >= THIN_POINTS) & self._thin
        dense = dense_rule(self._settings, self._grid.pixel_size)

        def estimate(tiles: NDArray[np.bool_], *rules: Rule) -> float:
            return pixels.share_unknown(keys[tiles], *rules) * float(tiles.sum()) if tiles.any() else 0.0

        few = float((~dense_enough & ~thin_enough).sum()) + estimate(~dense_enough & thin_enough, thin_rule)
        holes = estimate(dense_enough & ~thin_enough, dense) + estimate(dense_enough & thin_enough, dense, thin_rule)
        return {Reason.TOO_FEW_POINTS: few, Reason.TOO_MANY_HOLES: holes}


class _Counts:
    """Counts by key, merged from time to time so that memory grows with the number of keys only."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        self._waiting = 0

    def add(self, keys: NDArray[np.int64]) -> None:
        self._append(*np.unique(keys, return_counts=True))

    def merge(self, other: "_Counts") -> None:
        self._append(*other.total())

    def total(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the sorted keys and their counts."""
        if not self._parts:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        values = np.concatenate([part[0] for part in self._parts])
        counts = np.concatenate([part[1] for part in self._parts])
        keys, place = np.unique(values, return_inverse=True)
        return keys, np.bincount(place, weights=counts, minlength=keys.size).astype(np.int64)

    def _append(self, values: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        self._parts.append((values, counts))
        self._waiting += values.size
        if self._waiting > MERGE_AT:
            self._parts = [self.total()]
            self._waiting = 0


def _keys(cloud: PointCloud, grid: Grid) -> NDArray[np.int64]:
    """Return tile keys: column and row in 32 bits each, enough for all allowed coordinates and tiles from 1.5 m."""
    keys: NDArray[np.int64] = (grid.index(cloud.easting) << 32) + grid.index(cloud.northing)
    return keys
