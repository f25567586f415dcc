"""Files of a map as they are read back: opened as the one format that each must be, and held against their manifest.

A folder of layers may come from anybody, so rasters are opened as `bumpymap.core.open_tiff` does.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.core import (
    BadInputError,
    closed_gdal,
    gdal_text,
    open_tiff,
    raster_lock,
)
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rasterio.io import DatasetReader

_AGAIN = "Map the survey again"


def read_averaged(
    file: "DatasetReader", shape: tuple[int, int], window: tuple[tuple[int, int], tuple[int, int]] | None = None
) -> "NDArray[Any]":
    """Read the first band of a raster, or of a window of it, in another shape: means, from its overviews if it can.

    ``window`` holds the first row and the one after the last, then the columns likewise.
    """
    from rasterio.enums import Resampling

    found: NDArray[Any] = file.read(1, window=window, out_shape=shape, resampling=Resampling.average)
    return found


def read_colours(
    file: "DatasetReader", shape: tuple[int, int], window: tuple[tuple[int, int], tuple[int, int]] | None = None
) -> "NDArray[Any]":
    """Do the same with red, green and blue, (3, rows, cols) float32; NaN where the mask of the raster hides them."""
    import numpy as np
    from rasterio.enums import Resampling

    found = file.read((1, 2, 3), window=window, out_shape=(3, *shape), resampling=Resampling.average, masked=True)
    colours: NDArray[Any] = found.astype(np.float32).filled(np.nan)
    return colours


@contextmanager
def reading_raster(path: Path, remedy: str = _AGAIN, **options: Any) -> Iterator[None]:
    """Read a raster inside `closed_gdal`; its errors, and names that are no text, become BadInputErrors."""
    from rasterio.errors import RasterioError

    try:
        with closed_gdal(**options):
            yield
    except (OSError, UnicodeDecodeError, RasterioError) as error:
        raise BadInputError(f"cannot read {path}: {gdal_text(error)}. {remedy}") from error


@contextmanager
def open_layer(path: Path, *, remedy: str = _AGAIN, **options: Any) -> "Iterator[DatasetReader]":
    """Open a raster of a map, a GeoTIFF; nothing else is read.

    ``remedy``: sentence that ends the message of an error; ``**options``: of GDAL, while the raster is open. Raises
    BadInputError: it is missing, damaged or of another format; it leads to other files, or the names in it are no text.
    So is each error of GDAL in the body of the ``with``.
    """
    with reading_raster(path, remedy, **options), open_tiff(path, remedy) as file:
        yield file


_KEPT: dict[str, Any] = {"GDAL_CACHEMAX": 32 << 20}
"""Decoded blocks that GDAL keeps of all rasters together, bytes."""


class KeptRasters:
    """Rasters of one map that stay open from read to read inside `keep`, so that each is opened once.

    Outside of `keep`, a raster is opened for each read. A process that unpickles this starts with none open.
    """

    def __init__(self) -> None:
        self._keepers = 0
        self._open: dict[Path, DatasetReader] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return KeptRasters, ()

    @contextmanager
    def keep(self) -> Iterator[None]:
        """Keep rasters open during the body; all are closed when the last of several bodies ends."""
        with raster_lock():
            self._keepers += 1
        try:
            yield
        finally:
            with raster_lock():
                self._keepers -= 1
                self._close_unkept()

    @contextmanager
    def opened(self, path: Path) -> "Iterator[DatasetReader]":
        """Yield an open raster; for errors see `open_layer`."""
        if not self._keepers:
            with open_layer(path, **_KEPT) as file:
                yield file
            return
        with raster_lock(), reading_raster(path, **_KEPT):
            if path not in self._open:
                self._open[path] = open_tiff(path, _AGAIN)
            try:
                yield self._open[path]
            finally:  # the last body of `keep` may have ended in another thread meanwhile
                self._close_unkept()

    def _close_unkept(self) -> None:
        while self._open and not self._keepers:
            self._open.popitem()[1].close()


def require_written(folder: Path, manifest: Mapping[str, Any], names: Iterable[str], most: float = math.inf) -> None:
    """Raise BadInputError if a file is missing, or is not the one that a manifest lists by size and checksum.

    GDAL reads many a damaged block without an error. ``manifest``: with ``files``, from `describe_file`; ``most``:
    bytes of the largest file whose checksum is compared; a larger one is held against its size.
    """
    written = {str(file["path"]): file for file in manifest["files"]}
    for name in names:
        path = folder / name
        if not path.is_file():
            raise BadInputError(f"{path} is missing: it was not written, or was removed since. {_AGAIN}")
        if name not in written:
            raise BadInputError(f"{path} is not listed in {MANIFEST_NAME}: it is of another run. {_AGAIN}")
        size, found = int(written[name]["bytes"]), path.stat().st_size
        if found != size:
            raise BadInputError(
                f"{path} is cut off or was changed: it has {found:,} bytes and was written with {size:,}. Copy it "
                "again, or map the survey again"
            )
        if size <= most and describe_file(path)["sha256"] != written[name]["sha256"]:
            raise BadInputError(f"{path} is damaged: its checksum is not that of {MANIFEST_NAME}. {_AGAIN}")
