"""Dissolve adjacent tiles of one class into regions with the mean values of their tiles.

A region is either passable as a whole or not at all.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, FAIL_SHARE, NO_CLASS, REASON_TEXT, CostTable, Reason
from bumpymap.layers._label import add_up, label
from bumpymap.layers.outlines import shared_corners, trace_labels
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import BLOCK_TILES, TileWindow

__all__ = ["REGION_WINDOW", "Regions", "dissolve"]

REGION_WINDOW = 2_048
"""Side of the windows at whose borders regions are cut, tiles: 6 km of 3 m tiles."""
BATCH = 8_192
"""Most regions at a time: some tens of megabytes of outlines even if every tile is a region of its own."""
_STRIP = REGION_WINDOW * BLOCK_TILES
"""Most tiles to read at a time: one row of blocks, so that sums run along the rows of a window."""
_VALUES = ("c_r", "c_r_low", "c_r_high", "p_fail")

# Tiles with equal keys join. 0: no points; class + 1: passable; class + 1 + _IMPASSABLE: not passable;
# _UNKNOWN + reason: no class.
_IMPASSABLE = 10
_UNKNOWN = 100
_OTHER_WINDOW = 128
"""Added to the keys of tiles outside a window, so that the cut is a border."""


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
    c_r: NDArray[np.float64]
    """(m,) mean over the tiles, rad/m; NaN where unknown (as in the next three)."""
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    hazard: NDArray[np.float64]
    """(m,) mean over the tiles, 1/m; NaN where not passable, or if the rating has no ``p_fail``."""
    cost: NDArray[np.float64]
    """(m,) factor on distance, mean over the tiles; NaN where not passable."""

    @property
    def class_name(self) -> NDArray[np.object_]:
        """(m,) name of the class, or "unknown"."""
        names = np.array([*CLASS_NAMES, "unknown"], dtype=object)
        picked: NDArray[np.object_] = names[np.minimum(self.class_id, len(CLASS_NAMES))]
        return picked

    @property
    def c_r_basis(self) -> NDArray[np.object_]:
        """(m,) drives behind ``c_r``: ``drives`` (all), ``survivors`` (``p_fail`` >= ``FAIL_SHARE``), or None."""
        basis = np.where(self.p_fail >= FAIL_SHARE, "survivors", "drives").astype(object)
        basis[np.isnan(self.c_r)] = None
        return basis

    @property
    def reason_text(self) -> NDArray[np.object_]:
        """(m,) description of the reason."""
        names = np.array([REASON_TEXT[code] for code in Reason], dtype=object)
        picked: NDArray[np.object_] = names[self.reason]
        return picked

    @property
    def area_m2(self) -> NDArray[np.float64]:
        """(m,) area on the grid, m^2."""
        return np.asarray(self.tiles * self.placement.grid.tile_size**2, dtype=np.float64)


def dissolve(table: CostTable, placement: Placement | None = None) -> Iterator[Regions]:
    """Dissolve tiles that share a side into regions of one class and passability, or of one reason if unknown.

    Outlines run along tile sides; vertices are whole numbers of tiles. All of them are a valid coverage: adjacent
    regions have the same vertices along their border. A large map is dissolved in windows of
    `REGION_WINDOW` x `REGION_WINDOW` tiles from its north-west corner: regions are cut at the borders of windows, and
    memory does not depend on the size of the map.

    Parameters
    ----------
    table : CostTable
        The tiles.
    placement : Placement, optional
        Placement of the map, if already known.

    Yields
    ------
    Regions
        Up to some thousand regions: windows north-west first, regions of a window in the order of their first tile,
        northmost (then westmost) first. They are numbered in that order.

    Raises
    ------
    BadInputError
        The extent is too large for a raster.
    """
    place = placement or Placement.of(table)
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
    labels, first, last = label(keys)
    key = keys.ravel()[first]
    tiles = np.bincount(labels.ravel(), minlength=len(first) + 1)[1:]
    means = _sum_values(table, window, labels, len(first)) / tiles
    passable = key < _IMPASSABLE
    class_id = np.where(key >= _UNKNOWN, NO_CLASS, (key - 1) % _IMPASSABLE).astype(np.uint8)
    reason = np.where(key >= _UNKNOWN, key - _UNKNOWN, 0).astype(np.uint8)
    for start in range(0, len(first), BATCH):
        some = slice(start, start + BATCH)
        rows = slice(int(first[start]) // window.tiles.cols, int(last[some].max()) // window.tiles.cols + 1)
        c_r, c_r_low, c_r_high, p_fail, hazard = means[:, some]
        free = passable[some]
        numbers = range(start + 1, start + len(first[some]) + 1)
        yield Regions(
            placement=place,
            number=np.arange(before + numbers.start, before + numbers.stop),
            outlines=trace_labels(labels, window.tiles, rows, numbers, corners),
            class_id=class_id[some],
            reason=reason[some],
            tiles=tiles[some],
            passable=free,
            c_r=c_r,
            c_r_low=c_r_low,
            c_r_high=c_r_high,
            p_fail=p_fail,
            hazard=np.where(free, hazard, np.nan),
            cost=np.where(free, table.rule.cost(c_r, hazard), np.nan),
        )


def _region_keys(table: CostTable, window: RasterWindow) -> NDArray[np.uint8]:
    """Return the keys (rows + 2, cols + 2) of a window and of the tiles around it, north row first; 0: no tile."""
    inside = window.tiles
    around = TileWindow(inside.col - 1, inside.row - 1, inside.cols + 2, inside.rows + 2)
    keys = np.zeros((around.rows, around.cols), dtype=np.uint8)
    for strip in table.tiles.strips(_STRIP, around):
        found = table.tiles.read(("class_id", "barred", "reason"), strip)
        known = found["class_id"] + 1 + np.where(found["barred"] == 0, 0, _IMPASSABLE)
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
        for total, name in zip(totals, _VALUES, strict=False):
            add_up(area, found[name], total)
        add_up(area, table.rule.hazard(found["p_fail"]).astype(np.float32), totals[-1])
    return totals
