"""map.qgs: a QGIS project of the layers of a map, or of a run over maps; and all views of a map together."""

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj import CRS

from bumpymap.core import atomic, horizontal_of, stated_crs
from bumpymap.layers import GeoJsonCoordinates, MapFile, open_layer
from bumpymap.views.gis.styles import (
    MULTIPLY,
    NORMAL,
    Style,
    ViewLayer,
    class_labels,
    map_styles,
    speeds_of,
    write_qgis,
    write_styles,
)
from bumpymap.views.page.map_page import write_map_page
from bumpymap.views.page.page import NORTH_ARROW
from bumpymap.views.page.site import Site
from bumpymap.views.pictures.drawing import bar_length
from bumpymap.views.words import seen_sizes

if TYPE_CHECKING:
    from bumpymap.layers import MapReader, Placement

_MARGIN = 0.04
"""Ground around the layers when the project is opened, as a share of their larger side."""
_CLASSES = "roughness class, c_r in rad/m"
_PRINT_MM = 190.0, 180.0
"""Width and height of the map on a sheet of A4, mm."""
_BAR_MM = 25.0
"""Longest segment of its scale bar, mm: chosen."""
_ARROW = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 24 40">{NORTH_ARROW}</svg>'


def write_map_views(folder: Path, record: Mapping[str, Any], wait: Callable[..., None]) -> None:
    """Write the styles, map.qgs, report.html and the thumbnail of the layers in a folder.

    ``folder``: the layers of a run; ``record``: the content of run.json, which need not be there yet; ``files`` may be
    empty; ``wait``: waits until layers, given their names, are in the folder, or all of them. Raises BadInputError: a
    layer cannot be read; OutputError: a file cannot be written.
    """
    site = Site.read(folder, record, wait=wait)
    write_map_page(site, folder / MapFile.REPORT)
    with atomic(folder / MapFile.THUMBNAIL) as temporary:
        temporary.write_bytes(base64.b64decode(site.still.partition(",")[2]))
    wait()
    write_styles(folder, record)
    write_project(folder, record)


class _Tree:
    """The layers of a folder in groups, under those that it has: the topmost first."""

    def __init__(self, folder: Path, record: Mapping[str, Any], place: str = ".") -> None:
        """Take the folder, the record of the run, and where the folder lies as seen from the project."""
        self._folder, self._place, stated = folder, place, record["crs"]
        crs = None if stated is None else horizontal_of(stated_crs(stated["wkt"]))  # of all layers in the project
        self.wkt = None if crs is None else crs.to_wkt()
        self._styles = map_styles(record, in_project=True)
        self.styled: list[tuple[Style, Style]] = []
        """The layers, and how each is drawn."""

    def layer(
        self, file: MapFile, title: str, blend: int = NORMAL, *, visible: bool = False, part: str = ""
    ) -> list[Style]:
        """Return a file as a layer, in a list of one; nothing if the folder has no such file.

        ``part`` is the part of the file that it shows, if not the one that the file itself opens with; see
        `map_styles`.
        """
        if not self.has(file):
            return []
        style = self._styles[f"{file} {part}".strip()]
        return self.add(ViewLayer(file, title, style, part, visible=visible), self.wkt, blend, self._place)

    def add(self, found: ViewLayer, wkt: str | None, blend: int = NORMAL, place: str = ".") -> list[Style]:
        """Return a layer in a list of one."""
        is_raster = found.file.endswith(".tif")
        layer = {
            # longer than ten characters: QGIS does not find layers with shorter ids
            "id": "_".join(filter(None, ("bumpymap", Path(found.file).name.replace(".", "_"), found.part))),
            "title": found.title,
            "blend": blend,
            "visible": found.visible,
            "source": f"{place}/{found.file}{found.within}",
            "is_raster": is_raster,
            "provider": "gdal" if is_raster else "ogr",
            "geometry": "" if is_raster else found.geometry,
            "wkt": wkt,
        }
        self.styled.append((layer, found.style))
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
    closed = _closed(tree)
    why = tree.group(
        "Why not",
        tree.layer(MapFile.BARRED, "barred"),
        tree.layer(MapFile.REASON, "reason for no class", MULTIPLY),
        tree.layer(MapFile.OBSTACLE, "obstacles"),
        tree.layer(MapFile.PASSAGE, "where the vehicle fits"),
        expanded=False,
    )
    regions = tree.group("Regions", tree.layer(MapFile.REGIONS_IN_CRS, "regions", MULTIPLY), expanded=False)
    classes = tree.layer(MapFile.CLASS, _CLASSES, MULTIPLY, visible=True)
    fails = tree.layer(MapFile.ROUGHNESS, "most drives fail", visible=True, part="p_fail")
    rides = tree.layer(MapFile.ROUGHNESS, "c_r of the drives that get through", MULTIPLY, visible=True)
    others = [tree.layer(MapFile.SPEEDS, f"c_r at {speed:g} m/s", MULTIPLY, part=f"{speed:g}") for speed in speeds]
    if speeds:
        rides = tree.group("at one speed", rides, *others, one_of=True)
    c_r = tree.group("ride cost c_r", fails, rides, expanded=False, visible=False)
    cost = tree.layer(MapFile.COST, "cost of driving", MULTIPLY)
    ride = tree.group("Ride", classes, c_r, cost, tree.layer(MapFile.SPEED, "speed made good", MULTIPLY), one_of=True)
    heights = tree.layer(MapFile.HEIGHTMAP, "measured heights, with holes")
    return [*closed, *why, *regions, *ride, *tree.group("Ground", heights, *_below(tree))]


def _below(tree: _Tree) -> list[list[Style]]:
    relief = tree.layer(MapFile.RELIEF, "relief, holes filled", visible=not tree.has(MapFile.PHOTO))
    return [relief, tree.layer(MapFile.PHOTO, "photo: colours of the points", visible=True)]


def _closed(tree: _Tree, *, visible: bool = True) -> list[Style]:
    return tree.layer(MapFile.REGIONS_IN_CRS, "closed ground", MULTIPLY, visible=visible, part="closed")


def write_project(folder: Path, record: Mapping[str, Any]) -> None:
    """Write map.qgs: the layers in a folder, styled, the classes over the relief, paths relative to the folder.

    ``folder``: the folder of the layers. The project lists those that are there. ``record``: the record of the run, as
    in run.json. Raises OutputError: the project cannot be written, or a layer cannot be read.
    """
    tree = _Tree(folder, record)
    groups = _groups(tree, speeds_of(record))
    raster = next((layer["source"] for layer, _ in tree.styled if layer["is_raster"]), None)  # all have the same extent
    box = None
    if raster is not None:
        with open_layer(folder / raster) as file:
            box = tuple(file.bounds)
    classes = [f"Class {number}: {label}." for number, label in enumerate(class_labels(record))]
    _write(
        folder / MapFile.PROJECT, tree, groups, box, f"{record['survey']['name']}: ride cost", _notes(record), classes
    )


def view_writers(
    layers: Sequence[ViewLayer], place: "Placement", source: "MapReader", out: Path, title: str
) -> dict[str, Callable[[Path], None]]:
    """Return how the styles and the project of a run over maps are written, by name of the file.

    ``layers``: the files of the run, the topmost first; ``place``: what the project opens with. GeoJSON is in longitude
    and latitude where it has a CRS. ``source``: the map to lie under them, by a path relative to ``out``; ``out``: the
    folder of the run.
    """
    found: dict[str, dict[str, Any]] = {}
    for layer in layers:
        style = found.setdefault(str(Path(layer.file).with_suffix(".qml")), {"pixels": None, "vectors": None})
        if "looks" not in layer.style:
            style["pixels"] = style["pixels"] or layer.style
        else:  # QGIS takes one style for all of a file
            before = style["vectors"]["looks"] if style["vectors"] else []
            style["vectors"] = layer.style | {"looks": [*before, *layer.style["looks"]]}
    writers: dict[str, Callable[[Path], None]] = {
        name: partial(write_qgis, template="style.xml", **style) for name, style in found.items()
    }
    return writers | {MapFile.PROJECT: partial(_write_over_map, layers, place, source, out, title)}


def _write_over_map(
    layers: Sequence[ViewLayer], place: "Placement", source: "MapReader", out: Path, title: str, path: Path
) -> None:
    record = source.manifest
    tree = _Tree(source.folder, record, relpath(source.folder.resolve(), out.resolve()))
    degrees = CRS.from_epsg(4326).to_wkt() if GeoJsonCoordinates.of(place, local=True).has_degrees else None
    groups, covers = [], any(layer.file.endswith(".tif") for layer in layers)
    for layer in layers:
        wkt, blend = (tree.wkt, MULTIPLY) if layer.file.endswith(".tif") else (degrees, NORMAL)
        groups += tree.add(layer, wkt, blend)
    classes = tree.layer(MapFile.CLASS, _CLASSES, MULTIPLY, visible=not covers)  # they would shine through a raster
    groups += tree.group("Map", _closed(tree, visible=not covers), classes, *_below(tree))
    window = place.window
    west, east = place.to_crs(np.array([window.col, window.col + window.cols])).tolist()
    south, north = place.to_crs(np.array([window.row, window.row + window.rows])).tolist()
    _write(path, tree, groups, (west, south, east, north), f"{record['survey']['name']}: {title}", _notes(record))


def _write(
    path: Path,
    tree: _Tree,
    groups: list[Style],
    box: tuple[float, ...] | None,
    title: str,
    notes: Sequence[str],
    more: Iterable[str] = (),
) -> None:
    """Write a project that opens with a box, in units of the CRS. What its page says is also in its metadata."""
    crs = None if tree.wkt is None else CRS.from_wkt(tree.wkt)
    shown = _visible(groups)
    write_qgis(
        path,
        "project.xml",
        title=title,
        abstract="\n".join([*notes, *more]),
        notes="\n".join(notes),
        wkt=tree.wkt,
        groups=groups,
        view=None if box is None else _sides(box, _MARGIN * max(box[2] - box[0], box[3] - box[1])),
        print=None if box is None else _print(box, 1.0 if crs is None else crs.axis_info[0].unit_conversion_factor),
        styled=tree.styled,
        shown=[pair for pair in tree.styled if pair[0]["id"] in shown],
    )


def _visible(groups: Iterable[Style]) -> set[str]:
    """Return the ids of the layers that are shown when a project opens."""
    found: set[str] = set()
    for each in groups:
        if each["visible"]:
            found |= _visible(each["layers"]) if "layers" in each else {each["id"]}
    return found


def _sides(box: tuple[float, ...], margin: float) -> dict[str, float]:
    west, south, east, north = box
    return {"xmin": west - margin, "ymin": south - margin, "xmax": east + margin, "ymax": north + margin}


def _print(box: tuple[float, ...], metres: float) -> dict[str, Any]:
    """Return the map of a page: a box around another one, at a round scale, and its scale bar."""
    west, south, east, north = (side * metres for side in box)
    needed = 1000 * max((east - west) / _PRINT_MM[0], (north - south) / _PRINT_MM[1])
    power = 10.0 ** math.floor(math.log10(needed))
    scale = next(step * power for step in (1, 1.25, 1.5, 2, 2.5, 3, 4, 5, 7.5, 10) if step * power >= needed)
    half = [side * scale / 2000 / metres for side in _PRINT_MM]
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    segment = bar_length(_BAR_MM * scale / 1000)
    return {
        **_sides((x - half[0], y - half[1], x + half[0], y + half[1]), 0.0),
        "width": _PRINT_MM[0],
        "height": _PRINT_MM[1],
        "scale": scale,
        "segment": segment,
        "segment_mm": 1000 * segment / scale,
        "arrow": base64.b64encode(_ARROW.encode()).decode(),
    }


def _notes(record: Mapping[str, Any]) -> list[str]:
    """Return of which survey, for which vehicle and with which calibration a map was made."""
    calibration, crs, dates = record["calibration"], record["crs"], sorted(set(record["survey"]["dates"] or ()))
    about = (calibration.get("preferences") or {}).get("description")
    return [
        "Roughness and ride cost of the ground, made by bumpymap from a point cloud.",
        *([f"Files of the survey written on {' to '.join(dates)}."] if dates else []),
        f"Vehicle: {calibration['vehicle']}{f' ({about})' if about else ''}.",
        f"Calibration: {calibration['id']}.",
        *([f"Coordinates: {crs['name']}."] if crs else []),
        *filter(None, [seen_sizes(record).sentence]),
    ]
