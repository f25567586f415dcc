"""A batch whose layers go to a server: made in a working folder of this machine, uploaded, and then removed there."""

import hashlib
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from os.path import lexists
from pathlib import Path

from bumpymap.core import OutputError, atomic, is_own_folder, writing_to
from bumpymap.layers import BATCH_LOG, BATCH_NAMES, RemoteFolder, check_batch_out

__all__ = ["INDEX_NAME", "check_remote_out", "fetch_log", "naming_remote", "upload_summary", "working_folder"]

INDEX_NAME = "index.html"
"""The last file of a batch that is uploaded."""
_SUMMARY = "summary.csv"
_MAP = "run.json"


def working_folder(url: str, scratch: Path | None) -> Path:
    """Return the folder for the layers of a URL until they are uploaded: the same for every start of a batch."""
    digest = hashlib.sha256(url.rstrip("/").encode("utf-8", "surrogateescape")).hexdigest()[:16]
    return Path(scratch or tempfile.gettempdir()) / f"bumpymap-batch-{digest}"


def check_remote_out(remote: RemoteFolder, folder: Path) -> None:
    """Make the working folder, and check that no files but those of a batch are where its own would be uploaded.

    Raises
    ------
    OutputError
        There are; or the server or the working folder cannot be used.
    """
    with writing_to(folder, "`scratch`"):
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not is_own_folder(folder, folder.parent):
            raise OutputError(
                f"{folder} is a link or belongs to another user, and was not touched: layers are made there before "
                "they are uploaded. Remove it, or choose another `scratch`"
            )
    present = remote.sizes()
    with tempfile.TemporaryDirectory() as name, naming_remote(remote, Path(name)):
        copy = Path(name)
        for known in {*BATCH_NAMES, _MAP} & set(present):
            data = remote.read(known) if known in {BATCH_LOG, _SUMMARY} else b""
            (copy / known).write_bytes(data or b"")
        check_batch_out(copy)


def fetch_log(remote: RemoteFolder, folder: Path) -> None:
    """Download the log of earlier starts, unless one that was interrupted has left it here."""
    log = folder / BATCH_LOG
    if not lexists(log) and (data := remote.read(BATCH_LOG)) is not None:
        with atomic(log) as temporary:
            temporary.write_bytes(data)


def upload_summary(remote: RemoteFolder, folder: Path) -> None:
    """Upload the summary, the page and the log, and remove them here.

    Raises
    ------
    OutputError
        The server cannot be used; the files stay here.
    """
    try:
        remote.upload(folder, INDEX_NAME)
    except OutputError as error:
        raise OutputError(f"{error}. The summary is in {folder}; the next start uploads it") from error
    for name in BATCH_NAMES:
        with suppress(FileNotFoundError):
            (folder / name).unlink()


@contextmanager
def naming_remote(remote: RemoteFolder, folder: Path) -> Iterator[None]:
    """Name the URL instead of a folder of this machine in the message of an error of the body."""
    try:
        yield
    except OutputError as error:
        raise OutputError(str(error).replace(str(folder), remote.url)) from error
