"""The styles of what drives show of a map: stretches as points, tiles as areas, coloured by how far the map is off."""

from pathlib import Path
from xml.etree import ElementTree as ET

from bumpymap.layers.check.offset import OFF_KINDS
from bumpymap.layers.colours import OFF_COLOURS
from bumpymap.layers.gis.vector_style import areas_by_kind, points_by_kind
from bumpymap.layers.gis.xml_file import QGIS_VERSION, write_qgis

__all__ = ["write_check_style"]


def write_check_style(path: Path, *, areas: bool) -> None:
    """Write check.qml, which QGIS takes for check.geojson, or check_tiles.qml for check_tiles.geojson.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    root = ET.Element("qgis", {"version": QGIS_VERSION, "styleCategories": "Symbology"})
    looks = [(name, name, OFF_COLOURS[code]) for code, name in enumerate(OFF_KINDS)]
    if areas:
        root.extend(areas_by_kind("off", [(*look, "solid") for look in looks]))
    else:
        root.extend(points_by_kind("off", looks, '"explained" = false'))
    write_qgis(root, path)
