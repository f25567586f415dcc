"""Where the files of a check go: their names, and a look at the folder before anything is computed.

Nothing here needs GDAL, whose import takes a fifth of a second.
"""

from os.path import lexists
from pathlib import Path

from bumpymap.core import UsageError
from bumpymap.layers._replacing import refuse_present, require_folder
from bumpymap.layers.manifest import MANIFEST_NAME
from bumpymap.layers.route.names import OTHER_FILES

__all__ = ["CHECK_MANIFEST_NAME", "CHECK_NAMES", "CHECK_VIEW_NAMES", "check_check_out"]

CHECK_MANIFEST_NAME = "check.json"
CHECK_NAMES = (
    "check.md",
    "check.png",
    "stretches.csv",
    "check.geojson",
    "check_tiles.geojson",
    CHECK_MANIFEST_NAME,
)
"""Every file that a check may leave in its folder, but those to look at the others with."""
CHECK_VIEW_NAMES = ("check.qml", "check_tiles.qml")
"""Styles of QGIS, which rewrites them, so they have no checksum."""


def check_check_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that the files of a check can be written to a folder. Writes nothing.

    Raises
    ------
    UsageError
        ``out`` holds the layers of a survey, or is named like a file.
    OutputError
        There are files that must not be replaced, or ``out`` is a file.
    """
    if out.suffix.lower() in OTHER_FILES and not out.is_dir():
        raise UsageError(f"{out} is named like a {out.suffix.lower()} file, but a check is a folder. Give one as `out`")
    require_folder(out)
    if lexists(out / MANIFEST_NAME):
        raise UsageError(f"{out} holds the layers of a survey. Give a folder of its own as `out`")
    refuse_present(out, (*CHECK_NAMES, *CHECK_VIEW_NAMES), overwrite=overwrite)
