"""How QGIS draws rasters: as a palette, with a colour ramp, as a shaded relief."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from xml.etree import ElementTree as ET

from bumpymap.layers.gis.xml_file import add

__all__ = ["MULTIPLY", "NORMAL", "Colour", "RasterStyle", "hillshade", "paletted", "ramp"]

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

    Parameters
    ----------
    names : iterable of (int, str)
        The codes and what they mean, in the order of the legend.
    colours : mapping
        The colour of each code.
    clear : sequence of int
        Codes that are left transparent, whatever their colour.
    band : int
        The band with the codes.
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

    Parameters
    ----------
    z_factor : float
        What a height is multiplied by to have the unit of the CRS.
    opacity : float
        Below 1: paler, so that colours over it stay those of their legend.
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
