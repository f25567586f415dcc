"""Where the files of routes go: their names, and a check of the folder or file before anything is computed.

Nothing here needs GDAL, whose import takes a fifth of a second.
"""

from collections.abc import Mapping
from os.path import lexists
from pathlib import Path

from bumpymap.core import OutputError, UsageError
from bumpymap.layers.products import refuse_present, require_folder

__all__ = [
    "OTHER_FILES",
    "REACH_KINDS",
    "ROUTE_KINDS",
    "ROUTE_MANIFEST_NAME",
    "ROUTE_NAMES",
    "check_out",
    "check_reach_out",
    "check_route_out",
    "is_one_file",
]

ROUTE_MANIFEST_NAME = "route.json"
ROUTE_KINDS = {
    ".geojson": "route.geojson",
    ".gpx": "route.gpx",
    ".csv": "profile.csv",
    ".png": "route.png",
}
REACH_KINDS = {".tif": "reach.tif", ".geojson": "isochrones.geojson"}
"""What a single file is, by its suffix."""
ROUTE_NAMES = (*ROUTE_KINDS.values(), "reach.tif", "reach_back.tif", "isochrones.geojson", ROUTE_MANIFEST_NAME)
"""Every file that a run may leave in its folder."""
OTHER_FILES = frozenset(
    {
        *(".csv", ".fgb", ".geojson", ".gpkg", ".gpx", ".html", ".jpeg", ".jpg", ".json", ".kml", ".kmz", ".parquet"),
        *(".pdf", ".plan", ".png", ".shp", ".svg", ".tif", ".tiff", ".txt", ".xlsx"),
    }
)
"""Suffixes by which a user means a file, not a folder."""


def check_route_out(out: Path, *, overwrite: bool) -> None:
    """Check, before anything is computed, that files of routes can be written to a folder or a file. Writes nothing.

    Parameters
    ----------
    out : Path
        A folder, or one file that ends in .geojson, .gpx, .csv or .png.
    overwrite : bool
        Allow files of an earlier run to be replaced.

    Raises
    ------
    UsageError
        ``out`` is named like a file of a kind that is not written.
    OutputError
        There are files that must not be replaced, or the place of a file is missing.
    """
    check_out(out, ROUTE_KINDS, overwrite=overwrite)


def check_reach_out(out: Path, *, overwrite: bool) -> None:
    """Check the same for the reach: a folder, or one file that ends in .tif or .geojson."""
    check_out(out, REACH_KINDS, overwrite=overwrite)


def is_one_file(out: Path, kinds: Mapping[str, str]) -> bool:
    """Return whether ``out`` names one file: by its suffix, unless it is a folder that exists."""
    return out.suffix.lower() in kinds and not (out.is_dir() and not out.is_symlink())


def check_out(out: Path, kinds: Mapping[str, str], *, overwrite: bool) -> None:
    """Check a folder, or one file with one of the suffixes of ``kinds``; errors as in `check_route_out`."""
    suffix = out.suffix.lower()
    if is_one_file(out, kinds):
        if not out.parent.is_dir():
            raise OutputError(
                f"cannot write {out}: there is no folder {out.parent}. Create it, or choose another `out`"
            )
        if lexists(out) and not overwrite:
            raise OutputError(f"{out} exists. Choose another `out`, or pass `overwrite=True` to replace it")
        return
    if suffix in OTHER_FILES and not out.is_dir():
        raise UsageError(
            f"{out} is named like a {suffix} file, which is not written here. Give a folder as `out`, or a file that "
            f"ends in {', '.join(kinds)}"
        )
    require_folder(out)
    refuse_present(out, ROUTE_NAMES, overwrite=overwrite)
