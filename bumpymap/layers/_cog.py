"""Write cloud-optimised GeoTIFFs (COG), and names, colours and pixel counts of their values in ``NAME.tif.aux.xml``.

A sparse scratch raster is filled window by window, so that memory does not grow with the survey or with gaps in it.
GDAL's COG driver then converts it and adds overviews and statistics. Small rasters never leave memory.

GDAL reports no error when the disk fills up while it writes a TIFF. Seen in GDAL 3.10: blocks that are flushed when a
file is closed are lost without an error (libtiff prints a line to stderr), and the COG driver may crash on a full disk.
A thread that writes a raster also loses parts of blocks while another one reads or writes any: the other flushes its
blocks to free cache, and it reads them back too early. So it does if another thread only enters rasterio's environment
with another limit of the cache, which is the limit of the process: GDAL then flushes blocks down to it. Therefore small
rasters are made in memory and written by Python; a large one is made only if the disk has space for it, and is read
back afterwards; and threads take turns to write, read and trace rasters: `raster_lock`.

rasterio cannot write category names and raster attribute tables. The layout of the side file is that of GDAL's
``PAMDataset``; types and usages are the numbers of GDAL's ``GDALRATFieldType`` and ``GDALRATFieldUsage``.
"""

import os
import resource
import shutil
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree as ET

import numpy as np
import rasterio
import rasterio.shutil
from numpy.typing import NDArray
from rasterio.enums import Resampling
from rasterio.errors import RasterioError, StatisticsError
from rasterio.io import MemoryFile
from rasterio.windows import Window

from bumpymap.core import atomic, raster_lock
from bumpymap.layers.placement import Placement, RasterSpec, RasterWindow
from bumpytiles import BLOCK_TILES


def checksum(pixels: NDArray[np.generic]) -> int:
    """Return the CRC-32 of pixels; NaN counts as 0, whatever its bits."""
    return zlib.crc32(np.ascontiguousarray(np.nan_to_num(pixels)).data)


def require_intact(path: Path, painted: Iterable[tuple[Window, int]], *, mask_only: bool = False) -> None:
    """Read a raster back; raise OSError if a window does not match its `checksum` or an overview is unreadable.

    With ``mask_only`` the checksums are of the mask: JPEG changes the colours.
    """
    with rasterio.open(path) as raster:
        levels = len(raster.overviews(1))
        read = raster.dataset_mask if mask_only else raster.read
        if not all(checksum(read(window=window)) == expected for window, expected in painted):
            raise OSError("what was written cannot be read back; the disk may be full")
    for level in range(levels):
        with rasterio.open(path, overview_level=level) as raster:
            for _, window in raster.block_windows(1):
                raster.read(window=window)


_INTEGER, _REAL, _STRING = 0, 1, 2
"""Of ``GDALRATFieldType``."""
_FIELDS = {
    "Value": (_INTEGER, 5),
    "Count": (_INTEGER, 1),
    "Class": (_STRING, 2),
    "Red": (_INTEGER, 6),
    "Green": (_INTEGER, 7),
    "Blue": (_INTEGER, 8),
    "Alpha": (_INTEGER, 9),
}
"""Column -> type and usage: value (smallest and largest), number of pixels, name, parts of its colour."""
_LARGEST_INTEGER = 2**31 - 1
"""GDAL's integer columns have 32 bits; larger counts are real numbers, exact up to 2**53."""


def write_value_table(
    raster: Path, names: Sequence[str], colours: Mapping[int, tuple[int, int, int, int]], counts: NDArray[np.int64]
) -> None:
    """Add category names and an attribute table of band 1 to the side file of a raster.

    ``names``: names of the values 0, 1, 2, ...; ``colours``: red, green, blue, alpha of the values that pixels can
    have; those without a name (nodata) get no row; ``counts`` (256,): number of pixels of each value in the whole
    raster. Raises OSError: the file cannot be written; ParseError: GDAL has written a side file that was cut short, as
    by a full disk.
    """
    path = raster.with_name(f"{raster.name}.aux.xml")
    root = ET.parse(path).getroot() if path.exists() else ET.Element("PAMDataset")  # noqa: S314 (GDAL's own)
    band = ET.SubElement(root, "PAMRasterBand", band="1")
    listed = ET.SubElement(band, "CategoryNames")
    for name in names:
        ET.SubElement(listed, "Category").text = name
    rows = [(value, int(counts[value]), name, *colours[value]) for value, name in enumerate(names) if value in colours]
    table = ET.SubElement(band, "GDALRasterAttributeTable", tableType="thematic")
    for number, (name, (kind, usage)) in enumerate(_FIELDS.items()):
        large = any(isinstance(row[number], int) and int(row[number]) > _LARGEST_INTEGER for row in rows)
        field = ET.SubElement(table, "FieldDefn", index=str(number))
        for tag, value in (("Name", name), ("Type", _REAL if large else kind), ("Usage", usage)):
            ET.SubElement(field, tag).text = str(value)
    for number, row in enumerate(rows):
        element = ET.SubElement(table, "Row", index=str(number))
        for value in row:
            ET.SubElement(element, "F").text = str(value)
    ET.indent(root)
    path.write_bytes(ET.tostring(root, encoding="utf-8") + b"\n")


_FAILURES: tuple[type[Exception], ...] = (RasterioError, rasterio._err.CPLE_BaseError, ET.ParseError)  # noqa: SLF001 (no public name)
_GDAL = {"GDAL_CACHEMAX": 64, "COG_TMP_COMPRESSION": "NONE"}
"""The block cache, bytes, as rasterio takes a whole number: next to none, since every block is written once. A map of
10 million points takes the same processor time with 64 MB. Temporary overviews are not compressed: compressing them
took a third of the time of a dense raster and two thirds of that of an empty one."""
_SCRATCH_BLOCK = 256
"""Side of a block of the scratch raster, pixels. Writing 11 bands of 2560 x 2560 pixels takes 13 s of CPU time; blocks
of 512 pixels, or pixel interleaving, were measured to take up to 3 times as long."""
SMALL = 128 << 20
"""Largest scratch raster that is kept in memory, bytes; a file takes twice the time, as it is read back."""
_PAINTED_BEFORE = 32 << 20
"""Largest scratch raster whose pixels are made before its thread waits for GDAL, bytes."""
OVERVIEWS_FIRST_FROM = 128 << 20
"""Size as a scratch raster from which one of several bands gets its overviews before it is converted, bytes."""
_is_fork = False
"""True if this process was forked: GDAL's threads, if it had any, have stayed in the other."""


def _reset_after_fork() -> None:
    global _is_fork  # noqa: PLW0603 (of the process)
    _is_fork = True


os.register_at_fork(after_in_child=_reset_after_fork)


def write_cog(
    path: Path,
    placement: Placement,
    spec: RasterSpec,
    paint: Callable[[RasterWindow], NDArray[np.generic] | None],
    side: int,
) -> None:
    """Write a COG; the file appears only when it is complete.

    ``placement``: extent and CRS of the raster; ``spec``: bands, data type, overviews; ``paint``: returns the pixels of
    a window, (bands, lines * pixels, columns * pixels), north up; None if all are nodata; ``side``: side of a window in
    tiles, a multiple of a block's. Raises OutputError: the file cannot be written.
    """
    with atomic(path, _FAILURES) as temporary:
        pixels = placement.window.cols * placement.window.rows * spec.pixels**2
        size = pixels * len(spec.bands) * np.dtype(spec.dtype).itemsize
        # Of a photo GDAL leaves out the overviews that the scratch raster has: it makes a mask of the alpha first.
        large = len(spec.bands) > 1 and size > OVERVIEWS_FIRST_FROM and not spec.is_photo
        overviews_first = spec.counts_nodata or large
        counts = np.zeros(256, np.int64)
        block = max(spec.block, _SCRATCH_BLOCK)
        across, down = (
            -(-side * spec.pixels // block) * block for side in (placement.window.cols, placement.window.rows)
        )
        scratch_size = across * down * len(spec.bands) * np.dtype(spec.dtype).itemsize
        painted: Iterable[_Painted] = (
            (Window(part.column * spec.pixels, part.line * spec.pixels, canvas.shape[2], canvas.shape[1]), canvas)
            for part in placement.windows(side, aligned=True)
            if (canvas := paint(part)) is not None
        )
        if scratch_size <= _PAINTED_BEFORE:
            painted = list(painted)
        with raster_lock(), rasterio.Env(**_GDAL):
            if scratch_size <= SMALL:
                with MemoryFile(ext=".tif") as scratch, MemoryFile(ext=".tif") as layer:
                    for _, canvas in _write_scratch(scratch.name, placement, spec, painted):
                        _count(canvas, spec, counts)  # no checksum: memory loses nothing
                    painted = ()
                    _convert(scratch.name, layer.name, spec, overviews_first=overviews_first)
                    with rasterio.open(layer.name) as file:
                        has_side_file = len(file.files) > 1  # such as one with a CRS without GeoTIFF keys
                    if has_side_file:
                        rasterio.shutil.copyfiles(layer.name, str(temporary))
                    temporary.write_bytes(layer.getbuffer())
            else:
                waiting, checksums = temporary.with_name(f"{temporary.stem}.scratch.tif"), []
                for window, canvas in _write_scratch(str(waiting), placement, spec, painted):
                    exact = canvas[-1] if spec.is_photo else canvas  # of a photo the alpha is stored as it is
                    checksums.append((window, checksum(exact)))
                    _count(canvas, spec, counts)
                needed, free = waiting.stat().st_size, shutil.disk_usage(path.parent).free
                if free < needed:
                    raise OSError(f"up to {needed / 1e9:.1f} GB are needed and {free / 1e9:.1f} GB are free")
                _convert(str(waiting), str(temporary), spec, overviews_first=overviews_first)
                waiting.unlink()
                require_intact(temporary, checksums, mask_only=spec.is_photo)
        side_file = temporary.with_name(f"{temporary.name}.aux.xml")
        if side_file.exists():  # GDAL reports no error when the disk is full
            ET.parse(side_file)  # noqa: S314 (GDAL has just written it; fails if it was cut short)
        for band in spec.bands:
            if band.categories:
                write_value_table(temporary, band.categories, spec.colours, counts)


TILE_WINDOW = 16 * BLOCK_TILES
"""Side of a window of a raster with one pixel a tile, tiles: whole blocks, so that none is read twice."""


def _count(pixels: NDArray[np.generic], spec: RasterSpec, counts: NDArray[np.int64]) -> None:
    """Add pixels (uint8, any shape) that were painted to the counts (256,) of each value, if the values have names."""
    if any(band.categories for band in spec.bands):
        counts += np.bincount(pixels.ravel(), minlength=256)


def _convert(scratch: str, layer: str, spec: RasterSpec, *, overviews_first: bool) -> None:
    """Convert the scratch raster to the COG ``layer``.

    With ``overviews_first`` the scratch raster gets the overviews: GDAL's COG driver makes them in a file that keeps
    all bands of a pixel together, and writes each block of it once for every band, 12 GB for 5,000 x 5,000 pixels of
    18 bands, however empty.
    """
    options = {"COMPRESS": "DEFLATE", "PREDICTOR": "YES", "LEVEL": str(spec.level), "BIGTIFF": "IF_SAFER"}
    if spec.is_photo:
        options = {"COMPRESS": "JPEG", "QUALITY": "85", "BIGTIFF": "IF_SAFER"}  # per cent: chosen
    options |= {"OVERVIEW_RESAMPLING": spec.overviews, "BLOCKSIZE": str(spec.block)}
    if not spec.counts_nodata and not spec.is_photo:  # a mean of codes says nothing
        # The driver takes them over. Where it makes them itself, by its option STATISTICS, it goes through a raster
        # without a name, for which GDAL (3.10) opens the files .ovr and .msk of the current folder by any driver: they
        # may lead to a URL.
        with rasterio.open(scratch, "r+") as file, suppress(StatisticsError):  # a band without a value has none
            file.update_stats(approx=False)
    if overviews_first:
        _build_overviews(scratch, spec)
        options["OVERVIEWS"] = "FORCE_USE_EXISTING"
    options |= {"NUM_THREADS": gdal_threads(), "SPARSE_OK": "YES"}
    rasterio.shutil.copy(scratch, layer, driver="COG", **options)


def _build_overviews(scratch: str, spec: RasterSpec) -> None:
    """Give the scratch raster overviews, which GDAL's COG driver takes over.

    With ``counts_nodata`` nodata is a value among others in them. By itself GDAL leaves it out of the count: three
    unknown tiles and a smooth one would be smooth.
    """
    sparse = "NO" if spec.counts_nodata else "YES"
    with rasterio.Env(SPARSE_OK_OVERVIEW=sparse), rasterio.open(scratch, "r+") as file:
        longest, factors = max(file.shape), [2]
        while -(-longest // factors[-1]) > spec.block:
            factors.append(2 * factors[-1])
        if longest > spec.block:
            if spec.counts_nodata:
                file.nodata = None
            file.build_overviews(factors, Resampling[spec.overviews.lower()])
            if spec.counts_nodata:
                file.nodata = spec.nodata


def gdal_threads() -> str:
    """Return the number of threads that GDAL may compress blocks with, for its option ``NUM_THREADS``.

    Blocks are written in order, so the bytes do not depend on it. GDAL waits forever for a thread that could not be
    started (seen in 3.10), so it gets one thread if address space is limited (with ``ulimit -v``, GDAL's own memory may
    leave no space for a thread's stack), or in a forked process, in which those that it has started are not.
    """
    limited = resource.getrlimit(resource.RLIMIT_AS)[0] != resource.RLIM_INFINITY
    return "1" if limited or _is_fork else "ALL_CPUS"


_Painted: TypeAlias = tuple[Window, NDArray[np.generic]]
"""A window of a raster in pixels, and the pixels in it."""


def _write_scratch(
    scratch: str, placement: Placement, spec: RasterSpec, painted: Iterable[_Painted]
) -> Iterator[_Painted]:  # fmt: skip
    """Fill the scratch raster window by window; yield what was written."""
    with rasterio.open(
        scratch,
        "w",
        driver="GTiff",
        width=placement.window.cols * spec.pixels,
        height=placement.window.rows * spec.pixels,
        count=len(spec.bands),
        dtype=spec.dtype,
        nodata=None if spec.is_photo else spec.nodata,
        crs=None if spec.crs is None else rasterio.crs.CRS.from_wkt(spec.crs.to_wkt()),
        transform=placement.transform(spec.pixels),
        tiled=True,
        interleave="band",
        blockxsize=_SCRATCH_BLOCK,
        blockysize=_SCRATCH_BLOCK,
        sparse_ok=not spec.counts_nodata,  # overviews would take a block that is not written for zeros
        bigtiff="IF_SAFER",
        photometric="RGB" if spec.is_photo else "MINISBLACK",
        alpha="YES" if spec.is_photo else "NO",
    ) as file:
        file.update_tags(**spec.tags)
        for number, band in enumerate(spec.bands, start=1):
            file.set_band_description(number, band.name)
            file.set_band_unit(number, band.unit)
            file.update_tags(number, **({"long_name": band.description} if band.description else {}))
        if spec.colours:
            file.write_colormap(1, spec.colours)
        for window, canvas in painted:
            file.write(canvas, window=window)
            yield window, canvas
