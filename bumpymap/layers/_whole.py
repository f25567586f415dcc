"""Whether GDAL wrote what it was given: it does not say when a disk fills up while it writes a TIFF.

Seen in GDAL 3.10: blocks that leave its cache when a file is closed are lost without an error (libtiff prints a line to
stderr), and the COG driver may crash on a full disk. Two threads that write rasters at a time lose parts of blocks too:
one writes the other's blocks to disk to make room, and the other reads them again too early. So small rasters are made
in memory and written by Python; for a large one there must be room before it is made, and it is read back afterwards;
and rasters are written one after the other.
"""

import shutil
import zlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.windows import Window

__all__ = ["digest", "require_room", "require_same"]


def digest(pixels: NDArray[np.generic]) -> int:
    """Checksum of pixels; one NaN is like another."""
    return zlib.crc32(np.ascontiguousarray(np.nan_to_num(pixels)).data)


def require_room(folder: Path, size: int) -> None:
    """Make sure that a folder has room for so many bytes. Raises OSError where it has not."""
    free = shutil.disk_usage(folder).free
    if free < size:
        raise OSError(f"up to {size / 1e9:.1f} GB are needed and {free / 1e9:.1f} GB are free")


def require_same(path: Path, painted: Iterable[tuple[Window, int]]) -> None:
    """Make sure that a raster holds what was painted: windows with their `digest`. Raises OSError where it does not.

    Of overviews it is made sure that they can be read.
    """
    with rasterio.open(path) as raster:
        levels = len(raster.overviews(1))
        if not all(digest(raster.read(window=window)) == expected for window, expected in painted):
            raise OSError("what was written cannot be read back; the disk may be full")
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as raster:
            for _, window in raster.block_windows(1):
                raster.read(window=window)
