"""Settings from a TOML file, by the fields of the dataclass that they are for. Unknown keys are refused."""

import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from numbers import Integral, Real
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from bumpymap.core.config import NameOrFile, names_a_file
from bumpymap.core.errors import UsageError
from bumpymap.core.toml_file import read_toml, shown, shown_names

__all__ = ["read_settings_file", "settings_of_call", "why_no_path"]

_LONGEST_NAME = 255
"""Bytes of one name of a path: the file systems in use take no more."""

_WORDS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
}
_TEXT = ("a text", "texts")
"""One value of a kind, and several."""


def read_settings_file(path: Path, owner: type) -> dict[str, Any]:
    """Read settings from a TOML file.

    Parameters
    ----------
    path : Path
        Of the file. Relative paths in it start at its folder.
    owner : type
        Dataclass that the settings are for. A field may be a bool, a number, a text, a Path, a ``Path | str`` (a URL
        stays a text), a ``NameOrFile``, a Literal of texts, a tuple of one of these, a dataclass (a table of the
        file), or any of them or None.

    Returns
    -------
    dict
        Of the fields that the file names, as arguments of ``owner``.

    Raises
    ------
    UsageError
        No such file, not TOML, an unknown key, a value of the wrong type or out of bounds.
    """
    return _settings(read_toml(path, "settings", UsageError), owner, str(path), path.parent)


def settings_of_call(given: Mapping[str, Any], owner: type, function: str) -> dict[str, Any]:
    """Check the keyword arguments of a Python call as those of a file are checked.

    Parameters
    ----------
    given : mapping
        Name -> value. Tables may be dicts or records, paths any path-like object; None is left out.
    owner : type
        Dataclass that the settings are for, see `read_settings_file`.
    function : str
        What is called, for messages.

    Returns
    -------
    dict
        Arguments of ``owner``.

    Raises
    ------
    UsageError
        A value of the wrong type or out of bounds.
    """
    record = {name: _plain(value) for name, value in given.items() if value is not None}
    return _settings(record, owner, function, Path())


def _plain(value: Any) -> Any:
    """Turn a value of Python into what a TOML file would give."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool) or not isinstance(value, Real):
        return value
    return int(value) if isinstance(value, Integral) else float(value)  # numpy's numbers too


def _settings(record: dict[str, Any], owner: type, origin: str, folder: Path) -> dict[str, Any]:
    known: dict[str, Any] = {f.name: f.type for f in fields(owner)}
    unknown = sorted(set(record) - set(known))
    if unknown:
        raise UsageError(f"{origin}: unknown setting {shown_names(unknown)}; there are: {', '.join(known)}")
    return {name: _value(value, known[name], name, origin, folder) for name, value in record.items()}


def _value(value: Any, kind: Any, name: str, origin: str, folder: Path) -> Any:
    """Return a TOML value as the setting's type."""
    if get_args(kind)[1:] == (NoneType,):  # whoever wants None leaves the setting out
        kind = get_args(kind)[0]
    items = get_args(kind)
    if is_dataclass(kind) and isinstance(value, dict):
        return kind(**_settings(value, kind, f"{origin} [{name}]", folder))  # type: ignore[arg-type, operator]
    if get_origin(kind) is tuple and isinstance(value, list) and (items[-1] is Ellipsis or len(items) == len(value)):
        return tuple(
            _value(item, items[0], f"value {number} of {name}", origin, folder) for number, item in enumerate(value, 1)
        )
    if get_origin(kind) is Literal and isinstance(value, str) and value in items:
        return value
    if kind in (Path, Path | str, NameOrFile) and isinstance(value, str):
        if reason := why_no_path(value):
            raise UsageError(f"{origin}: {name}: {reason}")
        return _placed(value, kind, folder)
    if type(value) is kind:  # of a Python call: records too
        return value
    if kind is float and type(value) is int and abs(value) < 2**1023:
        return float(value)
    raise UsageError(f"{origin}: {name} is {shown(value)}; it must be {_word(kind, name)}")


def _placed(text: str, kind: Any, folder: Path) -> Path | str:
    """Let a path start at the folder of the file; URLs and names are none."""
    if kind == NameOrFile:
        return str(folder / text) if names_a_file(text) else text
    return text if kind is not Path and "://" in text else folder / text


def why_no_path(text: str) -> str:
    """Say why no file can have this path; empty where one can."""
    if "\0" in text:
        return "a path cannot hold the character NUL"
    if "://" in text:
        return ""
    longest = max((len(os.fsencode(name)) for name in text.split("/")), default=0)
    if longest > _LONGEST_NAME:
        return f"the path has a name of {longest} bytes; names have up to {_LONGEST_NAME}"
    return ""


def _word(kind: Any, name: str) -> str:
    """Say what a setting can be."""
    items = get_args(kind)
    if is_dataclass(kind):
        return f"a table [{name}]"
    if get_origin(kind) is tuple:
        count = "" if items[-1] is Ellipsis else f"{len(items)} "
        return f"a list of {count}{_WORDS.get(items[0], _TEXT)[1]}"
    if get_origin(kind) is Literal:
        return f"one of {', '.join(items)}"
    return _WORDS.get(kind, _TEXT)[0]
