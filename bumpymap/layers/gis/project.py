"""Write map.qgs, a QGIS project of the layers of a map."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from pyproj import CRS
from pyproj.exceptions import CRSError
from rasterio.errors import RasterioError

from bumpymap.core import OutputError, horizontal_of, stated_crs
from bumpymap.layers.gis.facts import StyleFacts
from bumpymap.layers.gis.project_parts import LayerGroup, ProjectLayer, canvas, layer_element, reference, tree
from bumpymap.layers.gis.raster_style import MULTIPLY
from bumpymap.layers.gis.styles import layer_style
from bumpymap.layers.gis.xml_file import QGIS_VERSION, add, write_qgis
from bumpymap.layers.map_files import open_layer
from bumpymap.layers.sheets.folders import raster_in

__all__ = ["write_project"]

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
        root.append(canvas(_bounds(folder / layer.source), crs))
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


def _bounds(path: Path) -> tuple[float, float, float, float]:
    """Return west, south, east, north of a raster."""
    try:
        with open_layer(path) as raster:
            west, south, east, north = map(float, raster.bounds)
            return west, south, east, north
    except RasterioError as error:
        raise OutputError(f"cannot read the extent of {path} for {_NAME}: {error}") from error
