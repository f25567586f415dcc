"""The run spec: inputs with their checksums, settings, and versions and ids of what a run computes with.

BLAKE3 takes a quarter of the time of SHA-256, even on a processor with SHA instructions (measured).
"""

import hashlib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from blake3 import blake3

from bumpymap.core.files import plain_json

CHECKSUM_METHOD = "blake3"
"""Stands before the digest in a checksum: ``blake3:12ab...``."""
_SET_METHOD = "blake3-set"
"""Stands before the digest in a checksum of several files."""
_PIECE_BYTES = 1 << 20
"""Read at once, bytes."""


def file_checksum(path: Path) -> str:
    """Return the checksum of a file: its BLAKE3, as ``b3sum`` prints it, after ``blake3:``."""
    found, piece = blake3(), bytearray(_PIECE_BYTES)
    with path.open("rb", buffering=0) as file:
        while size := file.readinto(piece):
            found.update(memoryview(piece)[:size])
    return f"{CHECKSUM_METHOD}:{found.hexdigest()}"


def join_checksums(checksums: Iterable[str]) -> str:
    """Return one checksum for a set of files: the BLAKE3 of their checksums, sorted, one a line."""
    lines = "".join(f"{checksum}\n" for checksum in sorted(checksums))
    return f"{_SET_METHOD}:{blake3(lines.encode()).hexdigest()}"


_OF_THE_MACHINE = {"out", "threads", "memory", "scratch", "scheduler", "overwrite", "page"}
"""Settings that say where and how a run is carried out, or the header of its page: no layer depends on them, and no
manifest repeats them."""

_MOST_LISTED = 8
"""Differences that a message lists at most."""
_LONGEST = 80
"""Characters of a value that a message shows at most."""
_FROM = {"calibration": ("vehicle", "calibration"), "model": ("model",), "method": ("method", "model")}
"""Settings that select something with an id of its own: they count as different only if the id differs."""


def flat_settings(config: Any, without: Collection[str]) -> dict[str, Any]:
    """Return the settings of a dataclass as JSON values; those of a nested table are named ``table.name``.

    Parameters
    ----------
    without : collection of str
        Settings to leave out, because they do not change the results, beside those of the machine.
    """
    found = config if isinstance(config, Mapping) else asdict(config)
    return {
        name: value
        for key, item in found.items()
        if key not in without and key not in _OF_THE_MACHINE
        for name, value in (
            ((f"{key}.{inner}", plain_json(own)) for inner, own in item.items())
            if isinstance(item, Mapping)
            else ((key, plain_json(item)),)
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


def same_content(path: str, known: Mapping[str, Any], here: Mapping[str, Any], hashed: Callable[[Path], str]) -> bool:
    """Return whether an input file is unchanged: by size and time, or by its checksum if the time differs.

    Parameters
    ----------
    path : str
        Of the file.
    known : mapping
        ``bytes``, ``checksum`` (see `file_checksum`; or ``sha256`` of all bytes) and, if it was recorded, ``mtime_ns``.
    here : mapping
        From `bumpymap.readers.identity`.
    hashed : callable
        Returns the checksum of an input, such as `bumpymap.readers.hash_survey`.
    """
    if known.get("bytes") is not None and known["bytes"] != here["size"]:
        return False
    if known.get("mtime_ns") and known["mtime_ns"] == here.get("mtime_ns"):
        return True
    checksum, sha256 = known.get("checksum"), known.get("sha256")
    if checksum is not None:
        return bool(str(checksum).startswith(f"{CHECKSUM_METHOD}:") and hashed(Path(path)) == checksum)
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
        elif before[path] is None or now[path] is None or same is None:
            found += [f"{path} has changed since"] * (before[path] != now[path])
        elif not same(path, before[path], now[path]):
            found.append(f"{path} has changed since")
    return found


def _value_text(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(value).lower()
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."
