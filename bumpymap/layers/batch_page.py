"""The page itself: a headline, where the surveys lie, and a table with a row for each."""

import base64
import hashlib
import io
import math
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any, Literal, TypeAlias
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from pyproj import Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import (
    CLASS_NAMES,
    NO_CLASS,
    Barred,
    count_text,
    escape_controls,
    share_text,
    shares_text,
    stated_crs,
)
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS
from bumpymap.layers.map_files import RemoteFolder, open_raster
from bumpymap.layers.products import REPORT_NAME

__all__ = ["SurveyRow", "SurveyStatus", "SurveyView", "index_page", "read_thumbnail"]

SurveyStatus: TypeAlias = Literal["done", "already done", "incomplete", "failed", "not reached"]
"""``incomplete``: layers were written, but files were skipped, or too many tiles are unknown."""


def _column(description: str, unit: str = "") -> Any:
    return field(default=None, metadata={"description": description} | ({"unit": unit} if unit else {}))


@dataclass(frozen=True, slots=True)
class SurveyRow:
    """What became of one survey. None: not known, as that of a survey without layers."""

    name: str
    """Folder of its layers."""
    status: SurveyStatus
    message: str = ""
    """Why it failed, or what is incomplete."""
    warnings: tuple[str, ...] = field(
        default=(), metadata={"description": "warnings of the run, in a table separated by ' | '"}
    )
    seconds: float | None = _column("wall time of the run that made the layers, or until it failed", "s")
    survey: str = ""
    """Its files or folder, as the run was given them; a URL without user and query, which may hold a key."""
    points: int | None = _column("points read that are neither withheld nor noise")
    density: float | None = _column("points per area of the tiles with points", "1/m2")
    area: float | None = _column("area of the tiles with points", "m2")
    tiles: int | None = _column("tiles with points")
    share_smooth: float | None = _column("share of the tiles of class 0")
    share_fair: float | None = _column("share of the tiles of class 1")
    share_rough: float | None = _column("share of the tiles of class 2")
    share_very_rough: float | None = _column("share of the tiles of class 3")
    share_passable: float | None = _column("share of the tiles that are passable")
    share_unknown: float | None = _column("share of the tiles without a class")
    unknown_reason: str | None = _column("why most of them have none")
    crs: str | None = _column("code of the CRS, or its name")
    min_x: float | None = _column("west edge of the tiles", "units of the CRS")
    min_y: float | None = _column("south edge of the tiles", "units of the CRS")
    max_x: float | None = _column("east edge of the tiles", "units of the CRS")
    max_y: float | None = _column("north edge of the tiles", "units of the CRS")
    vehicle: str | None = _column("vehicle of the calibration")
    calibration: str | None = _column("id of the calibration")
    checksum: str | None = _column("checksums of the input files, as in run.json, separated by spaces")


_LEAST_WIDTH, _WIDTH, _MOST_HEIGHT, _EDGE = 260.0, 640.0, 280.0, 24.0
_DEGREE_M = 111_320.0
_LEAST_M = 100.0
_SMALLEST_PX = 7.0
_SCALES = (1, 2, 5)


@dataclass(frozen=True, slots=True)
class _Placed:
    """Extent of a survey in WGS 84, degrees."""

    row: SurveyRow
    west: float
    south: float
    east: float
    north: float


def draw_places(rows: Sequence[SurveyRow], kinds: Sequence[str], labels: Sequence[str]) -> str:
    """Return the map as SVG; empty if fewer than two surveys have a known place, or they lie all over the Earth.

    Parameters
    ----------
    rows : sequence of SurveyRow
    kinds : sequence of str
        CSS class of each.
    labels : sequence of str
        Name of each, as text.
    """
    found = [(box, kind, label) for row, kind, label in zip(rows, kinds, labels, strict=True) if (box := _box(row))]
    if len(found) < 2:
        return ""
    west, south = min(box.west for box, _, _ in found), min(box.south for box, _, _ in found)
    east, north = max(box.east for box, _, _ in found), max(box.north for box, _, _ in found)
    middle = math.radians((south + north) / 2)
    if east - west > 180 or max(abs(south), abs(north)) > 85:
        return ""
    per_degree = _DEGREE_M * math.cos(middle), _DEGREE_M
    wide, high = max((east - west) * per_degree[0], _LEAST_M), max((north - south) * per_degree[1], _LEAST_M)
    scale = min((_WIDTH - 2 * _EDGE) / wide, (_MOST_HEIGHT - 2 * _EDGE) / high)
    width, height = max(wide * scale + 2 * _EDGE, _LEAST_WIDTH), high * scale + 2 * _EDGE + 16

    def place(box: _Placed) -> tuple[float, float, float, float]:
        left, top = _EDGE + (box.west - west) * per_degree[0] * scale, _EDGE + (north - box.north) * _DEGREE_M * scale
        size = (box.east - box.west) * per_degree[0] * scale, (box.north - box.south) * _DEGREE_M * scale
        grown = [max(side, _SMALLEST_PX) for side in size]
        return left - (grown[0] - size[0]) / 2, top - (grown[1] - size[1]) / 2, grown[0], grown[1]

    shapes = []
    for box, kind, label in found:
        x, y, w, h = place(box)
        shapes.append(
            f'<rect class="{kind}" x="{x:.1f}" y="{y:.1f}" width="{w:.1f}" height="{h:.1f}"><title>{escape(label)}'
            "</title></rect>"
        )
    missing = len(rows) - len(found)
    lying = count_text(len(found), "survey lies", "surveys lie")
    about = f"Where {lying}, north up, {west:.4f} to {east:.4f} east, {south:.4f} to {north:.4f} north"
    beside = f" {missing} without a known place are not drawn." if missing else ""
    return (
        f'<figure><svg class="places" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" role="img" '
        f'aria-label="{about}">'
        f"{''.join(shapes)}{_scale_bar(scale, height)}</svg>"
        f"<figcaption>Where the surveys lie, north up; small ones are drawn larger.{beside}</figcaption></figure>"
    )


def _scale_bar(scale: float, height: float) -> str:
    """Return a bar of a round length, at most a quarter of the width."""
    most = _WIDTH / 4 / scale
    power = 10 ** math.floor(math.log10(most))
    length = max(step * power for step in _SCALES if step * power <= most)
    text = f"{length / 1000:g} km" if length >= 1000 else f"{length:g} m"
    y = height - 12
    return (
        f'<path class="scale" d="M{_EDGE} {y - 5:.1f}v5h{length * scale:.1f}v-5"/>'
        f'<text x="{_EDGE + length * scale + 6:.1f}" y="{y:.1f}">{text}</text>'
    )


def _box(row: SurveyRow) -> _Placed | None:
    left, bottom, right, top = row.min_x, row.min_y, row.max_x, row.max_y
    if row.crs is None or left is None or bottom is None or right is None or top is None:
        return None
    transformer = _to_degrees(row.crs)
    if transformer is None:
        return None
    try:
        west, south, east, north = transformer.transform_bounds(left, bottom, right, top)
    except ProjError:
        return None
    if not all(map(math.isfinite, (west, south, east, north))) or west > east:
        return None
    return _Placed(row, west, south, east, north)


@cache
def _to_degrees(crs: str) -> Transformer | None:
    try:
        return Transformer.from_crs(stated_crs(crs), "EPSG:4326", always_xy=True)
    except ProjError:
        return None


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
_LIGHT = (-0.5, 0.5, 0.7071)
"""Towards the sun in the north-west, 45 degrees high: east, north, up."""
_DARKEST, _BRIGHTEST = 0.45, 1.2
_MOST_PIXELS = 20_000_000
"""Heights of a virtual raster to average."""


def read_thumbnail(folder: Path | RemoteFolder, most_bytes: int) -> bytes:
    """Return a PNG of a complete map, in one folder or in sheets; empty if none is small enough.

    It is made from the overviews, so that memory and time do not grow with the map.

    Parameters
    ----------
    folder : Path or RemoteFolder
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


def _read(folder: Path | RemoteFolder, side: int) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
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
    return kind, _shade(_heights(folder, shape), (high / shape[0], wide / shape[1]))


def _heights(folder: Path | RemoteFolder, shape: tuple[int, int]) -> NDArray[np.float64]:
    from rasterio.enums import Resampling

    with open_raster(folder, "heightmap.tif") as raster:
        # GDAL may average every pixel of a virtual raster, also those between sheets that lie far apart. The overviews
        # of large sheets are averages already.
        large = raster.driver == "VRT" and raster.height * raster.width > _MOST_PIXELS
        how = Resampling.nearest if large else Resampling.average
        heights: NDArray[np.float64] = raster.read(1, out_shape=shape, resampling=how)
    return heights


def _shade(heights: NDArray[np.float64], pixel: tuple[float, float]) -> NDArray[np.float64]:
    """Return the brightness of the relief, 1 where it is level or not known."""
    if min(heights.shape) < 2:
        return np.ones(heights.shape)
    down, east = np.gradient(heights, *pixel)
    light = (_LIGHT[0] * -east + _LIGHT[1] * down + _LIGHT[2]) / np.sqrt(1.0 + east**2 + down**2)
    shade = np.clip(light / _LIGHT[2], _DARKEST, _BRIGHTEST)
    return np.where(np.isnan(shade), 1.0, shade)


_ORDER: tuple[SurveyStatus, ...] = ("failed", "incomplete", "not reached", "done", "already done")
"""What needs a look comes first."""
_KINDS: dict[SurveyStatus, str] = {
    "done": "good", "already done": "good", "incomplete": "incomplete", "failed": "failed", "not reached": "waiting",
}  # fmt: skip
_WORDS: dict[SurveyStatus, str] = {
    "done": "done",
    "already done": "done earlier",
    "incomplete": "incomplete",
    "failed": "failed",
    "not reached": "not reached",
}
_SIDE = 96
_BAR = 160.0
_LARGE_AREA = 100_000.0
"""Areas from here on are given in km2."""
_COLUMNS = (
    ("Survey", "text"), ("Status", "order"), ("Points", "number"), ("Points per m²", "number"), ("Area", "number"),
    ("Classes", "shares"), ("CRS", "text"), ("Seconds", "number"),
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class SurveyView:
    """What the page shows of the layers of a survey beside its row."""

    thumbnail: bytes = b""
    """PNG; empty: there is none."""
    has_report: bool = False
    """Whether there is a report.html beside the layers."""


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
    style, script = (
        files(__package__).joinpath(name).read_text(encoding="utf-8") for name in ("batch_page.css", "batch_page.js")
    )
    policy = (
        f"default-src 'none'; img-src data:; style-src '{_digest(style)}'; script-src '{_digest(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )
    shown = sorted(rows, key=lambda row: (_ORDER.index(row.status), row.name))
    places = draw_places(shown, [_KINDS[row.status] for row in shown], [_text(row.name) for row in shown])
    head = "".join(f'<th scope="col" class="{kind}">{name}</th>' for name, kind in _COLUMNS)
    listed = " · ".join(f'<a href="{quote(name)}">{escape(name)}</a>' for name in links)
    body = "\n".join(_row(row, views.get(row.name, SurveyView())) for row in shown)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{policy}">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{_escaped(title)}</title>
<style>{style}</style>
</head>
<body>
<main>
<h1>{_escaped(title)}</h1>
<p class="headline">{_headline(rows)}</p>
<p class="soft">{escape(note)}</p>
<p>{listed}</p>
{places}
{_legend()}
<div class="scroll" role="region" aria-label="Surveys" tabindex="0">
<table>
<thead><tr>{head}</tr></thead>
<tbody>
{body}
</tbody>
</table>
</div>
</main>
<script>{script}</script>
</body>
</html>
"""


def _headline(rows: Sequence[SurveyRow]) -> str:
    counts = Counter(row.status for row in rows)
    earlier, good = counts["already done"], counts["done"] + counts["already done"]
    parts = []
    if good:
        all_earlier = " earlier" if earlier == good else ""
        some_earlier = f" ({earlier} of them earlier)" if 0 < earlier < good else ""
        parts.append(f'<span class="good">{good} done{all_earlier}{some_earlier}</span>')
    parts += [
        f'<span class="{_KINDS[status]}">{counts[status]} {_WORDS[status]}</span>'
        for status in _ORDER[2::-1]
        if counts[status]
    ]
    warned = sum(bool(row.warnings) for row in rows)
    more = f", {warned} with warnings" if warned else ""
    return f"{count_text(len(rows), 'survey')}: {', '.join(parts)}{more}"


def _legend() -> str:
    marks = [(CLASS_COLOURS[number], name) for number, name in enumerate(CLASS_NAMES)]
    marks.append((BARRED_COLOURS[Barred.UNKNOWN], "unknown: points, but no class"))
    shown = "".join(
        '<li><svg width="12" height="12" aria-hidden="true"><rect width="12" height="12" '
        f'fill="{_hex(colour)}"/></svg> {name}</li>'
        for colour, name in marks
    )
    shown += (
        '<li><svg width="12" height="12" aria-hidden="true"><rect width="12" height="12" fill="#4b090a"/></svg> '
        "dark in the pictures: not passable</li>"
    )
    return f'<ul class="legend" aria-label="Classes">{shown}</ul>'


def _row(row: SurveyRow, view: SurveyView) -> str:
    name = _escaped(row.name)
    if view.has_report:
        name = f'<a href="{quote(os.fsencode(row.name))}/{REPORT_NAME}">{name}</a>'
    if view.thumbnail:
        data = base64.b64encode(view.thumbnail).decode()
        size = f'width="{_SIDE}" height="{_SIDE}"'
        name += f'<img src="data:image/png;base64,{data}" {size} alt="Classes over relief, dark where not passable">'
    message = f"<p>{_escaped(row.message)}</p>" if row.message else ""
    message += "".join(f'<p class="soft">Warning: {_escaped(warning)}</p>' for warning in row.warnings)
    status = f'<span class="{_KINDS[row.status]}">{_WORDS[row.status]}</span>{message}'
    drivable = None if row.share_passable is None else f"{row.share_passable:.6f}"
    cells = (
        ("status", f"{_ORDER.index(row.status)}", status),
        ("number", row.points, "" if row.points is None else f"{row.points:,}"),
        ("number", row.density, "" if row.density is None else f"{row.density:,.1f}"),
        ("number", row.area, "" if row.area is None else _area(row.area)),
        ("shares", drivable, _shares(row)),
        ("crs", _text(row.crs or ""), _escaped(row.crs or "")),
        ("number", row.seconds, "" if row.seconds is None else f"{row.seconds:,.1f}"),
    )
    rest = "".join(
        f'<td class="{kind}" data-v="{"" if value is None else escape(str(value))}">{text}</td>'
        for kind, value, text in cells
    )
    return f'<tr><th scope="row" class="name" data-v="{_escaped(row.name)}">{name}</th>{rest}</tr>'


def _shares(row: SurveyRow) -> str:
    """Return a bar of the classes, and in words what share can be driven, what is unknown, and why."""
    known = (row.share_smooth, row.share_fair, row.share_rough, row.share_very_rough, row.share_unknown)
    if None in known:
        return ""
    shares = [share or 0.0 for share in known]
    names = (*CLASS_NAMES, "unknown")
    colours = [*(CLASS_COLOURS[number] for number in range(len(CLASS_NAMES))), BARRED_COLOURS[Barred.UNKNOWN]]
    told = shares_text(shares, (len(CLASS_NAMES),), 1)
    about = ", ".join(f"{name} {share}" for name, share in zip(names, told, strict=True))
    parts, left = "", 0.0
    for share, colour in zip(shares, colours, strict=True):
        if share > 0:
            parts += f'<rect x="{left:.1f}" width="{share * _BAR:.1f}" height="14" fill="{_hex(colour)}"/>'
        left += share * _BAR
    bar = (
        f'<svg class="bar" viewBox="0 0 {_BAR:.0f} 14" role="img" aria-label="{about}"><title>{about}</title>{parts}'
        "</svg>"
    )
    why = f", mostly {escape(row.unknown_reason)}" if row.unknown_reason and row.share_unknown else ""
    passable = "" if row.share_passable is None else f"{share_text(row.share_passable)} passable, "
    return f"{bar}{passable}{row.share_unknown:.1%} unknown{why}"


def _area(square_metres: float) -> str:
    if square_metres < _LARGE_AREA:
        return f"{square_metres:,.0f} m²"
    return f"{square_metres / 1e6:,.2f} km²"


def _text(text: str) -> str:
    """Return text that shows what it holds: control characters and bytes that are not UTF-8 as escapes."""
    return escape_controls(" ".join(text.split()))


def _escaped(text: str) -> str:
    return escape(_text(text))


def _hex(colour: tuple[int, int, int, int]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour[:3])


def _digest(text: str) -> str:
    return f"sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}"
