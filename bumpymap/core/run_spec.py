"""The run spec: inputs, settings, and versions and ids of what a run computes with; and how two of them differ."""

import hashlib
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bumpymap.core.file_hash import CHECKSUM_METHOD, hash_file

__all__ = ["differences", "flat_settings", "recorded_settings", "same_content", "spec_of_manifest"]

_OF_THE_MACHINE = {"out", "threads", "scratch", "scheduler", "resume", "overwrite"}
"""Settings that say where and how a run is carried out: they change no result, so no manifest repeats them."""

_MOST_LISTED = 8
"""Differences that a message lists at most."""
_LONGEST = 80
"""Characters of a value that a message shows at most."""
_FROM = {"calibration": ("vehicle", "calibration"), "model": ("model",), "method": ("method", "model", "stripes")}
"""Settings that select something with an id of its own: they count as different only if the id differs."""


def flat_settings(config: Any, without: Collection[str]) -> dict[str, Any]:
    """Return the settings of a dataclass as JSON values; those of a nested table are named ``table.name``.

    Parameters
    ----------
    config : dataclass, or mapping of its fields
    without : collection of str
        Settings to leave out, because they do not change the results.
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


def recorded_settings(config: Any) -> dict[str, Any]:
    """Return the settings of a dataclass that a manifest holds, which are those of every machine."""
    return {name: value for name, value in asdict(config).items() if name not in _OF_THE_MACHINE}


def differences(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None = None,
) -> list[str]:
    """Describe the differences between two run specs, one phrase each.

    Parameters
    ----------
    before, now : mapping
        ``inputs``: path -> identity of the file; ``settings``; ``made with``: name -> version or id.
    same : callable, optional
        Called with path, old and new identity of an input, returns whether it is the same file. None: compare the
        two identities.
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
            f"{name} was {_value_text(old.get(name))}, is {_value_text(new.get(name))}"
            for name in dict.fromkeys([*old, *new])
            if old.get(name) != new.get(name)
        ]
    return found if len(found) <= _MOST_LISTED else [*found[:_MOST_LISTED], f"and {len(found) - _MOST_LISTED} more"]


def same_content(path: str, known: Mapping[str, Any], here: Mapping[str, Any]) -> bool:
    """Return whether an input file is unchanged: by size and time, or by its checksum if the time differs.

    Parameters
    ----------
    path : str
        Of the file, or a URL. A URL is never downloaded to compare checksums.
    known : mapping
        ``bytes``, ``checksum`` (see `FileHash`; or ``sha256`` of all bytes) and, if they were recorded, ``mtime_ns`` or
        the ``version`` reported by a server.
    here : mapping
        From `bumpymap.readers.source.identity`.
    """
    if known.get("bytes") is not None and known["bytes"] != here["size"]:
        return False
    for key in ("mtime_ns", "version"):
        if known.get(key) and known[key] == here.get(key):
            return True
    if "://" in path:
        return False
    checksum, sha256 = known.get("checksum"), known.get("sha256")
    if checksum is not None:
        return bool(str(checksum).startswith(f"{CHECKSUM_METHOD}:") and hash_file(Path(path)) == checksum)
    if sha256 is None:
        return False
    with Path(path).open("rb") as file:
        return bool(hashlib.file_digest(file, "sha256").hexdigest() == sha256)


def spec_of_manifest(
    record: Mapping[str, Any], without: Collection[str], made_with: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the run spec of a complete run, from its run.json or scan.json.

    Parameters
    ----------
    record : mapping
    without : collection of str
        Settings to leave out, because they do not change the results.
    made_with : mapping
        Ids of models and calibrations, in addition to the versions.
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
    """Return a setting as it would be after a round trip through JSON."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_plain(item) for item in value]
    return value if value is None or isinstance(value, bool | int | float | str) else str(value)


def _value_text(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(value).lower()
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
