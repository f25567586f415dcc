"""Styles of layers for QGIS, which takes those that lie beside them by itself, and map.qgs, a project of them all.

A project is that of a map, or of a run over maps, which lies over its map.
"""

import base64
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from os.path import relpath
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import (
    BARRED_TEXT,
    CHANGE_KINDS,
    CLASS_NAMES,
    OBJECT_NAMES,
    OBSTACLE,
    REASON_TEXT,
    Barred,
    Reason,
    atomic,
    chance_text,
    horizontal_of,
    stated_crs,
)
from bumpymap.layers import (
    BARRED_COLOURS,
    CHANGE_COLOURS,
    CLASS_COLOURS,
    CLOSED_COLOUR,
    COST_COLOURS,
    DIFFERENCE_RAMP,
    ISLAND_M2,
    ISLAND_SHARE,
    MID_GREY,
    OBJECT_COLOURS,
    OFF_COLOURS,
    OFF_KINDS,
    PASSAGE_COLOURS,
    PASSAGE_NAMES,
    REASON_SHADES,
    ROUTE_COLOUR,
    STEP_LINE,
    UNKNOWN_COLOUR,
    GeoJsonCoordinates,
    MapFile,
    RideScale,
    class_limits,
    class_ranges,
    first_island,
    open_layer,
    read_colours,
)
from bumpymap.views.fields import TIPS, code_tip, field_names, quoted, ride_tip, value_tip
from bumpymap.views.light import CONTRAST, DETAIL, SATURATION, gain_of
from bumpymap.views.page.map_page import write_map_page
from bumpymap.views.page.page import NORTH_ARROW, render_text
from bumpymap.views.page.site import Site
from bumpymap.views.words import seen_sizes

if TYPE_CHECKING:  # of other jobs
    from bumpymap.core import Route
    from bumpymap.layers import ChangeField, MapReader, Placement

QGIS_VERSION = "3.22.0"
"""The version of QGIS whose form the files have; newer ones read it too."""
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_NOT_XML = re.compile("[\ufffe\uffff]")
_EVALUATED = re.compile(r"\[(?=%)|\$(?=CURRENT_DATE)")
"""Where what QGIS evaluates in a label begins: ``[% expression %]``, or the date."""
_DIVIDED = {"labelText": "[% '' %]", "label": "\N{WORD JOINER}"}
"""Inserted to make it text again: in labels of a page an expression that shows nothing; in legends, which QGIS
evaluates if the name of the layer holds an expression, a letter without width."""


def write_qgis(path: Path, template: str, **context: Any) -> None:
    """Write a style or a project, whole or not at all.

    Control characters and bytes that are not UTF-8, as in the name of a CRS, are shown as escapes, as on pages. Labels
    are shown as they are: QGIS evaluates no expression that a name or description holds.

    ``template``: name of a template beside this module; ``**context``: what the template needs. Raises OutputError: it
    cannot be written.
    """
    text = render_text(template, version=QGIS_VERSION, **context)
    root = ET.fromstring(_NOT_XML.sub("\ufffd", text).strip())  # noqa: S314 (of a template of our own)
    for element in root.iter():
        for name in _DIVIDED.keys() & element.attrib.keys():
            element.set(name, _EVALUATED.sub(rf"\g<0>{_DIVIDED[name]}", element.attrib[name]))
    ET.indent(root, " ")
    with atomic(path) as temporary:
        temporary.write_bytes(_DOCTYPE + ET.tostring(root, encoding="unicode").encode() + b"\n")


HARD_LIGHT = 10
"""A blending mode of QGIS; normal is 0."""
Style = dict[str, Any]
"""A layer for a template: pixels by `paletted`, `_ramp` or `_light`, areas, lines and points by `vectors`."""
_Colour = tuple[int, ...]
"""Red, green, blue, alpha from 0 to 255."""


def paletted(
    names: Iterable[tuple[int, str]], colours: Mapping[int, _Colour], *, clear: Sequence[int] = (), band: int = 1
) -> Style:
    """Return the style of a band of codes; what is transparent has no entry, as a legend would show it in black.

    The legend has the order of ``names``; the codes ``clear`` are left transparent, whatever their colour.
    """
    every = [*names]
    shown = [(value, label) for value, label in every if value not in clear and colours[value][3]]
    entries = [(value, label, (*colours[value][:3], 255)) for value, label in shown]
    return {"kind": "paletted", "band": band, "entries": entries, "tip": code_tip(every, band)}


def _ramp(
    name: str, unit: str, entries: Iterable[tuple[float, _Colour]], ends: tuple[str, str], *, band: int = 1
) -> Style:
    """Return the style of a band of numbers, with colours mixed between entries; beyond, those of the ends.

    ``ends``: what the legend says of them.
    """
    stops = [(value, f"{value:.3g} {unit}".strip(), colour) for value, colour in entries]
    kind = "singlebandpseudocolor"
    return {"kind": kind, "band": band, "entries": stops, "ends": ends, "tip": value_tip(name, unit, band)}


def _light(kind: str, tip: str, opacity: float, **more: Any) -> Style:
    """Return the style of a photo or relief over colours, which it leaves as they are where it is mid-grey."""
    return {"kind": kind, "band": 1, "tip": tip, "opacity": opacity, "blend": HARD_LIGHT, **more}


def vectors(file: str, looks: Iterable[tuple[str, str, _Colour, str]], large: str = "") -> Style:
    """Return the style of areas, lines or points: expression of QGIS that chooses them, label, colour, form of each.

    A form is ``solid``, ``outline``, ``line``, ``mark`` (a disc). An expression ``large`` says which marks are drawn
    larger.
    """
    about = {"tip": TIPS[file], "fields": field_names(file)}
    return {"kind": "vectors", "looks": list(looks), "large": large, **about}


def _muted_looks(record: Mapping[str, Any]) -> list[tuple[str, str, _Colour, str]]:
    """Return how regions and tiles are drawn that are closed or not known, and the veil over islands."""
    looks: list[tuple[str, str, _Colour, str]] = [
        ('"class" IS NOT NULL AND NOT coalesce("passable", FALSE)', "cannot be crossed", CLOSED_COLOUR, "solid"),
        ('"class" IS NULL', "not known", UNKNOWN_COLOUR, "solid"),
    ]
    if (first := first_island(record)) is not None:
        veil = (MID_GREY, MID_GREY, MID_GREY, round(255 * (1 - ISLAND_SHARE)))
        label = f"can be crossed, an island of under {ISLAND_M2:.0f} m2"
        looks.append((f'"zone" > {first - 1}', label, veil, "solid"))
    return looks


@dataclass(frozen=True, slots=True)
class ViewLayer:
    """A file, or a part of one, as a layer of a project."""

    file: str
    """Its path in the folder."""
    title: str
    style: Style
    part: str = ""
    """Tells layers of one file apart."""
    visible: bool = True
    within: str = ""
    """For GDAL: the geometries to take from a file of several kinds, such as ``|geometrytype=Point``."""
    place: str = "."
    """Where its folder lies as seen from the project."""
    wkt: str | None = None
    """Its CRS."""

    @property
    def id(self) -> str:
        """Its id: longer than ten characters, since QGIS does not find layers with shorter ones."""
        return "_".join(filter(None, ("bumpymap", Path(self.file).name.replace(".", "_"), self.part)))

    @property
    def source(self) -> str:
        """Its file as seen from the project."""
        return f"{self.place}/{self.file}{self.within}"

    @property
    def is_raster(self) -> bool:
        """True for pixels, False for geometries."""
        return self.file.endswith(".tif")

    @property
    def provider(self) -> str:
        """Name of the library with which QGIS reads it."""
        return "gdal" if self.is_raster else "ogr"

    @property
    def geometry(self) -> str:
        """Kind of its geometries, as QGIS names it."""
        return {"mark": "Point", "line": "Line"}.get(self.style["looks"][0][3], "Polygon")

    @property
    def nodes(self) -> str:
        """Entries of its legend: of a raster without the first, the name of the band, which readers do not need."""
        count = len(self.style.get("entries", ())) if self.style["kind"] == "paletted" else int("ends" in self.style)
        default = ",".join(map(str, range(1, 1 + count))) or "empty"
        return str(self.style.get("nodes", default)) if self.is_raster else ""


class LayerGroup(NamedTuple):
    """Layers and groups under a heading, the topmost first."""

    title: str
    layers: "Sequence[ViewLayer | LayerGroup]"
    expanded: bool = True
    one_of: bool = False
    """Showing one of them hides the others."""
    visible: bool = True


_Branches = list[ViewLayer | LayerGroup]


def _is(attribute: str, value: str) -> str:
    """Return an expression of QGIS: an attribute has a value."""
    return f'"{attribute}" = {quoted(value)}'


def change_layers(field: "ChangeField") -> list[ViewLayer]:
    """Return the layers of a comparison: its places, its kinds of change, its differences."""
    from bumpymap.layers import CHANGED_BAND

    looks = [(_is("kind", name), name, CHANGE_COLOURS[code], "solid") for code, name in enumerate(CHANGE_KINDS)]
    codes, file = paletted(enumerate(CHANGE_KINDS), CHANGE_COLOURS, band=CHANGED_BAND), "change.tif"
    c_r, height = _differences(field.d_c_r, "rad/m", 1), _differences(field.d_height, "m", 3)
    return [
        ViewLayer("change.geojson", "places that have changed", vectors("change.geojson", looks[1:]), visible=False),
        ViewLayer(file, "what has changed", codes),
        ViewLayer(file, "ride cost c_r, after minus before", c_r, "d_c_r", visible=False),
        ViewLayer(file, "height, after minus before", height, "d_height", visible=False),
    ]


def _differences(values: NDArray[np.float32], unit: str, band: int) -> Style:
    """Return the style of differences: white for none, as far down as up, most colours for small ones, as on pages."""
    most = float(np.abs(np.nan_to_num(values)).max(initial=0.0)) or 1.0
    parts = np.linspace(-1.0, 1.0, len(DIFFERENCE_RAMP))
    stops = zip((most * np.sign(parts) * parts**2).tolist(), DIFFERENCE_RAMP, strict=True)
    colours = [(stop, (*bytes.fromhex(text[1:]), 255)) for stop, text in stops]
    return _ramp("difference", unit, colours, (f"{-most:+.3g} {unit}", f"{most:+.3g} {unit}"), band=band)


def check_layers() -> list[ViewLayer]:
    """Return the stretches of a check."""
    file = "check.geojson"
    looks = [(_is("off", name), name, OFF_COLOURS[code], "mark") for code, name in enumerate(OFF_KINDS)]
    return [ViewLayer(file, "how far the map is off", vectors(file, looks, '"explained" = false'))]


def route_layers(route: "Route") -> list[ViewLayer]:
    """Return the stops of a route, and the way with its figures."""
    from bumpymap.layers import stop_roles

    colours = {"start": (255, 255, 255, 255), "via": (150, 150, 150, 255), "goal": (0, 0, 0, 255)}
    roles = dict.fromkeys(stop_roles(len(route.stops)))
    stops = [(_is("role", role), role, colours[role], "mark") for role in roles]
    found = route.figures
    chance = chance_text(found.p_arrives)
    label = f"{route.name}: {found.length_m:.0f} m, costs {found.cost_m:.0f} m, arrives {chance}"
    file = "route.geojson"
    ways = [(_is("name", route.name), label, (*ROUTE_COLOUR, 255), "line")]
    return [
        ViewLayer(file, "stops", vectors(file, stops), "stops", within="|geometrytype=Point"),
        ViewLayer(file, "ways", vectors(file, ways), "ways", within="|geometrytype=LineString"),
    ]


_RELIEF = {"contrast": -20, "brightness": -32}
"""Of a relief over colours: level ground, 179 with the sun at 45 degrees, becomes mid-grey, and steep faces stay
visible; the contrast is chosen."""
_TINT = 0.3
"""Opacity of the colours of a photo on driven ground, under the photo in grey: chosen."""
_SEEN_FROM = 1500
"""Obstacles are shown at scales of 1 to this and larger, where their pixels are 0.13 mm and more: chosen."""


def class_labels(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what a legend says for each class: its name and, where that decides, its interval of c_r [rad/m]."""
    named = zip(CLASS_NAMES, class_ranges(record), strict=False)
    return tuple(f"{name}: c_r {text}" for name, text in named) or CLASS_NAMES


def map_styles(record: Mapping[str, Any], *, in_project: bool = False, gain: float = 1.0) -> dict[str, Style]:
    """Return how QGIS shows each layer of a map.

    ``record``: the record of the run, as in run.json; ``in_project``: as layers of one project: clear where there is
    nothing to explain (passable tiles, tiles with a class); photo and relief as light over the others; ``gain``: factor
    on the photo. The keys are of `MapFile`, and for what else a project shows of one, it and a part: of obstacle.tif
    ``dark``, of cost.fgb ``closed``, what is not known, not passable or an island, of photo.tif ``colours``.
    """
    labels, limits = class_labels(record), class_limits(record)
    anchors = RideScale.of(record).anchors
    stops = [(at, CLASS_COLOURS[code]) for code, at in enumerate(anchors)]
    # Of the first band of roughness.tif.
    ride = _ramp("C_r", "rad/m", stops, (f"{anchors[0]:.2g} and less", f"{anchors[-1]:.2g} and more"))
    upto = [f"{name} to {limit:.3g}" for name, limit in zip(CLASS_NAMES, limits, strict=False)]
    units_per_m = 1.0 / record["metres_per_unit"]["horizontal"]
    relief = _light("hillshade", value_tip("height", "m"), DETAIL, z_factor=units_per_m, **_RELIEF)
    if not in_project:
        relief |= {"opacity": 1, "blend": 0, "contrast": 0, "brightness": 0}
    tip = ride_tip(limits, quoted("bumpymap_roughness_tif"))
    paler = {"saturation": round(100 * SATURATION - 100), "contrast": round(100 * math.sqrt(CONTRAST) - 100)}
    photo = partial(_light, "multibandcolor", tip, most=255 / gain, **paler)
    photos = {
        MapFile.PHOTO: photo(opacity=DETAIL, grey=True),
        f"{MapFile.PHOTO} colours": photo(opacity=_TINT, grey=False),
    }
    most, top = max(COST_COLOURS), record["cost"]["speeds_mps_at_c_r_radpm"][0][0]
    # The speed made good has the colours of a cost of as many times the metre at the top speed.
    made_good = sorted((top / times, colour) for times, colour in COST_COLOURS.items())
    named = (
        (f'"class" = {code} AND "passable"', label, CLASS_COLOURS[code], "solid") for code, label in enumerate(labels)
    )
    muted = _muted_looks(record)
    looks = [*named, *muted]
    dark = [(OBSTACLE, "obstacle, or step that it cannot cross"), (STEP_LINE, "")]
    return {
        MapFile.CLASS: paletted(enumerate(labels), CLASS_COLOURS),
        MapFile.REASON: paletted(REASON_TEXT.items(), REASON_SHADES, clear=[Reason.OK] if in_project else ()),
        MapFile.ROUGHNESS: ride | {"tip": ride_tip(limits), "limits": f"{', '.join(upto)},|{CLASS_NAMES[-1]} beyond"},
        MapFile.COST: _ramp("cost", "", COST_COLOURS.items(), ("1: level road", f"{most:g} and more")),
        MapFile.SPEED: _ramp("speed", "m/s", [(0.0, CLOSED_COLOUR), *made_good], ("0: closed", f"{top:.3g} m/s")),
        MapFile.REGIONS_IN_CRS: vectors(MapFile.REGIONS_IN_CRS, looks),
        f"{MapFile.REGIONS_IN_CRS} closed": vectors(MapFile.REGIONS_IN_CRS, muted),
        MapFile.REGIONS: vectors(MapFile.REGIONS, looks),
        MapFile.BARRED: paletted(BARRED_TEXT.items(), BARRED_COLOURS, clear=[Barred.NO] if in_project else ()),
        MapFile.OBSTACLE: paletted(enumerate(OBJECT_NAMES), OBJECT_COLOURS),
        f"{MapFile.OBSTACLE} dark": paletted(dark, dict.fromkeys((OBSTACLE, STEP_LINE), OBJECT_COLOURS[OBSTACLE]))
        | {"nodes": "1", "scale": _SEEN_FROM, "tip": code_tip(enumerate(OBJECT_NAMES))},
        MapFile.PASSAGE: paletted(enumerate(PASSAGE_NAMES), PASSAGE_COLOURS),
        MapFile.HEIGHTMAP: relief,
        MapFile.RELIEF: relief,
        **(photos if in_project else {MapFile.TILES: vectors(MapFile.TILES, looks)}),
    }


def _style_writers(styles: Iterable[tuple[str, Style]]) -> dict[str, Callable[[Path], None]]:
    """Return how the style files of layers are written, by name: class.qml for class.tif, and so on.

    A file holds a part for rasters and one for areas, of all layers with its stem; QGIS takes the part that fits. Of
    several styles of a raster it is the first; those of areas are one.
    """
    found: dict[str, dict[str, Any]] = {}
    for file, style in styles:
        parts = found.setdefault(str(Path(file).with_suffix(".qml")), {"pixels": None, "vectors": None})
        if "looks" not in style:
            parts["pixels"] = parts["pixels"] or style
        else:
            before = parts["vectors"]["looks"] if parts["vectors"] else []
            parts["vectors"] = style | {"looks": [*before, *(each for each in style["looks"] if each not in before)]}
    return {name: partial(write_qgis, template="style.xml", **parts) for name, parts in found.items()}


def write_styles(folder: Path, record: Mapping[str, Any]) -> None:
    """Write a QGIS style beside each layer in a folder.

    ``folder``: the folder of the layers. Styles are written for those that are there. ``record``: the record of the
    run, as in run.json. Raises OutputError: a style cannot be written.
    """
    styles = ((file, style) for file, style in map_styles(record).items() if (folder / file).is_file())
    for name, write in _style_writers(styles).items():
        write(folder / name)


_PHOTO_PX = 300
"""Most pixels of a photo along a side that are read to level it: chosen."""
_MARGIN = 0.04
"""Ground around the layers when the project is opened, as a share of their larger side."""
_RIDE = "ride cost C_r, rad/m"
_PAGES = {(297.0, 210.0): (190.0, 180.0), (210.0, 297.0): (103.0, 267.0)}
"""Width and height of sheets of A4 and of the largest map on each, mm."""
_SCALES = (1, 1.1, 1.25, 1.4, 1.5, 1.75, 2, 2.25, 2.5, 3, 3.5, 4, 4.5, 5, 6, 7, 7.5, 8, 9, 10)
"""Scales of a map, times a power of ten: chosen."""
_AROUND_MM = 4.0
"""White around the map in its frame, mm: chosen."""
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


def _map_layers(
    folder: Path, record: Mapping[str, Any], place: str = ".", *, under: bool = False
) -> tuple[_Branches, _Branches, _Branches, _Branches]:
    """Return the layers of a map that its folder has: light over all others, obstacles, reasons, the ground.

    ``place``: where the folder lies as seen from the project; ``under``: under rasters, in whose gaps closed ground is
    seen.
    """
    styles, wkt = map_styles(record, in_project=True, gain=_gain(folder / MapFile.PHOTO)), _wkt(record)

    def layer(file: MapFile, title: str, part: str = "", *, visible: bool = False) -> _Branches:
        """Return a file in a list of one, if it is there; ``part``: other than the file itself opens with."""
        style = styles[f"{file} {part}".strip()]
        return [ViewLayer(file, title, style, part, visible, "", place, wkt)] if (folder / file).is_file() else []

    photo = layer(MapFile.PHOTO, "photo in grey", visible=True)
    relief = layer(MapFile.RELIEF, "relief, holes filled", visible=not photo)
    light = [*photo, *relief, *layer(MapFile.HEIGHTMAP, "measured heights, with holes")]
    obstacles = layer(MapFile.OBSTACLE, f"obstacles, from 1:{_SEEN_FROM} on", "dark", visible=not under)
    reasons = [
        *layer(MapFile.BARRED, "barred"),
        *layer(MapFile.REASON, "reason for no class"),
        *layer(MapFile.OBSTACLE, "obstacles and canopy"),
        *layer(MapFile.PASSAGE, "where the vehicle fits"),
    ]
    regions = _group("Regions", layer(MapFile.REGIONS_IN_CRS, "regions"), expanded=False)
    ride = [
        *layer(MapFile.ROUGHNESS, _RIDE, visible=True),
        *layer(MapFile.CLASS, "class by C_r in rad/m"),
        *layer(MapFile.COST, "cost of driving a metre"),
        *layer(MapFile.SPEED, "speed made good"),
    ]
    ground = [
        *layer(MapFile.REGIONS_IN_CRS, "closed ground", "closed", visible=True),
        *layer(MapFile.PHOTO, "photo: its colours, on driven ground", "colours", visible=not under),
        *_group("Ride", ride, one_of=True, visible=not under),
    ]
    return (
        _group("Light", light, one_of=True),
        obstacles,
        [*_group("Why not", reasons, expanded=False), *regions],
        ground,
    )


def _gain(path: Path) -> float:
    """Return the factor on a photo, if there is one, that levels it."""
    if not path.is_file():
        return 1.0
    with open_layer(path) as file:
        step = max(1, max(file.shape) // _PHOTO_PX)
        return gain_of(np.moveaxis(read_colours(file, (file.height // step, file.width // step)), 0, -1))


def _wkt(record: Mapping[str, Any]) -> str | None:
    """Return the CRS of all layers of a map in its project, which has no heights."""
    crs = record["crs"] and horizontal_of(stated_crs(record["crs"]["wkt"]))
    return crs.to_wkt() if crs else None


def _group(title: str, layers: _Branches, **about: bool) -> _Branches:
    """Return layers under a heading, in a list of one; nothing if there are none."""
    return [LayerGroup(title, layers, **about)] if layers else []


def _leaves(branches: Iterable[ViewLayer | LayerGroup], *, shown: bool = False) -> Iterator[ViewLayer]:
    """Yield all layers, or those that are ``shown``, the topmost first."""
    for each in branches:
        if each.visible or not shown:
            yield from [each] if isinstance(each, ViewLayer) else _leaves(each.layers, shown=shown)


def write_project(folder: Path, record: Mapping[str, Any]) -> None:
    """Write map.qgs: the layers in a folder, styled, the classes over the relief, paths relative to the folder.

    ``folder``: the folder of the layers. The project lists those that are there. ``record``: the record of the run, as
    in run.json. Raises OutputError: the project cannot be written, or a layer cannot be read.
    """
    light, obstacles, reasons, ground = _map_layers(folder, record)
    layers = [*_leaves([*reasons, *light, *obstacles, *ground])]
    with open_layer(folder / next(layer.file for layer in layers if layer.is_raster)) as file:
        box = tuple(file.bounds)  # of all rasters
    classes = [f"Class {number}: {label}." for number, label in enumerate(class_labels(record))]
    tree = [*light, *obstacles, *reasons, *ground]
    _write(folder / MapFile.PROJECT, record, "ride cost", tree, layers, box, more=classes)


def view_writers(
    layers: Sequence[ViewLayer], place: "Placement", source: "MapReader", out: Path, title: str
) -> dict[str, Callable[[Path], None]]:
    """Return how the styles and the project of a run over maps are written, by name of the file.

    ``layers``: the files of the run, the topmost first; ``place``: what the project opens with. GeoJSON is in longitude
    and latitude where it has a CRS. ``source``: the map to lie under them, by a path relative to ``out``; ``out``: the
    folder of the run.
    """
    styles = _style_writers((layer.file, layer.style) for layer in layers)
    return styles | {MapFile.PROJECT: partial(_write_over_map, layers, place, source, out, title)}


def _write_over_map(
    layers: Sequence[ViewLayer], place: "Placement", source: "MapReader", out: Path, title: str, path: Path
) -> None:
    record = source.manifest
    degrees = CRS.from_epsg(4326).to_wkt() if GeoJsonCoordinates.of(place, local=True).has_degrees else None
    areas = [replace(layer, wkt=degrees) for layer in layers if not layer.is_raster]
    rasters = [replace(layer, wkt=_wkt(record)) for layer in layers if layer.is_raster]
    place_of_map = relpath(source.folder.resolve(), out.resolve())
    light, obstacles, _, ground = _map_layers(source.folder, record, place_of_map, under=bool(rasters))
    tree = [*areas, *light, *rasters, *_group("Map", [*obstacles, *ground])]
    window = place.window
    west, east = place.to_crs(np.array([window.col, window.col + window.cols])).tolist()
    south, north = place.to_crs(np.array([window.row, window.row + window.rows])).tolist()
    own = sum(layer.visible for layer in layers)
    _write(path, record, title, tree, [*_leaves(tree)], (west, south, east, north), own=own)


def _write(
    path: Path,
    record: Mapping[str, Any],
    title: str,
    tree: _Branches,
    layers: Sequence[ViewLayer],
    box: tuple[float, ...],
    *,
    more: Iterable[str] = (),
    own: int = 0,
) -> None:
    """Write a project that opens with a box, in units of the CRS. What its page says is also in its metadata.

    ``layers``: those of the tree; ``own``: number of its shown layers that are not of the map.
    """
    wkt, notes = _wkt(record), _notes(record)
    page = _print(box, CRS.from_wkt(wkt).axis_info[0].unit_conversion_factor if wkt else 1.0)
    legend = [
        layer
        for layer in _leaves(tree, shown=True)
        if layer.nodes != "empty" and page["scale"] <= layer.style.get("scale", math.inf)
    ]
    write_qgis(
        path,
        "project.xml",
        title=f"{record['survey']['name']}: {title}",
        abstract="\n".join([*notes, *more]),
        notes="\n".join(notes),
        wkt=wkt,
        groups=tree,
        view=_sides(box, _MARGIN * max(box[2] - box[0], box[3] - box[1])),
        print=page,
        layers=layers,
        # Of a map the ride comes first, and of a run its own layers do.
        shown=[*legend[:own], *reversed(legend[own:])],
    )


def _sides(box: tuple[float, ...], margin: float) -> dict[str, float]:
    west, south, east, north = box
    return {"xmin": west - margin, "ymin": south - margin, "xmax": east + margin, "ymax": north + margin}


def _print(box: tuple[float, ...], metres: float) -> dict[str, Any]:
    """Return the map of a page: a box around another one, at a round scale, and its scale bar.

    The page lies or stands as the map is larger; the frame is no larger than the map needs.
    """
    sides = np.array([box[2] - box[0], box[3] - box[1]]) * metres
    needed, page, most = min(
        (float(1000 * (sides / (np.array(room) - 2 * _AROUND_MM)).max()), page, room) for page, room in _PAGES.items()
    )
    power = 10.0 ** math.floor(math.log10(needed))
    scale = next(step * power for step in _SCALES if step * power >= needed)
    frame = np.minimum(1000 * sides / scale + 2 * _AROUND_MM, most)
    half = (frame * scale / 2000 / metres).tolist()
    x, y = (box[0] + box[2]) / 2, (box[1] + box[3]) / 2
    most_bar = _BAR_MM * scale / 1000
    power = 10.0 ** math.floor(math.log10(most_bar))
    segment = next(step * power for step in (10, 5, 2, 1) if step * power <= most_bar * (1 + 1e-9))
    return {
        **_sides((x - half[0], y - half[1], x + half[0], y + half[1]), 0.0),
        "page": page,
        "width": float(frame[0]),
        "height": float(frame[1]),
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
