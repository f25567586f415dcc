"""GDAL as every room uses it: one thread at a time; files of strangers by the GeoTIFF driver alone, without network.

GDAL chooses a driver by what a file holds, and several formats (VRT first) are instructions to read other files or to
fetch URLs. Files that it looks for beside a raster are opened by any driver too.
"""

import os
import threading
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.core.crs import CrsStatement, statement_from_wkt
from bumpymap.core.errors import BadInputError

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_CLOSED_GDAL = {
    "GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR",  # no .ovr and .msk, which GDAL opens by any driver
    "GDAL_PAM_ENABLED": "NO",  # no .aux.xml, which may name other files
    "CPL_VSIL_CURL_ALLOWED_FILENAME": "-",  # no network
}
"""Options with which GDAL reads a file and nothing else."""
_LARGEST_BLOCK = 1 << 28
"""Decoded bytes of a block of a raster at most, as of a chunk of LAZ."""
_gdal = threading.RLock()
"""Held while GDAL works on a raster."""


def _reset_after_fork() -> None:
    global _gdal  # noqa: PLW0603 (one for all threads)
    _gdal = threading.RLock()


os.register_at_fork(after_in_child=_reset_after_fork)


def raster_lock() -> AbstractContextManager[Any]:
    """Return the lock that every thread holds while it lets GDAL work on rasters, in memory too.

    A thread that writes a raster loses parts of blocks while another one reads or writes any, see
    `bumpymap.layers._cog`. Other options of GDAL than its cache are those of a thread, but for the main thread's, which
    are everyone's.
    """
    return _gdal


@contextmanager
def closed_gdal(**options: Any) -> Iterator[None]:
    """Let GDAL read a raster alone: no files beside it, no network, and no other thread of bumpymap."""
    import rasterio

    with raster_lock(), rasterio.Env(**_CLOSED_GDAL, **options):
        yield


def gdal_text(error: Exception) -> str:
    """Return why GDAL cannot read a raster; what rasterio raises may only say that this is its cause."""
    return str(error.__cause__ or error).rstrip(".")


def open_tiff(path: Path, remedy: str) -> "DatasetReader":
    """Open a GeoTIFF inside `closed_gdal`.

    Raises BadInputError: it leads to other files, or a block of it takes too much memory; ``remedy`` is the sentence
    that ends the message. Other errors are those of rasterio, and UnicodeDecodeError.
    """
    import rasterio
    from rasterio.errors import NotGeoreferencedWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        file = rasterio.open(path, driver="GTiff")
    if file.tags(ns="OVERVIEWS") or file.tags(ns="SUBDATASETS"):
        file.close()
        raise BadInputError(f"{path} keeps a part of its pixels in other files, which are not read. {remedy}")
    if (block := block_bytes(file)) > _LARGEST_BLOCK:
        file.close()
        raise BadInputError(
            f"{path} is stored in blocks of {block / 1e6:,.0f} MB when decoded; at most {_LARGEST_BLOCK / 1e6:,.0f} MB "
            f"are decoded at once. {remedy}"
        )
    return file


def block_bytes(file: "DatasetReader") -> int:
    """Return the bytes of a decoded block of a raster, all bands together."""
    import numpy as np

    return sum(
        rows * cols * np.dtype(kind).itemsize
        for (rows, cols), kind in zip(file.block_shapes, file.dtypes, strict=True)
        if not kind.startswith("complex_int")
    )


def raster_statement(file: "DatasetReader") -> CrsStatement:
    """Return the CRS that a raster states."""
    return CrsStatement() if file.crs is None else statement_from_wkt(file.crs.to_wkt())
