"""Where ``bumpytiles.native`` keeps machine code between runs.

Whoever can change a file of machine code decides what its reader runs. So a file counts only where nobody but the user
or root can have written it: both own it and its folder, nobody else may write to either, and neither is a link. All
else is as if it were not there, and nothing is kept where it would not count.
"""

import hashlib
import json
import logging
import os
import stat
from contextlib import suppress
from functools import cache
from pathlib import Path
from uuid import uuid4

from bumpytiles._compiler import Code, KernelSource, linkable, machine, versions

__all__ = ["Store"]

_log = logging.getLogger(__name__)


class Store:
    """Where the machine code of one kernel is kept: one file for each kind of processor, replaced when it is stale."""

    def __init__(self, source: KernelSource) -> None:
        processor = machine()
        parts = [*source.parts(), *_own_source(), versions(), processor, source.name.encode()]
        self._key = hashlib.sha256(b"\0".join(parts)).hexdigest()
        name = f"{source.file.stem}.{source.name}.{hashlib.sha256(processor).hexdigest()[:8]}.native"
        self._files = [folder / name for folder in _folders(source.file)]

    @property
    def can_keep(self) -> bool:
        """Whether there is a folder for it; where there is none, it is said once why."""
        faults = {str(file.parent): _fault(file.parent) for file in self._files}
        if None in faults.values():
            return True
        _say_once(", ".join(f"{folder} ({fault})" for folder, fault in faults.items()))
        return False

    def load(self) -> Code | None:
        """Return the machine code, None where there is none for this source, compiler and processor."""
        for file in self._files:
            with suppress(OSError, ValueError, KeyError):
                head, _, code = _read(file).partition(b"\n")
                record = json.loads(head)
                whole = record["digest"] == hashlib.sha256(code).hexdigest()
                if whole and record["key"] == self._key and linkable(record["outside"]):
                    return Code(record["symbol"], record["outside"], code)
        return None

    def save(self, code: Code) -> None:
        """Keep machine code in the first folder that will do; a file appears whole or not at all."""
        digest = hashlib.sha256(code.code).hexdigest()
        record = {"key": self._key, "digest": digest, "symbol": code.symbol, "outside": code.outside}
        for file in self._files:
            try:
                file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                _write(file, json.dumps(record).encode() + b"\n" + code.code)
            except OSError as error:
                _log.debug("cannot keep compiled kernels in %s: %s", file.parent, error)
            else:
                return


def _folders(source: Path) -> list[Path]:
    """Where to look, in this order: a container's user may have no home. Only on POSIX do files have owners."""
    if os.name != "posix":
        return []
    own = os.environ.get("NUMBA_CACHE_DIR")
    if own:
        return [Path(own)]
    folders = [source.parent / "__pycache__"]
    with suppress(RuntimeError):
        folders.append(Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "bumpytiles")
    return folders


def _fault(folder: Path) -> str | None:
    """Say why nothing can be kept in a folder; None where it can, though it may have to be made."""
    try:
        if os.path.lexists(folder):
            os.close(_open_folder(folder))
            return None if os.access(folder, os.W_OK) else "it cannot be written"
        above = next(parent for parent in folder.parents if parent.exists())
    except OSError as error:
        return error.strerror or str(error)
    return None if above.is_dir() and os.access(above, os.W_OK) else "it cannot be made"


def _open_folder(folder: Path) -> int:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    return _only_ours(descriptor)


def _only_ours(descriptor: int) -> int:
    """Close a descriptor and raise where others can have written what it stands for."""
    status = os.fstat(descriptor)
    if status.st_uid in {os.geteuid(), 0} and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return descriptor
    os.close(descriptor)
    raise PermissionError(0, "others can write to it")


def _read(file: Path) -> bytes:
    folder = _open_folder(file.parent)
    try:
        # Without O_NONBLOCK a named pipe would wait for its writer.
        descriptor = os.open(file.name, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK, dir_fd=folder)
    finally:
        os.close(folder)
    with open(_only_ours(descriptor), "rb") as data:
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            raise OSError(0, "it is not a file")
        return data.read()


def _write(file: Path, content: bytes) -> None:
    folder = _open_folder(file.parent)
    try:
        part = f".{file.name}.{uuid4().hex}"
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644, dir_fd=folder)
        try:
            with open(descriptor, "wb") as data:  # noqa: PTH123 (the same)
                data.write(content)
            os.replace(part, file.name, src_dir_fd=folder, dst_dir_fd=folder)
        except BaseException:
            os.unlink(part, dir_fd=folder)
            raise
    finally:
        os.close(folder)


_said: list[str] = []


def _say_once(where: str) -> None:
    if _said:
        return
    _said.append(where)
    _log.warning(
        "the numerical kernels are compiled in every run, which takes many seconds, because they cannot be cached%s. "
        "Set NUMBA_CACHE_DIR to a folder of your own that nobody else can write to",
        f": {where}" if where else "",
    )


@cache
def _own_source() -> list[bytes]:
    """Give the source of what makes machine code."""
    return [Path(__file__).with_name(name).read_bytes() for name in ("_compiler.py", "native.py")]
