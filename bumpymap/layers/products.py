"""The files of a map: where each lies in its folder, and checks of that folder: may they be written, are they complete.

Nothing here needs GDAL or Arrow, whose import takes a fifth of a second: a run checks its folder before it reads.
"""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from os.path import lexists
from pathlib import Path
from typing import Any
from uuid import uuid4

from bumpymap.core import (
    STAGED,
    BadInputError,
    OutputError,
    UsageError,
    locked,
    read_record,
    remove_empty_on_error,
    remove_path,
    write_together,
)
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file, write_manifest


def require_folder(out: Path) -> None:
    """Raise OutputError if there is something else than a folder at ``out``."""
    if lexists(out) and not out.is_dir():
        raise OutputError(f"cannot write to the folder {out}: it is a file. Choose another `out`")


def require_new_file(path: Path, *, overwrite: bool, option: str = "out") -> None:
    """Raise OutputError if there is no folder for a file, or one of that name that must not be replaced."""
    if not path.parent.is_dir():
        raise OutputError(
            f"cannot write {path}: there is no folder {path.parent}. Create it, or choose another `{option}`"
        )
    if lexists(path) and not overwrite:
        raise OutputError(f"{path} exists already. Choose another `{option}`, or pass `overwrite=True` to replace it")


def refuse_present(
    folder: Path, names: Sequence[str], *, overwrite: bool, whose: str = "", folders: Collection[str] = ()
) -> None:
    """Raise OutputError if a folder holds some of the files and they must not, or cannot, be replaced.

    ``whose`` ends their list in the message; ``folders``: those of them that are folders.
    """
    present = [name for name in names if lexists(folder / name)]
    for name in present:
        path, kind = folder / name, "folder" if name in folders else "file"
        if not path.is_symlink() and not (path.is_dir() if name in folders else path.is_file()):
            raise OutputError(f"{path} is not a {kind}, so it cannot be replaced. Choose another `out`")
    if present and not overwrite:
        raise OutputError(
            f"{folder} already holds {', '.join(present)}{whose}. Choose another `out`, or pass `overwrite=True` to "
            "replace them"
        )


OTHER_FILES = frozenset(
    {
        *(".csv", ".fgb", ".geojson", ".gpkg", ".gpx", ".html", ".jpeg", ".jpg", ".json", ".kml", ".kmz", ".parquet"),
        *(".pdf", ".plan", ".png", ".shp", ".svg", ".tif", ".tiff", ".txt", ".xlsx"),
    }
)
"""Suffixes by which a user means a file, not a folder."""
COLLECTION_NAME = "collection.json"
"""The maps of many surveys as a STAC collection."""
REPORT_NAME = "report.html"
"""The page of a map, or of a comparison."""


class MapFile(StrEnum):
    """Where each file of a map lies in its folder; QGIS and GDAL look for styles and side files beside a layer."""

    ROUGHNESS = "rasters/roughness.tif"
    CLASS = "rasters/class.tif"
    REASON = "rasters/reason.tif"
    COST = "cost.tif"
    SPEED = "rasters/speed.tif"
    BARRED = "rasters/barred.tif"
    HEIGHTMAP = "rasters/heightmap.tif"
    RELIEF = "rasters/relief.tif"
    OBSTACLE = "rasters/obstacle.tif"
    PASSAGE = "rasters/passage.tif"
    TILES = "tiles.parquet"
    REGIONS = "cost.geojson"
    REGIONS_IN_CRS = "cost.fgb"
    PHOTO = "rasters/photo.tif"
    """Of a survey whose points have colours."""
    ITEM = "item.json"
    """The map as a STAC item."""
    MANIFEST = MANIFEST_NAME
    PROJECT = "map.qgs"
    REPORT = REPORT_NAME
    THUMBNAIL = "rasters/thumbnail.jpg"
    """A small picture of the map, for catalogues."""


EVERY_NAME: tuple[str, ...] = tuple(
    name for name in MapFile if name not in {MapFile.PROJECT, MapFile.REPORT, MapFile.THUMBNAIL}
)
"""The files that a run may write, in their order; its manifest lists them with their checksums."""
PRODUCT_NAMES = tuple(name for name in EVERY_NAME if name != MapFile.PHOTO)
"""Those that every run writes."""
EVERY_VIEW_NAME: tuple[str, ...] = (
    *(
        str(Path(name).with_suffix(".qml"))
        for name in MapFile
        if name.endswith((".tif", ".parquet")) and name != MapFile.PHOTO  # it has its own colours
    ),
    MapFile.PROJECT,
    MapFile.REPORT,
    MapFile.THUMBNAIL,
)
"""Files to look at the others with: styles, a project, a page. GIS programs rewrite them, so they have no checksum."""
_RETIRED = tuple(f"rasters/{name}.{suffix}" for name in ("headings", "speeds") for suffix in ("tif", "qml"))
"""Files of maps of earlier versions: a map that replaces one leaves none that is older than the others."""
EVERY_FILE = (*EVERY_NAME, *EVERY_VIEW_NAME, *_RETIRED)
"""The files that a map may have left in its folder, relative to it."""


def make_folder(folder: Path) -> None:
    """Create a folder if it is missing, and find out whether files can be written there.

    Half-written files of a killed run are removed; the caller holds the lock of the folder, so no other run is using
    it. Raises OutputError: the folder cannot be created or written.
    """
    require_folder(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / f".bumpymap-{uuid4().hex}"
        probe.touch()
        probe.unlink()
        for left in folder.glob(f"{STAGED}*"):  # of a run that was killed
            remove_path(left)
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. "
            "Choose one that can be written, with `out`"
        ) from error


def check_folder(folder: Path, *, overwrite: bool) -> None:
    """Check that the files of a map can be written to a folder, which is made by `make_folder`.

    A file that is a symbolic link will be replaced as a link; its target is not touched. ``overwrite``: allow files of
    any earlier run to be replaced. Raises OutputError: the folder cannot be created or written, holds files that must
    not be replaced, or a folder in it is a link.
    """
    make_folder(folder)
    for part in sorted({(folder / name).parent for name in MapFile} - {folder}):
        if lexists(part) and (part.is_symlink() or not part.is_dir()):
            raise OutputError(f"{part} is a link or no folder, and was not touched. Remove it, or choose another `out`")
    unfinished = "" if lexists(folder / MANIFEST_NAME) else " of a run that did not end"
    refuse_present(folder, EVERY_FILE, overwrite=overwrite, whose=unfinished)


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

        Raises UsageError: ``out`` holds the layers of a survey, or is named like a file; OutputError: there are files
        that must not be replaced, or ``out`` is a file.
        """
        if out.suffix.lower() in OTHER_FILES and not out.is_dir():
            raise UsageError(f"{out} is named like a {out.suffix.lower()} file. Give a folder as `out`")
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

        ``writers``: how each is written, by name; ``describe``: returns the content of the manifest, given the folder
        with the new files, and their sizes and checksums; it may write views there; ``overwrite``: allow files of an
        earlier run to be replaced. Returns files of the writers, then the manifest. Raises OutputError: there are files
        that must not be replaced, or one cannot be written.
        """
        with remove_empty_on_error(out), locked(out):
            make_folder(out)
            refuse_present(out, self.names, overwrite=overwrite)
            with write_together(out, self.manifest, self.names) as staged:
                for name, write in writers.items():
                    write(staged / name)
                files = [describe_file(staged / name) | {"path": name} for name in writers if name not in self.views]
                write_manifest(describe(staged, files), staged / self.manifest)
        return [out / name for name in (*writers, self.manifest)]


CHECK_MANIFEST_NAME = "check.json"
CHECK_FILES = OutputFolder(
    ("check.html", "check.geojson", CHECK_MANIFEST_NAME, "check.qml", MapFile.PROJECT),
    CHECK_MANIFEST_NAME,
    views=("check.qml", MapFile.PROJECT),
)


_REMEDY = "Choose another `out`, or pass `overwrite=True` to replace it"


def is_complete(folder: Path, manifest: str = MANIFEST_NAME) -> bool:
    """Return whether a folder holds a complete run: the manifest is the last file that a run writes."""
    return lexists(folder / manifest)


@contextmanager
def verified_record(
    folder: Path, files: Collection[str] | None, manifest: str = MANIFEST_NAME
) -> Iterator[dict[str, Any]]:
    """Read the manifest of a complete run and verify the checksums of its files.

    Errors of the body of the ``with`` that mean a key is missing or malformed become an OutputError too. ``files``:
    files that must exist; those that the manifest lists are checked in any case. None: no file is checked, since the
    manifest alone is in the folder. ``manifest``: name of the manifest. Raises OutputError: the manifest cannot be read
    as that of a run or does not list a file, or a file is missing or has changed.
    """
    record = read_record(folder / manifest)
    unreadable = f"{folder} already holds a {manifest} that cannot be read as that of a run. {_REMEDY}"
    if record is None:
        raise OutputError(unreadable)
    try:
        listed = {str(file["path"]): str(file["sha256"]) for file in record["files"]}
        for name in sorted({*files, *listed} if files is not None else ()):
            try:
                same = describe_file(folder / name)["sha256"] == listed.get(name)
            except BadInputError as error:
                raise OutputError(f"{folder} already holds a complete run, but {name} is missing. {_REMEDY}") from error
            if not same:
                raise OutputError(f"{folder} already holds a complete run, but {name} has changed since. {_REMEDY}")
        yield record
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise OutputError(unreadable) from error


def refuse_replacing(folder: Path, differences: Sequence[str]) -> None:
    """Raise OutputError if there are differences between the complete run in a folder and the requested one."""
    if differences:
        raise OutputError(
            f"{folder} already holds a complete run with other inputs or settings:",
            *(f"  {difference}" for difference in differences),
            _REMEDY,
        )
