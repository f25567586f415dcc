"""Measures of thinly surveyed tiles from their points, beyond their pixels; see ``docs/pages/measuring.md``."""

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import DENSE_COVERAGE, HOLE_POINTS, HOLE_SHARE, FeatureSettings, PatchStack, Reason
from bumpymap.patches.features import points_by_tile
from bumpymap.patches.kernels.measure import (
    MeasureSettings,
    PointsByTile,
    TileMeasures,
    measure_scratch,
    measure_tiles,
)
from bumpymap.patches.kernels.standing import PAIR_MEASURES, PairSettings, measure_pairs, pair_scratch
from bumpytiles import TilePoints

__all__ = ["measure_thin"]

_SEEN = 1
"""Column of the share of a tile's nine parts that hold a point."""
_MOST_POINTS = 128
_NOISE_POINTS = 32
"""Points of a dense tile whose pairs are measured: they only help to tell the noise."""
_REACH_PX = (1.0, 2.0, 3.5, 5.5, 8.0)
"""Upper ends of the groups of distances, px."""


def measure_thin(
    points: TilePoints, patches: PatchStack, settings: FeatureSettings, *, ground_only: bool
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Measure the pairs of points of all tiles, and the filled heightmaps of thin ones.

    Parameters
    ----------
    points : TilePoints
        n tiles.
    patches : PatchStack
        The same tiles, measured by `measure`.
    settings, ground_only
        As for `measure`.

    Returns
    -------
    array (n, 15)
        Of `bumpymap.patches.kernels.standing.measure_pairs`; NaN where the points span no plane.
    array (n, pixels, pixels)
        Plane-removed heights with all holes filled from their neighbours, however wide, m; NaN for tiles that are not
        thin.
    """
    grid = points.grid
    tiles = points_by_tile(points, ground_only=ground_only)
    thin = (patches.coverage > 0) & (patches.coverage < DENSE_COVERAGE)
    limit = np.where(thin, _MOST_POINTS, _NOISE_POINTS)
    pairs = np.empty((len(points.col), PAIR_MEASURES))
    measure_pairs(
        tiles,
        PairSettings(grid.tile_size, settings.stray_gap, limit, (np.array(_REACH_PX) * grid.pixel_size) ** 2),
        pairs,
        pair_scratch(_MOST_POINTS, settings.stray_points),
    )
    at_random = -np.expm1(-patches.count / patches.grid.pixels**2)
    clustered = patches.coverage < HOLE_SHARE * at_random
    real_holes = (patches.reason == Reason.TOO_MANY_HOLES) & (patches.count >= HOLE_POINTS) & clustered
    pairs[real_holes, _SEEN] = 0.0
    if settings.min_points > FeatureSettings().min_points:
        pairs[patches.count < settings.min_points] = np.nan
    relief_map = np.full((len(points.col), grid.pixels, grid.pixels), np.nan, np.float32)
    if thin.any():
        relief_map[thin] = _filled(_take(tiles, thin), settings, grid.tile_size, grid.pixels)
    return pairs, relief_map


def _take(tiles: PointsByTile, wanted: NDArray[np.bool_]) -> PointsByTile:
    """Select tiles and their points."""
    count = np.diff(tiles.starts)
    kept = np.repeat(wanted, count)
    starts = np.concatenate(([0], np.cumsum(count[wanted])))
    return PointsByTile(
        starts,
        tiles.easting[kept],
        tiles.northing[kept],
        tiles.upward[kept],
        tiles.col[wanted],
        tiles.row[wanted],
    )


def _filled(tiles: PointsByTile, settings: FeatureSettings, tile_size: float, pixels: int) -> NDArray[np.float32]:
    """Return relief maps with holes of any width filled, (n, pixels, pixels) m; NaN where the points span no plane."""
    shape = (len(tiles.col), pixels, pixels)
    relief = np.empty(shape, np.float32)
    out = TileMeasures(
        np.empty((len(tiles.col), 9)),
        np.empty(shape, np.float32),
        np.empty(shape, np.float32),
        relief,
        np.empty(shape, np.int32),
    )
    thresholds = MeasureSettings(tile_size, settings.ransac_threshold, settings.stray_gap, depth=pixels)
    most = int(np.diff(tiles.starts).max())
    measure_tiles(tiles, thresholds, out, measure_scratch(most, pixels, settings.stray_points))
    return relief
