"""map.qgs, a QGIS project of the layers of a map; and all views of them together."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path, PurePath
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from bumpymap.core import horizontal_of, stated_crs
from bumpymap.layers import REPORT_NAME, open_layer, raster_in, virtual_name
from bumpymap.views.gis.styles import MULTIPLY, NORMAL, StyleFacts, layer_style, write_qgis, write_styles
from bumpymap.views.page.map_page import write_map_page
from bumpymap.views.page.site import Site

__all__ = ["write_map_views", "write_project"]

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

    @property
    def provider(self) -> str:
        """Name of the provider of QGIS that reads it."""
        return "gdal" if self.is_raster else "ogr"


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


def write_map_views(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the styles, map.qgs and report.html of the layers in a folder.

    Parameters
    ----------
    folder : Path
        The layers of a run, or the virtual rasters over those of its sheets.
    record : mapping
        The content of run.json, which need not be there yet.

    Raises
    ------
    BadInputError
        A layer cannot be read.
    OutputError
        A file cannot be written.
    """
    write_styles(folder, record)
    write_project(folder, record)
    write_map_page(Site.read(folder, record), folder / REPORT_NAME)


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
    facts, crs = StyleFacts.of(folder, record), _horizontal_crs(record)
    groups = [group.found_in(partial(_in_folder, folder)) for group in _groups(facts.speeds)]
    present = [layer for group in groups for layer in group.leaves()]
    raster = next((layer for layer in present if layer.is_raster), None)  # all have the same extent
    write_qgis(
        folder / _NAME,
        "project.xml",
        title=_title(record),
        abstract=_abstract(record, facts),
        wkt=None if crs is None else crs.to_wkt(),
        groups=[group for group in groups if group.layers],
        view=None if raster is None else _view(folder / raster.source),
        styled=[(layer, layer_style(layer.file, facts, layered=True, part=layer.part)) for layer in present],
    )


def _view(path: Path) -> dict[str, float]:
    """Return the sides of what QGIS shows first: the extent of a raster, and a margin."""
    with open_layer(path) as raster:
        west, south, east, north = raster.bounds
    margin = _MARGIN * max(east - west, north - south)
    return {"xmin": west - margin, "ymin": south - margin, "xmax": east + margin, "ymax": north + margin}


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
