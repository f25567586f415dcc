"""TOML files, read within bounds: settings and vehicle profiles alike.

``tomllib`` takes time and memory with the square of the parts of a dotted key: one of 40 kB took 11 s and 0.4 GB. All
else that was tried grows with the file (nested lists the fastest, 7 s for 1 MB), so two bounds hold all of it: the size
of the file, and how many parts a key may have.
"""

import re
import tomllib
from pathlib import Path
from reprlib import Repr
from typing import Any

from bumpymap.core.errors import BumpymapError

__all__ = ["read_toml", "short_names", "short_repr"]

_MOST_BYTES = 256 * 1024
_MOST_PARTS = 16
"""Of a dotted key; no setting has more than two."""
_TEXTS = re.compile(
    r'"""(?:[^"\\]|\\.|"{1,2}(?!"))*+(?:"{3,5})?'
    r"|'''(?:[^']|'{1,2}(?!'))*+(?:'{3,5})?"
    r'|"(?:[^"\\\n]|\\.)*+"?'
    r"|'[^'\n]*+'?"
    r"|#[^\n]*+",
    re.DOTALL,
)
"""Texts and comments. One without an end goes as far as it can: the parser refuses it, in linear time like this."""
_WORDS = 300
"""Letters of what the parser says that are shown: it may cite a key in full."""
_NAMED = 8
_SHORT = Repr()
_SHORT.maxlevel = 2
_SHORT.maxstring = _SHORT.maxother = _SHORT.maxlong = 80


def read_toml(path: Path, what: str, error: type[BumpymapError]) -> dict[str, Any]:
    """Read a TOML file of at most 256 kB; a mark of byte order at its start is skipped.

    Parameters
    ----------
    path : Path
    what : str
        What is read from it, for messages, such as ``settings``.
    error : exception type
        What is raised where it cannot be read: it is no regular file, too large, not UTF-8, not TOML.
    """
    try:
        return tomllib.loads(_checked(_text(path)))
    except OSError as caught:
        raise error(f"cannot read {what} from {path}: {caught.strerror or caught}") from caught
    except RecursionError as caught:
        raise error(f"cannot read {what} from {path}: lists or tables are nested too deep") from caught
    except ValueError as caught:  # not TOML, not UTF-8, too long a number, beyond a bound
        raise error(f"cannot read {what} from {path}: {str(caught)[:_WORDS]}") from caught


def short_repr(value: Any) -> str:
    """Show a value of a file in a message; the middle of a long one is left out."""
    return _SHORT.repr(value)


def short_names(names: list[str]) -> str:
    """Show keys of a file in a message: the first ones, each as far as it is short."""
    first = [short_repr(name)[1:-1] for name in names[:_NAMED]]
    return ", ".join(first + ([f"{len(names) - _NAMED} more"] if len(names) > _NAMED else []))


def _text(path: Path) -> str:
    """Read the text of a regular file: a pipe would be waited for, a device has no end."""
    if not path.is_file():
        raise ValueError(
            "there is no such file" if not path.exists() else "it is not a file; write the TOML to a file of its own"
        )
    with path.open("rb") as file:
        content = file.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise ValueError(f"it has more than {_MOST_BYTES // 1024} kB; is it a TOML file?")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as caught:
        raise ValueError(f"not UTF-8 text at byte {caught.start}; save it as UTF-8") from caught


def _checked(text: str) -> str:
    """Refuse keys of so many parts that the parser would take minutes; texts and comments may hold any dots."""
    for number, line in enumerate(_TEXTS.sub(_same_lines, text).split("\n"), 1):
        most = max(part.count(".") for part in re.split("[=,]", line)) + 1
        if most > _MOST_PARTS:
            raise ValueError(f"the key in line {number} has {most} parts; at most {_MOST_PARTS} are read")
    return text


def _same_lines(found: re.Match[str]) -> str:
    return "\n" * found[0].count("\n")
