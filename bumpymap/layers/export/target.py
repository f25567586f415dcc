"""The folder that an export is written to: checked first, then filled at once or not at all."""

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from os.path import lexists
from pathlib import Path
from typing import Any

from bumpymap.core import OutputError, atomic, locked, remove_empty_on_error, write_together
from bumpymap.layers._replacing import refuse_present
from bumpymap.layers.manifest import MANIFEST_NAME

__all__ = ["DATUM_NAME", "EXPORT_FILES", "check_target", "export_folder", "write_file", "write_json"]

DATUM_NAME = "datum.json"
"""The sidecar file with the local datum. It is written last: a folder that has one holds a complete export."""
EXPORT_FILES: dict[str, tuple[str, ...]] = {
    "nav2": (
        "map.yaml",
        "map.pgm",
        "keepout_mask.yaml",
        "keepout_mask.pgm",
        "speed_mask.yaml",
        "speed_mask.pgm",
        "nav2_params.yaml",
        DATUM_NAME,
    ),
    "gridmap": ("gridmap.mcap", "metadata.yaml", DATUM_NAME),
    "graph": ("graph.geojson", DATUM_NAME),
    "plan": ("route.plan", DATUM_NAME),
    "cost": ("cost.tif", DATUM_NAME),
}
"""Files of an export, by format."""


def check_target(out: Path, to: str, *, overwrite: bool) -> None:
    """Check that an export can be written to a folder, without touching it.

    Raises
    ------
    OutputError
        It is a file, holds the layers of a run or an export in another format, or an earlier export and ``overwrite``
        is False.
    """
    if lexists(out) and not out.is_dir():
        raise OutputError(f"cannot write to the folder {out}: it is not a folder. Choose another `out`")
    if lexists(out / MANIFEST_NAME):
        raise OutputError(f"{out} holds the layers of a run; an export has a folder of its own. Choose another `out`")
    own = EXPORT_FILES[to]
    foreign = sorted(
        name for names in EXPORT_FILES.values() for name in names if name not in own and lexists(out / name)
    )
    if foreign:
        raise OutputError(f"{out} already holds {foreign[0]} of an export in another format. Choose another `out`")
    refuse_present(out, own, overwrite=overwrite)


@contextmanager
def export_folder(out: Path, to: str, *, overwrite: bool) -> Iterator[Path]:
    """Yield an empty folder to write an export to; at the end its files move to ``out``, or none.

    A file that is a symbolic link is replaced as a link; its target is not touched.

    Raises
    ------
    OutputError
        See `check_target`; or another process is writing there, or the files cannot be written.
    """
    with remove_empty_on_error(out), locked(out):
        check_target(out, to, overwrite=overwrite)
        with write_together(out, DATUM_NAME) as staged:
            yield staged


def write_file(path: Path, *parts: bytes) -> None:
    """Write a file of given bytes. Raises OutputError if that fails."""
    with atomic(path) as temporary, temporary.open("wb") as file:
        for part in parts:
            file.write(part)


def write_json(path: Path, record: Mapping[str, Any]) -> None:
    """Write a record as JSON with one entry a line. Raises OutputError if that fails."""
    text = json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    write_file(path, text.encode("utf-8", "backslashreplace"))
