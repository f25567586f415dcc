"""Write virtual rasters (VRT): one file that shows the rasters of all sheets as one.

GDAL makes the VRT of one sheet, which has every name, unit, colour and CRS; size, position and sources are replaced.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import rasterio
import rasterio.shutil
from rasterio.errors import RasterioError

from bumpymap.core import BadInputError, atomic
from bumpymap.layers._value_table import sum_counts
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.placement import Placement
from bumpytiles import TileWindow

__all__ = ["write_virtual"]

_FAILURES: tuple[type[Exception], ...] = (RasterioError, rasterio._err.CPLE_BaseError)  # noqa: SLF001 (no public name)
_OF_ONE_SHEET = "STATISTICS_"
"""Metadata of this name do not hold for all sheets."""


@dataclass(frozen=True, slots=True)
class _Source:
    """A raster of a sheet."""

    path: str
    width: int
    height: int
    block: tuple[int, int]
    """Rows and columns."""
    left: int
    """Place in the virtual raster, pixels."""
    top: int


def write_virtual(path: Path, root: Path, placement: Placement, sheets: Mapping[str, TileWindow]) -> None:
    """Write a virtual raster; the same sheets give the same bytes.

    Parameters
    ----------
    path : Path
        The file to write, ``NAME.vrt`` for the rasters ``NAME.tif``.
    root : Path
        The folder that it will be moved to: paths in it are relative to this one.
    placement : Placement
        The extent of all sheets.
    sheets : mapping
        Path, relative to ``root``, of the folder of each sheet, and the tiles that its rasters span.

    Raises
    ------
    OutputError
        The file cannot be written.
    BadInputError
        The raster of a sheet cannot be read.
    """
    raster = f"{path.stem}.tif"
    try:
        sources = [_source(root, f"{folder}/{raster}", placement.window, window) for folder, window in sheets.items()]
        tree = _template(path, root / sources[0].path)
    except _FAILURES as error:
        raise BadInputError(f"cannot read {raster} of a sheet in {root}: {error}. Map the survey again") from error
    pixels = sources[0].width // next(iter(sheets.values())).cols
    window = placement.window
    tree.set("rasterXSize", str(window.cols * pixels))
    tree.set("rasterYSize", str(window.rows * pixels))
    place = tree.find("GeoTransform")
    if place is not None:
        place.text = ", ".join(f"{number:.17g}" for number in placement.transform(pixels).to_gdal())
    for domain in tree.findall("Metadata[@domain]"):
        tree.remove(domain)
    for band in tree.iter("VRTRasterBand"):
        _fill_band(band, sources)
        table = band.find("GDALRasterAttributeTable")
        if table is not None and not sum_counts(table, [root / source.path for source in sources]):
            band.remove(table)  # better none than the counts of one sheet
    ET.indent(tree)
    with atomic(path) as temporary:
        temporary.write_bytes(ET.tostring(tree, encoding="utf-8") + b"\n")


def _source(root: Path, path: str, whole: TileWindow, window: TileWindow) -> _Source:
    with open_layer(root / path) as file:
        pixels = file.width // window.cols
        left = (window.col - whole.col) * pixels
        top = (whole.row + whole.rows - window.row - window.rows) * pixels
        return _Source(path, file.width, file.height, file.block_shapes[0], left, top)


def _template(path: Path, raster: Path) -> ET.Element:
    """Return the VRT that GDAL makes of one raster."""
    scratch = path.with_name(f".{path.stem}.one.vrt")
    try:
        rasterio.shutil.copy(str(raster), str(scratch), driver="VRT")
        return ET.parse(scratch).getroot()  # noqa: S314 (GDAL has just written it)
    finally:
        scratch.unlink(missing_ok=True)


def _fill_band(band: ET.Element, sources: Sequence[_Source]) -> None:
    """Replace the sources of a band, and remove what is true of one sheet only."""
    for one in band.findall("SimpleSource") + band.findall("ComplexSource"):
        band.remove(one)
    for metadata in band.findall("Metadata"):
        for entry in [entry for entry in metadata if entry.get("key", "").startswith(_OF_ONE_SHEET)]:
            metadata.remove(entry)
    number, kind = band.get("band", "1"), band.get("dataType", "")
    names, colours = band.find("CategoryNames"), band.find("ColorTable")
    if names is not None and colours is not None:
        for unused in colours[len(names) :]:  # a list of classes then shows those that exist
            colours.remove(unused)
    for source in sources:
        element = ET.SubElement(band, "SimpleSource")
        ET.SubElement(element, "SourceFilename", {"relativeToVRT": "1"}).text = source.path
        ET.SubElement(element, "SourceBand").text = number
        block = {"BlockXSize": str(source.block[1]), "BlockYSize": str(source.block[0])}
        raster = {"RasterXSize": str(source.width), "RasterYSize": str(source.height), "DataType": kind}
        ET.SubElement(element, "SourceProperties", raster | block)
        _add_box(element, "SrcRect", 0, 0, (source.width, source.height))
        _add_box(element, "DstRect", source.left, source.top, (source.width, source.height))


def _add_box(element: ET.Element, name: str, left: int, top: int, size: tuple[int, int]) -> None:
    sides = {"xOff": left, "yOff": top, "xSize": size[0], "ySize": size[1]}
    ET.SubElement(element, name, {side: str(value) for side, value in sides.items()})
