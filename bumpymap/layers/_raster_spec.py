"""Everything about a raster but its pixels, and a raster that is opened with it."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import rasterio
from pyproj import CRS

from bumpymap.layers.placement import Placement

__all__ = ["SCRATCH_BLOCK", "BandSpec", "RasterSpec", "open_raster"]

SCRATCH_BLOCK = 256
"""Side of a block of the scratch raster, pixels. Writing 11 bands of 2560 x 2560 pixels takes 13 s of CPU time; blocks
of 512 pixels, or pixel interleaving, were measured to take up to 3 times as long."""


@dataclass(frozen=True, slots=True)
class BandSpec:
    """Name, unit and description of one band."""

    name: str
    unit: str = ""
    text: str = ""
    """Description, written as ``long_name``."""
    categories: tuple[str, ...] = ()
    """Names of the values 0, 1, 2, ...; only for the band of a uint8 raster that has one."""


@dataclass(frozen=True, slots=True)
class RasterSpec:
    """Everything about a raster but its pixels."""

    bands: Sequence[BandSpec]
    dtype: str
    nodata: float
    pixels: int
    """Pixels along the side of a tile."""
    crs: CRS | None
    overviews: str
    """Resampling method of the overviews, as GDAL names it."""
    block: int
    """Side of an internal block of the file, pixels."""
    colours: dict[int, tuple[int, int, int, int]] = field(default_factory=dict)
    """Colours of the values of band 1 that pixels can have, nodata included."""
    tags: dict[str, str] = field(default_factory=dict)
    """Metadata of the file."""
    worst: tuple[int, ...] = ()
    """All values, the worst first: of four pixels, the overviews that `write_sparse_cog` makes keep the worst."""
    counts_nodata: bool = False
    """In overviews nodata is a value among others: for rasters of one pixel a tile whose nodata means unknown."""
    level: int = 6
    """DEFLATE compression level, 1 to 9."""


def open_raster(
    name: str, placement: Placement, spec: RasterSpec, size: tuple[int, int], bigtiff: str = "IF_SAFER"
) -> rasterio.io.DatasetWriter:
    """Open a new sparse GeoTIFF of ``size`` (width, height) pixels, with CRS, transform and metadata set."""
    file = rasterio.open(
        name,
        "w",
        driver="GTiff",
        width=size[0],
        height=size[1],
        count=len(spec.bands),
        dtype=spec.dtype,
        nodata=spec.nodata,
        crs=None if spec.crs is None else rasterio.crs.CRS.from_wkt(spec.crs.to_wkt()),
        transform=placement.transform(spec.pixels),
        tiled=True,
        interleave="band",
        blockxsize=SCRATCH_BLOCK,
        blockysize=SCRATCH_BLOCK,
        sparse_ok=not spec.counts_nodata,  # overviews would take a block that is not written for zeros
        bigtiff=bigtiff,
        photometric="MINISBLACK",
        alpha="NO",
    )
    _write_metadata(file, spec)
    return file


def _write_metadata(file: rasterio.io.DatasetWriter, spec: RasterSpec) -> None:
    file.update_tags(**spec.tags)
    for number, band in enumerate(spec.bands, start=1):
        file.set_band_description(number, band.name)
        file.set_band_unit(number, band.unit)
        file.update_tags(number, **({"long_name": band.text} if band.text else {}))
    if spec.colours:
        file.write_colormap(1, spec.colours)
