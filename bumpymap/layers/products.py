"""The files of a map: their names, and a check of the folder that they will be written to.

Nothing here needs GDAL or Arrow, whose import takes a fifth of a second: a run checks its folder before it reads.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from os.path import lexists
from pathlib import Path
from typing import Any
from uuid import uuid4

from bumpymap.core import (
    STAGED,
    OutputError,
    UsageError,
    locked,
    read_record,
    remove_empty_on_error,
    remove_path,
    write_together,
    writing_to,
)
from bumpymap.layers.manifest import MANIFEST_NAME, SHEETS_FORMAT, describe_file, write_manifest

__all__ = [
    "CATALOG_NAME",
    "EVERY_NAME",
    "EVERY_VIEW_NAME",
    "ITEM_NAME",
    "NAMED_RASTERS",
    "OTHER_FILES",
    "PRODUCT_NAMES",
    "REPORT_NAME",
    "SPEEDS_NAME",
    "SPEEDS_STYLE_NAME",
    "VIEW_NAMES",
    "OutputFolder",
    "check_folder",
    "refuse_blocked",
    "refuse_present",
    "require_folder",
]


def require_folder(out: Path) -> None:
    """Raise OutputError if something else than a folder stands at ``out``."""
    if lexists(out) and not out.is_dir():
        raise OutputError(f"cannot write to the folder {out}: it is a file. Choose another `out`")


def refuse_blocked(folder: Path, names: Sequence[str]) -> None:
    """Raise OutputError if one of some names is neither a file nor a link, so that it cannot be replaced."""
    for name in names:
        if lexists(folder / name) and not (folder / name).is_symlink() and not (folder / name).is_file():
            raise OutputError(f"{folder / name} is not a file, so it cannot be replaced. Choose another `out`")


def refuse_present(folder: Path, names: Sequence[str], *, overwrite: bool) -> None:
    """Raise OutputError if a folder holds some of the files and they must not, or cannot, be replaced."""
    refuse_blocked(folder, names)
    present = [name for name in names if lexists(folder / name)]
    if present and not overwrite:
        raise OutputError(
            f"{folder} already holds {', '.join(present)}. Choose another `out`, or pass `overwrite=True` to replace "
            "them"
        )


OTHER_FILES = frozenset(
    {
        *(".csv", ".fgb", ".geojson", ".gpkg", ".gpx", ".html", ".jpeg", ".jpg", ".json", ".kml", ".kmz", ".parquet"),
        *(".pdf", ".plan", ".png", ".shp", ".svg", ".tif", ".tiff", ".txt", ".xlsx"),
    }
)
"""Suffixes by which a user means a file, not a folder."""
ITEM_NAME = "item.json"
"""The map as a STAC item."""
CATALOG_NAME = "catalog.json"
"""A STAC catalogue of the maps of many surveys."""
PRODUCT_NAMES: tuple[str, ...] = (
    "roughness.tif",
    "class.tif",
    "reason.tif",
    "cost.tif",
    "barred.tif",
    "heightmap.tif",
    "relief.tif",
    "obstacle.tif",
    "passage.tif",
    "tiles.parquet",
    "cost.geojson",
    "cost.fgb",
    ITEM_NAME,
    MANIFEST_NAME,
)
"""Files of a run, which its manifest lists with their checksums."""
SPEEDS_NAME = "speeds.tif"
"""One more, of a run that was asked for other speeds."""
EVERY_NAME = (*PRODUCT_NAMES[:-2], SPEEDS_NAME, *PRODUCT_NAMES[-2:])
"""The files that a run may write, in their order."""
REPORT_NAME = "report.html"
"""The page of a map."""
VIEW_NAMES: tuple[str, ...] = (
    *(f"{Path(name).stem}.qml" for name in PRODUCT_NAMES if name.endswith((".tif", ".parquet"))),
    "map.qgs",
    REPORT_NAME,
)
"""Files to look at the others with: styles, a project, a page. GIS programs rewrite them, so they have no checksum."""
SPEEDS_STYLE_NAME = SPEEDS_NAME.replace(".tif", ".qml")
"""One more, of a run that was asked for other speeds."""
EVERY_VIEW_NAME = (*VIEW_NAMES, SPEEDS_STYLE_NAME)
"""The files to look at the others with that a run may write."""
NAMED_RASTERS = ("class.tif", "reason.tif", "barred.tif", "obstacle.tif")
"""Rasters with names, colours and counts of their values beside them, in ``class.tif.aux.xml`` and so on."""


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that the files of a run can be written to a folder; create the folder if it is missing.

    Half-written files of a killed run are removed; the caller holds the lock of the folder, so no other run is using
    it. A file that is a symbolic link will be replaced as a link; its target is not touched.

    Parameters
    ----------
    folder : Path
        The output folder.
    overwrite : bool
        Allow files of any earlier run to be replaced.

    Raises
    ------
    OutputError
        The folder cannot be created or written, or holds files that must not be replaced.
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"cannot write to the folder {folder}: it is a file. Choose another `out`")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".bumpymap-{uuid4().hex}"
        probe.touch()
        probe.unlink()
        for left in folder.glob(f"{STAGED}*"):  # of a run that was killed
            remove_path(left)
        present = [name for name in (*EVERY_NAME, *EVERY_VIEW_NAME) if lexists(folder / name)]
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. "
            "Choose one that can be written, with `out`"
        ) from error
    if (read_record(folder / MANIFEST_NAME) or {}).get("format") == SHEETS_FORMAT:
        raise OutputError(
            f"{folder} holds a map in sheets, which an earlier version wrote. Choose another `out`, or remove it"
        )
    refuse_blocked(folder, present)
    finished = MANIFEST_NAME in present
    if present and not overwrite:
        unfinished = "" if finished else " of a run that did not end"
        raise OutputError(
            f"{folder} already holds {', '.join(present)}{unfinished}. Choose another `out`, "
            "or pass `overwrite=True` to replace them"
        )


@dataclass(frozen=True, slots=True)
class OutputFolder:
    """The files that one kind of run leaves in a folder of its own."""

    names: tuple[str, ...]
    """Every file that a run may leave there. Those of an earlier run that are not written again are removed."""
    manifest: str
    """The one among them that is written last: a folder that has it is complete."""
    views: tuple[str, ...] = ()
    """Those among them that the manifest does not list, since GIS programs rewrite them."""

    def check(self, out: Path, *, overwrite: bool) -> None:
        """Check, before anything is computed, that the files can be written to a folder. Writes nothing.

        Raises
        ------
        UsageError
            ``out`` holds the layers of a survey.
        OutputError
            There are files that must not be replaced, or ``out`` is a file.
        """
        require_folder(out)
        if lexists(out / MANIFEST_NAME):
            raise UsageError(f"{out} holds the layers of a survey. Give a folder of its own as `out`")
        refuse_present(out, self.names, overwrite=overwrite)

    def write(
        self,
        out: Path,
        writers: Mapping[str, Callable[[Path], None]],
        describe: Callable[[Path, list[dict[str, Any]]], Mapping[str, Any]],
        *,
        overwrite: bool,
    ) -> list[Path]:
        """Write files to a folder, which is created if it is missing: all of them, or none.

        Parameters
        ----------
        out : Path
        writers : mapping
            How each is written, by name.
        describe : callable
            Returns the content of the manifest, given the folder with the new files, and their sizes and checksums; it
            may write views there.
        overwrite : bool
            Allow files of an earlier run to be replaced.

        Returns
        -------
        list of Path
            Files of the writers, then the manifest.

        Raises
        ------
        OutputError
            There are files that must not be replaced, or one cannot be written.
        """
        with remove_empty_on_error(out), locked(out):
            check_folder(out, overwrite=True)
            refuse_present(out, self.names, overwrite=overwrite)
            with write_together(out, self.manifest) as staged:
                for name, write in writers.items():
                    write(staged / name)
                files = [describe_file(staged / name) | {"path": name} for name in writers if name not in self.views]
                write_manifest(describe(staged, files), staged / self.manifest)
                made = {path.name for path in staged.iterdir()}
            with writing_to(out):
                for name in self.names:
                    if name not in made and lexists(out / name):
                        remove_path(out / name)
        return [out / name for name in (*writers, self.manifest)]
