"""Cloud-optimised GeoTIFF: a sparse scratch raster, then GDAL's COG driver, which adds overviews and statistics.

The scratch raster is filled window by window, so that neither a large survey nor a large gap needs memory. A small one
stays in memory.
"""

import os
import struct
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import RasterioError
from rasterio.io import MemoryFile
from rasterio.windows import Window

try:
    import resource
except ImportError:  # not on Windows
    resource = None  # type: ignore[assignment]

from bumpymap.core import atomic
from bumpymap.layers._whole import digest, require_room, require_same
from bumpymap.layers.placement import Placement, RasterWindow

__all__ = ["Layer", "Sheet", "write_cog"]

_FAILURES: tuple[type[Exception], ...] = (RasterioError, rasterio._err.CPLE_BaseError, ET.ParseError)  # noqa: SLF001 (no public name)
_GDAL = {"GDAL_CACHEMAX": 64, "COG_TMP_COMPRESSION": "NONE"}
"""The block cache, MB: from 16 to 256 the time and the bytes are the same (236 million pixels). Overviews stay unpacked
while they wait for their place: packing them took a third of the time of a dense raster, two thirds of an empty one."""
SMALL = 16 << 20
"""Largest scratch raster to keep in memory, bytes."""
_SCRATCH_BLOCK = 256
"""Side of a scratch block, pixels. 11 bands of 2560 x 2560 pixels become a COG in 13 s of CPU time; with scratch blocks
of 512, or bands mixed pixel by pixel, it was measured to take up to 3 times as long."""
_EXTRA_SAMPLES = 338
"""TIFF tag: what samples beyond the photometric ones mean; 0 is "unspecified", 2 is "unassociated alpha"."""


@dataclass(frozen=True, slots=True)
class Layer:
    """One band."""

    name: str
    unit: str = ""
    text: str = ""
    """What it is, in words."""
    categories: tuple[str, ...] = ()
    """Names of the values 0, 1, 2, ..."""


@dataclass(frozen=True, slots=True)
class Sheet:
    """A raster to write: everything but its pixels."""

    layers: Sequence[Layer]
    dtype: str
    nodata: float
    pixels: int
    """Pixels along the side of a tile."""
    crs: CRS | None
    overviews: str
    """How overviews are made, as GDAL names it."""
    block: int
    """Side of a block of the file, pixels."""
    colours: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)
    """Colour table of band 1."""
    about: dict[str, str] = field(default_factory=dict)
    """Metadata of the file."""
    everywhere: bool = False
    """Blocks without any tile are written too."""
    level: int = 6
    """How hard DEFLATE tries, 1 to 9."""


def write_cog(
    path: Path,
    placement: Placement,
    sheet: Sheet,
    paint: Callable[[RasterWindow], NDArray[np.generic] | None],
    side: int,
) -> None:
    """Write a COG, whole or not at all.

    Parameters
    ----------
    path : Path
        The file.
    placement : Placement
        Where the tiles lie.
    sheet : Sheet
        Bands, type, overviews.
    paint : callable
        Gives the pixels of a window, (bands, lines * pixels, columns * pixels), north up; None where all are nodata.
    side : int
        Side of a window, tiles: a multiple of a block's.

    Raises
    ------
    OutputError
        The place cannot be written.
    """
    with atomic(path, _FAILURES) as temporary, rasterio.Env(**_GDAL):
        pixels = placement.window.cols * placement.window.rows * sheet.pixels**2
        if pixels * len(sheet.layers) * np.dtype(sheet.dtype).itemsize <= SMALL:
            with MemoryFile(ext=".tif") as scratch, MemoryFile(ext=".tif") as layer:
                _write_scratch(scratch.name, placement, sheet, paint, None)
                _convert(scratch.name, layer.name, temporary, sheet)
                if any(band.categories for band in sheet.layers):  # which GDAL keeps in a side file
                    rasterio.shutil.copyfiles(layer.name, str(temporary))
                temporary.write_bytes(layer.getbuffer())
        else:
            waiting = temporary.with_name(f"{temporary.stem}.scratch.tif")
            painted = _write_scratch(str(waiting), placement, sheet, paint, side)
            require_room(path.parent, waiting.stat().st_size)
            _convert(str(waiting), str(temporary), temporary, sheet)
            waiting.unlink()
            require_same(temporary, painted)
        names = temporary.with_name(f"{temporary.name}.aux.xml")
        if names.exists():
            ET.parse(names)  # noqa: S314 (GDAL has just written it; a full disk may have cut it)
        elif any(band.categories for band in sheet.layers):  # GDAL says nothing when a disk is full
            raise OSError("the names of its classes could not be written beside it; the disk may be full")
        if sheet.colours:
            _extra_band_is_no_alpha(temporary)


def _convert(scratch: str, layer: str, temporary: Path, sheet: Sheet) -> None:
    """Make the COG ``layer``; a virtual raster that may be needed on the way lies beside ``temporary``."""
    options = {"COMPRESS": "DEFLATE", "PREDICTOR": "YES", "LEVEL": str(sheet.level), "BIGTIFF": "IF_SAFER"}
    options |= {"OVERVIEW_RESAMPLING": sheet.overviews, "BLOCKSIZE": str(sheet.block), "STATISTICS": "YES"}
    options |= {"NUM_THREADS": gdal_threads(), "SPARSE_OK": "NO" if sheet.everywhere else "YES"}
    named = _name_categories(scratch, temporary.with_name(f"{temporary.stem}.vrt"), sheet.layers)
    rasterio.shutil.copy(named, layer, driver="COG", **options)


def gdal_threads() -> str:
    """Give how many threads GDAL may pack blocks with; they are written in order, so the bytes do not depend on it.

    GDAL waits for ever for a thread that could not be started (seen in 3.10). So it gets one where memory has a limit
    (``ulimit -v``: what GDAL takes may leave no room for a thread's stack), or where as many as there are cores cannot
    be started at this moment.
    """
    if resource is not None and resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY:
        return "1"
    end = threading.Event()
    started: list[threading.Thread] = []
    try:
        for _ in range(os.cpu_count() or 1):
            thread = threading.Thread(target=end.wait)
            thread.start()
            started.append(thread)
    except RuntimeError:
        return "1"
    finally:
        end.set()
        for thread in started:
            thread.join()
    return "ALL_CPUS"


def _write_scratch(
    scratch: str,
    placement: Placement,
    sheet: Sheet,
    paint: Callable[[RasterWindow], NDArray[np.generic] | None],
    side: int | None,
) -> list[tuple[Window, int]]:
    """Paint the raster window by window; give those that were painted, with their checksums.

    Without a ``side`` all is painted at once, in one write that cannot lose a part, and there are no checksums.
    """
    pixels = sheet.pixels
    painted: list[tuple[Window, int]] = []
    with rasterio.open(
        scratch,
        "w",
        driver="GTiff",
        width=placement.window.cols * pixels,
        height=placement.window.rows * pixels,
        count=len(sheet.layers),
        dtype=sheet.dtype,
        nodata=sheet.nodata,
        crs=None if sheet.crs is None else rasterio.crs.CRS.from_wkt(sheet.crs.to_wkt()),
        transform=placement.transform(pixels),
        tiled=True,
        interleave="band",
        blockxsize=_SCRATCH_BLOCK,
        blockysize=_SCRATCH_BLOCK,
        sparse_ok=True,
        bigtiff="IF_SAFER",
        photometric="MINISBLACK",
        alpha="NO",
    ) as file:
        file.update_tags(**sheet.about)
        for number, layer in enumerate(sheet.layers, start=1):
            file.set_band_description(number, layer.name)
            file.set_band_unit(number, layer.unit)
            file.update_tags(number, **({"long_name": layer.text} if layer.text else {}))
        if sheet.colours:
            file.write_colormap(1, sheet.colours)
        whole = max(placement.window.cols, placement.window.rows)
        for window in placement.windows(side or whole, aligned=side is not None):
            canvas = paint(window)
            if canvas is not None:
                across, down = canvas.shape[2], canvas.shape[1]
                place = Window(window.column * pixels, window.line * pixels, across, down)
                file.write(canvas, window=place)
                painted += [] if side is None else [(place, digest(canvas))]
    return painted


def _name_categories(scratch: str, virtual: Path, layers: Sequence[Layer]) -> str:
    # rasterio cannot set category names; GDAL takes them from a virtual raster, and the COG driver passes them on.
    if not any(layer.categories for layer in layers):
        return scratch
    rasterio.shutil.copy(scratch, virtual, driver="VRT")
    tree = ET.parse(virtual)  # noqa: S314 (GDAL has just written it)
    for band, layer in zip(tree.getroot().iter("VRTRasterBand"), layers, strict=True):
        names = ET.SubElement(band, "CategoryNames")
        for category in layer.categories:
            ET.SubElement(names, "Category").text = category
    tree.write(virtual, encoding="utf-8")
    return str(virtual)


def _extra_band_is_no_alpha(path: Path) -> None:
    """Say in every directory of the file that the band after the colour-mapped one is no transparency.

    GDAL takes the second band of a colour-mapped TIFF for alpha whenever it copies one, without an option to say
    otherwise (seen in 3.6, 3.10), and viewers would fade the classes by the reason code. The tag's value is two
    bytes in place, so the layout stays that of a COG. Layout: TIFF 6.0 section 2, BigTIFF with 8-byte offsets.
    """
    with path.open("rb+") as file:
        head = file.read(16)
        if head[:2] != b"II" or head[2] not in {42, 43}:
            raise RasterioError(f"{path} is not a little-endian TIFF")
        count, entry, link = ("<H", 12, "<I") if head[2] == 42 else ("<Q", 20, "<Q")
        (offset,) = struct.unpack_from(link, head, 4 if head[2] == 42 else 8)
        while offset:
            file.seek(offset)
            (entries,) = struct.unpack(count, file.read(struct.calcsize(count)))
            start = file.tell()
            table = file.read(entries * entry + struct.calcsize(link))
            for at in range(0, entries * entry, entry):
                if struct.unpack_from("<H", table, at)[0] == _EXTRA_SAMPLES:
                    file.seek(start + at + entry - struct.calcsize(link))
                    file.write(struct.pack("<H", 0))
            (offset,) = struct.unpack_from(link, table, entries * entry)
