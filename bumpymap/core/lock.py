"""One run at a time in a folder: a lock file that says who holds it. No link is followed."""

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
from datetime import datetime
from pathlib import Path
from typing import Any

from bumpymap.core.errors import OutputError
from bumpymap.core.json_text import parse_json

__all__ = ["LOCK", "locked"]

LOCK = ".bumpymap-lock"
"""In a folder, while a run writes there."""
_TRIES = 1000
"""So often a run that ends at this moment may take its lock, and the folder it made, away from under this one."""
_NOTED = 4096
"""Bytes of a lock file that are read."""
_LONGEST = 200
"""Characters of a command that a message shows."""
_NO_LOCKS = {errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.ENOTSUP, errno.EINVAL}
"""What a disk says that knows no locks."""


@contextmanager
def locked(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Make a folder where it is missing, and hold its lock in the body. Nobody is waited for.

    The system gives the lock back when its holder ends, in whatever way. On a disk without locks the file itself is
    the lock, and stays where its holder is killed.

    Parameters
    ----------
    folder : Path
        May be a link to a folder: that is the user's choice.
    name : str
        Of the lock file, which goes away at the end.

    Raises
    ------
    OutputError
        Another run holds the lock, or the folder cannot be written.
    """
    place, descriptor = _taken(folder, name)
    try:
        yield
    finally:
        with suppress(OSError):  # the folder may be gone
            os.unlink(name, dir_fd=place)  # before the lock is given back: whoever has it finds out
        os.close(descriptor)
        os.close(place)


def _taken(folder: Path, name: str) -> tuple[int, int]:
    """Open the folder and its lock file, and lock that; both descriptors."""
    for _ in range(_TRIES):
        with ExitStack() as opened:
            place = _opened_folder(folder)
            opened.callback(os.close, place)
            descriptor, fresh = _opened_lock(place, name, folder)
            if descriptor is None:
                continue
            opened.callback(os.close, descriptor)
            _lock(descriptor, folder / name, fresh=fresh)
            if _is_there(folder, place) and _is_there(name, descriptor, place):
                _note_holder(descriptor)
                opened.pop_all()
                return place, descriptor
    raise OutputError(f"cannot lock the folder {folder}: it comes and goes. Choose another `out`")


def _opened_folder(folder: Path) -> int:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        return os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except FileExistsError as error:
        raise OutputError(f"cannot write to the folder {folder}: it is a file. Choose another `out`") from error
    except OSError as error:
        raise _no_folder(folder, error) from error


def _opened_lock(place: int, name: str, folder: Path) -> tuple[int | None, bool]:
    """Open the lock file; None where it went away meanwhile. And whether it was made here."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
    try:
        return os.open(name, flags | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=place), True
    except FileExistsError:
        pass
    except FileNotFoundError:  # so is the folder
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
            "`out`, or have them take the file away"
        ) from error
    except OSError as error:
        raise _no_lock(folder / name) from error
    found = os.fstat(descriptor)
    if stat.S_ISREG(found.st_mode) and found.st_nlink <= 1:
        return descriptor, False
    os.close(descriptor)
    raise _no_lock(folder / name)


def _lock(descriptor: int, path: Path, *, fresh: bool) -> None:
    """Lock the file; raises OutputError where another run has."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno not in _NO_LOCKS:
            raise OutputError(_held(descriptor, path)) from None
        if not fresh:
            more = f". If it has ended, take {path} away: this disk knows no locks"
            raise OutputError(_held(descriptor, path) + more) from None


def _is_there(name: Path | str, descriptor: int, place: int | None = None) -> bool:
    """Whether this name is still that of the opened file: a run that ended may have taken it away."""
    try:
        found = os.stat(name, dir_fd=place, follow_symlinks=place is None)
    except OSError:
        return False
    return os.path.samestat(found, os.fstat(descriptor))


def _note_holder(descriptor: int) -> None:
    words = [Path(sys.argv[0]).name, *sys.argv[1:]] if sys.argv else []
    since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": since, "command": shlex.join(words)}
    with suppress(OSError):  # the disk is full: what matters will say so
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, json.dumps(holder).encode()[:_NOTED], 0)


def _held(descriptor: int, path: Path) -> str:
    try:
        holder: dict[str, Any] = parse_json(os.pread(descriptor, _NOTED, 0).decode())
        command = str(holder["command"])
        command = command if len(command) <= _LONGEST else f"{command[:_LONGEST]}..."
        who = f": pid {holder['pid']} on {holder['host']} since {holder['since']}: {command}"
    except (OSError, ValueError, KeyError, TypeError):  # it took the lock this moment
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
