"""Style files that QGIS takes by itself, since they lie beside the layers and have their names."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from bumpymap.core import BANDS, BARRED_TEXT, FAIL_SHARE, OBJECT_NAMES, REASON_TEXT, Barred, Reason, speed_bands
from bumpymap.layers.colours import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    COST_COLOURS,
    OBJECT_COLOURS,
    PASSAGE_COLOURS,
    PASSAGE_NAMES,
    REASON_COLOURS,
)
from bumpymap.layers.gis.facts import StyleFacts
from bumpymap.layers.gis.raster_style import NORMAL, Colour, RasterStyle, hillshade, paletted, ramp
from bumpymap.layers.gis.vector_style import REGION_KIND, TILE_KIND, class_areas
from bumpymap.layers.gis.xml_file import QGIS_VERSION, write_qgis
from bumpymap.layers.sheets.folders import raster_in

__all__ = ["layer_style", "write_styles"]

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
        return _at_speed(facts, part).elements(blend)
    if part:
        return _PARTS[part].elements(blend)
    if layer in _AREAS:
        return class_areas(_AREAS[layer], facts.class_labels, blend)
    if layered and layer in _LAYERED:
        return _LAYERED[layer](facts).elements(blend)
    return _RASTERS[layer](facts).elements(blend)


def _class(facts: StyleFacts) -> RasterStyle:
    return paletted(enumerate(facts.class_labels), CLASS_COLOURS)


def _roughness(facts: StyleFacts, band: int = _C_R_BAND) -> RasterStyle:
    stops = zip(facts.scale.anchors, facts.ride_labels, strict=True)
    return ramp(band, [(value, label, CLASS_COLOURS[number]) for number, (value, label) in enumerate(stops)])


def _at_speed(facts: StyleFacts, speed: str) -> RasterStyle:
    """Return the style of the C_r in speeds.tif at a speed; without one at the first, in the colours of the map's."""
    names = [band.name for band in speed_bands(facts.speeds)]
    return _roughness(facts, 1 + names.index(f"c_r_{speed}") if speed else 1)


def _cost() -> RasterStyle:
    most = max(COST_COLOURS)
    labels = {1.0: "1: level road", most: f"{most:g} and more"}
    return ramp(1, [(value, labels.get(value, f"{value:g}"), colour) for value, colour in COST_COLOURS.items()])


def _barred(clear: tuple[int, ...] = (), colours: Mapping[int, Colour] = BARRED_COLOURS) -> RasterStyle:
    return paletted(((code.value, text) for code, text in BARRED_TEXT.items()), colours, clear=clear)


def _reason(clear: tuple[int, ...] = ()) -> RasterStyle:
    return paletted(((code.value, text) for code, text in REASON_TEXT.items()), REASON_COLOURS, clear=clear)


_RASTERS: dict[str, Callable[[StyleFacts], RasterStyle]] = {
    "class.tif": _class,
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
