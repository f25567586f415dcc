"""Which files of an earlier run may be replaced in a folder. Nothing here needs GDAL."""

from collections.abc import Sequence
from os.path import lexists
from pathlib import Path

from bumpymap.core import OutputError

__all__ = ["refuse_blocked", "refuse_present", "require_folder"]


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
