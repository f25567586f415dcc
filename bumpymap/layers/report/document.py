"""What every page has: a head, a policy that forbids requests, the data of its maps and their script."""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from bumpymap.layers.report.markup import Html, raw, tag

__all__ = ["document"]

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
