"""index.html, the page of a batch: a row for each survey, with a thumbnail of its map and its place."""

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import CLASS_NAMES, shares_text, stated_crs
from bumpymap.layers import CLASS_COLOURS, UNKNOWN_COLOUR, MapFile, SurveyRow, SurveyStatus
from bumpymap.views.page.page import render_page
from bumpymap.views.page.site import UNREADABLE, jpeg, open_picture
from bumpymap.views.pictures.drawing import bar_length, ticks

_log = logging.getLogger(__name__)
_WIDTH, _HEIGHT, _EDGE, _SMALLEST_PX = 640.0, 300.0, 24.0, 9.0
"""Of the map of the surveys, pixels: its width and height, the space around the surveys, and the least side of the box
of a survey. Chosen."""
_LINES = 4
"""Most meridians and most parallels of that map: chosen."""
_DEGREE_M = 111_320.0
"""A degree of the equator of WGS 84, m."""
_LEAST_M = 100.0
"""Least extent of that map, m: chosen."""


def _places(rows: Sequence[SurveyRow]) -> dict[str, Any] | None:
    """Return the map of the surveys in pixels; None if fewer than two have a known place, or they lie far apart."""
    found = [(row, box) for row in rows if (box := _box(row))]
    if len(found) < 2:
        return None
    lows, highs = (pick(np.array([box for _, box in found]), axis=0).tolist() for pick in (np.min, np.max))
    (west, south, _, _), (_, _, east, north) = lows, highs
    if east - west > 180 or max(abs(south), abs(north)) > 85:
        return None
    middle = ((west + east) / 2, (south + north) / 2)
    east_m = _DEGREE_M * math.cos(math.radians(middle[1]))
    wide, high = max((east - west) * east_m, _LEAST_M), max((north - south) * _DEGREE_M, _LEAST_M)
    scale = min((_WIDTH - 2 * _EDGE) / wide, (_HEIGHT - 2 * _EDGE) / high)
    sizes = east_m * scale, _DEGREE_M * scale
    west, north = middle[0] - _WIDTH / 2 / sizes[0], middle[1] + _HEIGHT / 2 / sizes[1]
    bounds = west, north - _HEIGHT / sizes[1], west + _WIDTH / sizes[0], north
    boxes = []
    for row, (left, bottom, right, top) in found:
        size = (right - left) * sizes[0], (top - bottom) * sizes[1]
        grown = [max(side, _SMALLEST_PX) for side in size]
        x, y = (left - west) * sizes[0], (north - top) * sizes[1]
        boxes.append((row, (x - (grown[0] - size[0]) / 2, y - (grown[1] - size[1]) / 2, *grown)))
    bar_m = bar_length(_WIDTH / 4 / scale)
    meridians, parallels = ticks(bounds[0], bounds[2], _LINES), ticks(bounds[1], bounds[3], _LINES)
    return {
        "boxes": boxes,
        "bounds": bounds,
        "width": _WIDTH,
        "height": _HEIGHT,
        "meridians": [((lon - west) * sizes[0], _degrees(lon, "EW", meridians[1])) for lon in meridians[0]],
        "parallels": [((north - lat) * sizes[1], _degrees(lat, "NS", parallels[1])) for lat in parallels[0]],
        "bar": bar_m * scale,
        "bar_m": bar_m,
        "missing": len(rows) - len(found),
    }


def _degrees(value: float, sides: str, decimals: int) -> str:
    return f"{abs(value):.{decimals}f}° {sides[value < 0]}"


def _box(row: SurveyRow) -> tuple[float, float, float, float] | None:
    """Return west, south, east and north of a survey in WGS 84, degrees; None if they are not known."""
    left, bottom, right, top = row.min_x, row.min_y, row.max_x, row.max_y
    if row.crs is None or left is None or bottom is None or right is None or top is None:
        return None
    try:
        west, south, east, north = _to_degrees(row.crs).transform_bounds(left, bottom, right, top)
    except ProjError:
        return None
    if not all(map(math.isfinite, (west, south, east, north))) or west > east:
        return None
    return west, south, east, north


@cache
def _to_degrees(crs: str) -> Transformer:
    return Transformer.from_crs(stated_crs(crs), "EPSG:4326", always_xy=True)


_SIDE = 240
"""Most pixels of a picture along a side: chosen."""


def read_thumbnail(folder: Path, most: int) -> str:
    """Return rasters/thumbnail.jpg of a complete map as a data URI of at most ``most`` characters, or nothing.

    A picture that cannot be read is left out, with a warning: the map is none the worse.
    """
    path = folder / MapFile.THUMBNAIL
    try:
        with open_picture(path) as picture:
            picture.thumbnail((_SIDE, _SIDE))
            text = jpeg(np.asarray(picture.convert("RGB")), most)
    except UNREADABLE as error:
        _log.warning("%s is not shown: %s", path, getattr(error, "strerror", None) or error)
        return ""
    return text if len(text) <= most else ""


_ORDER: tuple[SurveyStatus, ...] = ("failed", "incomplete", "not reached", "done", "already done")
"""Order of the rows: those that need a look come first, then those of which most can be crossed."""


@dataclass(frozen=True, slots=True)
class SurveyView:
    """Picture and link of a survey, beside its row."""

    thumbnail: str = ""
    """A data URI; empty: there is none."""
    has_report: bool = False
    """True if there is a report.html beside the layers."""


def index_page(
    rows: Sequence[SurveyRow], views: Mapping[str, SurveyView], links: Sequence[str], title: str, note: str = ""
) -> str:
    """Return a page that requests nothing but what the reader follows a link to.

    All text from rows is escaped; scripts and styles other than the page's own are refused by its policy. ``views``: by
    name of a survey; those without one have no picture; ``links``: files beside the page to link to; ``title``: name of
    the batch; ``note``: a sentence below the headline, such as when the page was written.
    """
    shown = sorted(rows, key=lambda row: (_ORDER.index(row.status), -(row.share_passable or 0.0), row.name))
    return render_page(
        "batch.html",
        style="batch.css",
        script="batch.js",
        links=links,
        note=note,
        order={status: place for place, status in enumerate(_ORDER)},
        places=_places(shown),
        rows=shown,
        shares_of=_shares,
        title=title,
        vehicles=sorted({row.vehicle for row in rows if row.vehicle}),
        views=views,
    )


def _shares(row: SurveyRow) -> list[tuple[str, tuple[int, ...], float, str]]:
    """Return names, colours and shares of the classes and of unknown ground; empty if one is not known."""
    shares = [row.share_smooth, row.share_fair, row.share_rough, row.share_very_rough, row.share_unknown]
    known = [share for share in shares if share is not None]
    if len(known) < len(shares):
        return []
    colours = [*(CLASS_COLOURS[number] for number in range(len(CLASS_NAMES))), UNKNOWN_COLOUR]
    texts = shares_text(known, (len(CLASS_NAMES),), 1)
    return list(zip((*CLASS_NAMES, "unknown"), colours, known, texts, strict=True))
