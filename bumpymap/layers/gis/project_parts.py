"""Elements of a QGIS project: layers, their tree, a CRS, the extent that is shown first."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from xml.etree import ElementTree as ET

from pyproj import CRS

from bumpymap.layers.gis.raster_style import NORMAL
from bumpymap.layers.gis.xml_file import add

__all__ = ["LayerGroup", "ProjectLayer", "canvas", "layer_element", "reference", "tree"]

_MARGIN = 0.04
"""Ground around the layers when the project is opened, as a share of their larger side."""


@dataclass(frozen=True, slots=True)
class ProjectLayer:
    """A file as a layer of the project."""

    layer: str
    """Name of the file in a map that is not in sheets, which decides its style."""
    title: str
    blend: int = NORMAL
    visible: bool = False
    found: str = ""
    """Name of the file in the folder of the project."""

    @property
    def id(self) -> str:
        """From the name of the layer, and longer than ten characters: QGIS does not find layers with shorter ones."""
        return f"bumpymap_{self.layer.replace('.', '_')}"

    @property
    def is_raster(self) -> bool:
        """Whether it holds pixels; else polygons."""
        return PurePath(self.layer).suffix == ".tif"


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """Layers under one heading."""

    title: str
    layers: tuple[ProjectLayer, ...]
    expanded: bool = True
    one_of: bool = False
    """Whether showing one layer hides the others."""


def tree(groups: Iterable[LayerGroup]) -> ET.Element:
    """Return the tree of layers, the topmost group first."""
    root = ET.Element("layer-tree-group")
    for group in groups:
        shown = any(layer.visible for layer in group.layers) or group.one_of
        looks = {"name": group.title, "expanded": _flag(group.expanded), "checked": _checked(visible=True)}
        if group.one_of:
            chosen = next((number for number, layer in enumerate(group.layers) if layer.visible), -1)
            looks |= {"mutually-exclusive": "1", "mutually-exclusive-child": str(chosen)}
        branch = add(root, "layer-tree-group", looks)
        for layer in group.layers:
            leaf = {
                "id": layer.id,
                "name": layer.title,
                "source": f"./{layer.found}",
                "providerKey": _provider(layer),
                "expanded": _flag(layer.visible or not shown),
                "checked": _checked(visible=layer.visible),
            }
            add(branch, "layer-tree-layer", leaf)
    return root


def layer_element(layer: ProjectLayer, style: Sequence[ET.Element], crs: CRS | None) -> ET.Element:
    """Return a layer with its style, in a CRS."""
    kind = {"type": "raster"} if layer.is_raster else {"type": "vector", "geometry": "Polygon"}
    element = ET.Element("maplayer", kind | {"styleCategories": "AllStyleCategories"})
    add(element, "id", text=layer.id)
    add(element, "datasource", text=f"./{layer.found}")
    add(element, "layername", text=layer.title)
    add(element, "srs").append(reference(crs))
    add(element, "provider", None if layer.is_raster else {"encoding": "UTF-8"}, _provider(layer))
    element.extend(style)
    return element


def reference(crs: CRS | None) -> ET.Element:
    """Return the element of a CRS; without one QGIS would take its default for the layer."""
    element = ET.Element("spatialrefsys")
    add(element, "wkt", text="" if crs is None else crs.to_wkt())
    return element


def canvas(bounds: tuple[float, float, float, float], crs: CRS | None) -> ET.Element:
    """Return the view that QGIS opens with: west, south, east, north in the CRS, and a margin."""
    west, south, east, north = bounds
    margin = _MARGIN * max(east - west, north - south)
    element = ET.Element("mapcanvas", {"name": "theMapCanvas", "annotationsVisible": "1"})
    extent = add(element, "extent")
    for tag, value in (
        ("xmin", west - margin),
        ("ymin", south - margin),
        ("xmax", east + margin),
        ("ymax", north + margin),
    ):
        add(extent, tag, text=repr(value))
    add(element, "rotation", text="0")
    add(element, "destinationsrs").append(reference(crs))
    return element


def _provider(layer: ProjectLayer) -> str:
    return "gdal" if layer.is_raster else "ogr"


def _flag(yes: bool) -> str:
    return "1" if yes else "0"


def _checked(*, visible: bool) -> str:
    return "Qt::Checked" if visible else "Qt::Unchecked"
