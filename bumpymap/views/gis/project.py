"""map.qgs, a QGIS project of the layers of a map; and all views of them together."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from bumpymap.core import horizontal_of, stated_crs
from bumpymap.layers import MapFile, open_layer
from bumpymap.views.gis.styles import (
    MULTIPLY,
    NORMAL,
    Style,
    class_labels,
    map_styles,
    speeds_of,
    write_qgis,
    write_styles,
)
from bumpymap.views.page.map_page import write_map_page
from bumpymap.views.page.site import Site

_MARGIN = 0.04
"""Ground around the layers when the project is opened, as a share of their larger side."""


def write_map_views(folder: Path, record: Mapping[str, Any]) -> None:
    """Write the styles, map.qgs and report.html of the layers in a folder.

    Parameters
    ----------
    folder : Path
        The layers of a run.
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
    write_map_page(Site.read(folder, record), folder / MapFile.REPORT)


class _Tree:
    """The layers of a folder in groups, under those that it has: the topmost first."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.layers: list[Style] = []

    def layer(
        self, file: MapFile, title: str, blend: int = NORMAL, *, visible: bool = False, part: str = ""
    ) -> list[Style]:
        """Return a file as a layer, in a list of one; nothing if the folder has no such file.

        ``part`` is the part of the file that it shows, if not the one that the file itself opens with; see
        `map_styles`.
        """
        if not self.has(file):
            return []
        is_raster = file.endswith(".tif")
        layer = {
            # longer than ten characters: QGIS does not find layers with shorter ids
            "id": "_".join(filter(None, ("bumpymap", Path(file).name.replace(".", "_"), part))),
            "style": f"{file} {part}".strip(),
            "title": title,
            "blend": blend,
            "visible": visible,
            "source": file,
            "is_raster": is_raster,
            "provider": "gdal" if is_raster else "ogr",
        }
        self.layers.append(layer)
        return [layer]

    def has(self, file: str) -> bool:
        """Return whether the folder has a file."""
        return (self._folder / file).is_file()

    def group(
        self, title: str, *parts: list[Style], expanded: bool = True, one_of: bool = False, visible: bool = True
    ) -> list[Style]:
        """Return layers and groups under a heading, in a list of one; nothing if there are none.

        With ``one_of``, showing one of them hides the others.
        """
        layers = [child for part in parts for child in part]
        about = {"title": title, "layers": layers, "expanded": expanded, "one_of": one_of, "visible": visible}
        return [about] if layers else []


def _groups(tree: _Tree, speeds: Sequence[float]) -> list[Style]:
    """Return the groups of the project, the topmost first; the ride at other speeds [m/s] lies where the map's does."""
    why = tree.group(
        "Why not",
        tree.layer(MapFile.BARRED, "barred"),
        tree.layer(MapFile.REASON, "reason for no class", MULTIPLY, visible=True),
        tree.layer(MapFile.OBSTACLE, "obstacles"),
        tree.layer(MapFile.PASSAGE, "where the vehicle fits"),
        expanded=False,
    )
    regions = tree.group("Regions", tree.layer(MapFile.REGIONS_IN_CRS, "regions", MULTIPLY), expanded=False)
    classes = tree.layer(MapFile.CLASS, "roughness class", MULTIPLY, visible=True)
    fails = tree.layer(MapFile.ROUGHNESS, "most drives fail", visible=True, part="p_fail")
    rides = tree.layer(MapFile.ROUGHNESS, "c_r of the drives that get through", MULTIPLY, visible=True)
    others = [tree.layer(MapFile.SPEEDS, f"c_r at {speed:g} m/s", MULTIPLY, part=f"{speed:g}") for speed in speeds]
    if speeds:
        rides = tree.group("at one speed", rides, *others, one_of=True)
    c_r = tree.group("ride cost c_r", fails, rides, expanded=False, visible=False)
    cost = tree.layer(MapFile.COST, "cost of driving", MULTIPLY)
    ride = tree.group("Ride", classes, c_r, cost, tree.layer(MapFile.SPEED, "speed made good", MULTIPLY), one_of=True)
    photo = tree.has(MapFile.PHOTO)
    ground = tree.group(
        "Ground",
        tree.layer(MapFile.HEIGHTMAP, "measured heights, with holes"),
        tree.layer(MapFile.RELIEF, "relief, holes filled", visible=not photo),
        tree.layer(MapFile.PHOTO, "photo: colours of the points", visible=True),
    )
    return [*why, *regions, *ride, *ground]


def write_project(folder: Path, record: Mapping[str, Any]) -> None:
    """Write map.qgs: the layers in a folder, styled, the classes over the relief, paths relative to the folder.

    Parameters
    ----------
    folder : Path
        The folder of the layers. The project lists those that are there.
    record : mapping
        The record of the run, as in run.json.

    Raises
    ------
    OutputError
        The project cannot be written, or a layer cannot be read.
    """
    tree, crs = _Tree(folder), _horizontal_crs(record)
    groups, styles = _groups(tree, speeds_of(record)), map_styles(record, layered=True)
    raster = next((layer for layer in tree.layers if layer["is_raster"]), None)  # all have the same extent
    write_qgis(
        folder / MapFile.PROJECT,
        "project.xml",
        title=_title(record),
        abstract=_abstract(record),
        wkt=None if crs is None else crs.to_wkt(),
        groups=groups,
        view=None if raster is None else _view(folder / raster["source"]),
        styled=[(layer, styles[layer["style"]]) for layer in tree.layers],
    )


def _view(path: Path) -> dict[str, float]:
    """Return the sides of what QGIS shows first: the extent of a raster, and a margin."""
    with open_layer(path) as raster:
        west, south, east, north = raster.bounds
    margin = _MARGIN * max(east - west, north - south)
    return {"xmin": west - margin, "ymin": south - margin, "xmax": east + margin, "ymax": north + margin}


def _title(record: Mapping[str, Any]) -> str:
    survey = record.get("survey")
    name = survey.get("name") if isinstance(survey, Mapping) else None
    return f"{name}: ride cost" if name else "ride cost"


def _abstract(record: Mapping[str, Any]) -> str:
    """Return for which vehicle and with which calibration the layers were made."""
    calibration = record.get("calibration")
    known = calibration if isinstance(calibration, Mapping) else {}
    lines = ["Roughness and ride cost of the ground, made by bumpymap from a point cloud."]
    preferences = known.get("preferences")
    about = preferences.get("description") if isinstance(preferences, Mapping) else None
    lines += [f"Vehicle: {known.get('vehicle', 'not known')}{f' ({about})' if about else ''}."]
    lines += [f"Calibration: {known.get('id', 'not known')}."]
    lines += [f"Class {number}: {label}." for number, label in enumerate(class_labels(record))]
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
