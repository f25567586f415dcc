"""Values of a raster for xarray, whose file is open only while some are read.

A raster that `rioxarray.open_rasterio` has opened refers to itself, so that its file would stay open until Python looks
for such cycles: in a loop over maps, files and memory would add up.
"""

from pathlib import Path
from typing import Any

import numpy as np
import rioxarray
from numpy.typing import NDArray
from xarray.backends import BackendArray
from xarray.core import indexing

from bumpymap.core import BadInputError
from bumpymap.layers.map_reader import reading_raster


class _ValuesOnDisk(BackendArray):  # type: ignore[misc]  # mypy does not read xarray
    def __init__(self, path: Path, driver: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        self.path, self.driver, self.shape, self.dtype = path, driver, shape, dtype
        self._version = _version(path)

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read)

    def _read(self, key: tuple[Any, ...]) -> NDArray[Any]:
        options = {"cache": False, "parse_coordinates": False, "driver": self.driver}
        with reading_raster(self.path):
            if _version(self.path) != self._version:
                raise BadInputError(f"{self.path} was replaced after it was opened: open the layers again")
            with rioxarray.open_rasterio(self.path, **options) as raster:
                values: NDArray[Any] = raster.variable[key].values
        return values


def _version(path: Path) -> tuple[int, int]:
    found = path.stat()
    return found.st_mtime_ns, found.st_size


def lazy_values(path: Path, driver: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> Any:
    """Return the values (bands, rows, columns) of a raster, which are read when they are used, and then kept."""
    return indexing.MemoryCachedArray(indexing.LazilyIndexedArray(_ValuesOnDisk(path, driver, shape, dtype)))
