"""HTML from Python: text is escaped unless it was made here; numbers, tables, heads of pages; SVG histograms."""

import base64
import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import share_text, shares_text
from bumpymap.layers.report.tiles import C_R_EDGES, SLOPE_EDGES

__all__ = [
    "DASH",
    "Html",
    "area",
    "c_r_chart",
    "document",
    "join",
    "lines_of",
    "number",
    "raw",
    "section",
    "share",
    "shares",
    "slope_chart",
    "swatch",
    "table",
    "tag",
    "whole",
]

_WIDTH, _HEIGHT = 560, 210


_LEFT, _RIGHT, _TOP, _BOTTOM = 44, 12, 24, 40


_MARK = "#a3261b"


class Html(str):
    """Text that is HTML already, so that `tag` does not escape it again."""

    __slots__ = ()


def c_r_chart(bins: NDArray[np.int64], limits: Sequence[float], key: str) -> Html:
    """Return the histogram of the ride cost: bins of equal width on a logarithmic axis.

    Parameters
    ----------
    bins : int64 (n,)
        Tiles in each bin of ``C_R_EDGES``.
    limits : sequence of float
        Limits of the classes, rad/m.
    key : str
        Makes ids on the page differ.
    """
    used = np.flatnonzero(bins)
    first, last = (int(used[0]), int(used[-1]) + 1) if len(used) else (0, len(bins))
    # the first and the last bin have no length of their own on the axis
    at = np.log10(np.concatenate([[C_R_EDGES[1] * 10 ** (-1 / 8)], C_R_EDGES[1:-1], [C_R_EDGES[-2] * 10 ** (1 / 8)]]))
    ticks = [(np.log10(value), f"{value:g}") for value in (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)]
    marks = [(float(np.log10(limit)), f"{limit:g}") for limit in limits if limit > 0]
    rows = [
        (_between(C_R_EDGES[bin_], C_R_EDGES[bin_ + 1], 3), whole(int(bins[bin_])), told)
        for bin_, told in zip(range(first, last), shares(bins[first:last].tolist()), strict=True)
    ]
    title = "Ride cost C_r of the tiles"
    note = f"Red lines: limits of the classes, {', '.join(text for _, text in marks)} rad/m." if marks else ""
    picture = _histogram(bins[first:last], at[first : last + 1], ticks, marks, (title, "C_r, rad/m", key))
    return _figure(picture, title, note, "C_r, rad/m", rows)


def slope_chart(bins: NDArray[np.int64], limit: float | None, key: str) -> Html:
    """Return the histogram of the slope; ``limit`` is the steepest that the vehicle may drive, degrees."""
    used = np.flatnonzero(bins)
    last = max(int(used[-1]) + 1 if len(used) else 1, 4)
    ticks = [(float(value), f"{value:g}°") for value in range(0, 91, 10)]
    marks = [] if limit is None else [(limit, f"{limit:g}°")]
    rows = [
        (f"{SLOPE_EDGES[bin_]:g} to {SLOPE_EDGES[bin_ + 1]:g}", whole(int(bins[bin_])), told)
        for bin_, told in zip(range(last), shares(bins[:last].tolist()), strict=True)
    ]
    title = "Slope of the tiles"
    note = f"Red line: steepest slope for the vehicle, {limit:g} degrees." if limit is not None else ""
    picture = _histogram(bins[:last], SLOPE_EDGES[: last + 1], ticks, marks, (title, "slope, degrees", key))
    return _figure(picture, title, note, "slope, degrees", rows)


def _figure(picture: Html, title: str, note: str, what: str, rows: Sequence[tuple[str, ...]]) -> Html:
    numbers = tag("details", tag("summary", "The numbers"), table(title, (what, "tiles", "share"), rows))
    return tag("figure", tag("figcaption", tag("strong", title), f". {note}" if note else ""), picture, numbers)


def _between(low: float, high: float, decimals: int) -> str:
    if low == 0:
        return f"under {high:.{decimals}f}"
    return f"over {low:.{decimals}f}" if not np.isfinite(high) else f"{low:.{decimals}f} to {high:.{decimals}f}"


def _histogram(
    counts: NDArray[np.int64],
    edges: NDArray[np.float64],
    ticks: Sequence[tuple[float, str]],
    marks: Sequence[tuple[float, str]],
    names: tuple[str, str, str],
) -> Html:
    title, axis, key = names
    most = max(int(counts.max()), 1)
    across = (_WIDTH - _LEFT - _RIGHT) / (edges[-1] - edges[0])
    foot = _HEIGHT - _BOTTOM
    tall = foot - _TOP

    def x(value: float) -> float:
        return float(_LEFT + (value - edges[0]) * across)

    parts = []
    for part in (0.0, 0.5, 1.0):
        y = foot - tall * part
        parts.append(f'<line x1="{_LEFT}" x2="{_WIDTH - _RIGHT}" y1="{y:.1f}" y2="{y:.1f}" stroke="#d8dbdf"/>')
        label = share(most * part, max(int(counts.sum()), 1)) if part else "0"
        parts.append(f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{label}</text>')
    for count, low, high in zip(counts.tolist(), edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        height = tall * count / most
        parts.append(
            f'<rect x="{x(low) + 0.5:.1f}" y="{foot - height:.1f}" width="{max(x(high) - x(low) - 1, 0.5):.1f}" '
            f'height="{height:.1f}" fill="#3f6488"/>'
        )
    for value, text in ticks:
        if edges[0] <= value <= edges[-1]:
            parts.append(f'<text x="{x(value):.1f}" y="{foot + 16}" text-anchor="middle">{text}</text>')
    for value, text in marks:
        if edges[0] <= value <= edges[-1]:
            parts.append(
                f'<line x1="{x(value):.1f}" x2="{x(value):.1f}" y1="{_TOP - 6}" y2="{foot}" stroke="{_MARK}"/>'
            )
            parts.append(f'<text x="{x(value):.1f}" y="{_TOP - 10}" text-anchor="middle" fill="{_MARK}">{text}</text>')
    parts.append(f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 6}" text-anchor="middle">{axis}</text>')
    ident = f"chart-{key}"
    return tag(
        "svg",
        tag("title", f"{title}: histogram, numbers in the table below it", id=ident),
        raw("".join(parts)),
        viewBox=f"0 0 {_WIDTH} {_HEIGHT}",
        role="img",
        aria_labelledby=ident,
    )


def swatch(colour: tuple[int, ...], *, hatched: bool = False, falling: bool = False) -> Html:
    """Return a small square of a colour, which stands beside the words that say the same.

    Lines rise to the right, as on ground that is not known, or are ``falling``, as on ground that is not passable.
    """
    fill = f"#{colour[0]:02x}{colour[1]:02x}{colour[2]:02x}"
    path = '<path d="M0 7 7 14M0 0 14 14M7 0 14 7" stroke="#111" fill="none"/>'
    path = path if falling else '<path d="M0 7 7 0M5 14 14 5" stroke="#555" fill="none"/>'
    lines = path if hatched else ""
    square = f'<rect width="14" height="14" rx="2" fill="{fill}" stroke="#6b7280"/>'
    return raw(f'<svg class="swatch" viewBox="0 0 14 14" aria-hidden="true">{square}{lines}</svg>')


def section(title: str, key: str, *parts: str) -> Html:
    """Return a section of a page with its heading, which links find by ``key``."""
    return tag("section", tag("h2", title, id=key), *parts, aria_labelledby=key)


def lines_of(*items: str) -> Html:
    """Return a list of items."""
    return tag("ul", join(*(tag("li", item) for item in items)))


_EMPTY = frozenset({"br", "img", "input", "meta"})


def raw(text: str) -> Html:
    """Mark text as HTML. Only for text that no file or user has written."""
    return Html(text)


def join(*parts: str) -> Html:
    """Join parts; those that are not `Html` are escaped."""
    return Html("".join(part if isinstance(part, Html) else escape(_printable(part)) for part in parts))


def tag(name: str, /, *content: str, **attributes: str | bool) -> Html:
    """Return an element; ``class_`` is the attribute ``class``, ``data_of`` is ``data-of``; False leaves one out."""
    words = [name]
    for key, value in attributes.items():
        plain = key.rstrip("_").replace("_", "-")
        if value is True:
            words.append(plain)
        elif value is not False:
            words.append(f'{plain}="{escape(_printable(value))}"')
    opened = f"<{' '.join(words)}>"
    return Html(opened) if name in _EMPTY else Html(f"{opened}{join(*content)}</{name}>")


def table(
    caption: str, head: tuple[str, ...], rows: Sequence[tuple[str, ...]], *, texts: int = 1, wide: bool = False
) -> Html:
    """Return a table whose first ``texts`` columns are text and whose others are numbers.

    A row begins with the heading of the row.
    """
    kind = ["text" if column < texts else "number" for column in range(len(head))]
    top = tag("tr", *(tag("th", cell, scope="col", class_=kind[column]) for column, cell in enumerate(head)))
    body = [
        tag(
            "tr",
            tag("th", row[0], scope="row", class_=kind[0]),
            *(tag("td", cell, class_=kind[column]) for column, cell in enumerate(row[1:], 1)),
        )
        for row in rows
    ]
    inner = tag("table", tag("caption", caption), tag("thead", top), tag("tbody", *body))
    # What scrolls must be reached by keyboard.
    return tag("div", inner, class_="wide table" if wide else "table", tabindex="0", role="region", aria_label=caption)


def _printable(text: str) -> str:
    """Replace what UTF-8 cannot hold: bytes of a file name that are not text."""
    return text.encode("utf-8", "backslashreplace").decode()


DASH = "\N{EN DASH}"
"""Stands where nothing is known."""


_PERCENT = "\N{NO-BREAK SPACE}%"


_SQUARE_KILOMETRE = 1e6


_HECTARE = 1e4


def number(value: Any, decimals: int, unit: str = "") -> str:
    """Return a number with its unit; a dash if it is not known."""
    if not isinstance(value, int | float) or not math.isfinite(value):
        return DASH
    return f"{value:,.{decimals}f}{unit}"


def whole(value: int) -> str:
    """Return a whole number with its thousands apart."""
    return f"{value:,}"


def share(part: float, total: float) -> str:
    """Return a share in per cent; small shares are not rounded to nothing, nor large ones to all."""
    return share_text(part / total, percent=_PERCENT) if total else DASH


def shares(counts: Sequence[float], alone: Collection[int] = ()) -> list[str]:
    """Return the shares of all parts of a whole, which make 100 % together; see `shares_text`."""
    return shares_text(counts, alone, percent=_PERCENT) if sum(counts) else [DASH] * len(counts)


def area(square_metres: float) -> str:
    """Return an area in m2, ha or km2."""
    if square_metres >= _SQUARE_KILOMETRE:
        return f"{square_metres / _SQUARE_KILOMETRE:,.2f} km²"
    if square_metres >= _HECTARE:
        return f"{square_metres / _HECTARE:,.2f} ha"
    return f"{square_metres:,.0f} m²"


_DATA = Path(__file__).with_name("data")


def document(
    title: str,
    header: Sequence[Html],
    sections: Sequence[Html],
    data: Mapping[str, Any],
    source: str = "the layers in the folder of this page",
) -> str:
    """Return a page as HTML.

    Parameters
    ----------
    title : str
        Shown in the browser's tab.
    header, sections : sequences of Html
        What the page begins with, and its sections.
    data : mapping
        What the script needs to draw the maps, as plain JSON.
    source : str
        Named at the foot of the page.
    """
    style, script = _asset("report.css"), _asset("report.js")
    policy = (
        f"default-src 'none'; img-src data:; style-src {_digest(style)}; script-src {_digest(script)}; "
        "base-uri 'none'; form-action 'none'"
    )
    # In a script element only "<" could end it.
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c")
    head = tag(
        "head",
        tag("meta", charset="utf-8"),
        tag("meta", http_equiv="Content-Security-Policy", content=policy),
        tag("meta", name="viewport", content="width=device-width, initial-scale=1"),
        tag("meta", name="generator", content="bumpymap"),
        tag("title", title),
        raw(f"<style>{style}</style>"),
    )
    body = tag(
        "body",
        tag("header", *header),
        tag("main", *sections),
        tag("footer", tag("p", f"Made by bumpymap from {source}. It needs no network.")),
        raw(f'<script type="application/json" id="report-data">{text}</script>'),
        raw(f"<script>{script}</script>"),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, body, lang='en')}\n"


@cache
def _asset(name: str) -> str:
    return (_DATA / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
