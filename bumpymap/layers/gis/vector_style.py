"""How QGIS draws regions and tiles, filled by class, what is unknown or not passable hatched; and points."""

from collections.abc import Mapping, Sequence
from typing import TypeAlias
from xml.etree import ElementTree as ET

from bumpymap.core import CLASS_NAMES, Barred
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS
from bumpymap.layers.gis.raster_style import NORMAL, Colour
from bumpymap.layers.gis.xml_file import add

__all__ = ["REGION_KIND", "TILE_KIND", "AreaLook", "areas_by_kind", "class_areas", "points_by_kind"]

AreaLook: TypeAlias = tuple[str, str, Colour, str]
"""Value, label, colour and pattern of a category."""
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


def class_areas(kind: str, labels: Sequence[str], blend: int = NORMAL) -> list[ET.Element]:
    """Return what stands for areas by class in a style file or in the layer of a project.

    Parameters
    ----------
    kind : str
        Expression that gives the name of the class, or "unknown" or "not passable".
    labels : sequence of str
        What the legend says for each class.
    blend : int
        Blending mode.
    """
    looks: list[AreaLook] = [
        (name, label, CLASS_COLOURS[number], "solid")
        for number, (name, label) in enumerate(zip(CLASS_NAMES, labels, strict=True))
    ]
    looks += [
        (_UNKNOWN, _UNKNOWN, BARRED_COLOURS[Barred.UNKNOWN], "b_diagonal"),
        (_CLOSED, _CLOSED, BARRED_COLOURS[Barred.OBSTACLE], "diagonal_x"),
    ]
    return areas_by_kind(kind, looks, blend)


def areas_by_kind(kind: str, looks: Sequence[AreaLook], blend: int = NORMAL) -> list[ET.Element]:
    """Return what stands for areas in a style file: one look for each value of an attribute or expression ``kind``."""
    symbols = [_fill(number, colour, pattern) for number, (_, _, colour, pattern) in enumerate(looks)]
    return _by_kind(kind, [(value, label) for value, label, _, _ in looks], symbols, blend)


def points_by_kind(kind: str, looks: Sequence[tuple[str, str, Colour]], large: str) -> list[ET.Element]:
    """Return what stands for points in a style file: value, label and colour for each value of ``kind``.

    Points of which the expression ``large`` is true are larger.
    """
    symbols = [_disc(number, colour, large) for number, (_, _, colour) in enumerate(looks)]
    return _by_kind(kind, [(value, label) for value, label, _ in looks], symbols, NORMAL)


def _by_kind(
    kind: str, entries: Sequence[tuple[str, str]], symbols: Sequence[ET.Element], blend: int
) -> list[ET.Element]:
    renderer = ET.Element("renderer-v2", {"type": "categorizedSymbol", "attr": kind, "symbollevels": "0"})
    categories = add(renderer, "categories")
    add(renderer, "symbols").extend(symbols)
    for number, (value, label) in enumerate(entries):
        entry = {"value": value, "label": label, "symbol": str(number), "render": "true"}
        add(categories, "category", entry)
    found = [renderer]
    for tag, text in (("blendMode", str(blend)), ("featureBlendMode", str(NORMAL)), ("layerOpacity", "1")):
        element = ET.Element(tag)
        element.text = text
        found.append(element)
    return found


def _fill(number: int, colour: Colour, pattern: str) -> ET.Element:
    """Return a filled symbol. Its outline has its colour: without one, hairlines shine through between areas."""
    text = ",".join(map(str, colour))
    properties = {
        "color": text,
        "style": pattern,
        "outline_color": text,
        "outline_style": "solid",
        "outline_width": "0.1",
        "outline_width_unit": "MM",
        "joinstyle": "miter",
    }
    return _symbol(number, "fill", "SimpleFill", properties)


def _disc(number: int, colour: Colour, large: str) -> ET.Element:
    """Return a disc with a dark outline, so that a pale one is seen too."""
    properties = {
        "name": "circle",
        "color": ",".join(map(str, colour)),
        "outline_color": "35,35,35,255",
        "outline_style": "solid",
        "outline_width": "0.3",
        "outline_width_unit": "MM",
        "size": "2.6",
        "size_unit": "MM",
    }
    symbol = _symbol(number, "marker", "SimpleMarker", properties)
    layer = symbol[0]
    options = add(add(layer, "data_defined_properties"), "Option", {"type": "Map"})
    add(options, "Option", {"type": "QString", "name": "name", "value": ""})
    size = add(add(options, "Option", {"type": "Map", "name": "properties"}), "Option", {"type": "Map", "name": "size"})
    add(size, "Option", {"type": "bool", "name": "active", "value": "true"})
    add(size, "Option", {"type": "QString", "name": "expression", "value": f"if({large}, 4.2, 2.6)"})
    add(size, "Option", {"type": "int", "name": "type", "value": "3"})
    add(options, "Option", {"type": "QString", "name": "type", "value": "collection"})
    return symbol


def _symbol(number: int, kind: str, layer_class: str, properties: Mapping[str, str]) -> ET.Element:
    symbol = ET.Element("symbol", {"type": kind, "name": str(number), "alpha": "1", "clip_to_extent": "1"})
    layer = add(symbol, "layer", {"class": layer_class, "enabled": "1", "pass": "0", "locked": "0"})
    options = add(layer, "Option", {"type": "Map"})
    for name, value in properties.items():
        add(options, "Option", {"type": "QString", "name": name, "value": value})
    return symbol
