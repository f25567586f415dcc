"""The names, colours and pixel counts of a raster's values, in the side file ``NAME.tif.aux.xml``.

GDAL and the programs built on it read category names and raster attribute tables from there. rasterio cannot write
either. The layout is that of GDAL's ``PAMDataset``; types and usages are the numbers of GDAL's ``GDALRATFieldType`` and
``GDALRATFieldUsage``.
"""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

__all__ = ["count_values", "sum_counts", "write_value_table"]

_INTEGER, _REAL, _STRING = 0, 1, 2
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
_VALUE, _COUNT = 0, 1
"""Columns."""
_TABLE = "GDALRasterAttributeTable"
_LARGEST_INTEGER = 2**31 - 1
"""GDAL's integer columns have 32 bits; larger counts are real numbers, exact up to 2**53."""


def count_values(pixels: NDArray[np.generic]) -> NDArray[np.int64]:
    """Return the number of pixels (256,) that have each value; ``pixels`` are uint8 in any shape."""
    return np.bincount(pixels.ravel(), minlength=256)


def write_value_table(
    raster: Path, names: Sequence[str], colours: Mapping[int, tuple[int, int, int, int]], counts: NDArray[np.int64]
) -> None:
    """Add category names and an attribute table of band 1 to the side file of a raster.

    Parameters
    ----------
    raster : Path
    names : sequence of str
        Names of the values 0, 1, 2, ...
    colours : mapping
        Red, green, blue, alpha of the values that pixels can have; those without a name (nodata) get no row.
    counts : array (256,)
        Number of pixels of each value in the whole raster.

    Raises
    ------
    OSError
        The file cannot be written.
    ParseError
        GDAL has written a side file that was cut short, as by a full disk.
    """
    path = raster.with_name(f"{raster.name}.aux.xml")
    root = ET.parse(path).getroot() if path.exists() else ET.Element("PAMDataset")  # noqa: S314 (GDAL's own)
    band = ET.SubElement(root, "PAMRasterBand", band="1")
    listed = ET.SubElement(band, "CategoryNames")
    for name in names:
        ET.SubElement(listed, "Category").text = name
    rows = [(value, int(counts[value]), name, *colours[value]) for value, name in enumerate(names) if value in colours]
    _add_rows(ET.SubElement(band, _TABLE, tableType="thematic"), rows)
    ET.indent(root)
    path.write_bytes(ET.tostring(root, encoding="utf-8") + b"\n")


def sum_counts(table: ET.Element, rasters: Iterable[Path]) -> bool:
    """Replace the counts of an attribute table, that of any of the rasters, by their sums over all rasters.

    Returns
    -------
    bool
        False if a raster has no such table beside it: the counts are then unchanged.
    """
    totals: Counter[str] = Counter()
    for raster in rasters:
        try:
            side_file = ET.parse(raster.with_name(f"{raster.name}.aux.xml"))  # noqa: S314 (ours)
            found = side_file.getroot().find(f"PAMRasterBand/{_TABLE}")
            if found is None:
                return False
            for row in found.iter("Row"):
                totals[row[_VALUE].text or ""] += int(row[_COUNT].text or "")
        except (OSError, ET.ParseError, ValueError, IndexError):
            return False
    for row in table.iter("Row"):
        row[_COUNT].text = str(totals[row[_VALUE].text or ""])
    kind = table.findall("FieldDefn")[_COUNT].find("Type")
    if kind is not None and max(totals.values(), default=0) > _LARGEST_INTEGER:
        kind.text = str(_REAL)
    return True


def _add_rows(table: ET.Element, rows: Sequence[tuple[int | str, ...]]) -> None:
    for number, (name, (kind, usage)) in enumerate(_FIELDS.items()):
        large = any(isinstance(row[number], int) and int(row[number]) > _LARGEST_INTEGER for row in rows)
        field = ET.SubElement(table, "FieldDefn", index=str(number))
        for tag, value in (("Name", name), ("Type", _REAL if large else kind), ("Usage", usage)):
            ET.SubElement(field, tag).text = str(value)
    for number, row in enumerate(rows):
        element = ET.SubElement(table, "Row", index=str(number))
        for value in row:
            ET.SubElement(element, "F").text = str(value)
