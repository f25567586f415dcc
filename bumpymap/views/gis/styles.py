"""Style files that QGIS takes by itself, since they lie beside the layers and have their names."""

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, TypeAlias
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
from bumpymap.views.page.page import render_text

__all__ = [
    "MULTIPLY",
    "NORMAL",
    "RasterStyle",
    "StyleFacts",
    "VectorStyle",
    "layer_style",
    "write_change_style",
    "write_check_style",
    "write_qgis",
    "write_styles",
]

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


Colour = tuple[int, int, int, int]
"""Red, green, blue, alpha from 0 to 255."""
NORMAL, MULTIPLY = 0, 6
"""Blending modes of QGIS."""


@dataclass(frozen=True, slots=True)
class RasterStyle:
    """How a band is shown."""

    kind: Literal["paletted", "singlebandpseudocolor", "hillshade"]
    """Codes; numbers, with colours mixed between entries; heights as a relief with the light from the north-west."""
    band: int = 1
    entries: tuple[tuple[float, str, Colour], ...] = ()
    """Value, label and colour, in the order of the legend; stops of a ramp rise."""
    clip: bool = False
    """True if numbers beyond the first and the last stop are transparent; else they have their colours."""
    z_factor: float = 1.0
    """Turns heights into the unit of the CRS."""
    opacity: float = 1.0
    """Below 1, a relief is paler, so that colours over it stay those of their legend."""


def paletted(
    names: Iterable[tuple[int, str]], colours: Mapping[int, Colour], *, clear: Sequence[int] = (), band: int = 1
) -> RasterStyle:
    """Return the style of a band of codes; what is transparent has no entry, as a legend would show it in black.

    The legend has the order of ``names``; the codes ``clear`` are left transparent, whatever their colour.
    """
    shown = ((value, label) for value, label in names if value not in clear and colours[value][3])
    return RasterStyle("paletted", band, tuple((value, label, colours[value]) for value, label in shown))


VectorLook: TypeAlias = tuple[str, str, Colour, str]
"""Value, label, colour and, of areas, pattern."""
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


@dataclass(frozen=True, slots=True)
class VectorStyle:
    """How areas or points are shown: one look for each value."""

    kind: str
    """The attribute with the value, or an expression of QGIS that gives it."""
    looks: tuple[VectorLook, ...]
    large: str = ""
    """Of points: the expression of QGIS that says which are drawn larger."""


def class_areas(kind: str, labels: Sequence[str]) -> VectorStyle:
    """Return the style of areas by class: ``kind`` gives the name of the class, or "unknown" or "not passable"."""
    named = enumerate(zip(CLASS_NAMES, labels, strict=True))
    looks = [(name, label, CLASS_COLOURS[number], "solid") for number, (name, label) in named]
    unknown = (_UNKNOWN, _UNKNOWN, BARRED_COLOURS[Barred.UNKNOWN], "b_diagonal")
    closed = (_CLOSED, _CLOSED, BARRED_COLOURS[Barred.OBSTACLE], "diagonal_x")
    return VectorStyle(kind, (*looks, unknown, closed))


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
    write_qgis(path, "style.xml", pixels=codes, vectors=VectorStyle("kind", tuple(places)))


def write_check_style(path: Path) -> None:
    """Write check.qml, which QGIS takes for check.geojson.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    looks = tuple((name, name, OFF_COLOURS[code], "") for code, name in enumerate(OFF_KINDS))
    write_qgis(path, "style.xml", pixels=None, vectors=VectorStyle("off", looks, '"explained" = false'))


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
        styles = [layer_style(layer, facts) for layer in present]
        pixels = next((style for style in styles if isinstance(style, RasterStyle)), None)
        vectors = next((style for style in styles if isinstance(style, VectorStyle)), None)
        if present:
            write_qgis(folder / name, "style.xml", pixels=pixels, vectors=vectors)


def layer_style(layer: str, facts: StyleFacts, *, layered: bool = False, part: str = "") -> RasterStyle | VectorStyle:
    """Return how QGIS shows a layer.

    Parameters
    ----------
    layer : str
        Name of the file.
    facts : StyleFacts
        What the style depends on.
    layered : bool
        As one of several layers of a project: clear where there is nothing to explain (passable tiles, tiles with a
        class); a pale relief.
    part : str
        Show something else of the file: ``p_fail``, the tiles where at least half of the drives fail; of speeds.tif
        the C_r at another of its speeds, such as ``0.5`` [m/s].
    """
    if layer == "speeds.tif":
        names = [band.name for band in speed_bands(facts.speeds)]
        return _roughness(facts, 1 + names.index(f"c_r_{part}") if part else 1)
    if part:
        return _PARTS[part]
    if layer in _AREAS:
        return class_areas(_AREAS[layer], facts.class_labels)
    if layered and layer in _LAYERED:
        return _LAYERED[layer](facts)
    return _RASTERS[layer](facts)


def _roughness(facts: StyleFacts, band: int = _C_R_BAND) -> RasterStyle:
    colours = [CLASS_COLOURS[number] for number in range(len(CLASS_NAMES))]
    stops = zip(facts.scale.anchors, facts.ride_labels, colours, strict=True)
    return RasterStyle("singlebandpseudocolor", band, tuple(stops))


def _cost() -> RasterStyle:
    most = max(COST_COLOURS)
    labels = {1.0: "1: level road", most: f"{most:g} and more"}
    stops = ((value, labels.get(value, f"{value:g}"), colour) for value, colour in COST_COLOURS.items())
    return RasterStyle("singlebandpseudocolor", entries=tuple(stops))


def _relief(facts: StyleFacts, opacity: float = 1.0) -> RasterStyle:
    return RasterStyle("hillshade", z_factor=facts.z_factor, opacity=opacity)


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
    "heightmap.tif": _relief,
    "relief.tif": _relief,
}
_LAYERED: dict[str, Callable[[StyleFacts], RasterStyle]] = {
    "barred.tif": lambda _: _barred((Barred.NO,), BARRED_COLOURS | {Barred.UNKNOWN: _GREY}),
    "reason.tif": lambda _: _reason((Reason.OK,)),
    "heightmap.tif": lambda facts: _relief(facts, _PALE),
    "relief.tif": lambda facts: _relief(facts, _PALE),
}
_VERY_ROUGH = CLASS_COLOURS[3]
_FAILS = ((FAIL_SHARE, "at least half of the drives fail", _VERY_ROUGH), (1.0, "all drives fail", _VERY_ROUGH))
_P_FAIL_BAND = 1 + [band.name for band in BANDS].index("p_fail")
_PARTS = {"p_fail": RasterStyle("singlebandpseudocolor", _P_FAIL_BAND, _FAILS, clip=True)}
