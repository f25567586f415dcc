"""The page itself: a headline, where the surveys lie, and a table with a row for each."""

import base64
import hashlib
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from urllib.parse import quote

from bumpymap.core import CLASS_NAMES, Barred, count_text, escape_controls, share_text, shares_text
from bumpymap.layers.batch_row import SurveyRow, SurveyStatus
from bumpymap.layers.colours import BARRED_COLOURS, CLASS_COLOURS
from bumpymap.layers.index_page.place_map import draw_places
from bumpymap.layers.products import REPORT_NAME

__all__ = ["SurveyView", "index_page"]

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
    style, script = (files(__package__).joinpath(name).read_text(encoding="utf-8") for name in ("style.css", "sort.js"))
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
