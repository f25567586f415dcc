"""The folder of a scan run: checked before the long work; what an earlier run left and this one does not write goes."""

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from os.path import lexists
from pathlib import Path

import lazrs
import pyarrow as pa
from rasterio.errors import RasterioError

from bumpymap.core import OutputError, remove_path
from bumpymap.layers.folder import PRODUCT_NAMES, check_folder
from bumpymap.layers.scan.names import FRAME_FILES, FRAME_FOLDER

__all__ = ["GATHERED", "MANIFEST", "MAP_FOLDER", "TABLE", "check_scan_folder", "drop_older", "sync", "writing"]

MANIFEST, TABLE, GATHERED, MAP_FOLDER = "scan.json", "sectors.parquet", "gathered.laz", "map"
_NAMES = (FRAME_FOLDER, TABLE, GATHERED, MAP_FOLDER, MANIFEST)
_SIDE = ("class.tif.aux.xml",)


def check_scan_folder(folder: Path, inputs: Iterable[Path] = (), *, overwrite: bool, unfinished: bool = False) -> None:
    """Make sure that the products of a scan run can be written to a folder; create it where it is missing.

    With ``unfinished``, products of the run that goes on there may be replaced: it was killed between moving them to
    their places and clearing up. A product that is a link is replaced itself, what it points to stays.

    Raises
    ------
    OutputError
        It cannot be created or written, or it holds products that may not be replaced, or ``inputs`` of this run or
        files of somebody else where products would go.
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
    strange = _strange(folder, unfinished=unfinished)
    if strange:
        raise OutputError(
            f"{strange} was not written by a complete scan run and would be deleted by `overwrite=True`. Move it away, "
            "or choose another `out`"
        )


def drop_older(folder: Path, kept: Sequence[str]) -> None:
    """Take away the products of an earlier run that this one, which wrote ``kept``, did not replace."""
    for name in _NAMES:
        if name in kept or not lexists(folder / name):
            continue
        if name == MAP_FOLDER and not (folder / name).is_symlink():
            for layer in (*PRODUCT_NAMES, *_SIDE):
                (folder / name / layer).unlink(missing_ok=True)
            with suppress(OSError):  # it stays where it holds anything else
                (folder / name).rmdir()
        else:
            remove_path(folder / name)


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Turn what goes wrong while products are written into an OutputError."""
    try:
        yield
    except (OSError, lazrs.LazrsError, pa.ArrowException, RasterioError) as error:
        raise OutputError(
            f"cannot write to {folder}: {error}. Free some space, or choose another `out`; nothing half-written was "
            "left there"
        ) from error


def sync(path: Path) -> None:
    """Make sure that a file is on the disk."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _strange(folder: Path, *, unfinished: bool) -> Path | None:
    """Return a file among the frames that no run wrote; their folder itself where no run ended here."""
    frames = folder / FRAME_FOLDER
    if frames.is_symlink() or not frames.is_dir():
        return None
    if not (unfinished or (folder / MANIFEST).exists()):
        return frames
    return next((path for path in sorted(frames.iterdir()) if path.suffix not in FRAME_FILES.values()), None)
