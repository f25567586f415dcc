"""Points of tiles in, measured patches out: heightmap, spread, z-variance, RANSAC residual, slope, reason."""

from collections.abc import Sequence
from dataclasses import fields

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import POINT_GROUND, FeatureSettings, PatchStack, Reason
from bumpymap.patches.kernels.measure import (
    MeasureSettings,
    PointsByTile,
    TileMeasures,
    measure_scratch,
    measure_tiles,
)
from bumpytiles import TilePoints

__all__ = ["join_stacks", "measure", "points_by_tile"]

_SCALARS = 9


def measure(points: TilePoints, settings: FeatureSettings, *, ground_only: bool) -> PatchStack:
    """Measure the tiles of a block.

    Parameters
    ----------
    points : TilePoints
        Points by tile, in canonical order; ``flag`` holds their kind.
    settings : FeatureSettings
        Thresholds.
    ground_only : bool
        Measure the points of the ground alone; tiles without any get reason ``NO_GROUND``.

    Returns
    -------
    PatchStack
        One row a tile, in the order of ``points``.
    """
    grid = points.grid
    measured = points_by_tile(points, ground_only=ground_only)
    count = np.diff(measured.starts)
    tiles, px, most = len(points.col), grid.pixels, int(count.max(initial=0))
    maps = [np.empty((tiles, px, px), np.float32) for _ in range(3)]
    out = TileMeasures(np.empty((tiles, _SCALARS)), maps[0], maps[1], maps[2], np.empty((tiles, px, px), np.int32))
    thresholds = MeasureSettings(
        tile_size=grid.tile_size,
        threshold=settings.ransac_threshold,
        gap=settings.stray_gap,
        depth=max(1, round(settings.max_hole / grid.pixel_size)),
    )
    measure_tiles(
        measured,
        thresholds,
        out,
        measure_scratch(most, px, settings.stray_points),
    )
    scalars, relief_map = out.scalars, out.relief
    reason = _reasons(count, scalars, settings)
    relief_map[reason != Reason.OK] = np.nan
    z_min, z_max, z_variance, residual, slope, z_range, coverage, relief, _ = scalars.T.copy()
    return PatchStack(
        grid=grid,
        col=points.col,
        row=points.row,
        count=count,
        z_min=z_min,
        z_max=z_max,
        z_variance=z_variance,
        ransac_residual=residual,
        slope=slope,
        z_range=z_range,
        density=count / grid.tile_size**2,
        coverage=np.nan_to_num(coverage),
        heights=out.heights,
        spread_count=out.pixel_count,
        spread_variance=out.variance,
        relief_map=relief_map,
        relief=np.where(reason == Reason.OK, relief, np.nan),
        reason=reason,
    )


def points_by_tile(points: TilePoints, *, ground_only: bool) -> PointsByTile:
    """Return the points that are measured: all, or those of the ground alone."""
    starts, place = points.starts, (points.easting, points.northing, points.upward)
    if ground_only and not (ground := points.flag == POINT_GROUND).all():
        starts = np.concatenate(([0], np.cumsum(ground)))[starts]
        place = (place[0][ground], place[1][ground], place[2][ground])
    return PointsByTile(starts, *place, points.col, points.row)


def _reasons(count: NDArray[np.int64], scalars: NDArray[np.float64], settings: FeatureSettings) -> NDArray[np.uint8]:
    """Why tiles cannot be judged: the first of no ground, too few points, outlier relief, too many holes; else 0."""
    coverage, relief, strays = scalars[:, 6], scalars[:, 7], scalars[:, 8]
    return np.select(
        [
            count == 0,
            count < settings.min_points,
            strays > settings.stray_share * count,
            np.isnan(relief) | (coverage < settings.min_coverage),
        ],
        [Reason.NO_GROUND, Reason.TOO_FEW_POINTS, Reason.OUTLIER_RELIEF, Reason.TOO_MANY_HOLES],
        Reason.OK,
    ).astype(np.uint8)


def join_stacks(stacks: Sequence[PatchStack]) -> PatchStack:
    """Put stacks of one grid (at least one) together, north to south, then west to east: the order of every file."""
    columns = {f.name: [getattr(stack, f.name) for stack in stacks] for f in fields(PatchStack) if f.name != "grid"}
    order = np.lexsort((np.concatenate(columns["col"]), -np.concatenate(columns["row"])))
    return PatchStack(stacks[0].grid, **{name: np.concatenate(parts)[order] for name, parts in columns.items()})
