"""HTML from Python: text is escaped unless it was made here."""

from collections.abc import Sequence
from html import escape

__all__ = ["Html", "join", "raw", "table", "tag"]

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
