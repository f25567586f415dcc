"""Write a template of a vehicle profile: every key with its description, unit and allowed values."""

import json
import math
import re
from pathlib import Path
from typing import Any, TextIO

from bumpymap.core import UNFILLED, OutputError, UsageError
from bumpymap.rating.vehicle.keys import ProfileKey
from bumpymap.rating.vehicle.profile import KEYS, load_profile, shipped_profiles

__all__ = ["profile_template", "write_profile_template"]

_NAME = re.compile(r"[\w-]{1,64}")


def write_profile_template(name: str, path: Path, like: str | None) -> None:
    """Write `profile_template` to a new file.

    Raises
    ------
    UsageError
        The name is that of an included vehicle, or not one word; there is no vehicle ``like``.
    OutputError
        The file exists, or cannot be written.
    """
    if not _NAME.fullmatch(name):
        raise UsageError(f"the name of a vehicle is {name!r}; it must be up to 64 letters, digits, _ and -")
    if name in shipped_profiles():
        raise UsageError(f"a vehicle named {name} is included in bumpymap: choose another name, or --like {name}")
    text = profile_template(name, like)
    try:
        with path.open("x", encoding="utf-8") as file:  # "x" does not follow a symbolic link either
            _fill(file, path, text)
    except FileExistsError as error:
        raise OutputError(f"{path} exists and is not overwritten: give another --out") from error
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}; give another --out") from error


def _fill(file: TextIO, path: Path, text: str) -> None:
    """Write the whole text, or remove the file."""
    try:
        file.write(text)
        file.flush()
    except OSError:
        path.unlink()
        raise


def profile_template(name: str, like: str | None) -> str:
    """Return the text of a profile to edit.

    Parameters
    ----------
    name : str
        Name of the new vehicle.
    like : str or None
        A vehicle (name or TOML file) to copy the numbers from; None: put a placeholder that `vehicle check` reports.
    """
    model: dict[str, Any] = {} if like is None else load_profile(like).to_dict()
    lines = ["# A vehicle profile for bumpymap. Check it with: bumpymap vehicle check FILE"]
    if like is None:
        lines.append(f'# Replace each "{UNFILLED}" by a value.')
    else:
        lines.append(f"# The numbers are those of {model['name']}: change whatever differs.")
    lines += [f"name = {json.dumps(name)}", "# A one-line description."]
    lines.append(f"description = {json.dumps('like ' + model['name'] if model else UNFILLED, ensure_ascii=False)}")
    table = ""
    for key in KEYS:
        if key.table != table:
            table = key.table
            lines += ["", f"[{table}]"]
        what = key.quantity.what.replace("`", "")
        lines += [f"# {what[0].upper()}{what[1:]} ({key.quantity.allowed}).", _line(key, model)]
    return "\n".join(lines) + "\n"


def _line(key: ProfileKey, model: dict[str, Any]) -> str:
    """Return the line of a key, as a comment if its default follows from the others."""
    if not model and key.default is not None and math.isnan(key.default):
        return f"# {key.short} =   (if left out, it follows from the keys above)"
    return f"{key.short} = {_value(key, model)}"


def _value(key: ProfileKey, model: dict[str, Any]) -> str:
    if not model:
        return json.dumps(UNFILLED if key.default is None else key.default)
    return json.dumps((model[key.table] if key.table else model)[key.short])
