"""Read TOML files (settings and vehicle profiles) with limits on size and key length.

The time and memory of ``tomllib`` grow with the square of the number of parts of a dotted key: a key of 40 kB took 11 s
and 0.4 GB. Everything else that was tried grows linearly (nested lists the fastest, 7 s for 1 MB), so two limits
suffice: the size of the file, and the number of parts of a key.
"""

import re
import tomllib
from dataclasses import fields
from pathlib import Path
from reprlib import Repr
from typing import Any

from bumpymap.core.errors import BumpymapError
from bumpymap.core.files import read_regular

__all__ = ["brief_repr", "read_toml", "short_names", "short_repr"]

_MOST_BYTES = 256 * 1024
_MOST_PARTS = 16
"""Parts of a dotted key; no setting has more than two."""
_STRINGS_AND_COMMENTS = re.compile(
    r'"""(?:[^"\\]|\\.|"{1,2}(?!"))*+(?:"{3,5})?'
    r"|'''(?:[^']|'{1,2}(?!'))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
"""Strings and comments. An unterminated one matches as far as it can, in linear time; the parser then rejects it."""
_MESSAGE_CHARACTERS = 300
"""Characters of the parser's message that are shown at most: it may quote a key in full."""
_NAMED = 8
_BRIEF = 80
"""Characters of a field that `brief_repr` shows."""
_SHORT = Repr()
_SHORT.maxlevel = 2
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80


def read_toml(path: Path, what: str, error: type[BumpymapError]) -> dict[str, Any]:
    """Read a TOML file of at most 256 kB; a byte order mark at its start is skipped.

    Parameters
    ----------
    path : Path
    what : str
        What the file contains, for messages, such as ``settings``.
    error : exception type
        Raised if the file cannot be read: it is not a regular file, too large, not UTF-8, or not TOML.
    """
    try:
        return tomllib.loads(_checked(_text(path)))
    except OSError as caught:
        raise error(f"cannot read {what} from {path}: {caught.strerror or caught}") from caught
    except RecursionError as caught:
        raise error(f"cannot read {what} from {path}: lists or tables are nested too deep") from caught
    except ValueError as caught:  # not TOML, not UTF-8, a number too long, over a limit
        raise error(f"cannot read {what} from {path}: {str(caught)[:_MESSAGE_CHARACTERS]}") from caught


def short_repr(value: Any) -> str:
    """Return a value as text for a message; the middle of a long one is left out."""
    return _SHORT.repr(value)


def brief_repr(record: Any) -> str:
    """Return a dataclass as a few lines; of an array its type and shape. To be used as its ``__repr__``."""
    parts = []
    for field in fields(record):
        value = getattr(record, field.name)
        text = f"{value.dtype}{list(value.shape)}" if hasattr(value, "dtype") else short_repr(value)
        parts.append(f"{field.name}={text if len(text) <= _BRIEF else text[: _BRIEF - 3] + '...'}")
    return f"{type(record).__name__}({', '.join(parts)})"


def short_names(names: list[str]) -> str:
    """Return keys as text for a message: the first few, each shortened if it is long."""
    first = [short_repr(name)[1:-1] for name in names[:_NAMED]]
    return ", ".join(first + ([f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []))


def _text(path: Path) -> str:
    """Read the text of a regular file; reading a pipe or a device might never end."""
    if not path.is_file():
        raise ValueError(
            "there is no such file" if not path.exists() else "it is not a file; write the TOML to a file of its own"
        )
    try:
        return read_regular(path, _MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError as caught:
        raise ValueError(f"not UTF-8 text at byte {caught.start}; save it as UTF-8") from caught


def _checked(text: str) -> str:
    """Reject keys with so many parts that parsing would take minutes; dots in strings and comments do not count."""
    for number, line in enumerate(_STRINGS_AND_COMMENTS.sub(_line_breaks, text).split("\n"), 1):
        most = max(part.count(".") for part in re.split("[=,]", line)) + 1
        if most > _MOST_PARTS:
            raise ValueError(f"the key in line {number} has {most} parts; at most {_MOST_PARTS} are read")
    return text


def _line_breaks(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")
