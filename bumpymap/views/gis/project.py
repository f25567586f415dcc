"""Write map.qgs, a QGIS project of the layers of a map."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any
from xml.etree import ElementTree as ET

from pyproj import CRS
from pyproj.exceptions import CRSError

from bumpymap.core import horizontal_of, stated_crs
from bumpymap.layers import open_layer, raster_in, virtual_name
from bumpymap.views.gis.styles import MULTIPLY, NORMAL, QGIS_VERSION, StyleFacts, add, layer_style, write_qgis

__all__ = ["write_project"]

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
    """True if it is the virtual raster over those of sheets."""
    part: str = ""
    """Part of the file that it shows, if not the one that the file itself opens with; see `layer_style`."""

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
        """True if it holds pixels; else polygons."""
        return PurePath(self.file).suffix == ".tif"


@dataclass(frozen=True, slots=True)
class LayerGroup:
    """Layers, or groups of them, under one heading."""

    title: str
    layers: "tuple[ProjectLayer | LayerGroup, ...]"
    expanded: bool = True
    one_of: bool = False
    """True if showing one of them hides the others."""
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


_NAME = "map.qgs"
_CLASS = ProjectLayer("class.tif", "roughness class", MULTIPLY, visible=True)
_FAILS = ProjectLayer("roughness.tif", "most drives fail", visible=True, part="p_fail")
_C_R = ProjectLayer("roughness.tif", "c_r of the drives that get through", MULTIPLY, visible=True)
_COST = ProjectLayer("cost.tif", "cost of driving", MULTIPLY)
_ABOVE = (
    LayerGroup(
        "Why not",
        (
            ProjectLayer("barred.tif", "barred"),
            ProjectLayer("reason.tif", "reason for no class", MULTIPLY, visible=True),
            ProjectLayer("obstacle.tif", "obstacles"),
            ProjectLayer("passage.tif", "where the vehicle fits"),
        ),
        expanded=False,
    ),
    LayerGroup("Regions", (ProjectLayer("cost.fgb", "regions", MULTIPLY),), expanded=False),
)
_GROUND = LayerGroup(
    "Ground",
    (
        ProjectLayer("heightmap.tif", "measured heights, with holes"),
        ProjectLayer("relief.tif", "relief, holes filled", visible=True),
    ),
)


def write_project(folder: Path, record: Mapping[str, Any]) -> None:
    """Write map.qgs: the layers in a folder, styled, the classes over the relief, paths relative to the folder.

    Parameters
    ----------
    folder : Path
        The folder of the layers. The project lists those that are there; of a map in sheets, the virtual rasters.
    record : mapping
        The record of the run, as in run.json.

    Raises
    ------
    OutputError
        The project cannot be written, or a layer cannot be read.
    """
    facts, crs, title = StyleFacts.of(folder, record), _horizontal_crs(record), _title(record)
    groups = [group.found_in(partial(_in_folder, folder)) for group in _groups(facts.speeds)]
    root = ET.Element("qgis", {"version": QGIS_VERSION, "projectname": title})
    add(root, "homePath", {"path": ""})
    add(root, "title", text=title)
    if crs is not None:
        add(root, "projectCrs").append(reference(crs))
    root.append(tree(group for group in groups if group.layers))
    present = [layer for group in groups for layer in group.leaves()]
    for layer in [layer for layer in present if layer.is_raster][:1]:  # all rasters have the same extent
        with open_layer(folder / layer.source) as raster:
            root.append(canvas(raster.bounds, crs))
    layers = add(root, "projectlayers")
    for layer in present:
        style = layer_style(layer.file, facts, layer.blend, layered=True, part=layer.part)
        layers.append(layer_element(layer, style, crs))
    properties = add(root, "properties")
    add(add(properties, "Paths"), "Absolute", {"type": "bool"}, "false")
    add(add(properties, "SpatialRefSys"), "ProjectionsEnabled", {"type": "int"}, "0" if crs is None else "1")
    about = add(root, "projectMetadata")
    add(about, "type", text="dataset")
    add(about, "title", text=title)
    add(about, "abstract", text=_abstract(record, facts))
    write_qgis(root, folder / _NAME)


def _groups(speeds: tuple[float, ...]) -> tuple[LayerGroup, ...]:
    """Return the groups of the project, the topmost first; the ride at other speeds [m/s] lies where the map's does."""
    told = [(f"{speed:g}", f"c_r at {speed:g} m/s") for speed in speeds]
    others = tuple(ProjectLayer("speeds.tif", title, MULTIPLY, part=part) for part, title in told)
    rides = (LayerGroup("at one speed", (_C_R, *others), one_of=True),) if others else (_C_R,)
    c_r = LayerGroup("ride cost c_r", (_FAILS, *rides), expanded=False, visible=False)
    return (*_ABOVE, LayerGroup("Ride", (_CLASS, c_r, _COST), one_of=True), _GROUND)


def _in_folder(folder: Path, layer: ProjectLayer) -> ProjectLayer | None:
    """Return a layer as it is in a folder; None if it is not there."""
    path = raster_in(folder, layer.file)
    return replace(layer, virtual=path != folder / layer.file) if path.is_file() else None


def _title(record: Mapping[str, Any]) -> str:
    survey = record.get("survey")
    name = survey.get("name") if isinstance(survey, Mapping) else None
    return f"{name}: ride cost" if name else "ride cost"


def _abstract(record: Mapping[str, Any], facts: StyleFacts) -> str:
    """Return for which vehicle and with which calibration the layers were made."""
    calibration = record.get("calibration")
    known = calibration if isinstance(calibration, Mapping) else {}
    lines = ["Roughness and ride cost of the ground, made by bumpymap from a point cloud."]
    preferences = known.get("preferences")
    about = preferences.get("description") if isinstance(preferences, Mapping) else None
    lines += [f"Vehicle: {known.get('vehicle', 'not known')}{f' ({about})' if about else ''}."]
    lines += [f"Calibration: {known.get('id', 'not known')}."]
    lines += [f"Class {number}: {label}." for number, label in enumerate(facts.class_labels)]
    return "\n".join(lines)


def _horizontal_crs(record: Mapping[str, Any]) -> CRS | None:
    """Return the horizontal CRS of a map, which is that of all its layers in the project; None without one."""
    found = record.get("crs")
    wkt = found.get("wkt") if isinstance(found, Mapping) else None
    if not isinstance(wkt, str):
        return None
    try:
        return horizontal_of(stated_crs(wkt))
    except CRSError:
        return None
