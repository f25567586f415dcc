"""An orthophoto on the pixels of a map: opened and checked before the points are read, and warped window by window."""

import logging
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import (
    BadInputError,
    CostTable,
    Georeference,
    Orthophoto,
    raster_statement,
)
from bumpymap.layers.map_reader import open_layer
from bumpymap.layers.placement import Placement, RasterWindow
from bumpytiles import Bounds

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

_log = logging.getLogger(__name__)
_COLOURS = (1, 2, 3)
"""Bands of red, green and blue."""
_FINEST_M = 0.002
"""Smallest pixel, m: of a finer one more than 10,000 are averaged for a pixel of a map."""
_SAMPLE = 32
"""Rows and columns of a sample that tells the highest number."""
_REMEDY = "Export the orthophoto as a GeoTIFF with red, green and blue of 8 or 16 bits"


_opened = partial(open_layer, remedy=_REMEDY, GDAL_CACHEMAX=64 << 20)
"""Opens an orthophoto; GDAL keeps 64 MB of decoded blocks meanwhile (chosen)."""


def _warped(file: "DatasetReader", path: Path, crs: CRS | None, **place: Any) -> Any:
    """Return a view of an orthophoto in the CRS of a map, that of its own pixels if one of both has none."""
    import rasterio
    from rasterio.enums import Resampling
    from rasterio.vrt import WarpedVRT

    statement = raster_statement(file)
    if statement.trouble:
        raise BadInputError(f"the CRS of {path} is unclear: {statement.trouble}. {_REMEDY}")
    local = CRS.from_epsg(3857)  # any will do: nothing is transformed
    ends = (local, local) if crs is None or statement.crs is None else (statement.crs, crs)
    source, target = (rasterio.crs.CRS.from_wkt(end.to_wkt()) for end in ends)
    return WarpedVRT(file, src_crs=source, crs=target, resampling=Resampling.average, **place)


def open_photo(path: Path, place: Georeference, areas: Sequence[Bounds | None]) -> Orthophoto:
    """Check an orthophoto of a map.

    ``place``: CRS of the map; ``areas``: extents of its surveys, m; None: unknown. Raises BadInputError: it cannot be
    read, has no three bands of 8 or 16 bits, does not say where it lies, is too fine, or lies beside all surveys.
    """
    with _opened(path) as file:
        if file.count < len(_COLOURS) or set(file.dtypes[:3]) - {"uint8", "uint16"} or "cmyk" in str(file.photometric):
            bands = f"{file.count} band{'s' * (file.count > 1)} of {file.dtypes[0]}"
            raise BadInputError(f"{path} is no orthophoto: it has {bands}. {_REMEDY}")
        if file.transform.is_identity and not file.gcps[0]:
            raise BadInputError(f"{path} does not say where it lies, or a file beside it does. {_REMEDY}")
        crs = None if place.crs is None else place.crs.to_2d()
        with _warped(file, path, crs) as there:
            unit = place.metres_per_unit
            pixel, sides = min(map(abs, there.res)) * unit, np.array(there.bounds) * unit
        if file.crs is None or crs is None:
            _log.warning("%s is taken to be in the CRS of the survey: one of both states none", path)
        if pixel < _FINEST_M:
            raise BadInputError(f"the pixels of {path} are {pixel:g} m wide; at least {_FINEST_M:g} m are read")
        west, south, east, north = sides.tolist()
        known = [box for box in areas if box is not None]
        if len(known) == len(areas) and not any(
            box.west < east and west < box.east and box.south < north and south < box.north for box in known
        ):
            raise BadInputError(
                f"{path} lies beside the survey: easting {west:,.0f} to {east:,.0f}, northing {south:,.0f} to "
                f"{north:,.0f} m in its CRS. Is it of another site, or its CRS wrong?"
            )
        bits = 8
        if file.dtypes[0] == "uint16":  # of 16 bits often only 12 or even 8 are used
            bits = max(8, int(file.read(_COLOURS, out_shape=(3, _SAMPLE, _SAMPLE)).max()).bit_length())
    return Orthophoto(path, bits - 8)


def tiles_of_photo(table: CostTable, window: RasterWindow, found: Mapping[str, NDArray[np.int64]]) -> NDArray[np.uint8]:
    """Return the colours of some tiles of a window, (n, pixels, pixels, 3), north up; 0, 0, 0 where it has none."""
    from rasterio.windows import Window, transform

    photo, place, pixels = table.orthophoto, Placement.of(table), table.tiles.grid.pixels
    if photo is None or not len(found["row"]):
        return np.empty((0, pixels, pixels, 3), np.uint8)
    lines, columns = window.tiles.rows * pixels, window.tiles.cols * pixels
    inside = Window(window.column * pixels, window.line * pixels, columns, lines)
    corner = transform(inside, place.transform(pixels))
    with (
        _opened(photo.path) as file,
        _warped(file, photo.path, place.horizontal_crs, transform=corner, width=columns, height=lines) as there,
    ):
        colours, known = there.read(_COLOURS), there.dataset_mask() > 127
    bytes_ = np.clip(colours >> photo.shift, 1, 255).astype(np.uint8) * known
    line, column = window.tiles.cells(found["col"], found["row"])
    by_tile = bytes_.reshape(3, window.tiles.rows, pixels, window.tiles.cols, pixels)
    found_there: NDArray[np.uint8] = by_tile.transpose(1, 3, 2, 4, 0)[line, column]
    return found_there
