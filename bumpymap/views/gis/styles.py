"""Style files that QGIS takes by itself, since they lie beside the layers and have their names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree as ET

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    BANDS,
    BARRED_TEXT,
    CHANGE_KINDS,
    CLASS_NAMES,
    FAIL_SHARE,
    OBJECT_NAMES,
    REASON_TEXT,
    Barred,
    Reason,
    atomic,
    chance_text,
    speed_bands,
)
from bumpymap.layers import (
    BARRED_COLOURS,
    CHANGE_COLOURS,
    CLASS_COLOURS,
    COST_COLOURS,
    DIFFERENCE_RAMP,
    OBJECT_COLOURS,
    OFF_COLOURS,
    OFF_KINDS,
    PASSAGE_COLOURS,
    PASSAGE_NAMES,
    REASON_GREYS,
    ROUTE_COLOUR,
    UNKNOWN_COLOUR,
    MapFile,
    RideScale,
    class_ranges,
    reach_colours,
)
from bumpymap.views.page.page import render_text

if TYPE_CHECKING:  # of other jobs
    from bumpymap.core import Route
    from bumpymap.layers import ChangeField, ReachField

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


NORMAL, MULTIPLY = 0, 6
"""Blending modes of QGIS."""
Style = dict[str, Any]
"""A layer for a template: pixels by `paletted` or `_ramp`, areas, lines and points by `vectors`."""
_Colour = tuple[int, int, int, int]
"""Red, green, blue, alpha from 0 to 255."""


def paletted(
    names: Iterable[tuple[int, str]], colours: Mapping[int, _Colour], *, clear: Sequence[int] = (), band: int = 1
) -> Style:
    """Return the style of a band of codes; what is transparent has no entry, as a legend would show it in black.

    The legend has the order of ``names``; the codes ``clear`` are left transparent, whatever their colour.
    """
    shown = [(value, label) for value, label in names if value not in clear and colours[value][3]]
    entries = [(value, label, colours[value]) for value, label in shown]
    return {"kind": "paletted", "band": band, "entries": entries, "opacity": 1.0}


def _ramp(entries: Iterable[tuple[float, str, _Colour]], band: int = 1, *, clip: bool = False) -> Style:
    """Return the style of a band of numbers, with colours mixed between entries; beyond, with ``clip``, transparent."""
    return {"kind": "singlebandpseudocolor", "band": band, "entries": list(entries), "clip": clip, "opacity": 1.0}


def vectors(looks: Iterable[tuple[str, str, _Colour, str]], large: str = "", line: str = "") -> Style:
    """Return the style of areas, lines or points: expression of QGIS that chooses them, label, colour, form of each.

    A form is ``solid``, ``rising`` (solid under lines), ``falling`` (lines alone, over other forms), ``outline``,
    ``line``, ``mark`` (a disc). An expression ``large`` says which marks are drawn larger; ``line`` is a line over each
    area, NULL where there is none.
    """
    return {"kind": "vectors", "looks": list(looks), "large": large, "line": line}


CALM_RATIO = 1.3
"""From this ratio of the highest to the lowest C_r by heading on, the heading matters."""
_END = 'project(centroid($geometry), 0.4 * sqrt(area($geometry)), radians("calm_axis_deg" + {turn}))'
_MATTERS = f'"passable" and "heading_ratio" > {CALM_RATIO}'
CALM_LINE = f"if({_MATTERS}, make_line({_END.format(turn=0)}, {_END.format(turn=180)}), NULL)"
"""Expression of QGIS: a line through a passable tile along the heading with the lowest C_r, where that matters."""


_CLOSED_LOOKS = (
    ('"class" IS NULL', "not known", UNKNOWN_COLOUR, "rising"),
    ('"class" IS NOT NULL AND NOT coalesce("passable", FALSE)', "not passable", (17, 17, 17, 255), "falling"),
)
"""How regions and tiles are drawn that are not known, and what lies over the class of those that are not passable."""


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

    @property
    def geometry(self) -> str:
        """Kind of its geometries, as QGIS names it."""
        return {"mark": "Point", "line": "Line"}.get(self.style["looks"][0][3], "Polygon")


def _is(attribute: str, value: str) -> str:
    """Return an expression of QGIS: an attribute has a value."""
    value = value.replace("\\", r"\\").replace("'", "''")
    return f"\"{attribute}\" = '{value}'"


def change_layers(field: "ChangeField") -> list[ViewLayer]:
    """Return the layers of a comparison: its places, its kinds of change, its differences."""
    from bumpymap.layers import CHANGED_BAND

    looks = [(_is("kind", name), name, CHANGE_COLOURS[code], "solid") for code, name in enumerate(CHANGE_KINDS)]
    codes, file = paletted(enumerate(CHANGE_KINDS), CHANGE_COLOURS, band=CHANGED_BAND), "change.tif"
    c_r, height = _differences(field.d_c_r, "rad/m", 1), _differences(field.d_height, "m", 3)
    return [
        ViewLayer("change.geojson", "places that have changed", vectors(looks[1:]), visible=False),
        ViewLayer(file, "what has changed", codes),
        ViewLayer(file, "ride cost c_r, after minus before", c_r, "d_c_r", visible=False),
        ViewLayer(file, "height, after minus before", height, "d_height", visible=False),
    ]


def _differences(values: NDArray[np.float32], unit: str, band: int) -> Style:
    """Return the style of differences: white for none, as far down as up, most colours for small ones, as on pages."""
    most = float(np.abs(np.nan_to_num(values)).max(initial=0.0)) or 1.0
    parts = np.linspace(-1.0, 1.0, len(DIFFERENCE_RAMP))
    ends = zip((most * np.sign(parts) * parts**2).tolist(), DIFFERENCE_RAMP, strict=True)
    return _ramp([(end, f"{end:+.3g} {unit}", _rgba(text)) for end, text in ends], band)


def _rgba(text: str) -> _Colour:
    red, green, blue = bytes.fromhex(text[1:])
    return red, green, blue, 255


def check_layers() -> list[ViewLayer]:
    """Return the stretches of a check."""
    looks = [(_is("off", name), name, OFF_COLOURS[code], "mark") for code, name in enumerate(OFF_KINDS)]
    return [ViewLayer("check.geojson", "how far the map is off", vectors(looks, '"explained" = false'))]


def route_layers(route: "Route") -> list[ViewLayer]:
    """Return the stops of a route, and the way with its figures."""
    from bumpymap.layers import stop_roles

    colours = {"start": (255, 255, 255, 255), "via": (150, 150, 150, 255), "goal": (0, 0, 0, 255)}
    roles = dict.fromkeys(stop_roles(len(route.stops)))
    stops = [(_is("role", role), role, colours[role], "mark") for role in roles]
    found = route.figures
    chance = f"arrives {chance_text(found.p_arrives)} {found.seen.condition}"
    label = f"{route.name}: {found.length_m:.0f} m, costs {found.cost_m:.0f} m, {chance}"
    file = "route.geojson"
    return [
        ViewLayer(file, "stops", vectors(stops), "stops", within="|geometrytype=Point"),
        ViewLayer(
            file,
            "ways",
            vectors([(_is("name", route.name), label, (*ROUTE_COLOUR, 255), "line")]),
            "ways",
            within="|geometrytype=LineString",
        ),
    ]


_REACH_STOPS = 6
"""Colours of reach.tif: chosen."""


def reach_layers(reach: "ReachField", levels: Sequence[float]) -> list[ViewLayer]:
    """Return what can be reached: outlines of ``levels`` [min], minutes, cost."""
    steps = sorted({float(level) for level in levels})
    looks = [
        (f'"within" = {level!r}', f"within {level:g} min", (*colour, 255), "outline")
        for level, colour in zip(steps, reach_colours(len(steps)), strict=True)
    ]
    cost, minutes = _distances(reach.cost, "m", 1), _distances(reach.minutes, "min", 2)
    return [
        *([ViewLayer("isochrones.geojson", "outlines", vectors(looks))] if looks else []),
        ViewLayer("reach.tif", "minutes from the start", minutes, "minutes"),
        ViewLayer("reach.tif", "cost from the start", cost, "cost", visible=False),
    ]


def _distances(values: NDArray[np.float32], unit: str, band: int) -> Style:
    ends = np.linspace(0.0, float(np.nan_to_num(values).max(initial=0.0)) or 1.0, _REACH_STOPS).tolist()
    shades = zip(ends, reach_colours(_REACH_STOPS), strict=True)
    return _ramp([(end, f"{end:.3g} {unit}", (*colour, 255)) for end, colour in shades], band)


_PALE = 0.6
"""Opacity of relief and photo under other layers, so that colours over them stay those of their legend."""
_GREY = (*UNKNOWN_COLOUR[:3], 180)
"""Colour of unknown ground over the relief, which shows through; no class is drawn between them."""
_BAND = {band.name: number for number, band in enumerate(BANDS, 1)}


def class_labels(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what a legend says for each class: its name and, where that decides, its interval of c_r [rad/m]."""
    named = zip(CLASS_NAMES, class_ranges(record), strict=False)
    return tuple(f"{name}: c_r {text}" for name, text in named) or CLASS_NAMES


def speeds_of(record: Mapping[str, Any]) -> list[float]:
    """Return the speeds of speeds.tif, m/s, in the order of its bands."""
    return [float(speed) for speed in record["settings"].get("speeds") or ()]


def _speed_stops(record: Mapping[str, Any]) -> list[tuple[float, str, _Colour]]:
    """Return the colours of the speed made good: those of a cost of as many times the metre at the top speed."""
    top = record["cost"]["speeds_mps_at_c_r_radpm"][0][0]
    steps = [(top / times, f"{top / times:.3g} m/s", colour) for times, colour in COST_COLOURS.items()]
    return [(0.0, "0: not passable", BARRED_COLOURS[Barred.OBSTACLE]), *sorted(steps)]


def map_styles(record: Mapping[str, Any], *, in_project: bool = False) -> dict[str, Style]:
    """Return how QGIS shows each layer of a map.

    ``record``: the record of the run, as in run.json; ``in_project``: as layers of one project: clear where there is
    nothing to explain (passable tiles, tiles with a class); a pale relief; the photo, which needs no style of its own.
    Returns by `MapFile`; what else a project shows of one, by it and a part: of roughness.tif ``p_fail``, the tiles
    where at least half of the drives fail, of speeds.tif the C_r at each speed, such as ``0.5``, and of cost.fgb
    ``closed``, what is not known or not passable.
    """
    labels, speeds = class_labels(record), speeds_of(record)
    anchors = zip(RideScale.of(record).anchors, CLASS_NAMES, strict=True)
    stops = [(at, f"{at:.3g} rad/m ({name})", CLASS_COLOURS[code]) for code, (at, name) in enumerate(anchors)]
    units_per_m = 1.0 / record["metres_per_unit"]["horizontal"]
    relief = {"kind": "hillshade", "band": 1, "z_factor": units_per_m, "opacity": _PALE if in_project else 1.0}
    bars = BARRED_COLOURS | ({Barred.UNKNOWN: _GREY} if in_project else {})
    most = max(COST_COLOURS)
    costs = {value: f"{value:g}" for value in COST_COLOURS} | {1.0: "1: level road", most: f"{most:g} and more"}
    named = ((f'"class" = {code}', label, CLASS_COLOURS[code], "solid") for code, label in enumerate(labels))
    looks = [*named, *_CLOSED_LOOKS]
    fails = [
        (FAIL_SHARE, "at least half of the drives fail", CLASS_COLOURS[3]),
        (1.0, "all drives fail", CLASS_COLOURS[3]),
    ]
    at_speeds = [band.name for band in speed_bands(tuple(speeds))]
    return {
        MapFile.CLASS: paletted(enumerate(labels), CLASS_COLOURS),
        MapFile.REASON: paletted(REASON_TEXT.items(), REASON_GREYS, clear=[Reason.OK] if in_project else ()),
        MapFile.ROUGHNESS: _ramp(stops, _BAND["c_r"]),
        f"{MapFile.ROUGHNESS} p_fail": _ramp(fails, _BAND["p_fail"], clip=True),
        MapFile.COST: _ramp((value, label, COST_COLOURS[value]) for value, label in costs.items()),
        MapFile.SPEED: _ramp(_speed_stops(record)),
        MapFile.REGIONS_IN_CRS: vectors(looks),
        f"{MapFile.REGIONS_IN_CRS} closed": vectors(_CLOSED_LOOKS),
        MapFile.REGIONS: vectors(looks),
        MapFile.BARRED: paletted(BARRED_TEXT.items(), bars, clear=[Barred.NO] if in_project else ()),
        MapFile.OBSTACLE: paletted(enumerate(OBJECT_NAMES), OBJECT_COLOURS),
        MapFile.PASSAGE: paletted(enumerate(PASSAGE_NAMES), PASSAGE_COLOURS),
        MapFile.HEIGHTMAP: relief,
        MapFile.RELIEF: relief,
        **({MapFile.PHOTO: {"kind": "multibandcolor", "opacity": _PALE}} if in_project else {}),
        MapFile.SPEEDS: _ramp(stops),
        MapFile.HEADINGS: _ramp(stops),
        **{f"{MapFile.SPEEDS} {speed:g}": _ramp(stops, 1 + at_speeds.index(f"c_r_{speed:g}")) for speed in speeds},
        MapFile.TILES: vectors(looks, line=CALM_LINE if record["settings"].get("headings") else ""),
    }


def write_styles(folder: Path, record: Mapping[str, Any]) -> None:
    """Write a QGIS style beside each layer in a folder: class.qml for class.tif, and so on.

    A file holds a part for rasters and one for areas, of all layers with its stem; QGIS takes the part that fits.
    ``folder``: the folder of the layers. Styles are written for those that are there. ``record``: the record of the
    run, as in run.json. Raises OutputError: a style cannot be written.
    """
    found: dict[Path, dict[str, Style]] = {}
    for layer, style in map_styles(record).items():
        if " " not in layer and (folder / layer).is_file():
            path = (folder / layer).with_suffix(".qml")
            found.setdefault(path, {})["vectors" if "looks" in style else "pixels"] = style
    for path, parts in found.items():
        write_qgis(path, "style.xml", **({"pixels": None, "vectors": None} | parts))
