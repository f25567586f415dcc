"""Put a page together: one file that asks nobody for anything."""

from collections.abc import Sequence

from bumpymap.core import BARRED_TEXT, CLASS_NAMES, OBJECT_NAMES, REASON_TEXT, Barred, Reason
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS, OBJECT_COLOURS, OFF_COLOURS
from bumpymap.layers.report.document import document
from bumpymap.layers.report.map_figure import RAMP, map_figure
from bumpymap.layers.report.markup import Html, join, tag
from bumpymap.layers.report.sections import (
    drive_section,
    ground_section,
    lettered,
    limit_section,
    repeat_section,
    sheet_section,
    summary_line,
    survey_section,
    vehicle_section,
    way_section,
)
from bumpymap.layers.report.site import Site
from bumpymap.layers.report.tiles import UNKNOWN_FROM
from bumpymap.layers.report.words import headline

__all__ = ["render"]


def render(sites: Sequence[Site]) -> str:
    """Return the page of one map, or of two side by side, as HTML.

    It holds everything that it shows; its policy forbids a browser to fetch anything else. The same layers give the
    same page: it holds no time and no folder.
    """
    name = " and ".join(site.name for site in sites)
    shared = _same_place(sites)
    data = {"maps": [site.map_record() for site in sites], "together": shared, "codes": _codes()}
    maps = [map_figure(site, at, letter) for at, (letter, site) in enumerate(lettered(sites))]
    sections = [
        tag(
            "section",
            tag("h2", "Maps" if len(sites) > 1 else "Map", id="map"),
            tag("p", "Both maps move together and show the same layers." if shared else "", class_="note")
            if len(sites) > 1
            else "",
            tag("div", *maps, class_="beside maps"),
            *_to_sheets(sites),
            aria_labelledby="map",
        ),
        drive_section(sites),
        way_section(sites),
        ground_section(sites),
        sheet_section(sites),
        vehicle_section(sites),
        limit_section(sites),
        survey_section(sites),
        repeat_section(sites),
    ]
    return document(f"{name}: ground roughness", _headings(sites, name), sections, data)


def _to_sheets(sites: Sequence[Site]) -> list[Html]:
    """Return a line that leads to the table of sheets, if they have pages that can be opened from this one."""
    if not any(site.has_links and site.record.get("sheets") for site in sites):
        return []
    return [tag("p", "Each of ", tag("a", "the sheets", href="#sheets"), " has a page that shows it larger.")]


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
        "offColours": [OFF_COLOURS[code] for code in range(len(OFF_COLOURS))],
        "ramp": RAMP,
    }
