"""Files of a map as they are read back: opened as the one format that each must be, and held against their manifest.

A folder of layers may come from anybody, so rasters are opened as `bumpymap.core.open_tiff` does. Vector files are read
in a process whose GDAL has no drivers but those of their formats, under limits of time and memory.
"""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bumpymap.core import (
    CLOSED_GDAL,
    BadInputError,
    Child,
    DecoderError,
    Guard,
    closed_gdal,
    gdal_text,
    module_folder,
    open_regular,
    open_tiff,
    raster_lock,
)
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file

if TYPE_CHECKING:
    import numpy as np
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


_STARTS = {".fgb": b"fgb\3", ".parquet": b"PAR1", ".shp": b"\0\0\x27\x0a", ".gpkg": b"SQLite format 3\0"}


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


def require_format(path: Path) -> None:
    """Raise BadInputError if a file does not begin as the format does that its name states."""
    try:
        with open_regular(path) as file:
            start = file.read(16)
    except OSError as error:
        raise BadInputError(f"cannot read {path}: {error.strerror or error}") from error
    if not start.startswith(_STARTS[path.suffix.lower()]):
        raise BadInputError(
            f"cannot read {path}: it does not begin as such a file does. It is damaged, or of another format"
        )


_DRIVERS = {".fgb": "FlatGeobuf", ".gpkg": "GPKG", ".shp": "ESRI Shapefile"}
SECONDS, SECONDS_PER_BYTE = 10.0, 2e-6
"""Limit of the processor time to read a vector file, and for each of its bytes: ten times what real ones need."""
_MEMORY, _MEMORY_PER_BYTE = 1 << 30, 30
"""Limit of the memory of the process that reads one, likewise."""


def read_features(
    path: Path, columns: Collection[str] | None = None
) -> "tuple[str | None, NDArray[np.object_], dict[str, NDArray[Any]]]":
    """Read the only layer of geometries of a FlatGeobuf, GeoPackage or Shapefile by the driver of its format alone.

    ``columns``: names of the columns that are read, where they are there; None: all. Returns ``crs``: as the file
    states it: code or WKT; ``geometry`` (n,): WKB in two dimensions; None for a feature without one; ``columns``: name
    -> (n,) values. Raises BadInputError: it is missing, damaged or of another format, computes what it holds, or holds
    several layers of geometries; UsageError: no process can be started.
    """
    parts = [part for part in path.parent.iterdir() if part.stem == path.stem] if path.parent.is_dir() else []
    if pipes := [part for part in parts if part.exists() and not (part.is_file() or part.is_dir())]:
        raise BadInputError(f"cannot read {path}: {pipes[0]} is a pipe or a device. Remove it")
    require_format(path)
    size = sum(part.stat().st_size for part in parts if part.is_file())
    guard = Guard(lambda: _vector_child(_skipped_drivers()), "reads vector files", "pyogrio")
    try:
        limits = {"seconds": SECONDS + SECONDS_PER_BYTE * size, "memory": _MEMORY + _MEMORY_PER_BYTE * size}
        crs, geometry, values = guard.call("read", str(path.absolute()), columns, list(_DRIVERS.values()), **limits)
    except DecoderError as error:
        raise BadInputError(f"cannot read {path}: {error}. Save it again, as GeoJSON for example") from error
    finally:
        guard.end()
    return crs, geometry, values


def _vector_child(skipped: str) -> Child:
    folders = [module_folder("pyogrio"), module_folder("numpy"), str(Path(__file__).parent)]
    closed = {**CLOSED_GDAL, "GDAL_SKIP": skipped, "PROJ_NETWORK": "OFF"}
    return Child("to read vector files", "_vector_child", folders, closed)


@cache
def _skipped_drivers() -> str:
    """Return the names of all vector drivers but those of the formats that are read, as GDAL takes them."""
    guard = Guard(lambda: _vector_child(""), "lists the formats of GDAL", "pyogrio")
    try:
        return ",".join(sorted(set(guard.call("vector_drivers", seconds=SECONDS)) - set(_DRIVERS.values())))
    finally:
        guard.end()


def require_written(
    folder: Path, manifest: Mapping[str, Any], names: Iterable[str], record: str = MANIFEST_NAME, most: float = math.inf
) -> None:
    """Raise BadInputError if a file is missing, or is not the one that a manifest lists by size and checksum.

    GDAL reads many a damaged block without an error. ``manifest``: with ``files``, from `describe_file`; ``record``:
    file name of the manifest, for messages; ``most``: bytes of the largest file whose checksum is compared; a larger
    one is held against its size.
    """
    written = {str(file["path"]): file for file in manifest["files"]}
    for name in names:
        path = folder / name
        if not path.is_file():
            raise BadInputError(f"{path} is missing: it was not written, or was removed since. {_AGAIN}")
        if name not in written:
            raise BadInputError(f"{path} is not listed in {record}: it is of another run. {_AGAIN}")
        size, found = int(written[name]["bytes"]), path.stat().st_size
        if found != size:
            raise BadInputError(
                f"{path} is cut off or was changed: it has {found:,} bytes and was written with {size:,}. Copy it "
                "again, or map the survey again"
            )
        if size <= most and describe_file(path)["sha256"] != written[name]["sha256"]:
            raise BadInputError(f"{path} is damaged: its checksum is not that of {record}. {_AGAIN}")
