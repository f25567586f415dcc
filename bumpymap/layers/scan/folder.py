"""The output folder of a scan run: check it before the run, remove stale files of an earlier run afterwards."""

import os
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from os.path import lexists
from pathlib import Path

import lazrs
import pyarrow as pa
from rasterio.errors import RasterioError

from bumpymap.core import OutputError, remove_path
from bumpymap.layers.products import EVERY_NAME, EVERY_VIEW_NAME, NAMED_RASTERS, check_folder
from bumpymap.layers.scan.names import FRAME_FILES, FRAME_FOLDER

__all__ = [
    "ACCUMULATED_NAME",
    "MAP_FOLDER",
    "SCAN_MANIFEST_NAME",
    "SECTOR_TABLE_NAME",
    "check_scan_folder",
    "output_errors",
    "remove_stale_products",
    "sync_to_disk",
]

SCAN_MANIFEST_NAME, SECTOR_TABLE_NAME, ACCUMULATED_NAME, MAP_FOLDER = (
    "scan.json",
    "sectors.parquet",
    "gathered.laz",
    "map",
)
_NAMES = (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, MAP_FOLDER, SCAN_MANIFEST_NAME)
_SYNCED_AT_A_TIME = 8
_SIDE = tuple(f"{name}.aux.xml" for name in NAMED_RASTERS)


def check_scan_folder(folder: Path, inputs: Iterable[Path] = (), *, overwrite: bool, unfinished: bool = False) -> None:
    """Check that the files of a scan run can be written to a folder; create the folder if it is missing.

    A file that is a symbolic link will be replaced as a link; its target is not touched.

    Parameters
    ----------
    folder : Path
        The output folder.
    inputs : iterable of Path
        Input files of this run, which must not be where the output goes.
    overwrite : bool
        Allow files of any earlier run to be replaced.
    unfinished : bool
        Allow files of the run that is being resumed to be replaced: it may have been killed after it moved them here.

    Raises
    ------
    OutputError
        The folder cannot be created or written, or holds files that must not be replaced: of an earlier run, inputs of
        this run, or files that no scan run wrote.
    """
    taken = (folder / FRAME_FOLDER).resolve()
    inside = next((path for path in inputs if taken in path.resolve().parents), None)
    if inside is not None:
        raise OutputError(f"{inside} is an input of this run, and the output would replace it. Choose another `out`")
    check_folder(folder, overwrite=True)
    present = [name for name in _NAMES if lexists(folder / name)]
    if present and not (overwrite or unfinished):
        raise OutputError(
            f"{folder} already holds {', '.join(present)}. Choose another `out`, or pass `overwrite=True` to replace "
            "them"
        )
    for name in present:
        is_link = (folder / name).is_symlink()
        if not is_link and (folder / name).is_dir() != (name in {FRAME_FOLDER, MAP_FOLDER}):
            raise OutputError(f"{folder / name} is not what a scan run writes. Choose another `out`")
    foreign = _foreign_file(folder, unfinished=unfinished)
    if foreign:
        raise OutputError(
            f"{foreign} was not written by a complete scan run and would be deleted by `overwrite=True`. Move it away, "
            "or choose another `out`"
        )


def remove_stale_products(folder: Path, kept: Sequence[str]) -> None:
    """Remove the files of an earlier run, except ``kept``, the names that this run has just written."""
    for name in _NAMES:
        if name in kept or not lexists(folder / name):
            continue
        if name == MAP_FOLDER and not (folder / name).is_symlink():
            for layer in (*EVERY_NAME, *EVERY_VIEW_NAME, *_SIDE):
                (folder / name / layer).unlink(missing_ok=True)
            with suppress(OSError):  # a folder with other files in it stays
                (folder / name).rmdir()
        else:
            remove_path(folder / name)


@contextmanager
def output_errors(folder: Path) -> Iterator[None]:
    """Convert errors of the libraries that write files into an OutputError."""
    try:
        yield
    except (OSError, lazrs.LazrsError, pa.ArrowException, RasterioError) as error:
        raise OutputError(
            f"cannot write to {folder}: {error}. Free some space, or choose another `out`; nothing half-written was "
            "left there"
        ) from error


def sync_to_disk(paths: Iterable[Path]) -> None:
    """Flush files to the disk (fsync), several at a time: the disk then writes them in an order of its own."""
    with ThreadPoolExecutor(_SYNCED_AT_A_TIME) as pool:
        for _ in pool.map(_sync, paths):
            pass


def _sync(path: Path) -> None:
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _foreign_file(folder: Path, *, unfinished: bool) -> Path | None:
    """Return a file in ``frames`` that no scan run wrote (``frames`` itself if there is no run here), or None."""
    frames = folder / FRAME_FOLDER
    if frames.is_symlink() or not frames.is_dir():
        return None
    if not (unfinished or (folder / SCAN_MANIFEST_NAME).exists()):
        return frames
    return next((path for path in sorted(frames.iterdir()) if path.suffix not in FRAME_FILES.values()), None)
