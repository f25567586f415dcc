"""Style files that QGIS takes by itself, since they lie beside the layers and have their names."""

import re
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

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
    speed_bands,
)
from bumpymap.layers import (
    BARRED_COLOURS,
    CHANGE_COLOURS,
    CLASS_COLOURS,
    COST_COLOURS,
    OBJECT_COLOURS,
    OFF_COLOURS,
    OFF_KINDS,
    OR_FAILS,
    PASSAGE_COLOURS,
    PASSAGE_NAMES,
    REASON_COLOURS,
    MapFile,
    RideScale,
    class_limits,
)
from bumpymap.views.page.page import render_text

QGIS_VERSION = "3.22.0"
"""The version of QGIS whose form the files have; newer ones read it too."""
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_NOT_XML = re.compile("[\ufffe\uffff]")


def write_qgis(path: Path, template: str, **context: Any) -> None:
    """Write a style or a project, whole or not at all.

    Control characters and bytes that are not UTF-8, as in the name of a CRS, are shown as escapes, as on pages.

    Parameters
    ----------
    path : Path
        The file.
    template : str
        Name of a template beside this module.
    **context
        What the template needs.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    text = render_text(template, version=QGIS_VERSION, **context)
    root = ET.fromstring(_NOT_XML.sub("\ufffd", text).strip())  # noqa: S314 (of a template of our own)
    ET.indent(root, " ")
    with atomic(path) as temporary:
        temporary.write_bytes(_DOCTYPE + ET.tostring(root, encoding="unicode").encode() + b"\n")


NORMAL, MULTIPLY = 0, 6
"""Blending modes of QGIS."""
Style = dict[str, Any]
"""A layer for a template: pixels by `paletted` or `_ramp`, areas and points by `_vectors`."""
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
    return {
        "kind": "singlebandpseudocolor",
        "band": band,
        "entries": list(entries),
        "clip": clip,
        "opacity": 1.0,
    }


def _vectors(kind: str, looks: Iterable[tuple[str, str, _Colour, str]], large: str = "", line: str = "") -> Style:
    """Return the style of areas or points: for each value of ``kind`` label, colour and pattern.

    ``kind`` is an attribute or an expression of QGIS; so is ``large``, which says which points are drawn larger.
    ``line`` is an expression for a line over each area, NULL where there is none.
    """
    return {"kind": kind, "looks": list(looks), "large": large, "line": line}


CALM_RATIO = 1.3
"""From this ratio of the highest to the lowest C_r by heading on, the heading matters."""
_END = 'project(centroid($geometry), 0.4 * sqrt(area($geometry)), radians("calm_axis_deg" + {turn}))'
_MATTERS = f'"passable" and "heading_ratio" > {CALM_RATIO}'
CALM_LINE = f"if({_MATTERS}, make_line({_END.format(turn=0)}, {_END.format(turn=180)}), NULL)"
"""Expression of QGIS: a line through a passable tile along the heading with the lowest C_r, where that matters."""


_UNKNOWN, _CLOSED = "unknown", "not passable"
REGION_KIND = (
    f'CASE WHEN "class_name" = \'{_UNKNOWN}\' THEN \'{_UNKNOWN}\' WHEN "passable" THEN "class_name" '
    f"ELSE '{_CLOSED}' END"
)
"""Expression of QGIS: the category of a region of cost.geojson or cost.fgb."""
_NAMED = " ".join(f"WHEN \"class\" = {number} THEN '{name}'" for number, name in enumerate(CLASS_NAMES))
TILE_KIND = (
    f"CASE WHEN \"class\" IS NULL THEN '{_UNKNOWN}' WHEN \"passable\" IS NOT TRUE THEN '{_CLOSED}' "
    f"{_NAMED} ELSE '{_UNKNOWN}' END"
)
"""Expression of QGIS: the category of a tile of tiles.parquet."""


def write_change_style(path: Path, band: int) -> None:
    """Write change.qml: QGIS takes it for change.tif and change.geojson, since both have its name.

    Parameters
    ----------
    path : Path
        The file.
    band : int
        Band of change.tif with the codes, from 1.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    places = [(name, name, CHANGE_COLOURS[code], "solid") for code, name in enumerate(CHANGE_KINDS) if code]
    codes = paletted(enumerate(CHANGE_KINDS), CHANGE_COLOURS, band=band)
    write_qgis(path, "style.xml", pixels=codes, vectors=_vectors("kind", places))


def write_check_style(path: Path) -> None:
    """Write check.qml, which QGIS takes for check.geojson.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    looks = [(name, name, OFF_COLOURS[code], "") for code, name in enumerate(OFF_KINDS)]
    write_qgis(path, "style.xml", pixels=None, vectors=_vectors("off", looks, '"explained" = false'))


_PALE = 0.6
"""Opacity of the relief under other layers, so that colours over it stay those of their legend."""
_GREY = (*BARRED_COLOURS[Barred.UNKNOWN][:3], 180)
"""Colour of unknown ground over the relief, which shows through; no class is drawn between them."""
_BAND = {band.name: number for number, band in enumerate(BANDS, 1)}


def class_labels(record: Mapping[str, Any]) -> tuple[str, ...]:
    """Return what a legend says for each class: its name and, where that decides, its interval of c_r."""
    limits = class_limits(record)
    if limits is None or _setting(record, "compat") == "paper":
        return CLASS_NAMES
    named = [f"{name}: c_r {text}" for name, text in zip(CLASS_NAMES, _intervals(limits), strict=True)]
    return (*named[:-1], f"{named[-1]}{OR_FAILS}")


def speeds_of(record: Mapping[str, Any]) -> list[float]:
    """Return the speeds of speeds.tif, m/s, in the order of its bands."""
    return [float(speed) for speed in _setting(record, "speeds") or ()]


def _intervals(limits: list[float]) -> tuple[str, ...]:
    texts = [f"{limit:.3g}" for limit in limits]
    between = [f"{low} to {high} rad/m" for low, high in pairwise(["0", *texts])]
    return (*between, f"from {texts[-1]} rad/m")


def _setting(record: Mapping[str, Any], name: str) -> Any:
    """Return a setting of a run, or None; settings are a dataclass until they are written, then an object of JSON."""
    settings = record.get("settings")
    return settings.get(name) if isinstance(settings, Mapping) else getattr(settings, name, None)


def _ride_stops(record: Mapping[str, Any]) -> list[tuple[float, str, _Colour]]:
    """Return the colours of c_r with their labels."""
    limits = class_limits(record)
    anchors = RideScale.of(record).anchors
    labels = [f"{anchor:.3g} rad/m" for anchor in anchors]
    if limits:
        labels = [f"{text} ({name})" for name, text in zip(CLASS_NAMES, _intervals(limits), strict=True)]
    return [
        (anchor, label, CLASS_COLOURS[code]) for code, (anchor, label) in enumerate(zip(anchors, labels, strict=True))
    ]


def _speed_stops(record: Mapping[str, Any]) -> list[tuple[float, str, _Colour]]:
    """Return the colours of the speed made good: those of a cost of as many times the metre at the top speed."""
    speeds = record.get("cost", {}).get("speeds_mps_at_c_r_radpm") or [[1.0]]
    top = speeds[0][0]
    steps = [(top / times, f"{top / times:.3g} m/s", colour) for times, colour in COST_COLOURS.items()]
    return [(0.0, "0: not passable", BARRED_COLOURS[Barred.OBSTACLE]), *sorted(steps)]


def map_styles(record: Mapping[str, Any], *, layered: bool = False) -> dict[str, Style]:
    """Return how QGIS shows each layer of a map.

    Parameters
    ----------
    record : mapping
        The record of the run, as in run.json.
    layered : bool
        As layers of one project: clear where there is nothing to explain (passable tiles, tiles with a class); a pale
        relief; the photo, which needs no style of its own.

    Returns
    -------
    dict
        By `MapFile`; what else a project shows of one, by it and a part: of roughness.tif ``p_fail``, the tiles where
        at least half of the drives fail, and of speeds.tif the C_r at each speed, such as ``0.5``.
    """
    labels, stops, speeds = class_labels(record), _ride_stops(record), speeds_of(record)
    units = record.get("metres_per_unit")
    metres = units.get("horizontal") if isinstance(units, Mapping) else None
    units_per_m = 1.0 / metres if isinstance(metres, int | float) and metres > 0 else 1.0
    relief = {"kind": "hillshade", "band": 1, "z_factor": units_per_m, "opacity": _PALE if layered else 1.0}
    bars = BARRED_COLOURS | ({Barred.UNKNOWN: _GREY} if layered else {})
    most = max(COST_COLOURS)
    costs = {value: f"{value:g}" for value in COST_COLOURS} | {1.0: "1: level road", most: f"{most:g} and more"}
    named = (
        (name, label, CLASS_COLOURS[code], "solid")
        for code, (name, label) in enumerate(zip(CLASS_NAMES, labels, strict=True))
    )
    looks = [
        *named,
        (_UNKNOWN, _UNKNOWN, BARRED_COLOURS[Barred.UNKNOWN], "b_diagonal"),
        (_CLOSED, _CLOSED, BARRED_COLOURS[Barred.OBSTACLE], "diagonal_x"),
    ]
    fails = [
        (FAIL_SHARE, "at least half of the drives fail", CLASS_COLOURS[3]),
        (1.0, "all drives fail", CLASS_COLOURS[3]),
    ]
    at_speeds = [band.name for band in speed_bands(tuple(speeds))]
    return {
        MapFile.CLASS: paletted(enumerate(labels), CLASS_COLOURS),
        MapFile.REASON: paletted(REASON_TEXT.items(), REASON_COLOURS, clear=[Reason.OK] if layered else ()),
        MapFile.ROUGHNESS: _ramp(stops, _BAND["c_r"]),
        f"{MapFile.ROUGHNESS} p_fail": _ramp(fails, _BAND["p_fail"], clip=True),
        MapFile.COST: _ramp((value, label, COST_COLOURS[value]) for value, label in costs.items()),
        MapFile.SPEED: _ramp(_speed_stops(record)),
        MapFile.REGIONS_IN_CRS: _vectors(REGION_KIND, looks),
        MapFile.REGIONS: _vectors(REGION_KIND, looks),
        MapFile.BARRED: paletted(BARRED_TEXT.items(), bars, clear=[Barred.NO] if layered else ()),
        MapFile.OBSTACLE: paletted(enumerate(OBJECT_NAMES), OBJECT_COLOURS),
        MapFile.PASSAGE: paletted(enumerate(PASSAGE_NAMES), PASSAGE_COLOURS),
        MapFile.HEIGHTMAP: relief,
        MapFile.RELIEF: relief,
        **({MapFile.PHOTO: {"kind": "multibandcolor", "opacity": 1.0}} if layered else {}),
        MapFile.SPEEDS: _ramp(stops),
        MapFile.HEADINGS: _ramp(stops),
        **{f"{MapFile.SPEEDS} {speed:g}": _ramp(stops, 1 + at_speeds.index(f"c_r_{speed:g}")) for speed in speeds},
        MapFile.TILES: _vectors(TILE_KIND, looks, line=CALM_LINE if _setting(record, "headings") else ""),
    }


def write_styles(folder: Path, record: Mapping[str, Any]) -> None:
    """Write a QGIS style beside each layer in a folder: class.qml for class.tif, and so on.

    A file holds a part for rasters and one for areas, of all layers with its stem; QGIS takes the part that fits.

    Parameters
    ----------
    folder : Path
        The folder of the layers. Styles are written for those that are there.
    record : mapping
        The record of the run, as in run.json.

    Raises
    ------
    OutputError
        A style cannot be written.
    """
    found: dict[Path, dict[str, Style]] = {}
    for layer, style in map_styles(record).items():
        if " " not in layer and (folder / layer).is_file():
            path = (folder / layer).with_suffix(".qml")
            found.setdefault(path, {})["vectors" if "looks" in style else "pixels"] = style
    for path, parts in found.items():
        write_qgis(path, "style.xml", **({"pixels": None, "vectors": None} | parts))
