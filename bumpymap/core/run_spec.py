"""What a run was asked: inputs, settings, what makes its numbers. Two such records are compared, in words."""

import hashlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

__all__ = ["differences", "flat_settings", "same_content", "spec_of_manifest"]

_SHOWN = 8
"""So many differences are named."""
_LONGEST = 80
"""Characters of a value that are shown."""
_FROM = {"calibration": ("vehicle", "calibration"), "model": ("model",), "method": ("method", "model", "stripes")}
"""What names a thing that has an id of its own: these settings differ only where the id does."""


def flat_settings(config: Any, without: Collection[str]) -> dict[str, Any]:
    """Give the settings of a dataclass as JSON knows them, with those of a table as ``table.name``.

    Parameters
    ----------
    config : dataclass, or mapping of its fields
    without : collection of str
        Settings that have no say.
    """
    found = config if isinstance(config, Mapping) else asdict(config)
    return {
        name: value
        for key, item in found.items()
        if key not in without
        for name, value in (
            ((f"{key}.{inner}", _plain(own)) for inner, own in item.items())
            if isinstance(item, Mapping)
            else ((key, _plain(item)),)
        )
    }


def differences(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None = None,
) -> list[str]:
    """Say in words what differs between two records of what a run was asked; one phrase each.

    Parameters
    ----------
    before, now : mapping
        ``inputs``: path to what tells the file from another; ``settings``; ``made with``: name to version or id.
    same : callable, optional
        Whether an input (its path, what was known, what is) is still the same; None: where the two are equal.
    """
    made = [{**record.get("made with", {})} for record in (before, now)]
    settings = [{**record.get("settings", {})} for record in (before, now)]
    for name, sources in _FROM.items():
        if made[0].get(name) == made[1].get(name):
            for own in settings:
                for source in sources:
                    own.pop(source, None)
        elif any(settings[0].get(source) != settings[1].get(source) for source in sources):
            for own in made:
                own.pop(name, None)
    found = _inputs(before.get("inputs", {}), now.get("inputs", {}), same)
    for old, new in (settings, made):
        found += [
            f"{name} was {_shown(old.get(name))}, is {_shown(new.get(name))}"
            for name in dict.fromkeys([*old, *new])
            if old.get(name) != new.get(name)
        ]
    return found if len(found) <= _SHOWN else [*found[:_SHOWN], f"and {len(found) - _SHOWN} more"]


def same_content(path: str, known: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    """Whether an input is still the one that a run read: by size and time, or by its checksum where the time differs.

    Parameters
    ----------
    path : str
        Of the file, or a URL, which is never read for this.
    known : mapping
        ``bytes``, ``sha256`` and, where it was noted, ``mtime_ns`` or the ``version`` that a server gave.
    here : mapping
        From `bumpymap.readers.source.identity`.
    """
    if known.get("bytes") is not None and known["bytes"] != here["size"]:
        return False
    for key in ("mtime_ns", "version"):
        if known.get(key) and known[key] == here.get(key):
            return True
    if "://" in path or known.get("sha256") is None:
        return False
    with Path(path).open("rb") as file:
        return bool(hashlib.file_digest(file, "sha256").hexdigest() == known["sha256"])


def spec_of_manifest(
    record: Mapping[str, Any], without: Collection[str], made_with: Mapping[str, Any]
) -> dict[str, Any]:
    """Give what a complete run was asked, by its run.json or scan.json.

    Parameters
    ----------
    record : mapping
    without : collection of str
        Settings that have no say.
    made_with : mapping
        Ids of what made the numbers, beside the versions.
    """
    return {
        "inputs": {str(file["path"]): file for file in (*record["inputs"], *record.get("skipped_inputs", ()))},
        "settings": flat_settings(record["settings"], without),
        "made with": {**record["versions"], **made_with},
    }


def _inputs(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None,
) -> list[str]:
    found = []
    for path in dict.fromkeys([*before, *now]):
        if path not in now:
            found.append(f"{path} was an input, but is not given now")
        elif path not in before:
            found.append(f"{path} is given now, but was not an input")
        elif not _is_same(path, before[path], now[path], same):
            found.append(f"{path} has changed since")
    return found


def _is_same(path: str, old: Any, new: Any, same: Callable[..., bool] | None) -> bool:
    if old is None or new is None or same is None:
        return bool(old == new)
    return same(path, old, new)


def _plain(value: Any) -> Any:
    """Turn a setting into what it is when it was JSON."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _shown(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(value).lower()
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
