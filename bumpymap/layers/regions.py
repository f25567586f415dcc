"""Dissolve adjacent tiles of one class into regions with the mean values of their tiles, and trace their outlines.

A region is either passable as a whole, and then lies in one zone, or not at all. scikit-image numbers the areas,
because scipy.ndimage labels one value at a time. Sums are made one tile after the other: the same tiles in the same
order give the same bits.

Rings have a vertex wherever the ring of a neighbour has one. Outlines of adjacent areas are then a valid coverage in
any coordinates: both sides of a border are the same segments, however they are bent or rounded on the way.
"""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine

from bumpymap.core import NO_CLASS, CostTable, raster_lock
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES, TileWindow


def label(keys: NDArray[np.integer]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Give a number to each of the 4-connected areas of equal key, from 1, in the order of their first pixels.

    ``keys`` (rows, cols) integers: 0 belongs to no area. Returns ``labels`` (rows, cols) int32: number of the area of
    each pixel; 0 where the key is 0; ``first`` (m,) int64: first pixel of each area, as a position in ``keys.ravel()``.
    """
    from skimage.measure import label as number_areas

    labels = number_areas(keys, background=0, connectivity=1).astype(np.int32)
    first = np.empty(int(labels.max(initial=0)) + 1, np.int64)
    first[labels.ravel()[::-1]] = np.arange(labels.size - 1, -1, -1)  # of equal indices the last assignment counts
    return labels, first[1:]


def shared_corners(areas: NDArray[np.integer]) -> NDArray[np.bool_]:
    """Find the corners of tiles that are vertices of outlines: all at which borders turn, meet, cross or touch.

    ``areas`` integers (rows + 2, cols + 2): number of the area of each tile of a window and of the tiles around it,
    north row first; 0 for none. There is a border between tiles that share a side and have unlike numbers. Returns bool
    (rows + 1, cols + 1): one for each corner of a tile of the window, north-west first. False on straight borders and
    off them.
    """
    beside = areas[:, 1:] != areas[:, :-1]
    below = areas[1:] != areas[:-1]
    corners: NDArray[np.bool_] = (beside[1:] | beside[:-1]) & (below[:, 1:] | below[:, :-1])
    return corners


def trace_labels(
    labels: NDArray[np.int32], window: TileWindow, rows: slice, wanted: range, corners: NDArray[np.bool_] | None = None
) -> NDArray[np.object_]:
    """Trace the outlines of 4-connected areas of tiles: right-hand rings, in grid coordinates (1 is one tile).

    ``labels`` int32 (rows, cols): number of the area of each tile of the window, north row first; ``rows``: rows of
    the window in which the wanted areas lie; ``wanted``: their numbers; ``corners`` bool (rows + 1, cols + 1):
    corners of tiles of the window that are vertices, from `shared_corners`: at least those at which the border of a
    wanted area turns. By default those of ``labels`` alone. Returns (len(wanted),) polygons.
    """
    part = labels[rows]
    held = shared_corners(np.pad(part, 1)) if corners is None else corners[rows.start : rows.start + len(part) + 1]
    mask = (part >= wanted.start) & (part < wanted.stop)
    order, holes, rings = [], [], []
    with raster_lock():  # a raster in memory, whose blocks share the cache with those that other threads write
        shapes = list(rasterio.features.shapes(part, mask=mask, connectivity=4, transform=Affine.identity()))
    for shape, number in shapes:
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


def trace_all(labels: NDArray[np.int32], window: TileWindow, count: int) -> NDArray[np.object_]:
    """Trace the outlines of the areas 1 to ``count`` of a window; see `trace_labels`."""
    return trace_labels(labels, window, slice(0, window.rows), range(1, count + 1)) if count else np.empty(0, object)


def _follow(
    points: NDArray[np.int64], sizes: NDArray[np.int64], corners: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Follow closed rings along the sides of tiles and stop at each corner that is marked.

    ``points`` (n, 2) are column and line of the vertices of all rings, ``sizes`` (m,) of them in each, as in what is
    returned; ``corners`` (lines, columns) holds every point at which a ring turns.
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


REGION_WINDOW = 2_048
"""Side of the windows at whose borders regions are cut, tiles: 6 km of 3 m tiles."""
BATCH = 8_192
"""Most regions at a time: some tens of megabytes of outlines even if every tile is a region of its own."""
_STRIP = REGION_WINDOW * BLOCK_TILES
"""Most tiles to read at a time: one row of blocks, so that sums run along the rows of a window."""
_VALUES = ("c_r", "c_r_low", "c_r_high", "p_fail")

_IMPASSABLE, _UNKNOWN, _OTHER_WINDOW, _ZONE = 10, 100, 128, 256
"""Parts of the keys of tiles, of which those with equal ones join. 0: no points; class + 1: passable; with the first
added: not passable; the second plus the reason: no class; the third is added outside a window, so that the cut is a
border; the last times the zone is added to passable ones."""


@dataclass(frozen=True, slots=True)
class Regions:
    """Regions of a map, one row each."""

    placement: Placement
    number: NDArray[np.int64]
    """(m,) number of the region in the map, from 1, without gaps."""
    outlines: NDArray[np.object_]
    """(m,) polygons in grid coordinates: 1 is one tile, 0 the origin of the CRS. A corner of a region is a vertex of
    all regions that it touches."""
    class_id: NDArray[np.uint8]
    """(m,) class; ``NO_CLASS`` where unknown."""
    reason: NDArray[np.uint8]
    """(m,) a ``Reason``."""
    tiles: NDArray[np.int64]
    """(m,) number of tiles."""
    passable: NDArray[np.bool_]
    """(m,) True: every tile is passable; False: none is."""
    zone: NDArray[np.int32]
    """(m,) the zone of all tiles, from 1; 0 where not passable, or part of none."""
    c_r: NDArray[np.float64]
    """(m,) mean over the tiles, rad/m; NaN where unknown (as in the next three)."""
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    hazard: NDArray[np.float64]
    """(m,) mean over the tiles, 1/m; NaN where not passable, or if the rating has no ``p_fail``."""
    cost: NDArray[np.float64]
    """(m,) factor on distance, mean over the tiles; NaN where not passable."""


def dissolve(table: CostTable) -> Iterator[Regions]:
    """Dissolve tiles that share a side into regions: of one class and, if passable, zone, or of one reason if unknown.

    Outlines run along tile sides; vertices are whole numbers of tiles. All of them are a valid coverage: adjacent
    regions have the same vertices along their border. A large map is dissolved in windows of `REGION_WINDOW` x
    `REGION_WINDOW` tiles from its north-west corner: regions are cut at the borders of windows, and memory does not
    depend on the size of the map. Yields up to some thousand regions: windows north-west first, regions of a window in
    the order of their first tile, northmost (then westmost) first. They are numbered in that order. Raises
    BadInputError: the extent is too large for a raster.
    """
    place = Placement.of(table)
    found = 0
    for window in place.windows(REGION_WINDOW, aligned=False):
        if table.tiles.holds(window.tiles):
            for regions in _dissolve_window(table, place, window, found):
                found += len(regions.number)
                yield regions


def _dissolve_window(table: CostTable, place: Placement, window: RasterWindow, before: int) -> Iterator[Regions]:
    """Yield the regions of a window; ``before`` are those of the windows before it."""
    keys = _region_keys(table, window)
    corners = shared_corners(keys)
    keys = np.ascontiguousarray(keys[1:-1, 1:-1])
    labels, first = label(keys)
    last_row = np.empty(len(first) + 1, np.int64)
    last_row[labels] = np.arange(len(labels))[:, None]
    last_row = last_row[1:]
    zone, key = np.divmod(keys.ravel()[first], _ZONE)
    tiles = np.bincount(labels.ravel(), minlength=len(first) + 1)[1:]
    means = _sum_values(table, window, labels, len(first)) / tiles
    passable = key < _IMPASSABLE
    class_id = np.where(key >= _UNKNOWN, NO_CLASS, (key - 1) % _IMPASSABLE).astype(np.uint8)
    reason = np.where(key >= _UNKNOWN, key - _UNKNOWN, 0).astype(np.uint8)
    for start in range(0, len(first), BATCH):
        some = slice(start, start + BATCH)
        numbers = range(start + 1, start + len(first[some]) + 1)
        rows = slice(int(first[start]) // window.tiles.cols, int(last_row[some].max()) + 1)
        c_r, c_r_low, c_r_high, p_fail, hazard = means[:, some]
        free = passable[some]
        yield Regions(
            placement=place,
            number=np.arange(before + numbers.start, before + numbers.stop),
            outlines=trace_labels(labels, window.tiles, rows, numbers, corners),
            class_id=class_id[some],
            reason=reason[some],
            tiles=tiles[some],
            passable=free,
            zone=zone[some].astype(np.int32),
            c_r=c_r,
            c_r_low=c_r_low,
            c_r_high=c_r_high,
            p_fail=p_fail,
            hazard=np.where(free, hazard, np.nan),
            cost=np.where(free, table.rule.cost(c_r, hazard), np.nan),
        )


def _region_keys(table: CostTable, window: RasterWindow) -> NDArray[np.int64]:
    """Return the keys (rows + 2, cols + 2) of a window and of the tiles around it, north row first; 0: no tile."""
    around = window.tiles.grown(1)
    keys = np.zeros((around.rows, around.cols), dtype=np.int64)
    for strip in table.tiles.strips(_STRIP, around):
        found = table.tiles.read(("class_id", "barred", "reason", "zone"), strip)
        part = np.where(found["barred"] == 0, found["zone"].astype(np.int64) * _ZONE, _IMPASSABLE)
        known = part + found["class_id"] + 1
        key = np.where(found["class_id"] == NO_CLASS, _UNKNOWN + found["reason"], known)
        keys[RasterWindow(around, window.line - 1, window.column - 1).pixel_indices(found)] = key
    for edge in (keys[0], keys[-1], keys[1:-1, 0], keys[1:-1, -1]):
        edge[edge > 0] += _OTHER_WINDOW
    return keys


def _sum_values(table: CostTable, window: RasterWindow, labels: NDArray[np.int32], count: int) -> NDArray[np.float64]:
    """Return the sums (5, count) of ``_VALUES`` and of the hazard over the tiles of each label.

    Columns are read a second time here because that takes less memory than keeping them.
    """
    totals = np.zeros((len(_VALUES) + 1, count))
    for strip in table.tiles.strips(_STRIP, window.tiles):
        found = table.tiles.read(_VALUES, strip)
        area = labels[window.pixel_indices(found)] - 1
        values = [*(found[name] for name in _VALUES), table.rule.hazard(found["p_fail"]).astype(np.float32)]
        for total, own in zip(totals, values, strict=True):
            np.add.at(total, area, own.astype(np.float64))
    return totals
