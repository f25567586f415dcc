"""Check that GDAL wrote a raster completely: it reports no error when the disk fills up while it writes a TIFF.

Seen in GDAL 3.10: blocks that are flushed when a file is closed are lost without an error (libtiff prints a line to
stderr), and the COG driver may crash on a full disk. Two threads that write rasters at the same time also lose parts of
blocks: one flushes the other's blocks to free cache, and the other reads them back too early. Therefore small rasters
are made in memory and written by Python; a large one is made only if the disk has space for it, and is read back
afterwards; and rasters are written one after the other.
"""

import shutil
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window

__all__ = ["checksum", "require_disk_space", "require_intact"]


def checksum(pixels: NDArray[np.generic]) -> int:
    """Return the CRC-32 of pixels; NaN counts as 0, whatever its bits."""
    return zlib.crc32(np.ascontiguousarray(np.nan_to_num(pixels)).data)


def require_disk_space(folder: Path, size: int) -> None:
    """Raise OSError if the disk of a folder has fewer than ``size`` bytes free."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise OSError(f"up to {size / 1e9:.1f} GB are needed and {free / 1e9:.1f} GB are free")


def require_intact(path: Path, painted: Iterable[tuple[Window, int]]) -> None:
    """Read a raster back; raise OSError if a window does not match its `checksum` or an overview is unreadable."""
    with rasterio.open(path) as raster:
        levels = len(raster.overviews(1))
        if not all(checksum(raster.read(window=window)) == expected for window, expected in painted):
            raise OSError("what was written cannot be read back; the disk may be full")
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as raster:
            for _, window in raster.block_windows(1):
                raster.read(window=window)
