"""What the points of a survey are like: how many, where, how dense. Reads them all once, keeps only counts by tile."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.readers.protocol import SurveyReader
from bumpymap.types import PointCloud
from bumpytiles import Bounds, Grid

__all__ = ["PointSummary", "enough_points", "summarise"]

_MERGE_AT = 4_000_000


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
    enough_share: float
    """Share of the tiles that hold enough points to be judged, 0..1."""
    ground_points_per_tile: float
    """Points of class 2 (ground), median over the tiles that hold any; 0 where none does."""
    ground_enough_share: float
    """Share of the tiles that hold enough points of class 2, 0..1."""
    ground_share: float
    """Share of the points that are of class 2 (ground), 0..1."""
    ground_tile_share: float
    """Share of the tiles that hold such a point, 0..1."""


def enough_points(grid: Grid, min_points: int, min_coverage: float) -> int:
    """Points from which on a tile can probably be judged.

    Points scattered at random over ``m`` pixels leave a pixel empty with probability ``exp(-n / m)``, so ``n`` points
    cover the share ``1 - exp(-n / m)``.
    """
    pixels = grid.pixels**2
    for_coverage = -np.log1p(-min(min_coverage, 0.999)) * pixels
    return max(min_points, int(np.ceil(for_coverage)))


def summarise(
    reader: SurveyReader, grid: Grid, enough: int, advance: Callable[[int], None] = lambda _: None
) -> PointSummary | None:
    """Read all points and sum them up.

    Parameters
    ----------
    reader : SurveyReader
    grid : Grid
    enough : int
        Points from which on a tile counts as dense enough.
    advance : callable
        Told after each chunk how many points it held.

    Returns
    -------
    PointSummary or None
        None where no point counts.

    Raises
    ------
    BadInputError
        As ``reader.chunks`` does.
    """
    tally, ground_tally = _Tally(), _Tally()
    low, high, ground = np.full(3, np.inf), np.full(3, -np.inf), 0
    for cloud in reader.chunks():
        axes = (cloud.easting, cloud.northing, cloud.upward)
        low = np.minimum(low, [axis.min() for axis in axes])
        high = np.maximum(high, [axis.max() for axis in axes])
        keys = _keys(cloud, grid)
        tally.add(keys)
        ground_tally.add(keys[cloud.is_ground])
        ground += int(cloud.is_ground.sum())
        advance(cloud.easting.size)
    counts = tally.counts()
    if counts.size == 0:
        return None
    ground_counts = ground_tally.counts()
    median, points = float(np.median(counts)), int(counts.sum())
    return PointSummary(
        points=points,
        bounds=Bounds(float(low[0]), float(low[1]), float(high[0]), float(high[1])),
        z_min=float(low[2]),
        z_max=float(high[2]),
        tiles=counts.size,
        density=median / grid.tile_size**2,
        points_per_tile=median,
        enough_share=float((counts >= enough).mean()),
        ground_points_per_tile=float(np.median(ground_counts)) if ground_counts.size else 0.0,
        ground_enough_share=float((ground_counts >= enough).sum() / counts.size),
        ground_share=ground / points,
        ground_tile_share=ground_counts.size / counts.size,
    )


class _Tally:
    """Counts by key, merged now and then so that memory follows the tiles and not the points."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        self._waiting = 0

    def add(self, keys: NDArray[np.int64]) -> None:
        values, counts = np.unique(keys, return_counts=True)
        self._parts.append((values, counts))
        self._waiting += values.size
        if self._waiting > _MERGE_AT:
            self._parts = [self._merged()]
            self._waiting = 0

    def counts(self) -> NDArray[np.int64]:
        return self._merged()[1]

    def _merged(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        if not self._parts:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        values = np.concatenate([part[0] for part in self._parts])
        counts = np.concatenate([part[1] for part in self._parts])
        keys, place = np.unique(values, return_inverse=True)
        return keys, np.bincount(place, weights=counts, minlength=keys.size).astype(np.int64)


def _keys(cloud: PointCloud, grid: Grid) -> NDArray[np.int64]:
    """One number a tile: column and row in 32 bits each; tiles of 1.5 m and more fit wherever readers allow a point."""
    keys: NDArray[np.int64] = (grid.index(cloud.easting) << 32) + grid.index(cloud.northing)
    return keys
