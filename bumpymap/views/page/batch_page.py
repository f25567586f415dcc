"""index.html, the page of a batch: a row for each survey, with a thumbnail of its map."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from bumpymap.core import CLASS_NAMES, NO_CLASS, Barred, shares_text
from bumpymap.layers import (
    BARRED_COLOURS,
    CLASS_COLOURS,
    SurveyRow,
    SurveyStatus,
    open_raster,
    read_averaged,
)
from bumpymap.views.page.page import render_page
from bumpymap.views.pictures.drawing import LEVEL, light_of

__all__ = ["SurveyView", "index_page", "read_thumbnail"]

_SIDES = ((96, 12), (96, 5), (64, 5), (48, 3), (32, 2))
"""Pixels of the longer side and shades of each colour: the first that fits is taken."""
_COLOURS = np.array(
    [
        *(CLASS_COLOURS[number][:3] for number in range(len(CLASS_NAMES))),
        *([0.35 * part for part in CLASS_COLOURS[number][:3]] for number in range(len(CLASS_NAMES))),
        BARRED_COLOURS[Barred.UNKNOWN][:3],
    ],
    np.float64,
)
"""Of the classes, of the same where the ground is not passable, and of unknown ground."""
_BARRED, _UNKNOWN, _NOTHING = len(CLASS_NAMES), 2 * len(CLASS_NAMES), 2 * len(CLASS_NAMES) + 1
_DARKEST, _BRIGHTEST = 0.45, 1.2
_MOST_PIXELS = 20_000_000
"""Heights of a virtual raster to average."""


def read_thumbnail(folder: Path, most_bytes: int) -> bytes:
    """Return a PNG of a complete map, in one folder or in sheets; empty if none is small enough.

    It is made from the overviews, so that memory and time do not grow with the map.

    Parameters
    ----------
    folder : Path
    most_bytes : int
        Largest size of the PNG.

    Raises
    ------
    BadInputError
        A layer is missing or damaged.
    """
    kind, shade = _read(folder, _SIDES[0][0])
    for side, shades in _SIDES:
        levels = np.linspace(_DARKEST, _BRIGHTEST, shades)
        nearest = np.rint((shade - _DARKEST) / (_BRIGHTEST - _DARKEST) * (shades - 1)).astype(np.intp)
        # A palette of its own: one that fits the picture would mix the colours of rare kinds of ground.
        palette = np.vstack([(_COLOURS[:, None] * levels[:, None]).reshape(-1, 3), np.full((1, 3), 255.0)])
        index = np.where(kind == _NOTHING, len(palette) - 1, kind * shades + nearest).astype(np.uint8)
        picture = Image.fromarray(index, "P")
        picture.putpalette(np.clip(np.rint(palette), 0, 255).astype(np.uint8).tobytes())
        picture.thumbnail((side, side), Image.Resampling.NEAREST)
        packed = io.BytesIO()
        picture.save(packed, "PNG", optimize=True)
        if packed.tell() <= most_bytes:
            return packed.getvalue()
    return b""


def _read(folder: Path, side: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Return the kind of ground (class, class plus ``_BARRED``, ``_UNKNOWN``, ``_NOTHING``) and its brightness.

    Both have ``side`` pixels along the longer side.
    """
    with open_raster(folder, "class.tif") as raster:
        scale = side / max(raster.height, raster.width)
        shape = max(1, round(raster.height * scale)), max(1, round(raster.width * scale))
        wide, high = raster.bounds.right - raster.bounds.left, raster.bounds.top - raster.bounds.bottom
        class_id = raster.read(1, out_shape=shape)
    with open_raster(folder, "barred.tif") as raster:
        barred = raster.read(1, out_shape=shape)
    # A tile may have a class although it is not known whether it can be crossed.
    unknown = (barred == Barred.UNKNOWN) | (class_id == NO_CLASS)
    kind = np.where(barred == Barred.NO, class_id, class_id + np.intp(_BARRED))
    kind = np.where(barred == NO_CLASS, _NOTHING, np.where(unknown, _UNKNOWN, kind)).astype(np.intp)
    light = light_of(_heights(folder, shape), (high / shape[0], wide / shape[1]))
    return kind, np.clip(light / LEVEL, _DARKEST, _BRIGHTEST)


def _heights(folder: Path, shape: tuple[int, int]) -> NDArray[np.float64]:
    with open_raster(folder, "heightmap.tif") as raster:
        # GDAL may average every pixel of a virtual raster, also those between sheets that lie far apart. The overviews
        # of large sheets are averages already.
        large = raster.driver == "VRT" and raster.height * raster.width > _MOST_PIXELS
        heights: NDArray[np.float64] = raster.read(1, out_shape=shape) if large else read_averaged(raster, shape)
    return heights


_ORDER: tuple[SurveyStatus, ...] = ("failed", "incomplete", "not reached", "done", "already done")
"""Order of the rows: those that need a look come first."""


@dataclass(frozen=True, slots=True)
class SurveyView:
    """Picture and link of a survey, beside its row."""

    thumbnail: bytes = b""
    """PNG; empty: there is none."""
    has_report: bool = False
    """True if there is a report.html beside the layers."""


def index_page(
    rows: Sequence[SurveyRow], views: Mapping[str, SurveyView], links: Sequence[str], title: str, note: str = ""
) -> str:
    """Return a page that requests nothing but what the reader follows a link to.

    All text from rows is escaped; scripts and styles other than the page's own are refused by its policy.

    Parameters
    ----------
    rows : sequence of SurveyRow
    views : mapping
        By name of a survey; those without one have no picture.
    links : sequence of str
        Files beside the page to link to.
    title : str
        Name of the batch.
    note : str, optional
        A sentence below the headline, such as when the page was written.
    """
    shown = sorted(rows, key=lambda row: (_ORDER.index(row.status), row.name))
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
        unknown_colour=BARRED_COLOURS[Barred.UNKNOWN],
        views=views,
    )


def _shares(row: SurveyRow) -> list[tuple[str, tuple[int, ...], float, str]]:
    """Return names, colours and shares of the classes and of unknown ground; empty if one is not known."""
    shares = [row.share_smooth, row.share_fair, row.share_rough, row.share_very_rough, row.share_unknown]
    known = [share for share in shares if share is not None]
    if len(known) < len(shares):
        return []
    colours = [*(CLASS_COLOURS[number] for number in range(len(CLASS_NAMES))), BARRED_COLOURS[Barred.UNKNOWN]]
    told = shares_text(known, (len(CLASS_NAMES),), 1)
    return list(zip((*CLASS_NAMES, "unknown"), colours, known, told, strict=True))
