"""index.html, the page of a batch: a row for each survey, with a thumbnail of its map."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bumpymap.core import CLASS_NAMES, shares_text
from bumpymap.layers import CLASS_COLOURS, UNKNOWN_COLOUR, MapFile, SurveyRow, SurveyStatus
from bumpymap.views.page.page import render_page
from bumpymap.views.page.site import UNREADABLE, jpeg, open_picture

_log = logging.getLogger(__name__)
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
