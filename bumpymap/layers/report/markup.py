"""HTML from Python: text is escaped unless it was made here; numbers as a page shows them; the head of every page."""

import base64
import hashlib
import json
import math
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

from bumpymap.core import share_text, shares_text

__all__ = ["DASH", "Html", "area", "document", "join", "number", "raw", "share", "shares", "table", "tag", "whole"]

_EMPTY = frozenset({"br", "img", "input", "meta"})


class Html(str):
    """Text that is HTML already, so that `tag` does not escape it again."""

    __slots__ = ()


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


def document(title: str, header: Sequence[Html], sections: Sequence[Html], data: Mapping[str, Any]) -> str:
    """Return a page as HTML.

    Parameters
    ----------
    title : str
        Shown in the browser's tab.
    header, sections : sequences of Html
        What the page begins with, and its sections.
    data : mapping
        What the script needs to draw the maps, as plain JSON.
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
        tag("footer", tag("p", "Made by bumpymap from the layers in the folder of this page. It needs no network.")),
        raw(f'<script type="application/json" id="report-data">{text}</script>'),
        raw(f"<script>{script}</script>"),
    )
    return f"<!DOCTYPE html>\n{tag('html', head, body, lang='en')}\n"


@cache
def _asset(name: str) -> str:
    return (_DATA / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
