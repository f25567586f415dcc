"""A lock file that allows one run at a time in a folder and records who holds it. Links are not followed."""

import errno
import fcntl
import json
import os
import shlex
import socket
import stat
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from bumpymap.core.errors import OutputError
from bumpymap.core.json_text import parse_json

__all__ = ["LOCK", "Holder", "lock_for", "locked"]

LOCK = ".bumpymap-lock"
"""Name of the lock file, which exists while a run writes to the folder."""
_TRIES = 1000
"""Attempts: a run that is just ending may remove its lock file and the folder while this one opens them."""
_MOST_BYTES = 4096
"""Bytes of a lock file that are read at most."""
_LONGEST = 200
"""Characters of a command that a message shows at most."""
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
"""Errors of file systems that do not support locks."""


@dataclass(frozen=True, slots=True)
class Holder:
    """The process that a user started."""

    pid: int
    command: str

    @classmethod
    def here(cls) -> "Holder":
        """Return this process, or the one that it works for."""
        words = [Path(sys.argv[0]).name, *sys.argv[1:]] if sys.argv else []
        return _works_for or cls(os.getpid(), shlex.join(words))


_works_for: Holder | None = None


def lock_for(holder: Holder | None) -> None:
    """Take the locks of this process in the name of the one that it works for; None: in its own."""
    global _works_for  # noqa: PLW0603 (one for each process)
    _works_for = holder


@contextmanager
def locked(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Create the folder if it is missing, and hold its lock during the body. Does not wait for the lock.

    The operating system releases the lock when its holder ends, even if it is killed. On a file system without locks
    the file itself is the lock, and stays behind if its holder is killed.

    Parameters
    ----------
    folder : Path
        May be a link to a folder, as the user chose it.
    name : str
        Name of the lock file, which is removed at the end.

    Raises
    ------
    OutputError
        Another run holds the lock, or the folder cannot be written.
    """
    place, descriptor = _acquire(folder, name)
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            os.unlink(name, dir_fd=place)  # before releasing the lock: `_is_current` then sees it
        os.close(descriptor)
        os.close(place)


def _acquire(folder: Path, name: str) -> tuple[int, int]:
    """Open the folder and its lock file, lock the file, and return both descriptors."""
    for _ in range(_TRIES):
        with ExitStack() as opened:
            place = _open_folder(folder)
            opened.callback(os.close, place)
            descriptor, created = _open_lock(place, name, folder)
            if descriptor is None:
                continue
            opened.callback(os.close, descriptor)
            _lock(descriptor, folder / name, created=created)
            if _is_current(folder, place) and _is_current(name, descriptor, place):
                _note_holder(descriptor)
                opened.pop_all()
                return place, descriptor
    raise OutputError(f"cannot lock the folder {folder}: other runs keep removing it. Choose another `out`")


def _open_folder(folder: Path) -> int:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileExistsError as error:
        raise OutputError(f"cannot write to the folder {folder}: it is a file. Choose another `out`") from error
    except OSError as error:
        raise _no_folder(folder, error) from error


def _open_lock(place: int, name: str, folder: Path) -> tuple[int | None, bool]:
    """Open or create the lock file; return its descriptor (None if it was removed meanwhile) and whether it is new."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        return os.open(name, flags | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=place), True
    except FileExistsError:
        pass
    except FileNotFoundError:  # the folder is gone too
        return None, False
    except OSError as error:
        raise _no_folder(folder, error) from error
    try:
        descriptor = os.open(name, flags, dir_fd=place)
    except FileNotFoundError:
        return None, False
    except PermissionError as error:
        raise OutputError(
            f"{folder / name} belongs to another user: a run of theirs writes there, or was killed. Choose another "
            "`out`, or ask them to remove the file"
        ) from error
    except OSError as error:
        raise _no_lock(folder / name) from error
    found = os.fstat(descriptor)
    if stat.S_ISREG(found.st_mode) and found.st_nlink <= 1:
        return descriptor, False
    os.close(descriptor)
    raise _no_lock(folder / name)


def _lock(descriptor: int, path: Path, *, created: bool) -> None:
    """Lock the file; raise OutputError if another run holds the lock."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise OutputError(_held(descriptor, path)) from None
        if not created:
            more = f". If it has ended, remove {path}: this file system does not support locks"
            raise OutputError(_held(descriptor, path) + more) from None


def _is_current(name: Path | str, descriptor: int, place: int | None = None) -> bool:
    """Return whether the name still refers to the open file: a run that ended may have removed it."""
    try:
        found = os.stat(name, dir_fd=place, follow_symlinks=place is None)
    except OSError:
        return False
    return os.path.samestat(found, os.fstat(descriptor))


def _note_holder(descriptor: int) -> None:
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    holder = {**asdict(Holder.here()), "host": socket.gethostname(), "since": since}
    with suppress(OSError):  # disk full: writing the results will report it
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(holder).encode()[:_MOST_BYTES], 0)


def _held(descriptor: int, path: Path) -> str:
    try:
        holder: dict[str, Any] = parse_json(os.pread(descriptor, _MOST_BYTES, 0).decode())
        command = str(holder["command"])
        command = command if len(command) <= _LONGEST else f"{command[:_LONGEST]}..."
        who = f": pid {holder['pid']} on {holder['host']} since {holder['since']}: {command}"
    except (OSError, ValueError, KeyError, TypeError):  # the holder has not written its record yet
        who = ""
    return f"another run is writing to {path.parent}{who}. Wait until it has ended, or choose another `out`"


def _no_folder(folder: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write to the folder {folder}: {error.strerror or error}. Choose one that can be written, with `out`"
    )


def _no_lock(path: Path) -> OutputError:
    return OutputError(
        f"{path} is not a lock file but a link or something else, and was not touched. Remove it, or choose another "
        "`out`"
    )
