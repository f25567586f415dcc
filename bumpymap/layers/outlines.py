"""Outlines of areas of tiles: rings that have a vertex wherever the ring of a neighbour has one.

Outlines of adjacent areas are then a valid coverage in any coordinates: both sides of a border are the same segments,
however they are bent or rounded on the way.
"""

import itertools

import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine

from bumpytiles import TileWindow

__all__ = ["shared_corners", "trace_labels"]


def shared_corners(areas: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Find the corners of tiles that are vertices of outlines: all at which borders turn, meet, cross or touch.

    Parameters
    ----------
    areas : integers (rows + 2, cols + 2)
        Number of the area of each tile of a window and of the tiles around it, north row first; 0 for none. There is a
        border between tiles that share a side and have unlike numbers.

    Returns
    -------
    bool (rows + 1, cols + 1)
        One for each corner of a tile of the window, north-west first. False on straight borders and off them.
    """
    beside = areas[:, 1:] != areas[:, :-1]
    below = areas[1:] != areas[:-1]
    corners: NDArray[np.bool_] = (beside[1:] | beside[:-1]) & (below[:, 1:] | below[:, :-1])
    return corners


def trace_labels(
    labels: NDArray[np.int32],
    window: TileWindow,
    rows: slice,
    wanted: range,
    corners: NDArray[np.bool_] | None = None,
) -> NDArray[np.object_]:
    """Trace the outlines of 4-connected areas of tiles: right-hand rings, in grid coordinates (1 is one tile).

    Parameters
    ----------
    labels : int32 (rows, cols)
        Number of the area of each tile of the window, north row first.
    window : TileWindow
    rows : slice
        Rows of the window in which the wanted areas lie.
    wanted : range
        Their numbers.
    corners : bool (rows + 1, cols + 1), optional
        Corners of tiles of the window that are vertices, from `shared_corners`: at least those at which the border of a
        wanted area turns. By default those of ``labels`` alone.

    Returns
    -------
    array (len(wanted),) of polygons
    """
    part = labels[rows]
    held = shared_corners(np.pad(part, 1)) if corners is None else corners[rows.start : rows.start + len(part) + 1]
    mask = (part >= wanted.start) & (part < wanted.stop)
    order, holes, rings = [], [], []
    for shape, number in rasterio.features.shapes(part, mask=mask, connectivity=4, transform=Affine.identity()):
        order.append(int(number) - wanted.start)
        holes.append(len(shape["coordinates"]))
        rings += shape["coordinates"]
    # In one call: one call per ring takes three times as long.
    turns = np.array(list(itertools.chain.from_iterable(rings))).astype(np.int64)
    points, sizes = _follow(turns, np.array([len(ring) for ring in rings]), held)
    placed = np.array([window.col, window.row + window.rows - rows.start]) + points * np.array([1.0, -1.0])
    lines = shapely.linearrings(placed, indices=np.repeat(np.arange(len(rings)), sizes))
    traced = np.empty(len(wanted), dtype=object)
    traced[order] = shapely.polygons(lines, indices=np.repeat(np.arange(len(holes)), holes))
    # GEOS normalises exterior rings to clockwise order with a fixed first vertex; reversed, they follow RFC 7946.
    outlines: NDArray[np.object_] = shapely.reverse(shapely.normalize(traced))
    return outlines


def _follow(
    points: NDArray[np.int64], sizes: NDArray[np.int64], corners: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Follow closed rings along the sides of tiles and stop at each corner that is marked.

    Parameters
    ----------
    points : int64 (n, 2)
        Column and line of the vertices of all rings.
    sizes : int64 (m,)
        How many are in each ring.
    corners : bool (lines, columns)
        Holds every point at which a ring turns.

    Returns
    -------
    points : int64 (k, 2)
    sizes : int64 (m,)
    """
    lines, columns = corners.shape
    # The marked corners twice, line by line and column by column: those of a segment follow each other in one of both.
    marked = np.concatenate([np.flatnonzero(corners), np.flatnonzero(corners.T) + corners.size]).astype(np.int32)
    ends = np.cumsum(sizes)
    start = np.delete(points, ends - 1, axis=0)
    stop = np.delete(points, ends - sizes, axis=0)
    upright = start[:, 0] == stop[:, 0]
    first, last = (
        np.where(upright, corners.size + at[:, 0] * lines + at[:, 1], at[:, 1] * columns + at[:, 0]).astype(np.int32)
        for at in (start, stop)
    )
    first, last = (np.searchsorted(marked, at) for at in (first, last))
    count = np.abs(last - first)
    before = np.cumsum(count) - count
    step = np.sign(last - first)
    found = marked[np.repeat(first - step * before, count) + np.repeat(step, count) * np.arange(count.sum())]
    upright = np.repeat(upright, count)
    found = found - corners.size * upright
    met = np.where(upright, [found // lines, found % lines], [found % columns, found // columns]).T
    held = np.add.reduceat(count, ends - sizes - np.arange(len(sizes)))
    ends = np.cumsum(held)
    return np.insert(met, ends, met[ends - held], axis=0), held + 1
