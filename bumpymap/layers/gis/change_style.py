"""The style of what has changed between two surveys, for its raster and for its places."""

from pathlib import Path
from xml.etree import ElementTree as ET

from bumpymap.core import CHANGE_KINDS
from bumpymap.layers.colours import CHANGE_COLOURS
from bumpymap.layers.gis.raster_style import paletted
from bumpymap.layers.gis.vector_style import areas_by_kind
from bumpymap.layers.gis.xml_file import QGIS_VERSION, write_qgis

__all__ = ["write_change_style"]


def write_change_style(path: Path, band: int) -> None:
    """Write change.qml: QGIS takes it for change.tif and change.geojson, since both have its name.

    Parameters
    ----------
    path : Path
        The file.
    band : int
        Band of change.tif with the codes, from 1.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    root = ET.Element("qgis", {"version": QGIS_VERSION, "styleCategories": "Symbology"})
    raster = paletted(enumerate(CHANGE_KINDS), CHANGE_COLOURS, band=band).elements()
    places = areas_by_kind("kind", [(name, name, CHANGE_COLOURS[code], "solid") for code, name in _CHANGED])
    known = {element.tag for element in raster}
    root.extend([*raster, *(element for element in places if element.tag not in known)])
    write_qgis(root, path)


_CHANGED = list(enumerate(CHANGE_KINDS))[1:]
