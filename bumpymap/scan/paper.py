"""The filter method exactly as in the paper, for comparison: ``compat='paper'``.

The grid does not turn with the scan. Heightmaps cover the bounding box of a sector's points in x and y, are scaled from
their lowest to their highest pixel, and empty pixels are black. The stripes are the sensor's scan lines in such an
image, so their direction depends on the azimuth. The classes are fitted in each scan, so class 0 is whatever has the
most stripes in it.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, PolarSettings, Scan, SectorStack
from bumpymap.scan.polar import polar_sectors
from bumpymap.scan.stripes import StripeFilter, fit_centres, nearest_class, stripes_in

__all__ = ["classify_paper", "paper_heights", "paper_settings"]


def paper_settings(settings: PolarSettings) -> PolarSettings:
    """Return the grid without what the paper does not have: ground of its own, the anchor, the overhead check.

    The default grid becomes the paper's, which has no zone nearer than 4 m.
    """
    if settings == PolarSettings():
        settings = replace(
            settings, zone_starts_m=settings.zone_starts_m[1:], sectors=settings.sectors[1:], rings=settings.rings[1:]
        )
    return replace(settings, ground_only=False, anchored=False, overhead_m=math.inf)


def classify_paper(scan: Scan, settings: PolarSettings | None = None, seed: int = 0) -> ClassedSectors:
    """Classify the sectors of one scan by the paper's rules.

    Parameters
    ----------
    scan : Scan
    settings : PolarSettings, optional
    seed : int
        Seed of k-means++.

    Returns
    -------
    ClassedSectors
        ``heights`` are the paper's, see ``paper_heights``. A scan with fewer than three different stripe counts has as
        many classes.
    """
    stack = polar_sectors(scan, paper_settings(settings or PolarSettings()))
    heights = paper_heights(scan, stack)
    stripes = stripes_in(_as_waves(heights), StripeFilter())
    different = np.unique(stripes[stack.traversable])[::-1].tolist()
    few = len(different) < CLASSES
    smooth, middle, rough = (
        [*different, *[-math.inf] * CLASSES][:CLASSES] if few else fit_centres(stripes[stack.traversable], seed, 1)
    )
    return nearest_class(replace(stack, heights=heights), stripes, (smooth, middle, rough))


def _as_waves(heights: NDArray[np.float32]) -> NDArray[np.float32]:
    """Subtract the mean of each image, and scale it to the power of a wave of amplitude 1."""
    waves = heights - heights.mean(axis=(1, 2), keepdims=True)
    power = np.sqrt(2.0 * (waves**2).mean(axis=(1, 2), keepdims=True))
    scaled: NDArray[np.float32] = np.asarray(waves / np.where(power > 0.0, power, 1.0), np.float32)
    return scaled


def paper_heights(scan: Scan, stack: SectorStack) -> NDArray[np.float32]:
    """Return the paper's heightmaps.

    Returns
    -------
    (n, pixels, pixels) float32
        Mean z of a pixel, 0 for the lowest to 1 for the highest of the sector; north row (greatest y) first, west
        column first; 0 in pixels without points.
    """
    pixels, count = stack.settings.pixels, len(stack.zone)
    inside = np.flatnonzero(stack.point_sector >= 0)
    order = inside[np.argsort(stack.point_sector[inside], kind="stable")]
    row, xyz = stack.point_sector[order], scan.points[order].astype(np.float64)
    if not count:
        return np.zeros((0, pixels, pixels), np.float32)
    starts = np.searchsorted(row, np.arange(count))
    low, high = np.minimum.reduceat(xyz, starts), np.maximum.reduceat(xyz, starts)
    size = np.where(high > low, high - low, 1.0)
    place = np.minimum((pixels * (xyz - low[row]) / size[row]).astype(np.int64), pixels - 1)
    pixel = (row * pixels + pixels - 1 - place[:, 1]) * pixels + place[:, 0]
    cells = count * pixels * pixels
    held = np.bincount(pixel, minlength=cells)
    mean = np.bincount(pixel, xyz[:, 2], cells) / np.maximum(held, 1)
    maps = np.where(held > 0, mean, np.nan).reshape(count, -1)
    least = np.nanmin(maps, axis=1, keepdims=True)
    extent = np.nanmax(maps, axis=1, keepdims=True) - least
    scaled: NDArray[np.float64] = np.nan_to_num((maps - least) / np.where(extent > 0.0, extent, 1.0))
    return scaled.reshape(count, pixels, pixels).astype(np.float32)
