"""Tiles of one class that touch along a side, dissolved into regions with the mean cost of their tiles."""

from dataclasses import dataclass

import numpy as np
import rasterio.features
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine
from scipy import ndimage

from bumpymap.products.placement import Placement
from bumpymap.types import CLASS_NAMES, NO_CLASS, REASON_TEXT, CostMap, Reason

__all__ = ["Regions", "dissolve"]

_UNKNOWN = 100
"""Key of an unknown tile: this plus its reason. A class's key is the class plus one; 0 is a tile without points."""


@dataclass(frozen=True, slots=True)
class Regions:
    """One row a region, the one with the northmost (then westmost) tile first."""

    placement: Placement
    outlines: NDArray[np.object_]
    """(m,) polygons in grid coordinates: 1 is one tile, 0 the origin of the CRS."""
    klass: NDArray[np.uint8]
    """(m,) class; ``NO_CLASS`` where unknown."""
    reason: NDArray[np.uint8]
    """(m,) a ``Reason``."""
    tiles: NDArray[np.int64]
    """(m,) number of tiles."""
    c_r: NDArray[np.float64]
    """(m,) mean over the tiles, rad/m; NaN where unknown (so are the next four)."""
    c_r_low: NDArray[np.float64]
    c_r_high: NDArray[np.float64]
    p_fail: NDArray[np.float64]
    cost: NDArray[np.float64]
    """(m,) factor on distance: 1 + ride_weight * c_r."""

    @property
    def class_name(self) -> NDArray[np.object_]:
        """(m,) class in words."""
        names = np.array([*CLASS_NAMES, "unknown"], dtype=object)
        picked: NDArray[np.object_] = names[np.minimum(self.klass, len(CLASS_NAMES))]
        return picked

    @property
    def reason_text(self) -> NDArray[np.object_]:
        """(m,) reason in words."""
        names = np.array([REASON_TEXT[code] for code in Reason], dtype=object)
        picked: NDArray[np.object_] = names[self.reason]
        return picked

    @property
    def area_m2(self) -> NDArray[np.float64]:
        """(m,) area on the grid, m^2."""
        return np.asarray(self.tiles * self.placement.grid.tile_size**2, dtype=np.float64)


def dissolve(cost_map: CostMap, placement: Placement | None = None) -> Regions:
    """Join neighbouring tiles of one class, or unknown for one reason, into regions.

    Tiles are neighbours when they share a side. Outlines run along tile sides; vertices are whole numbers of tiles.

    Parameters
    ----------
    cost_map : CostMap
        Tiles in any order.
    placement : Placement, optional
        Where they lie, if that is known already.

    Returns
    -------
    Regions

    Raises
    ------
    BadInputError
        No tiles, or they span too much for a raster.
    """
    place = placement or Placement.of(cost_map)
    klass, reason = cost_map.klass[place.order], cost_map.patches.reason[place.order]
    keys = np.where(cost_map.klass == NO_CLASS, _UNKNOWN + cost_map.patches.reason, cost_map.klass + 1)
    labels = _label(place.raster(keys, 0))
    found, first, region, tiles = np.unique(
        labels[place.line, place.column], return_index=True, return_inverse=True, return_counts=True
    )
    by_first = np.argsort(first)  # tiles stand in canonical order, so this one does not depend on how labels were given
    first, tiles = first[by_first], tiles[by_first]

    def mean(values: NDArray[np.floating]) -> NDArray[np.float64]:
        total = np.bincount(region, weights=values[place.order].astype(np.float64), minlength=len(found))
        return np.asarray(total[by_first] / tiles, dtype=np.float64)

    c_r = mean(cost_map.c_r)
    return Regions(
        placement=place,
        outlines=_outlines(labels, place, found[by_first]),
        klass=klass[first],
        reason=reason[first],
        tiles=tiles.astype(np.int64),
        c_r=c_r,
        c_r_low=mean(cost_map.c_r_low),
        c_r_high=mean(cost_map.c_r_high),
        p_fail=mean(cost_map.p_fail),
        cost=1.0 + cost_map.ride_weight * c_r,
    )


def _label(keys: NDArray[np.generic]) -> NDArray[np.int32]:
    """Give a number to each of the 4-connected areas of equal key, from 1; 0 where the key is 0."""
    labels = np.zeros(keys.shape, dtype=np.int32)
    known = 0
    for key in np.unique(keys):
        if key == 0:
            continue
        part, count = ndimage.label(keys == key)
        np.add(part, known, out=labels, where=part > 0)
        known += count
    return labels


def _outlines(labels: NDArray[np.int32], place: Placement, wanted: NDArray[np.int32]) -> NDArray[np.object_]:
    """Trace the outline of each label, in the order of ``wanted``, in grid coordinates."""
    window = place.window
    grid = Affine(1.0, 0.0, window.col, 0.0, -1.0, window.row + window.rows)
    by_label = np.empty(int(labels.max()) + 1, dtype=object)
    for shape, label in rasterio.features.shapes(labels, mask=labels > 0, connectivity=4, transform=grid):
        outer, *holes = shape["coordinates"]
        by_label[int(label)] = shapely.Polygon(outer, holes)
    # GEOS's normal form runs clockwise; right-hand rings are its reverse. It also fixes where a ring starts.
    outlines: NDArray[np.object_] = shapely.reverse(shapely.normalize(by_label[wanted]))
    return outlines
