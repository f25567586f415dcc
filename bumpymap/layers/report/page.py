"""Put a page together: one file that asks nobody for anything."""

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from pathlib import Path

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT, Barred, Reason
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS
from bumpymap.layers.report.map_figure import RAMP, map_figure
from bumpymap.layers.report.markup import Html, join, raw, tag
from bumpymap.layers.report.sections import (
    ground_section,
    lettered,
    limit_section,
    repeat_section,
    summary_line,
    survey_section,
    vehicle_section,
    way_section,
)
from bumpymap.layers.report.site import Site
from bumpymap.layers.report.tiles import UNKNOWN_FROM
from bumpymap.layers.report.words import headline

__all__ = ["render"]

_DATA = Path(__file__).with_name("data")


def render(sites: Sequence[Site]) -> str:
    """Return the page of one map, or of two side by side, as HTML.

    It holds everything that it shows; its policy forbids a browser to fetch anything else. The same layers give the
    same page: it holds no time and no folder.
    """
    style, script = _asset("report.css"), _asset("report.js")
    name = " and ".join(site.name for site in sites)
    title = f"{name}: ground roughness"
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; script-src {_digest(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="generator", content="bumpymap"),
        tag("title", title),
        raw(f"<style>{style}</style>"),
    )
    shared = _same_place(sites)
    data = {"maps": [site.map_record() for site in sites], "together": shared, "codes": _codes()}
    # In a script element only "<" could end it.
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c")
    maps = [map_figure(site, at, letter) for at, (letter, site) in enumerate(lettered(sites))]
    body = tag(
        "body",
        tag("header", *_headings(sites, name)),
        tag(
            "main",
            tag(
                "section",
                tag("h2", "Maps" if len(sites) > 1 else "Map", id="map"),
                tag("p", "Both maps move together and show the same layers." if shared else "", class_="note")
                if len(sites) > 1
                else "",
                tag("div", *maps, class_="beside maps"),
                aria_labelledby="map",
            ),
            way_section(sites),
            ground_section(sites),
            vehicle_section(sites),
            limit_section(sites),
            survey_section(sites),
            repeat_section(sites),
        ),
        tag("footer", tag("p", "Made by bumpymap from the layers in the folder of this page. It needs no network.")),
        raw(f'<script type="application/json" id="report-data">{text}</script>'),
        raw(f"<script>{script}</script>"),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, body, lang='en')}\n"


def _headings(sites: Sequence[Site], name: str) -> list[Html]:
    if len(sites) == 1:
        (site,) = sites
        lines = [tag("p", headline(site), class_="result"), tag("p", summary_line(site), class_="facts")]
    else:
        lines = [
            tag("p", tag("strong", f"{letter}, {site.name}: "), headline(site), class_="result small")
            for letter, site in lettered(sites)
        ]
        lines += [tag("p", f"{letter}: {summary_line(site)}", class_="facts") for letter, site in lettered(sites)]
    kind = "Ground roughness" if len(sites) == 1 else "Ground roughness, two maps compared"
    return [tag("p", kind, class_="kind"), tag("h1", name), join(*lines)]


def _same_place(sites: Sequence[Site]) -> bool:
    """Return whether maps overlap in one CRS, so that they can move together."""
    if len(sites) < 2 or len({site.crs_name for site in sites}) > 1:
        return False
    boxes = [
        (spot.west, spot.north - spot.rows * spot.tile_size, spot.west + spot.cols * spot.tile_size, spot.north)
        for spot in (site.tiles.spot for site in sites)
    ]
    (west, south, east, north), (left, low, right, high) = boxes
    return west < right and left < east and south < high and low < north


def _codes() -> dict[str, object]:
    """Return names and colours of the codes in the grids."""
    return {
        "unknownFrom": UNKNOWN_FROM,
        "notKnown": int(Barred.UNKNOWN),
        "classes": list(CLASS_NAMES),
        "reasons": [REASON_TEXT[code] for code in Reason],
        "barred": [BARRED_TEXT[code] for code in Barred],
        "objects": list(OBJECT_NAMES),
        "classColours": [CLASS_COLOURS[code] for code in range(len(CLASS_NAMES))],
        "barredColours": [BARRED_COLOURS[code] for code in Barred],
        "objectColours": [OBJECT_COLOURS[code] for code in range(len(OBJECT_NAMES))],
        "ramp": RAMP,
    }


@cache
def _asset(name: str) -> str:
    return (_DATA / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
