"""What the points of a survey are like: how many, where, how dense, and which tiles they cannot fill.

Reads them all once. Counts are kept of every tile, the pixels that hold a point of a sample of the tiles: which ones is
told by a hash of their place, and halved whenever the sample grows too large.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FeatureSettings, PointCloud, Reason
from bumpymap.readers.protocol import SurveyReader
from bumpytiles import Bounds, Grid

__all__ = ["PointSummary", "PointSummaryBuilder"]

MERGE_AT = 4_000_000
MOST_PIXELS = 500_000
"""Pixels of the sample: more than 2,000 tiles of 15 x 15."""
BATCH_PIXELS = 4_000_000
_WRAP = (1 << 23) - 1
"""Tiles are told apart within so many of them, 25,000 km of 3 m."""
_MIX = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, slots=True)
class PointSummary:
    """Points that count, and the tiles they fall into."""

    points: int
    bounds: Bounds
    """Of the points that count, m."""
    z_min: float
    z_max: float
    """m."""
    tiles: int
    """Tiles that hold a point."""
    density: float
    """Points per square metre, in the median tile."""
    points_per_tile: float
    """Median."""
    ground_points_per_tile: float
    """Points of class 2 (ground), median over all tiles."""
    ground_share: float
    """Share of the points that are of class 2 (ground), 0..1."""
    ground_tiles: int
    """Tiles that hold such a point."""
    unknown: dict[Reason, float]
    """Tiles that cannot be judged where all points are measured, by reason; too many holes: estimated from a sample."""
    ground_unknown: dict[Reason, float]
    """The same where points of class 2 are measured alone."""


class PointSummaryBuilder:
    """Counts points by tile; memory follows the tiles, not the points.

    Parameters
    ----------
    grid : Grid
    settings : FeatureSettings
        When a tile cannot be judged.
    """

    def __init__(self, grid: Grid, settings: FeatureSettings) -> None:
        self._grid, self._settings = grid, settings
        self.every, self.ground = _Counts(), _Counts()
        self.every_pixels, self.ground_pixels = _PixelSample(grid), _PixelSample(grid)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)

    def read(self, reader: SurveyReader, advance: Callable[[int], None] = lambda _: None) -> Self:
        """Count all points of a file; ``advance`` is told after each piece how many it held.

        Raises
        ------
        BadInputError
            As ``reader.chunks`` does.
        """
        for cloud in reader.clouds():
            axes = (cloud.easting, cloud.northing, cloud.upward)
            self.low = np.minimum(self.low, [axis.min() for axis in axes])
            self.high = np.maximum(self.high, [axis.max() for axis in axes])
            keys, ground = _keys(cloud, self._grid), cloud.is_ground
            self.every.add(keys)
            self.ground.add(keys[ground])
            self.every_pixels.add_points(keys, cloud.easting, cloud.northing)
            if ground.any():
                self.ground_pixels.add_points(keys[ground], cloud.easting[ground], cloud.northing[ground])
            advance(cloud.easting.size)
        return self

    def merge(self, other: "PointSummaryBuilder") -> None:
        """Add the points of another file, on the same grid."""
        for mine, theirs in ((self.every, other.every), (self.ground, other.ground)):
            mine.merge(theirs)
        for sample, its in ((self.every_pixels, other.every_pixels), (self.ground_pixels, other.ground_pixels)):
            sample.merge(its)
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)

    def summary(self) -> PointSummary | None:
        """Sum up; None where no point counts."""
        keys, counts = self.every.total()
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
            unknown=self._unknown(keys, counts, self.every_pixels),
            ground_unknown={Reason.NO_GROUND: float(without)}
            | self._unknown(ground_keys, ground_counts, self.ground_pixels),
        )

    def _unknown(
        self, keys: NDArray[np.int64], counts: NDArray[np.int64], pixels: "_PixelSample"
    ) -> dict[Reason, float]:
        """Count tiles without enough points; of the others, estimate how many have holes."""
        enough = counts >= self._settings.min_points
        share = pixels.share_with_holes(keys[enough], self._settings)
        return {
            Reason.TOO_FEW_POINTS: float((~enough).sum()),
            Reason.TOO_MANY_HOLES: share * float(enough.sum()),
        }


class _Counts:
    """Counts by key, merged now and then so that memory follows the tiles and not the points."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        self._waiting = 0

    def add(self, keys: NDArray[np.int64]) -> None:
        self._append(*np.unique(keys, return_counts=True))

    def merge(self, other: "_Counts") -> None:
        self._append(*other.total())

    def total(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Give the keys in order, and how often each came."""
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


class _PixelSample:
    """The pixels that hold a point, of one tile in ``step``: a power of two that grows with the survey."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._parts: list[NDArray[np.int64]] = []
        """Places of pixels: column and row of the tile in 23 bits each, the pixel within it in 16."""
        self._waiting = 0
        self.step = 1

    def add_points(self, keys: NDArray[np.int64], easting: NDArray[np.float64], northing: NDArray[np.float64]) -> None:
        """Add points by the keys of their tiles and their coordinates [m]."""
        codes = _codes(keys)
        chosen = _sampled(codes, self.step)
        pixel = self._pixel(easting[chosen]) * self._grid.pixels + self._pixel(northing[chosen])
        self._add(_distinct((codes[chosen] << 16) | pixel))

    def merge(self, other: "_PixelSample") -> None:
        self.step = max(self.step, other.step)
        self._add(other.whole())

    def _add(self, places: NDArray[np.int64]) -> None:
        self._parts.append(places)
        self._waiting += places.size
        if self._waiting > 3 * MOST_PIXELS:
            self._parts, self._waiting = [self.whole()], 0

    def whole(self) -> NDArray[np.int64]:
        """Put the parts together, and make the sample smaller until few enough pixels are in it."""
        places = _distinct(np.concatenate([np.zeros(0, np.int64), *self._parts]))
        places = places[_sampled(places >> 16, self.step)]
        while places.size > MOST_PIXELS and places[0] >> 16 != places[-1] >> 16:
            self.step *= 2
            places = places[_sampled(places >> 16, self.step)]
        return places

    def _pixel(self, axis: NDArray[np.float64]) -> NDArray[np.int64]:
        """Column or row of the pixel within its tile."""
        offset = (axis / self._grid.tile_size - self._grid.index(axis)) * self._grid.pixels
        return np.clip(offset.astype(np.int64), 0, self._grid.pixels - 1)

    def share_with_holes(self, keys: NDArray[np.int64], settings: FeatureSettings) -> float:
        """Share of these tiles, as far as they are in the sample, with too little coverage or too wide a hole."""
        px, size = self._grid.pixels, self._grid.pixels**2
        places = self.whole()
        tiles = np.intersect1d(_distinct(places >> 16), _codes(keys), assume_unique=True)
        depth = max(1, round(settings.max_hole / self._grid.pixel_size))
        bad, batch = 0, max(1, BATCH_PIXELS // size)
        for first in range(0, tiles.size, batch):
            part = tiles[first : first + batch]
            mine = places[np.isin(places >> 16, part)]
            known = np.zeros((part.size, size), np.bool_)
            known[np.searchsorted(part, mine >> 16), mine & 0xFFFF] = True
            covered = known.mean(axis=1) >= settings.min_coverage
            bad += int((~covered | ~_filled(known.reshape(-1, px, px), depth)).sum())
        return bad / tiles.size if tiles.size else 0.0


def _filled(known: NDArray[np.bool_], depth: int) -> NDArray[np.bool_]:
    """Tell of which tiles (n, pixels, pixels) every pixel has a known one within ``depth`` pixels, corners too."""
    for axis in (1, 2):
        lines = np.moveaxis(known, axis, 1)
        near = lines.copy()
        for step in range(1, min(depth, lines.shape[1] - 1) + 1):
            near[:, step:] |= lines[:, :-step]
            near[:, :-step] |= lines[:, step:]
        known = np.moveaxis(near, 1, axis)
    return np.asarray(known.all(axis=(1, 2)))


def _keys(cloud: PointCloud, grid: Grid) -> NDArray[np.int64]:
    """One number a tile: column and row in 32 bits each; tiles of 1.5 m and more fit wherever readers allow a point."""
    keys: NDArray[np.int64] = (grid.index(cloud.easting) << 32) + grid.index(cloud.northing)
    return keys


def _codes(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Column and row of the tiles of these keys, in 23 bits each."""
    rows = ((keys + (1 << 31)) & 0xFFFFFFFF) - (1 << 31)
    codes: NDArray[np.int64] = (((keys - rows) >> 32 & _WRAP) << 23) | (rows & _WRAP)
    return codes


def _distinct(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """As ``np.unique``, whose hashing is ten times slower where most values differ."""
    ordered = np.sort(values)
    return ordered[np.diff(ordered, prepend=-1) > 0]


def _sampled(codes: NDArray[np.int64], step: int) -> NDArray[np.bool_]:
    """Tell which tiles are in a sample of one in ``step``: a hash of their place, not their place itself."""
    mixed = (codes.astype(np.uint64) * _MIX) >> np.uint64(40)
    chosen: NDArray[np.bool_] = (mixed & np.uint64(step - 1)) == 0
    return chosen
