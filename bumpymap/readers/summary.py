"""Summarize the points of a survey: number, extent, density, and how many tiles cannot be rated.

All points are read once. Points are counted in every tile. Which pixels hold a point is only recorded for a sample of
the tiles, chosen by a hash of their indices; the sample is halved whenever it grows too large. Four tiles that make one
of twice the size are in it together: the same counts and pixels tell what larger tiles would give.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    DENSE_COVERAGE,
    GROUND_CLASSES,
    HOLE_POINTS,
    HOLE_SHARE,
    INCLUDED_PIXELS,
    POINT_DECK,
    POINT_GROUND,
    SEEN_PER_M2,
    SPANNED_POINTS,
    THIN_PARTS,
    THIN_POINTS,
    THIN_SEEN,
    FeatureSettings,
    Floats,
    Reason,
)
from bumpymap.readers.point_stats import AXIS_BITS, LineSums, cell_indices, kinds_of, sampled, summed
from bumpymap.readers.protocol import SurveyReader
from bumpymap.readers.unclassified import UnclassifiedPart, tile_marks
from bumpytiles import BLOCK_TILES, Bounds, Grid

Ints = NDArray[np.int64]
Rule = Callable[[NDArray[np.bool_], Ints], NDArray[np.bool_]]
"""Pixels that hold a point, (n, pixels, pixels), and numbers of points, (n,), in; whether a tile can be rated, out."""
MOST_PIXELS = 1_000_000
"""Pixels of the sample at most: more than 4,000 tiles of 15 x 15."""
GROUP_PIXELS = 4_000_000
"""Pixels of tiles that are judged at once."""
MERGE_AT = 4_000_000
"""Keys that wait to be merged, at most."""
_INDEX_MASK = (1 << AXIS_BITS) - 1
"""Tile indices are reduced to 23 bits, as those of cells of flight lines: unique within 25,000 km for 3 m tiles."""


class KeyCounts:
    """Numbers of points by key, or sums, merged from time to time, so that memory grows with the number of keys only.

    ``most``: keys at most: only those of one in ``step`` fours of tiles are kept; ``step``, a power
    of two, grows as needed; ``shift``: bits of a key below the code of its tile; ``join``: what
    becomes of two values of a key: their sum, or the lower one.
    """

    def __init__(self, most: int | None = None, shift: int = 0, join: np.ufunc = np.add) -> None:
        self._most, self._shift, self._join, self.step = most, shift, join, 1
        self._parts: list[tuple[Ints, NDArray[Any]]] = []
        self._waiting = 0

    def add(self, keys: Ints) -> None:
        """Count points by their keys."""
        self._append(*np.unique(keys, return_counts=True))

    def add_sums(self, keys: Ints, values: Floats) -> None:
        """Add values of points, (n, ...), by their keys."""
        self._append(*summed(keys, values, self._join))

    def merge(self, other: "KeyCounts") -> None:
        """Add the counts of another file."""
        self.step = max(self.step, other.step)
        self._append(*other.total())

    def sampled(self, codes: Ints) -> NDArray[np.bool_]:
        """Return which tiles are in the sample: all four of a tile of twice the size, or none."""
        return np.ones(codes.size, np.bool_) if self.step == 1 else sampled(_parents(codes), self.step)

    def add_renamed(self, other: "KeyCounts", rename: Callable[[Ints], Ints]) -> None:
        """Add the counts of others under new keys."""
        keys, counts = other.total()
        self._append(rename(keys), counts)

    def total(self) -> tuple[Ints, NDArray[Any]]:
        """Return the sorted keys, reduced to the size of the sample, and their counts or sums."""
        nothing = np.zeros(0, np.int64)
        parts = [*map(np.concatenate, zip(*self._parts, strict=True))]
        keys, counts = summed(parts[0], parts[1], self._join) if parts else (nothing, nothing)
        while True:
            kept = self.sampled(keys >> self._shift)
            keys, counts = keys[kept], counts[kept]
            if self._most is None or keys.size <= self._most:
                self._parts, self._waiting = [(keys, counts)], 0
                return keys, counts
            self.step *= 2

    def _append(self, keys: Ints, counts: NDArray[Any]) -> None:
        self._parts.append((keys, counts))
        self._waiting += keys.size
        if self._waiting > (MERGE_AT if self._most is None else 3 * self._most):
            self.total()


class TileCounts:
    """Points of every tile, and in a sample of the tiles the pixels that hold one."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self.tiles, self.pixels = KeyCounts(), KeyCounts(MOST_PIXELS, shift=16)

    def add(self, codes: Ints, easting: Floats, northing: Floats) -> None:
        """Add points by the codes of their tiles and their coordinates [m]."""
        self.tiles.add(codes)
        chosen = self.pixels.sampled(codes)
        col, row = (self._grid.pixel(axis[chosen], self._grid.index(axis[chosen])) for axis in (easting, northing))
        self.pixels.add((codes[chosen] << 16) | (col * self._grid.pixels + row))

    def merge(self, other: "TileCounts") -> None:
        """Add the points of another file, on the same grid."""
        self.tiles.merge(other.tiles)
        self.pixels.merge(other.pixels)

    def add_as_doubled(self, other: "TileCounts") -> None:
        """Add the points of tiles of half the size."""
        px = self._grid.pixels // 2

        def of_pixel(keys: Ints) -> Ints:
            col, row = (place & 1 for place in cell_indices(keys >> 16))
            pixel = (col * px + (keys & 0xFFFF) // px) * 2 * px + row * px + (keys & 0xFFFF) % px
            return np.asarray(_parents(keys >> 16) << 16 | pixel)

        self.tiles.add_renamed(other.tiles, _parents)
        self.pixels.add_renamed(other.pixels, of_pixel)

    def share_unknown(self, codes: Ints, *rules: Rule) -> float:
        """Return the share of these tiles, of those in the sample, that fulfil none of the rules."""
        px, size = self._grid.pixels, self._grid.pixels**2
        places, points = self.pixels.total()
        tiles = np.intersect1d(np.unique(places >> 16), codes, assume_unique=True)
        bad, group = 0, max(1, GROUP_PIXELS // size)
        for first in range(0, tiles.size, group):
            part = tiles[first : first + group]
            chosen = np.isin(places >> 16, part)
            mine, tile = places[chosen], np.searchsorted(part, places[chosen] >> 16)
            known = np.zeros((part.size, size), np.bool_)
            known[tile, mine & 0xFFFF] = True
            maps, held = known.reshape(-1, px, px), np.bincount(tile, points[chosen], part.size)
            bad += part.size - int(np.logical_or.reduce([rule(maps, held) for rule in rules]).sum())
        return bad / tiles.size if tiles.size else 0.0


ClassSummary = tuple[int, float, float]
"""The points of one class: their number; share of the tiles that hold such, 0..1; median over these tiles of their mean
height above the ground in and around the tile, m, NaN if there is none."""


def _summarise_classes(
    keys: Ints, sums: Floats, tiles: int, ground_classes: tuple[int, ...]
) -> dict[int, ClassSummary]:
    """Summarise each class.

    ``keys`` array (n,): codes of tiles in the bits above 8, LAS classes in those below; ``sums``
    array (n, 2): number of these points, and sum of their heights, m; ``tiles``: tiles that hold a
    point.
    """
    code, tile = keys & 0xFF, keys >> 8
    on_ground = np.isin(code, ground_classes)
    ground_tile, ground = summed(tile[on_ground], sums[on_ground])
    found = {}
    for one in np.unique(code).tolist():
        mine = code == one
        known = np.zeros(0)
        if one not in ground_classes and ground_tile.size:
            beside = np.zeros((int(mine.sum()), 2))
            col, row = tile[mine] >> 23, tile[mine] & _INDEX_MASK
            for east, north in product((-1, 0, 1), repeat=2):
                near = (((col + east) & _INDEX_MASK) << 23) | ((row + north) & _INDEX_MASK)
                at = np.minimum(np.searchsorted(ground_tile, near), ground_tile.size - 1)
                beside += np.where((ground_tile[at] == near)[:, None], ground[at], 0.0)
            has = beside[:, 0] > 0.0
            known = sums[mine][has, 1] / sums[mine][has, 0] - beside[has, 1] / beside[has, 0]
        height = float(np.median(known)) if known.size else math.nan
        found[one] = int(sums[mine, 0].sum()), float(mine.sum() / tiles), height
    return found


def thin_rule(known: NDArray[np.bool_], points: NDArray[Any]) -> NDArray[np.bool_]:
    """Return which tiles (n, pixels, pixels) of ``points`` (n,) points are thin by rule: these span them.

    Of many points, holes are no chance: such a tile is not thin.

    The same as the measure ``seen`` of `bumpymap.patches.measure_thin`, from pixels instead of points, which differ
    where a part of the tile is no whole number of pixels.
    """
    pixels = known.shape[1]
    first = [-(-pixels * part // THIN_PARTS) for part in range(THIN_PARTS)]
    seen = np.logical_or.reduceat(np.logical_or.reduceat(known, first, axis=1), first, axis=2)
    squares = seen[:, 1:, 1:] | seen[:, 1:, :-1] | seen[:, :-1, 1:] | seen[:, :-1, :-1]
    spanned = (seen.mean(axis=(1, 2)) >= THIN_SEEN) & squares.all(axis=(1, 2))
    coverage = known.mean(axis=(1, 2))
    holes = (points >= HOLE_POINTS) & (coverage < -HOLE_SHARE * np.expm1(-points / pixels**2))
    return np.asarray(spanned & ~holes & (coverage < DENSE_COVERAGE))


def _filled(known: NDArray[np.bool_], depth: int) -> NDArray[np.bool_]:
    """Return in which tiles (n, pixels, pixels) each pixel has a known one within ``depth`` pixels (Chebyshev)."""
    from scipy.ndimage import maximum_filter

    side = 2 * depth + 1
    return np.asarray(maximum_filter(known, (1, side, side), mode="constant").all(axis=(1, 2)))


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
    unseen: float
    """Share of the tiles that hold so few points that no way is seen through them, 0..1."""
    classes: dict[int, ClassSummary]
    """By LAS class."""
    never_classified: int
    """Tiles of a part that nobody has classified, beside classified ones."""
    doubled: "PointSummary | None"
    """The same points in tiles of twice the size; None if no calibration for them is included."""


class PointSummaryBuilder:
    """Counts points by tile; memory grows with the number of tiles, not of points.

    ``settings``: decides when a heightmap cannot be rated; ``ground_classes``: LAS classes that are
    ground: readers give classes, with `ReadOptions.keep_classes`; ``thin``: thin tiles are rated
    from their points, as with ``rating = "ride"``.
    """

    def __init__(
        self,
        grid: Grid,
        settings: FeatureSettings,
        ground_classes: tuple[int, ...] = GROUND_CLASSES,
        *,
        thin: bool = True,
    ) -> None:
        self._grid, self._settings, self._thin = grid, settings, thin
        self._ground_classes = ground_classes
        self._is_ground = np.isin(kinds_of(ground_classes), (POINT_GROUND, POINT_DECK))
        self.classes, self.lowest = KeyCounts(), KeyCounts(join=np.minimum)
        self.all_points, self.ground = TileCounts(grid), TileCounts(grid)
        self.low, self.high = np.full(3, np.inf), np.full(3, -np.inf)
        self.lines = LineSums()
        """Sums to compare flight lines, if the readers make them."""

    def read(self, reader: SurveyReader, advance: Callable[[int], None] = lambda _: None) -> Self:
        """Count all points of a file; ``advance`` is called after each chunk with its number of points.

        Raises BadInputError: as ``reader.clouds``.
        """
        for cloud in reader.clouds():
            axes = (cloud.easting, cloud.northing, cloud.upward)
            self.low = np.minimum(self.low, [axis.min() for axis in axes])
            self.high = np.maximum(self.high, [axis.max() for axis in axes])
            col, row = (self._grid.index(axis) & _INDEX_MASK for axis in axes[:2])
            codes, ground = (col << 23) | row, self._is_ground[cloud.kind]
            self.all_points.add(codes, cloud.easting, cloud.northing)
            self.classes.add_sums((codes << 8) | cloud.kind, np.column_stack([np.ones(len(codes)), cloud.upward]))
            self.lowest.add_sums((codes << 1) | ground, cloud.upward)
            if ground.any():
                self.ground.add(codes[ground], cloud.easting[ground], cloud.northing[ground])
            advance(cloud.easting.size)
        self.lines = self.lines.merge(reader.lines)
        return self

    def merge(self, other: "PointSummaryBuilder") -> None:
        """Add the points of another file, on the same grid."""
        self.all_points.merge(other.all_points)
        self.ground.merge(other.ground)
        self.classes.merge(other.classes)
        self.lowest.merge(other.lowest)
        self.low, self.high = np.minimum(self.low, other.low), np.maximum(self.high, other.high)
        self.lines = self.lines.merge(other.lines)

    def summary(self) -> PointSummary | None:
        """Return the summary; None if there are no points."""
        _, counts = self.all_points.tiles.total()
        if counts.size == 0:
            return None
        _, ground_counts = self.ground.tiles.total()
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
            unknown=self._unknown(self.all_points),
            ground_unknown={Reason.NO_GROUND: float(without)} | self._unknown(self.ground),
            unseen=float(np.mean(counts < SEEN_PER_M2 * self._grid.tile_size**2)),
            classes=_summarise_classes(*self.classes.total(), counts.size, self._ground_classes),
            never_classified=self._never_classified() if ground_counts.size else 0,
            doubled=self._doubled(),
        )

    def _doubled(self) -> PointSummary | None:
        """Summarize the same points in tiles of twice the size, of the same pixels."""
        size, pixels = 2.0 * self._grid.tile_size, 2 * self._grid.pixels
        if INCLUDED_PIXELS.get(size) != pixels:
            return None
        twice = PointSummaryBuilder(Grid(size, pixels), self._settings, self._ground_classes, thin=self._thin)
        twice.all_points.add_as_doubled(self.all_points)
        twice.ground.add_as_doubled(self.ground)
        twice.classes.add_renamed(self.classes, lambda keys: _parents(keys >> 8) << 8 | keys & 0xFF)
        twice.lowest.add_renamed(self.lowest, lambda keys: _parents(keys >> 1) << 1 | keys & 1)
        twice.low, twice.high = self.low, self.high
        return twice.summary()

    def _never_classified(self) -> int:
        """Count the tiles of a part that nobody has classified."""
        keys, _ = self.classes.total()
        tiles, place = np.unique(keys >> 8, return_inverse=True)
        flags = np.zeros((tiles.size, 8), np.bool_)
        flags[place, kinds_of(self._ground_classes)[keys & 0xFF]] = True
        col, row = cell_indices(tiles)
        of_block, block = np.unique(np.stack([row, col], axis=1) // BLOCK_TILES, axis=0, return_inverse=True)
        marks = np.zeros((len(of_block), BLOCK_TILES, BLOCK_TILES), np.uint8)
        marks[block.reshape(-1), row % BLOCK_TILES, col % BLOCK_TILES] = tile_marks(flags)
        blocks = dict(zip(map(tuple, of_block.tolist()), marks.reshape(-1, BLOCK_TILES**2), strict=True))
        part = UnclassifiedPart.find(blocks, self._grid.tile_size)
        if part is None:
            return 0
        keys, lowest = self.lowest.total()
        of_ground = (keys & 1) > 0
        kinds = enumerate((~of_ground, of_ground))
        each = [(*cell_indices(keys[of] >> 1)[::-1], lowest[of], bool(number)) for number, of in kinds]
        return int(part.never_classified(each).sum())

    def _unknown(self, held: TileCounts) -> dict[Reason, float]:
        """Count tiles with too few points; estimate from the sample how many others have holes."""
        codes, counts = held.tiles.total()
        dense_enough = counts >= self._settings.min_points
        thin_enough = (counts >= THIN_POINTS) & self._thin
        settings, depth = self._settings, max(1, round(self._settings.max_hole / self._grid.pixel_size))

        def dense(known: NDArray[np.bool_], _: Ints) -> NDArray[np.bool_]:
            """Judge heightmaps: enough pixels hold a point, and none is far from all of these."""
            return np.asarray((known.mean(axis=(1, 2)) >= settings.min_coverage) & _filled(known, depth))

        def estimate(tiles: NDArray[np.bool_], *rules: Rule) -> float:
            return held.share_unknown(codes[tiles], *rules) * float(tiles.sum()) if tiles.any() else 0.0

        asked = ~dense_enough & thin_enough & (counts >= SPANNED_POINTS)
        few = float((~dense_enough & ~thin_enough).sum()) + estimate(asked, thin_rule)
        holes = estimate(dense_enough & ~thin_enough, dense) + estimate(dense_enough & thin_enough, dense, thin_rule)
        return {Reason.TOO_FEW_POINTS: few, Reason.TOO_MANY_HOLES: holes}


def _parents(codes: Ints) -> Ints:
    """Return the codes of the tiles of twice the size that these are in."""
    col, row = (place >> 1 & _INDEX_MASK for place in cell_indices(codes))
    return col << 23 | row
