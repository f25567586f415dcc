"""Style files that QGIS takes by itself, since they lie beside the layers and have their names."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

import numpy as np

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
    RideScale,
    class_limits,
    open_layer,
    raster_in,
)

__all__ = [
    "MULTIPLY",
    "NORMAL",
    "QGIS_VERSION",
    "StyleFacts",
    "add",
    "layer_style",
    "write_change_style",
    "write_check_style",
    "write_qgis",
    "write_styles",
]

QGIS_VERSION = "3.22.0"
"""The version of QGIS whose form the files have; newer ones read it too."""
_DOCTYPE = b"<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>\n"
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def add(
    parent: ET.Element, tag: str, attributes: Mapping[str, str] | None = None, text: str | None = None
) -> ET.Element:
    """Append an element to another one and return it."""
    element = ET.SubElement(parent, tag, dict(attributes or {}))
    element.text = text
    return element


def write_qgis(root: ET.Element, path: Path) -> None:
    """Write a style or a project, whole or not at all.

    What XML cannot hold (control characters, bytes that are not UTF-8), as in the name of a CRS, becomes U+FFFD.

    Raises
    ------
    OutputError
        It cannot be written.
    """
    ET.indent(root, " ")
    text = _NOT_XML.sub("\ufffd", ET.tostring(root, encoding="unicode"))
    with atomic(path) as temporary:
        temporary.write_bytes(_DOCTYPE + text.encode() + b"\n")


Colour = tuple[int, int, int, int]
"""Red, green, blue, alpha from 0 to 255."""
NORMAL, MULTIPLY = 0, 6
"""Blending modes of QGIS."""


@dataclass(frozen=True, slots=True)
class RasterStyle:
    """A renderer and whether pixels are mixed."""

    renderer: ET.Element
    smooth: bool = False
    """Bilinear resampling, zoomed in and out, without which a relief shows a grid that is not there; else the nearest
    pixel, since codes must not be mixed."""

    def elements(self, blend: int = NORMAL) -> list[ET.Element]:
        """Return what stands for a raster in a style file or in the layer of a project."""
        pipe = ET.Element("pipe")
        pipe.append(self.renderer)
        add(pipe, "brightnesscontrast", {"brightness": "0", "contrast": "0", "gamma": "1"})
        add(pipe, "huesaturation", {"saturation": "0", "grayscaleMode": "0", "colorizeOn": "0", "invertColors": "0"})
        method = {"zoomedInResampler": "bilinear", "zoomedOutResampler": "bilinear"} if self.smooth else {}
        add(pipe, "rasterresampler", {**method, "maxOversampling": "2"})
        add(pipe, "resamplingStage", text="resamplingFilter")
        mode = ET.Element("blendMode")
        mode.text = str(blend)
        return [pipe, mode]


def paletted(
    names: Iterable[tuple[int, str]], colours: Mapping[int, Colour], *, clear: Sequence[int] = (), band: int = 1
) -> RasterStyle:
    """Return the style of a band of codes; what is transparent has no entry, as a legend would show it in black.

    The legend has the order of ``names``; the codes ``clear`` are left transparent, whatever their colour.
    """
    renderer = _renderer("paletted", band)
    palette = add(renderer, "colorPalette")
    for value, label in names:
        if value not in clear and colours[value][3]:
            add(palette, "paletteEntry", _entry(value, label, colours[value]))
    return RasterStyle(renderer)


def ramp(band: int, stops: Sequence[tuple[float, str, Colour]], *, clip: bool = False) -> RasterStyle:
    """Return the style of a band of numbers: colours mixed between stops (value, label, colour), rising.

    Numbers beyond the first and the last stop have their colours, or with ``clip`` are transparent. The legend lists
    the stops.
    """
    low, high = f"{stops[0][0]:.9g}", f"{stops[-1][0]:.9g}"
    renderer = _renderer("singlebandpseudocolor", band)
    renderer.attrib |= {"classificationMin": low, "classificationMax": high}
    shader = add(
        add(renderer, "rastershader"),
        "colorrampshader",
        {
            "colorRampType": "INTERPOLATED",
            "classificationMode": "1",
            "clip": "1" if clip else "0",
            "minimumValue": low,
            "maximumValue": high,
            "labelPrecision": "3",
        },
    )
    for value, label, colour in stops:
        add(shader, "item", _entry(value, label, colour))
    add(shader, "rampLegendSettings", {"useContinuousLegend": "0"})
    return RasterStyle(renderer)


def hillshade(z_factor: float, opacity: float = 1.0) -> RasterStyle:
    """Return the style of heights as a relief with the light from the north-west.

    ``z_factor`` turns heights into the unit of the CRS. An ``opacity`` below 1 is paler, so that colours over it stay
    those of their legend.
    """
    renderer = _renderer("hillshade", 1, opacity)
    renderer.attrib |= {"azimuth": "315", "angle": "45", "zfactor": f"{z_factor:.9g}", "multidirection": "0"}
    return RasterStyle(renderer, smooth=True)


def _renderer(kind: str, band: int, opacity: float = 1.0) -> ET.Element:
    looks = {"type": kind, "band": str(band), "opacity": f"{opacity:g}", "alphaBand": "-1", "nodataColor": ""}
    renderer = ET.Element("rasterrenderer", looks)
    add(renderer, "rasterTransparency")
    add(add(renderer, "minMaxOrigin"), "limits", text="None")
    return renderer


def _entry(value: float, label: str, colour: Colour) -> dict[str, str]:
    return {
        "value": f"{value:.9g}",
        "label": label,
        "color": "#{:02x}{:02x}{:02x}".format(*colour),
        "alpha": str(colour[3]),
    }


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

    The expression ``kind`` gives the name of the class, or "unknown" or "not passable".
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
    root = ET.Element("qgis", {"version": QGIS_VERSION, "styleCategories": "Symbology"})
    raster = paletted(enumerate(CHANGE_KINDS), CHANGE_COLOURS, band=band).elements()
    places = areas_by_kind("kind", [(name, name, CHANGE_COLOURS[code], "solid") for code, name in _CHANGED])
    known = {element.tag for element in raster}
    root.extend([*raster, *(element for element in places if element.tag not in known)])
    write_qgis(root, path)


_CHANGED = list(enumerate(CHANGE_KINDS))[1:]


def write_check_style(path: Path) -> None:
    """Write check.qml, which QGIS takes for check.geojson.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    root = ET.Element("qgis", {"version": QGIS_VERSION, "styleCategories": "Symbology"})
    looks = [(name, name, OFF_COLOURS[code]) for code, name in enumerate(OFF_KINDS)]
    symbols = [_disc(number, colour, '"explained" = false') for number, (_, _, colour) in enumerate(looks)]
    root.extend(_by_kind("off", [(value, label) for value, label, _ in looks], symbols, NORMAL))
    write_qgis(root, path)


_SAMPLE = 512
"""Most rows and columns of roughness.tif to read where the record has no limits of the classes."""


@dataclass(frozen=True, slots=True)
class StyleFacts:
    """Classes, colours of the ride cost and units of one map."""

    intervals: tuple[str, ...] | None
    """(4,) c_r of each class for the vehicle; None where the record has no limits of the classes."""
    by_c_r: bool
    """True if the intervals decide the class; False under the rules of the paper."""
    scale: RideScale
    z_factor: float
    """Units of the CRS in a metre, which is the unit of all heights."""
    speeds: tuple[float, ...] = ()
    """Of speeds.tif, m/s, in the order of its bands."""

    @classmethod
    def of(cls, folder: Path, record: Mapping[str, Any]) -> "StyleFacts":
        """Read them from the record of a run; c_r of its layers only if the record has no limits of the classes.

        Raises
        ------
        OutputError
            roughness.tif cannot be read.
        """
        limits = class_limits(record)
        sample = np.empty(0)
        if not limits:  # c_r from an overview if the raster is large
            with open_layer(raster_in(folder, "roughness.tif")) as raster:
                sample = raster.read(1, out_shape=(min(raster.height, _SAMPLE), min(raster.width, _SAMPLE)))
        units = record.get("metres_per_unit")
        metres = units.get("horizontal") if isinstance(units, Mapping) else None
        return cls(
            None if limits is None else _intervals(limits),
            _setting(record, "compat") != "paper",
            RideScale.of(record, sample),
            1.0 / metres if isinstance(metres, int | float) and metres > 0 else 1.0,
            tuple(float(speed) for speed in _setting(record, "speeds") or ()),
        )

    @property
    def class_labels(self) -> tuple[str, ...]:
        """(4,) what a legend says for each class: its name and, where it decides, its interval of c_r."""
        if self.intervals is None or not self.by_c_r:
            return CLASS_NAMES
        named = [f"{name}: c_r {text}" for name, text in zip(CLASS_NAMES, self.intervals, strict=True)]
        return (*named[:-1], f"{named[-1]}{OR_FAILS}")

    @property
    def ride_labels(self) -> tuple[str, ...]:
        """(4,) what a legend says for the colour of each class in a picture of c_r."""
        if self.intervals is None:
            return tuple(f"{anchor:.3g} rad/m" for anchor in self.scale.anchors)
        return tuple(f"{text} ({name})" for name, text in zip(CLASS_NAMES, self.intervals, strict=True))


def _intervals(limits: list[float]) -> tuple[str, ...]:
    texts = [f"{limit:.3g}" for limit in limits]
    between = [f"{low} to {high} rad/m" for low, high in pairwise(["0", *texts])]
    return (*between, f"from {texts[-1]} rad/m")


def _setting(record: Mapping[str, Any], name: str) -> Any:
    """Return a setting of a run, or None; settings are a dataclass until they are written, then an object of JSON."""
    settings = record.get("settings")
    return settings.get(name) if isinstance(settings, Mapping) else getattr(settings, name, None)


_C_R_BAND = 1 + [band.name for band in BANDS].index("c_r")
_PALE = 0.6
"""Opacity of the relief under other layers."""
_GREY = (*BARRED_COLOURS[Barred.UNKNOWN][:3], 180)
"""Colour of unknown ground over the relief, which shows through; no class is drawn between them."""
_AREAS = {"cost.geojson": REGION_KIND, "cost.fgb": REGION_KIND, "tiles.parquet": TILE_KIND}
_FILES: dict[str, tuple[str, ...]] = {
    "class.qml": ("class.tif",),
    "reason.qml": ("reason.tif",),
    "roughness.qml": ("roughness.tif",),
    "cost.qml": ("cost.tif", "cost.fgb", "cost.geojson"),
    "barred.qml": ("barred.tif",),
    "obstacle.qml": ("obstacle.tif",),
    "passage.qml": ("passage.tif",),
    "heightmap.qml": ("heightmap.tif",),
    "relief.qml": ("relief.tif",),
    "speeds.qml": ("speeds.tif",),
    "tiles.qml": ("tiles.parquet",),
}
"""Each style file and the layers that QGIS uses it for, all with its stem: one file holds a part for rasters and one
for areas, and QGIS takes the part that fits."""


def write_styles(folder: Path, record: Mapping[str, Any]) -> None:
    """Write a QGIS style beside each layer in a folder: class.qml for class.tif, and so on.

    Parameters
    ----------
    folder : Path
        The folder of the layers. Styles are written for those that are there, or are virtual rasters over sheets.
    record : mapping
        The record of the run, as in run.json.

    Raises
    ------
    OutputError
        A style cannot be written.
    """
    facts = StyleFacts.of(folder, record)
    for name, layers in _FILES.items():
        present = [layer for layer in layers if raster_in(folder, layer).is_file()]
        rasters = [layer for layer in present if layer not in _AREAS]
        areas = [layer for layer in present if layer in _AREAS]
        root = ET.Element("qgis", {"version": QGIS_VERSION, "styleCategories": "Symbology"})
        for layer in (*rasters[:1], *areas[:1]):
            known = {element.tag for element in root}
            root.extend(element for element in layer_style(layer, facts) if element.tag not in known)
        if present:
            write_qgis(root, folder / name)


def layer_style(
    layer: str, facts: StyleFacts, blend: int = NORMAL, *, layered: bool = False, part: str = ""
) -> list[ET.Element]:
    """Return how QGIS shows a layer: elements of a style file, or of a layer in a project.

    Parameters
    ----------
    layer : str
        Name of the file.
    facts : StyleFacts
        What the style depends on.
    blend : int
        Blending mode.
    layered : bool
        As one of several layers of a project: clear where there is nothing to explain (passable tiles, tiles with a
        class); a pale relief.
    part : str
        Show something else of the file: ``p_fail``, the tiles where at least half of the drives fail; of speeds.tif
        the C_r at another of its speeds, such as ``0.5`` [m/s].
    """
    if layer == "speeds.tif":
        names = [band.name for band in speed_bands(facts.speeds)]
        return _roughness(facts, 1 + names.index(f"c_r_{part}") if part else 1).elements(blend)
    if part:
        return _PARTS[part].elements(blend)
    if layer in _AREAS:
        return class_areas(_AREAS[layer], facts.class_labels, blend)
    if layered and layer in _LAYERED:
        return _LAYERED[layer](facts).elements(blend)
    return _RASTERS[layer](facts).elements(blend)


def _roughness(facts: StyleFacts, band: int = _C_R_BAND) -> RasterStyle:
    stops = zip(facts.scale.anchors, facts.ride_labels, strict=True)
    return ramp(band, [(value, label, CLASS_COLOURS[number]) for number, (value, label) in enumerate(stops)])


def _cost() -> RasterStyle:
    most = max(COST_COLOURS)
    labels = {1.0: "1: level road", most: f"{most:g} and more"}
    return ramp(1, [(value, labels.get(value, f"{value:g}"), colour) for value, colour in COST_COLOURS.items()])


def _barred(clear: tuple[int, ...] = (), colours: Mapping[int, Colour] = BARRED_COLOURS) -> RasterStyle:
    return paletted(((code.value, text) for code, text in BARRED_TEXT.items()), colours, clear=clear)


def _reason(clear: tuple[int, ...] = ()) -> RasterStyle:
    return paletted(((code.value, text) for code, text in REASON_TEXT.items()), REASON_COLOURS, clear=clear)


_RASTERS: dict[str, Callable[[StyleFacts], RasterStyle]] = {
    "class.tif": lambda facts: paletted(enumerate(facts.class_labels), CLASS_COLOURS),
    "roughness.tif": _roughness,
    "cost.tif": lambda _: _cost(),
    "barred.tif": lambda _: _barred(),
    "reason.tif": lambda _: _reason(),
    "obstacle.tif": lambda _: paletted(enumerate(OBJECT_NAMES), OBJECT_COLOURS),
    "passage.tif": lambda _: paletted(enumerate(PASSAGE_NAMES), PASSAGE_COLOURS),
    "heightmap.tif": lambda facts: hillshade(facts.z_factor),
    "relief.tif": lambda facts: hillshade(facts.z_factor),
}
_LAYERED: dict[str, Callable[[StyleFacts], RasterStyle]] = {
    "barred.tif": lambda _: _barred((Barred.NO,), BARRED_COLOURS | {Barred.UNKNOWN: _GREY}),
    "reason.tif": lambda _: _reason((Reason.OK,)),
    "heightmap.tif": lambda facts: hillshade(facts.z_factor, _PALE),
    "relief.tif": lambda facts: hillshade(facts.z_factor, _PALE),
}
_VERY_ROUGH = CLASS_COLOURS[3]
_FAILS = ((FAIL_SHARE, "at least half of the drives fail", _VERY_ROUGH), (1.0, "all drives fail", _VERY_ROUGH))
_PARTS = {"p_fail": ramp(1 + [band.name for band in BANDS].index("p_fail"), _FAILS, clip=True)}
