"""Rasters of heights and orthophotos, written by rasterio."""

import numpy as np
import rasterio
from rasterio.transform import Affine

WEST, NORTH = 500_001.0, 4_000_031.0


def write_raster(path, bands, *, pixel=0.2, crs="EPSG:32614", transform=None, scale=None, mask=None, **profile):
    """Write bands, (rows, cols) or (bands, rows, cols), north row first, with the corner at ``WEST``, ``NORTH``."""
    bands = np.atleast_3d(bands) if np.ndim(bands) == 3 else np.asarray(bands)[None]
    transform = Affine(pixel, 0, WEST, 0, -pixel, NORTH) if transform is None else transform
    count, height, width = bands.shape
    how = {"driver": "GTiff", "dtype": bands.dtype, "count": count, "height": height, "width": width, "crs": crs}
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"),
        rasterio.open(path, "w", transform=transform, **how | profile) as f,
    ):
        f.write(bands)
        if scale is not None:
            f.scales, f.offsets = (scale,) * count, (100.0,) * count
        if mask is not None:
            f.write_mask(mask)
    return path


def ground(rows=150, cols=140, seed=3):
    """Rolling ground with a step, on whole centimetres, m."""
    y, x = np.mgrid[:rows, :cols] * 0.2
    bumps = 0.05 * np.random.default_rng(seed).standard_normal((rows, cols))
    return np.round(100.0 + 0.1 * np.sin(2.0 * x) + 0.05 * y + bumps + 0.6 * (x > 20.0), 2)


def middles(shape, pixel=0.2):
    """Easting and northing of the middles of pixels, (rows, cols) each."""
    row, col = np.indices(shape)
    return WEST + (col + 0.5) * pixel, NORTH - (row + 0.5) * pixel
