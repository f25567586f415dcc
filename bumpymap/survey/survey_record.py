"""What a survey is called and which data it is: the entry ``survey`` of run.json, which the layers repeat."""

from collections.abc import Sequence
from datetime import date
from os.path import abspath
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from bumpymap.core import join_checksums
from bumpymap.readers import Location, is_url

__all__ = ["survey_record"]


def survey_record(
    given: Sequence[Location],
    files: Sequence[Location],
    checksums: Sequence[str | None],
    dates: Sequence[date | None],
) -> dict[str, Any]:
    """Return name, checksum and dates of a survey; nothing in them depends on where its files lie.

    Parameters
    ----------
    given : sequence of Path or str
        Files and folders as the user named them; URLs are str.
    files : sequence of Path or str
        The files that were read.
    checksums : sequence of str or None
        Checksum of each file; None for a URL.
    dates : sequence of date or None
        Date in the header of each file.

    Returns
    -------
    dict
        ``name``: that of the one file without its suffix, or of the folder that was given or that holds all files, or
        ``N files``. ``checksum``: that of the one file, or one made from those of all; None if a file has none.
        ``dates``: the first and the last in the headers, ISO 8601; None if no header has one.
    """
    known = [checksum for checksum in checksums if checksum is not None]
    whole = len(known) == len(files)
    days = sorted(day for day in dates if day is not None)
    return {
        "name": _printable(_name(given, files)),
        "checksum": None if not whole else known[0] if len(known) == 1 else join_checksums(known),
        "dates": [days[0].isoformat(), days[-1].isoformat()] if days else None,
    }


def _name(given: Sequence[Location], files: Sequence[Location]) -> str:
    paths = [_path(file) for file in files]
    if len(paths) == 1:
        return paths[0].stem.removesuffix(".copc") or paths[0].name
    folders = {path.parent for path in paths} if len(given) > 1 else {_path(given[0])}
    name = folders.pop().name if len(folders) == 1 else ""
    return name or f"{len(files)} files"


def _path(location: Location) -> Path:
    """Return the absolute path of a file or folder; of a URL without its server and its query, which may hold a key."""
    if is_url(location):
        return Path(unquote(urlsplit(str(location)).path))
    return Path(abspath(location))  # noqa: PTH100 (resolve() follows links)


def _printable(name: str) -> str:
    """Replace what is not text (bytes that are not UTF-8, control characters): metadata of layers cannot hold it."""
    return "".join(letter if letter.isprintable() else "\N{REPLACEMENT CHARACTER}" for letter in name)
