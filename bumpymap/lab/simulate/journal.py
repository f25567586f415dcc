"""The progress file of many drives: one line of JSON for each driven patch, so that an interrupted run can continue.

The drives along a way are recorded in the same manner: a `JobJournal` is told how a record is read back.
"""

import errno
import json
import logging
import os
import stat
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Generic, TextIO, TypeVar

from bumpymap.core import OutputError, atomic, parse_json
from bumpymap.lab.simulate.patch import PatchDrives

__all__ = ["JobJournal", "Journal", "Key"]

_FORMAT = "bumpymap-drives-progress"
_LOG = logging.getLogger(__name__)

Key = tuple[str | int, ...]
"""Identifies a patch in a run."""

Record = TypeVar("Record")


class JobJournal(Generic[Record]):
    """The file of finished jobs. The first line holds the settings; drives with other settings are not reused.

    Only settings and versions are compared, so a code change that does not affect the numbers keeps the journal valid.

    Parameters
    ----------
    path : Path
    settings : dict
        Plain JSON.
    read : callable
        Makes a record, a dataclass, from the dict of its fields; raises ValueError, KeyError or TypeError if it cannot.
    """

    def __init__(self, path: Path, settings: dict[str, Any], read: Callable[[dict[str, Any]], Record]) -> None:
        self._path = path
        self._read = read
        self._header = json.dumps({"format": _FORMAT, "settings": settings}, sort_keys=True)

    def resume(self, *, discard_other: bool) -> dict[Key, Record]:
        """Open the file and return the patches that an earlier run with the same settings drove.

        An incomplete line, for example after a power cut, is dropped with all lines that follow it.

        Raises
        ------
        OutputError
            The file has other settings and ``discard_other`` is False, or the folder cannot be written.
        """
        try:
            lines = self._lines()
            if lines and lines[0] != self._header:
                if not discard_other:
                    raise OutputError(
                        f"{self._path} holds the progress of a run with other settings or versions; "
                        "use those settings, or start again with --overwrite"
                    )
                lines = []
            driven = self._records(lines[1:])
            kept = [self._header, *(_line(key, drives) for key, drives in driven.items())]
            with atomic(self._path) as temporary:  # a full disk must not lose driven patches
                temporary.write_text("\n".join(kept) + "\n", encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise OutputError(f"cannot use the progress file {self._path}: {error}") from error
        if driven:
            _LOG.info("continuing with %d driven patches of %s", len(driven), self._path)
        return driven

    def add(self, key: Key, drives: Record) -> None:
        """Append a driven patch and flush it to disk."""
        try:
            with self._open_file(os.O_WRONLY | os.O_APPEND) as file:
                file.write(_line(key, drives) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"cannot write the progress file {self._path}: {error}") from error

    def remove(self) -> None:
        """Delete the file: the run is complete."""
        self._path.unlink(missing_ok=True)

    def _lines(self) -> list[str]:
        try:
            with self._open_file(os.O_RDONLY) as file:
                return file.read().splitlines()
        except FileNotFoundError:
            return []

    def _open_file(self, flags: int) -> TextIO:
        """Open the file; raise OutputError for a link, because its target would be overwritten."""
        try:
            descriptor = os.open(self._path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
        except OSError as error:
            if error.errno != errno.ELOOP:
                raise
            raise OutputError(
                f"{self._path} is a link and was not touched: the run would write its progress there. Remove it, or "
                "choose another --out"
            ) from error
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise OutputError(f"{self._path} is not a file. Remove it, or choose another --out")
        return os.fdopen(descriptor, "a" if flags & os.O_APPEND else "r", encoding="utf-8")

    def _records(self, lines: list[str]) -> dict[Key, Record]:
        driven: dict[Key, Record] = {}
        for line in lines:
            try:
                fields = parse_json(line)
                key = tuple(fields.pop("patch"))
                driven[key] = self._read(fields)
            except (ValueError, KeyError, TypeError, AttributeError):
                text = "the progress file ends in a damaged line; %d driven patches before it are kept"
                _LOG.warning(text, len(driven))
                break
        return driven


class Journal(JobJournal[PatchDrives]):
    """The file of driven patches."""

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        super().__init__(path, settings, _patch_drives)


def _line(key: Key, drives: Any) -> str:
    return json.dumps({"patch": key, **asdict(drives)}, allow_nan=False)


def _patch_drives(fields: dict[str, Any]) -> PatchDrives:
    return PatchDrives(tuple(fields["outcome"]), tuple(fields["c_r"]))
