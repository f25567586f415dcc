"""A plain implementation of the filter method: sector by sector, with scikit-learn, SciPy and scikit-image.

It is a baseline for timing. It follows the steps of the paper; its numbers may differ slightly.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PolarSettings, Scan
from bumpymap.scan import StripeFilter, StripeModel

__all__ = ["plain_classes"]

_LEAST_INLIER_M = 0.1


def plain_classes(scan: Scan, model: StripeModel, settings: PolarSettings | None = None) -> tuple[int, list[int]]:
    """Classify the sectors of a scan by the filter method, one after another.

    Returns
    -------
    sectors : int
        Number of sectors with enough points.
    classes : list of int
        Classes of the traversable ones, in no particular order.
    """
    from sklearn.decomposition import PCA
    from sklearn.linear_model import RANSACRegressor

    settings = settings or PolarSettings()
    points = scan.points.astype(np.float64)
    distance = np.hypot(points[:, 0], points[:, 1])
    azimuth = np.mod(np.arctan2(points[:, 1], points[:, 0]), 2 * math.pi)
    edges = (*settings.zone_starts_m, settings.end_m)
    sectors, classes = 0, []
    for zone, (count, rings) in enumerate(zip(settings.sectors, settings.rings, strict=True)):
        bounds = np.linspace(edges[zone], edges[zone + 1], rings + 1)
        for ring in range(rings):
            for sector in range(count):
                low, high = 2 * math.pi * sector / count, 2 * math.pi * (sector + 1) / count
                inside = (
                    (distance >= bounds[ring]) & (distance < bounds[ring + 1]) & (azimuth >= low) & (azimuth < high)
                )
                if inside.sum() <= settings.least_points:
                    continue
                sectors += 1
                own = points[inside]
                if abs(PCA(3).fit(own).components_[2, 2]) < settings.least_normal_z:
                    continue
                place = np.stack([(distance[inside] - bounds[ring]), azimuth[inside] - low], axis=1)
                heights = _heightmap(place, own[:, 2], (bounds[ring + 1] - bounds[ring], high - low), settings.pixels)
                own[:, 2].var()
                RANSACRegressor(residual_threshold=_LEAST_INLIER_M, random_state=0).fit(own[:, :2], own[:, 2])
                stripes = _stripes(heights, model.filter)
                classes.append(int(np.abs(np.array(model.centres) - stripes).argmin()))
    return sectors, classes


def _heightmap(
    place: NDArray[np.float64], z: NDArray[np.float64], size: tuple[float, float], pixels: int
) -> NDArray[np.float64]:
    """Return the mean z per pixel, with holes filled from the nearest pixel and the plane removed."""
    from scipy.ndimage import distance_transform_edt
    from scipy.stats import binned_statistic_2d

    limits = ((0.0, size[0]), (0.0, size[1]))
    heights = binned_statistic_2d(place[:, 0], place[:, 1], z, "mean", pixels, limits).statistic
    nearest = distance_transform_edt(np.isnan(heights), return_distances=False, return_indices=True)
    filled = heights[tuple(nearest)]
    row, column = np.indices(filled.shape)
    terms = np.stack([np.ones(filled.size), row.ravel(), column.ravel()], axis=1)
    plane = terms @ np.linalg.lstsq(terms, filled.ravel(), rcond=None)[0]
    level: NDArray[np.float64] = filled - plane.reshape(filled.shape)
    return level


def _stripes(heights: NDArray[np.float64], settings: StripeFilter) -> float:
    """Draw stripes over the heights, apply eight Gabor filters and count stripes along the columns."""
    from scipy.ndimage import convolve
    from skimage.filters import gabor_kernel

    rows = np.arange(len(heights))[:, None]
    waves = np.cos(2 * math.pi * (rows / settings.wavelength_px + heights / settings.metres_per_stripe))
    seen: NDArray[np.bool_] = np.zeros(waves.shape, np.bool_)
    for number in range(settings.orientations):
        theta = math.pi * number / settings.orientations
        kernel: NDArray[np.float64] = np.asarray(gabor_kernel(1 / settings.wavelength_px, theta, bandwidth=1)).real
        down, right = np.indices(kernel.shape) - (np.array(kernel.shape) // 2)[:, None, None]
        own = np.cos(2 * math.pi * (right * math.cos(theta) + down * math.sin(theta)) / settings.wavelength_px)
        seen |= convolve(waves, kernel / (kernel * own).sum()) >= settings.threshold
    starts = seen[1:] & ~seen[:-1]
    return float((starts.sum() + seen[0].sum()) / len(seen))
