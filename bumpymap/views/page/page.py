"""Pages, and files for GIS and robots, from templates: the engine, which escapes every text, and the frame of pages."""

import base64
import hashlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache
from importlib.util import cache_from_source
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from bumpymap.core import BARRED_TEXT, CHANGE_KINDS, CLASS_NAMES, Barred, atomic, count_text, escape_controls
from bumpymap.layers import (
    BARRED_COLOURS,
    CHANGE_COLOURS,
    CLASS_COLOURS,
    CLOSED_COLOUR,
    OBJECT_COLOURS,
    OFF_COLOURS,
    OFF_KINDS,
    REPORT_NAME,
    UNKNOWN_COLOUR,
)
from bumpymap.views.page.tiles import crs_name
from bumpymap.views.words import DASH, area, base_name, degrees, number, share, whole

if TYPE_CHECKING:
    import jinja2

_HERE = Path(__file__).parent


def write_page(path: Path, template: str, **context: Any) -> None:
    """Write a page, which appears only when it is complete; see `render_page`.

    Raises OutputError: the page cannot be written.
    """
    text = render_page(template, **context)
    with atomic(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def render_page(
    template: str,
    *,
    style: str = "report.css",
    script: str = "report.js",
    data: Mapping[str, Any] | None = None,
    **context: Any,
) -> str:
    """Return a page as HTML: it holds all that it shows, and its policy forbids a browser to fetch anything else.

    ``style``, ``script``: names of files in ``data``; the policy lets a browser run these two alone; ``data``: what the
    script needs, as plain JSON; None for a script that needs nothing; ``**context``: what the template needs. All of it
    is escaped where it is written. Raises LookupError: the template names what a record does not hold.
    """
    # In a script element only "<" could end it.
    text = json.dumps(data, allow_nan=False, ensure_ascii=True, separators=(",", ":")).replace("<", "\\u003c")
    return render_text(template, style=_asset(style), script=_asset(script), data=text, **context)


def render_text(template: str, **context: Any) -> str:
    """Return a filled template of a page, or of a file for GIS or robots. Raises LookupError as `render_page`."""
    import jinja2

    try:
        return _engine().get_template(template).render(**context)
    except jinja2.UndefinedError as error:
        raise LookupError(str(error)) from error


@cache
def _asset(name: str) -> str:
    return (_HERE / "data" / name).read_text(encoding="utf-8")


@cache
def _engine() -> "jinja2.Environment":
    """Return the engine; it is imported here alone, since most that imports this package writes no page."""
    import jinja2

    class _Compiled(jinja2.FileSystemBytecodeCache):
        """Compiled templates beside their sources, as Python keeps its own; without a place to write, none are kept."""

        def load_bytecode(self, bucket: jinja2.bccache.Bucket) -> None:
            with suppress(OSError):
                super().load_bytecode(bucket)

        def dump_bytecode(self, bucket: jinja2.bccache.Bucket) -> None:
            if not sys.dont_write_bytecode:
                with suppress(OSError):
                    Path(self.directory).mkdir(parents=True, exist_ok=True)
                    super().dump_bytecode(bucket)

    engine = jinja2.Environment(
        loader=jinja2.FileSystemLoader([_HERE.parent / part / "templates" for part in ("page", "gis", "export")]),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        finalize=_printable,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
        bytecode_cache=_Compiled(str(Path(cache_from_source(str(_HERE / "templates" / "page.py"))).parent)),
    )
    engine.filters.update(_FILTERS)
    engine.globals.update(_NAMES)
    return engine


def _printable(value: Any) -> Any:
    """Show as escapes what UTF-8 cannot hold, and control characters and marks of text direction but line breaks."""
    if not isinstance(value, str) or value.isprintable():
        return value
    if hasattr(value, "__html__"):  # of a template
        text = value.encode("utf-8", "backslashreplace").decode()
        return value if text == value else text
    return "\n".join(map(escape_controls, value.split("\n")))


_FILTERS: dict[str, Callable[..., str]] = {
    "address": lambda text: quote(os.fsencode(text)),
    "area": area,
    "base_name": base_name,
    "degrees": degrees,
    "digest": lambda text: base64.b64encode(hashlib.sha256(text.encode()).digest()).decode(),
    "hex": lambda colour: "#{:02x}{:02x}{:02x}".format(*colour[:3]),
    "number": number,
    "share": share,
    # text that shows what it holds: control characters and bytes that are not UTF-8 as escapes
    "shown": lambda text: escape_controls(" ".join(text.split())),
    "whole": whole,
}
NORTH_ARROW = (
    '<path d="M12 2 20 24 12 19 4 24Z" fill="#1f2937"/>'
    '<path d="M8 38V28L16 38V28" fill="none" stroke="#1f2937" stroke-width="2"/>'
)
"""Within 24 x 40."""
_NAMES = {
    "DASH": DASH,
    "NORTH_ARROW": NORTH_ARROW,
    "REPORT_NAME": REPORT_NAME,
    "barred": [(code, BARRED_TEXT[code], BARRED_COLOURS[code]) for code in Barred if code != Barred.UNKNOWN],
    "changes": [(name, CHANGE_COLOURS[code]) for code, name in enumerate(CHANGE_KINDS)],
    "closed_colour": CLOSED_COLOUR,
    "classes": [(name, CLASS_COLOURS[code]) for code, name in enumerate(CLASS_NAMES)],
    "count_text": count_text,
    "crs_name": crs_name,
    "object_colours": OBJECT_COLOURS,
    "unknown_colour": UNKNOWN_COLOUR,
    "off_kinds": [(name, OFF_COLOURS[code]) for code, name in enumerate(OFF_KINDS)],
}
