"""Elements of a QGIS project: layers, their tree, a CRS, the extent that is shown first."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from xml.etree import ElementTree as ET

from pyproj import CRS

from bumpymap.layers.gis.raster_style import NORMAL
from bumpymap.layers.gis.xml_file import add
from bumpymap.layers.sheets.folders import virtual_name

__all__ = ["LayerGroup", "ProjectLayer", "canvas", "layer_element", "reference", "tree"]

_MARGIN = 0.04
"""Ground around the layers when the project is opened, as a share of their larger side."""


@dataclass(frozen=True, slots=True)
class ProjectLayer:
    """A file as a layer of the project."""

    file: str
    title: str
    blend: int = NORMAL
    visible: bool = False
    virtual: bool = False
    """Whether it is the virtual raster over those of sheets."""
    part: str = ""
    """What it shows, if not what the file itself opens with; see `layer_style`."""

    @property
    def id(self) -> str:
        """From the name of the file, and longer than ten characters: QGIS does not find layers with shorter ones."""
        return "_".join(filter(None, ("bumpymap", self.file.replace(".", "_"), self.part)))

    @property
    def source(self) -> str:
        """The file that QGIS opens."""
        return virtual_name(self.file) if self.virtual else self.file

    @property
    def is_raster(self) -> bool:
        """Whether it holds pixels; else polygons."""
        return PurePath(self.file).suffix == ".tif"


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """Layers, or groups of them, under one heading."""

    title: str
    layers: "tuple[ProjectLayer | LayerGroup, ...]"
    expanded: bool = True
    one_of: bool = False
    """Whether showing one of them hides the others."""
    visible: bool = True

    def found_in(self, find: Callable[[ProjectLayer], ProjectLayer | None]) -> "LayerGroup":
        """Return the group with those layers that ``find`` gives, and groups that have one."""
        kept: list[ProjectLayer | LayerGroup] = []
        for child in self.layers:
            if isinstance(child, LayerGroup):
                inner = child.found_in(find)
                kept += [inner] if inner.layers else []
            elif found := find(child):
                kept.append(found)
        return replace(self, layers=tuple(kept))

    def leaves(self) -> Iterator[ProjectLayer]:
        """Yield its layers and those of its groups, the topmost first."""
        for child in self.layers:
            if isinstance(child, LayerGroup):
                yield from child.leaves()
            else:
                yield child


def tree(groups: Iterable[LayerGroup]) -> ET.Element:
    """Return the tree of layers, the topmost group first."""
    root = ET.Element("layer-tree-group")
    for group in groups:
        _add_group(root, group)
    return root


def _add_group(parent: ET.Element, group: LayerGroup) -> None:
    shown = any(child.visible for child in group.layers) or group.one_of
    looks = {"name": group.title, "expanded": _flag(group.expanded), "checked": _checked(visible=group.visible)}
    if group.one_of:
        chosen = next((number for number, child in enumerate(group.layers) if child.visible), -1)
        looks |= {"mutually-exclusive": "1", "mutually-exclusive-child": str(chosen)}
    branch = add(parent, "layer-tree-group", looks)
    for child in group.layers:
        if isinstance(child, LayerGroup):
            _add_group(branch, child)
            continue
        leaf = {
            "id": child.id,
            "name": child.title,
            "source": f"./{child.source}",
            "providerKey": _provider(child),
            "expanded": _flag(child.visible or not shown),
            "checked": _checked(visible=child.visible),
        }
        add(branch, "layer-tree-layer", leaf)


def layer_element(layer: ProjectLayer, style: Sequence[ET.Element], crs: CRS | None) -> ET.Element:
    """Return a layer with its style, in a CRS."""
    kind = {"type": "raster"} if layer.is_raster else {"type": "vector", "geometry": "Polygon"}
    element = ET.Element("maplayer", kind | {"styleCategories": "AllStyleCategories"})
    add(element, "id", text=layer.id)
    add(element, "datasource", text=f"./{layer.source}")
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
