"""The map of a page: what stands there before the script runs, its controls and legends."""

from collections.abc import Sequence

import numpy as np

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, NO_CLASS, OBSTACLE, Barred
from bumpymap.layers.check.offset import OFF_KINDS
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, OFF_COLOURS, class_ranges
from bumpymap.layers.report.markup import Html, join, raw, swatch, tag
from bumpymap.layers.report.site import Site
from bumpymap.layers.report.tiles import NOT_KNOWN, ByteGrid

__all__ = ["RAMP", "controls_of", "map_figure", "scale_of", "stage_of"]

RAMP = ("#fcfdbf", "#feca8d", "#fd9668", "#f1605d", "#cd4071", "#9e2f7f", "#721f81", "#440f76", "#180f3d")
"""Colours from the least to the most of a value: lightness falls evenly, so that they can be told apart in grey."""
_GREY = (178, 178, 178)
_OVERLAYS = (
    ("relief", "Relief", True),
    ("barred", "Not passable", True),
)
_DENSE = 0.1
"""From this share of pixels with an obstacle on, as in a forest, they would hide the classes: they start hidden."""
_NORTH = (
    '<svg class="north" viewBox="0 0 24 40" role="img" aria-label="North is up"><path d="M12 2 20 24 12 19 4 24Z" '
    'fill="#1f2937"/><text x="12" y="38" text-anchor="middle">N</text></svg>'
)


def map_figure(site: Site, index: int, letter: str) -> Html:
    """Return the figure of a map; the script fills it and finds it by ``index``."""
    grids = {grid.key: grid for grid in site.grids}
    names = [("class", "Class"), *((key, _capital(grids[key].label)) for key in ("c_r", "p_fail", "slope", "cost"))]
    names += [("barred", "What can be crossed"), ("none", "Relief only")]
    names = [(key, name) for key, name in names if key not in grids or (grids[key].codes != NOT_KNOWN).any()]
    radios = [
        tag("label", tag("input", type="radio", name=f"layer-{index}", value=key, checked=key == "class"), f" {name}")
        for key, name in names
    ]
    dense = float(np.mean(site.objects[site.objects != NO_CLASS] == OBSTACLE)) if site.objects_known else 0.0
    overlays = [
        *_OVERLAYS,
        ("objects", "Obstacles and canopy", dense < _DENSE),
        *([("ways", "Way", True)] if site.ways else []),
        *([("stretches", "Real drives", True)] if site.check is not None else []),
    ]
    boxes = [
        tag("label", tag("input", type="checkbox", value=key, checked=checked), f" {name}")
        for key, name, checked in overlays
        if key != "objects" or site.objects_known
    ]
    title = f"{letter}: {site.name}" if letter else site.name
    legends = [_legend(key, site, grids) for key, _ in names if key != "none"]
    return tag(
        "figure",
        tag("figcaption", tag("strong", title)) if letter else "",
        controls_of(radios, boxes),
        stage_of(title, site.still, "roughness classes over shaded relief", index),
        tag("div", *legends, _overlay_legend(site), _drive_legend(site), class_="legends"),
        tag("p", _notes(site), class_="note"),
        class_="map",
        data_map=str(index),
    )


def controls_of(radios: Sequence[Html], boxes: Sequence[Html]) -> Html:
    """Return what chooses the colours of a map, and what is drawn over them."""
    return tag(
        "div",
        tag("fieldset", tag("legend", "Colours"), *radios),
        tag("fieldset", tag("legend", "Also shown"), *boxes),
        class_="controls",
    )


def stage_of(title: str, still: str, shown: str, index: int) -> Html:
    """Return the place of a map, its buttons and its line of values; ``still`` is a picture of what ``shown`` says."""
    buttons = [
        tag("button", text, type="button", value=value, aria_label=label)
        for value, text, label in (
            ("in", "+", "Zoom in"),
            ("out", "\N{MINUS SIGN}", "Zoom out"),
            ("all", "All", "Show all"),
        )
    ]
    stage = tag(
        "div",
        tag("img", class_="still", src=still, alt=f"Map of {title}: {shown}"),
        tag(
            "canvas",
            tabindex="0",
            role="application",
            aria_label=f"Map of {title}. Arrow keys move, plus and minus zoom, 0 shows all.",
            aria_describedby=f"readout-{index}",
            hidden=True,
        ),
        tag("div", *buttons, class_="zoom"),
        raw(_NORTH),
        tag("div", tag("span", class_="bar"), tag("span", class_="length"), class_="scale"),
        class_="stage",
    )
    readout = tag("p", "Point at the map to read its values.", class_="readout", id=f"readout-{index}", role="status")
    return join(stage, readout)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def _legend(key: str, site: Site, grids: dict[str, ByteGrid]) -> Html:
    if key == "class":
        ranges = class_ranges(site.record)
        told = [f": C_r {text}" for text in ranges] or [""] * len(CLASS_NAMES)
        entries = [(CLASS_COLOURS[code], f"{code} {name}{told[code]}") for code, name in enumerate(CLASS_NAMES)]
        items = [tag("li", swatch(colour), " ", text) for colour, text in entries]
    elif key == "barred":
        codes = [code for code in Barred if code != Barred.UNKNOWN and (site.summary.by_bar[code] or not code)]
        items = [tag("li", swatch(BARRED_COLOURS[code]), " ", BARRED_TEXT[code]) for code in codes]
    else:
        items = [scale_of(grids[key], RAMP)]
    items.append(tag("li", swatch(_GREY, hatched=True), " not known"))
    items.append(tag("li", swatch((255, 255, 255)), " no points"))
    return tag("ul", *items, class_="legend", data_of=key, hidden=key != "class")


def scale_of(grid: ByteGrid, ramp: Sequence[str], ends: tuple[str, str] = ("light", "dark")) -> Html:
    """Return a strip of the colours of a ramp with the values at its ends and in its middle."""
    width, height = 220, 14
    part = width / len(ramp)
    strips = [
        f'<rect x="{at * part:.2f}" width="{part + 0.5:.2f}" height="{height}" fill="{colour}"/>'
        for at, colour in enumerate(ramp)
    ]
    values = grid.span()
    unit = grid.unit and f" {grid.unit}"
    words = [f"{value:.{grid.decimals}f}{unit}" if value else "0" for value in values]
    texts = "".join(
        f'<text x="{x}" y="{height + 14}" text-anchor="{anchor}">{word}</text>'
        for x, anchor, word in zip((0, width / 2, width), ("start", "middle", "end"), words, strict=True)
    )
    label = f"{grid.label}: from {words[0]}, {ends[0]}, to {words[2]}, {ends[1]}"
    svg = f'<svg class="ramp" viewBox="0 0 {width} {height + 18}" role="img" aria-label="{label}">'
    return tag("li", raw(f"{svg}{''.join(strips)}{texts}</svg>"))


def _overlay_legend(site: Site) -> Html:
    items = [
        tag(
            "li",
            swatch((236, 236, 236), hatched=True, falling=True),
            " not passable: hatched, or dark where tiles are small",
        )
    ]
    if site.objects_known:
        items += [
            tag("li", swatch(OBJECT_COLOURS[1]), " obstacle"),
            tag("li", swatch(OBJECT_COLOURS[2]), " canopy: higher than the vehicle"),
        ]
    if site.ways:
        items.append(tag("li", swatch((214, 0, 147)), " way"))
    return tag("ul", *items, class_="legend also")


def _drive_legend(site: Site) -> Html:
    if site.check is None:
        return Html()
    items = [tag("li", swatch(OFF_COLOURS[code]), f" {name}") for code, name in enumerate(OFF_KINDS)]
    items.append(tag("li", "large marks: errors do not explain the difference"))
    return tag("ul", tag("li", tag("strong", "Real drives:")), *items, class_="legend also")


def _notes(site: Site) -> Html:
    spot = site.tiles.spot
    metres = spot.metres
    if spot.step > 1:
        size = (
            f"One pixel of the map is {metres:g} m, {spot.step} x {spot.step} tiles of {spot.tile_size:g} m. The worst "
            "tile decides: a pixel is not known if one of its tiles is not or holds no point, and not passable if one "
            "is not; its values are the largest."
        )
    else:
        size = f"One square of the map is a tile of {metres:g} m."
    if site.objects_known:
        fine = spot.cols * spot.tile_size / site.objects.shape[1]
        size += f" Obstacles are shown in pixels of {fine:.2g} m, the worst in each."
    rounding = "; ".join(grid.rounding for grid in site.grids if (grid.codes != NOT_KNOWN).any())
    return join(f"{size} Values are rounded for this page ({rounding}); the layers beside it hold them in full.")
