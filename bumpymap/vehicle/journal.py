"""The progress file of a calibration: one JSON line a finished cell, so that an interrupted run can go on."""

import json
import logging
import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bumpymap.errors import OutputError
from bumpymap.vehicle.plan import PatchDrives

__all__ = ["Journal"]

_FORMAT = "bumpymap-calibration-progress"
_LOG = logging.getLogger(__name__)

Cell = tuple[int, int]
"""Indices of texture and z range."""


class Journal:
    """Finished cells beside the output. The first line holds the settings; cells of other settings are not reused."""

    def __init__(self, path: Path, settings: dict[str, Any]) -> None:
        self._path = path
        self._header = json.dumps({"format": _FORMAT, "settings": settings}, sort_keys=True)

    def resume(self, *, discard_other: bool) -> dict[Cell, list[PatchDrives]]:
        """Open the file and return the cells that an earlier run with the same settings finished.

        A line that was cut off in the middle, by a power cut say, is dropped with all that follows.

        Raises
        ------
        OutputError
            The file is of other settings and ``discard_other`` is False, or the folder cannot be written.
        """
        try:
            lines = self._path.read_text(encoding="utf-8").splitlines() if self._path.exists() else []
            if lines and lines[0] != self._header:
                if not discard_other:
                    raise OutputError(
                        f"{self._path} holds the progress of a calibration with other settings or versions; "
                        "go on with those settings, or start anew with --overwrite"
                    )
                lines = []
            cells = _read_cells(lines[1:])
            kept = [self._header, *(_line(cell, drives) for cell, drives in cells.items())]
            self._path.write_text("\n".join(kept) + "\n", encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise OutputError(f"cannot use the progress file {self._path}: {error}") from error
        if cells:
            _LOG.info("going on with %d finished cells of %s", len(cells), self._path)
        return cells

    def add(self, cell: Cell, drives: list[PatchDrives]) -> None:
        """Note a finished cell; it is on the disk when this returns."""
        try:
            with self._path.open("a", encoding="utf-8") as file:
                file.write(_line(cell, drives) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise OutputError(f"cannot write the progress file {self._path}: {error}") from error

    def remove(self) -> None:
        """Delete the file: the calibration is complete."""
        self._path.unlink(missing_ok=True)


def _line(cell: Cell, drives: list[PatchDrives]) -> str:
    return json.dumps({"cell": cell, "patches": [asdict(d) for d in drives]}, allow_nan=False)


def _read_cells(lines: list[str]) -> dict[Cell, list[PatchDrives]]:
    cells: dict[Cell, list[PatchDrives]] = {}
    for line in lines:
        try:
            record = json.loads(line)
            texture, z = record["cell"]
            cells[texture, z] = [PatchDrives(tuple(d["outcome"]), tuple(d["c_r"])) for d in record["patches"]]
        except (ValueError, KeyError, TypeError):
            _LOG.warning("the progress file ends in a damaged line; %d finished cells before it are kept", len(cells))
            break
    return cells
