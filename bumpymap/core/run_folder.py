"""The run spec, the folder for the checkpoints of a run, ``.bumpymap-run`` in the output folder, and the lock on that.

The run spec is what a run depends on: inputs with their checksums, settings, and versions and ids of what it computes
with. BLAKE3 takes a quarter of the time of SHA-256, even on a processor with SHA instructions (measured).

A run that is killed leaves it behind, and the same command continues from it. Its files are written atomically, so
every file in it is complete. It belongs to the user (mode 0700) and holds no symbolic links, so that nothing outside of
it is written or deleted. The lock allows one run at a time in a folder and records who holds it; it follows no links.
"""

import errno
import fcntl
import hashlib
import json
import os
import shlex
import socket
import stat
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime
from enum import Enum, auto
from pathlib import Path
from typing import Any
from uuid import uuid4

from blake3 import blake3

from bumpymap.core.errors import BadInputError, OutputError, UsageError
from bumpymap.core.files import (
    STAGED,
    Each,
    Number,
    atomic,
    parse_json,
    plain_json,
    read_regular,
    remove_path,
    shape_fault,
    writing_to,
)

CHECKSUM_METHOD = "blake3"
"""Stands before the digest in a checksum: ``blake3:12ab...``."""
_SET_METHOD = "blake3-set"
"""Stands before the digest in a checksum of several files."""


def file_checksum(path: Path) -> str:
    """Return the checksum of a file: its BLAKE3, as ``b3sum`` prints it, after ``blake3:``."""
    with path.open("rb", buffering=0) as file:
        return f"{CHECKSUM_METHOD}:{hashlib.file_digest(file, blake3).hexdigest()}"  # type: ignore[arg-type]


def join_checksums(checksums: Iterable[str]) -> str:
    """Return one checksum for a set of files: the BLAKE3 of their checksums, sorted, one a line."""
    lines = "".join(f"{checksum}\n" for checksum in sorted(checksums))
    return f"{_SET_METHOD}:{blake3(lines.encode()).hexdigest()}"


_OF_THE_MACHINE = {"out", "threads", "memory", "scratch", "scheduler", "overwrite", "page"}
"""Settings that say where and how a run is carried out, or the header of its page: no layer depends on them, and no
manifest repeats them."""

_MOST_LISTED = 8
"""Differences that a message lists at most."""
_LONGEST_VALUE = 80
"""Characters of a value that a message shows at most."""
_FROM = {"calibration": ("vehicle", "calibration"), "model": ("model",), "method": ("method", "model")}
"""Settings that select something with an id of its own: they count as different only if the id differs."""


def flat_settings(config: Any, without: Collection[str]) -> dict[str, Any]:
    """Return the settings of a dataclass as JSON values; those of a nested table are named ``table.name``.

    ``without``: settings to leave out, because they do not change the results, beside those of the machine.
    """
    found = config if isinstance(config, Mapping) else asdict(config)
    return {
        name: value
        for key, item in found.items()
        if key not in without and key not in _OF_THE_MACHINE
        for name, value in (
            ((f"{key}.{inner}", plain_json(own)) for inner, own in item.items())
            if isinstance(item, Mapping)
            else ((key, plain_json(item)),)
        )
    }


def recorded_settings(config: Any) -> dict[str, Any]:
    """Return the settings of a dataclass that a manifest holds, which are those of every machine."""
    return {name: value for name, value in asdict(config).items() if name not in _OF_THE_MACHINE}


def differences(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None = None,
) -> list[str]:
    """Describe the differences between two run specs, one phrase each.

    ``before`` and ``now``: ``inputs``: path -> identity of the file; ``settings``; ``made with``: name -> version or
    id. ``same``: called with path, old and new identity of an input, returns whether it is the same file. None: compare
    the two identities.
    """
    made = [{**record.get("made with", {})} for record in (before, now)]
    settings = [{**record.get("settings", {})} for record in (before, now)]
    for name, sources in _FROM.items():
        if made[0].get(name) == made[1].get(name):
            for own in settings:
                for source in sources:
                    own.pop(source, None)
        elif any(settings[0].get(source) != settings[1].get(source) for source in sources):
            for own in made:
                own.pop(name, None)
    found = _inputs(before.get("inputs", {}), now.get("inputs", {}), same)
    for old, new in (settings, made):
        found += [
            f"{name} was {_value_text(old.get(name))}, is {_value_text(new.get(name))}"
            for name in dict.fromkeys([*old, *new])
            if old.get(name) != new.get(name)
        ]
    return found if len(found) <= _MOST_LISTED else [*found[:_MOST_LISTED], f"and {len(found) - _MOST_LISTED} more"]


def same_content(path: str, known: Mapping[str, Any], here: Mapping[str, Any], hashed: Callable[[Path], str]) -> bool:
    """Return whether an input file is unchanged: by size and time, or by its checksum if the time differs.

    ``path``: of the file; ``known``: ``bytes``, ``checksum`` (see `file_checksum`; or ``sha256`` of all bytes) and, if
    it was recorded, ``mtime_ns``; ``here``: from `bumpymap.readers.identity`; ``hashed``: returns the checksum of an
    input, such as `bumpymap.readers.hash_survey`.
    """
    if known.get("bytes") is not None and known["bytes"] != here["size"]:
        return False
    if known.get("mtime_ns") and known["mtime_ns"] == here.get("mtime_ns"):
        return True
    checksum, sha256 = known.get("checksum"), known.get("sha256")
    if checksum is not None:
        return bool(str(checksum).startswith(f"{CHECKSUM_METHOD}:") and hashed(Path(path)) == checksum)
    if sha256 is None:
        return False
    with Path(path).open("rb") as file:
        return bool(hashlib.file_digest(file, "sha256").hexdigest() == sha256)


def spec_of_manifest(
    record: Mapping[str, Any], without: Collection[str], made_with: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the run spec of a complete run, from its run.json or scan.json.

    ``without``: settings to leave out, because they do not change the results; ``made_with``: ids of models and
    calibrations, in addition to the versions.
    """
    return {
        "inputs": {str(file["path"]): file for file in (*record["inputs"], *record.get("skipped_inputs", ()))},
        "settings": flat_settings(record["settings"], without),
        "made with": {**record["versions"], **made_with},
    }


def _inputs(
    before: Mapping[str, Any],
    now: Mapping[str, Any],
    same: Callable[[str, Mapping[str, Any], Mapping[str, Any]], bool] | None,
) -> list[str]:
    found = []
    for path in dict.fromkeys([*before, *now]):
        if path not in now:
            found.append(f"{path} was an input, but is not given now")
        elif path not in before:
            found.append(f"{path} is given now, but was not an input")
        elif before[path] is None or now[path] is None or same is None:
            found += [f"{path} has changed since"] * (before[path] != now[path])
        elif not same(path, before[path], now[path]):
            found.append(f"{path} has changed since")
    return found


def _value_text(value: Any) -> str:
    if value is None:
        return "not given"
    if isinstance(value, bool):
        return str(value).lower()
    text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 3]}..."


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


_works_for: Mapping[str, Any] = {}
"""The process that this one works for; empty: none."""


def lock_holder() -> Mapping[str, Any]:
    """Return ``pid`` and ``command`` of the process that a user started: of this one, or of that it works for."""
    words = [Path(sys.argv[0]).name, *sys.argv[1:]] if sys.argv else []
    return _works_for or {"pid": os.getpid(), "command": shlex.join(words)}


def lock_for(holder: Mapping[str, Any]) -> None:
    """Take the locks of this process in the name of a `lock_holder` that it works for; empty: in its own."""
    global _works_for  # noqa: PLW0603 (one for each process)
    _works_for = holder


@contextmanager
def locked(folder: Path, name: str = LOCK) -> Iterator[None]:
    """Create the folder if it is missing, and hold its lock during the body. Does not wait for the lock.

    The operating system releases the lock when its holder ends, even if it is killed. On a file system without locks
    the file itself is the lock, and stays behind if its holder is killed. ``folder``: may be a link to a folder, as the
    user chose it; ``name``: name of the lock file, which is removed at the end. Raises OutputError: another run holds
    the lock, or the folder cannot be written.
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
            with writing_to(folder):
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                except FileExistsError as error:
                    raise OutputError(
                        f"cannot write to the folder {folder}: it is a file. Choose another `out`"
                    ) from error
                place = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
            opened.callback(os.close, place)
            descriptor, created = _open_lock(place, name, folder)
            if descriptor is None:
                continue
            opened.callback(os.close, descriptor)
            _lock(descriptor, folder / name, created=created)
            if _is_current(folder, place) and _is_current(name, descriptor, place):
                since = datetime.now().astimezone().isoformat(sep=" ", timespec="seconds")
                holder = {**lock_holder(), "host": socket.gethostname(), "since": since}
                with suppress(OSError):  # disk full: writing the results will report it
                    os.ftruncate(descriptor, 0)
                    os.pwrite(descriptor, json.dumps(holder).encode()[:_MOST_BYTES], 0)
                opened.pop_all()
                return place, descriptor
    raise OutputError(f"cannot lock the folder {folder}: other runs keep removing it. Choose another `out`")


def _open_lock(place: int, name: str, folder: Path) -> tuple[int | None, bool]:
    """Open or create the lock file; return its descriptor (None if it was removed meanwhile) and whether it is new."""
    flags = os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK
    with writing_to(folder), suppress(FileExistsError):
        try:
            return os.open(name, flags | os.O_CREAT | os.O_EXCL, 0o600, dir_fd=place), True
        except FileNotFoundError:  # the folder is gone too
            return None, False
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


def _held(descriptor: int, path: Path) -> str:
    try:
        holder: dict[str, Any] = parse_json(os.pread(descriptor, _MOST_BYTES, 0).decode())
        command = str(holder["command"])
        command = command if len(command) <= _LONGEST else f"{command[:_LONGEST]}..."
        who = f": pid {holder['pid']} on {holder['host']} since {holder['since']}: {command}"
    except (OSError, ValueError, KeyError, TypeError):  # the holder has not written its record yet
        who = ""
    return f"another run is writing to {path.parent}{who}. Wait until it has ended, or choose another `out`"


def _no_lock(path: Path) -> OutputError:
    return OutputError(
        f"{path} is not a lock file but a link or something else, and was not touched. Remove it, or choose another "
        "`out`"
    )


WORK_FOLDER = ".bumpymap-run"
"""Exists in the output folder while a run is under way, or after it was interrupted."""
_RUN_SPEC = "run_spec.json"
_COMPARED = {"inputs", "settings", "made with"}
"""Entries of a run spec that must be the same in a resumed run."""
_SPEC_SHAPE = {
    "inputs": Each(Each()),
    "settings": Each(),
    "made with": Each(),
    "cut?": {"chunk_points?": Number(1, 1e15, whole=True)},
}


class Kept(Enum):
    """Checkpoints that stay after a run that ends early."""

    NOTHING = auto()
    """None: a second attempt would fail in the same way."""
    FINISHED = auto()
    """Finished tiles; large scratch files are removed."""
    ALL = auto()
    """Everything, as after a kill."""


def work_folder(out: Path) -> Path:
    """Return the folder for the checkpoints of a run that writes to ``out``."""
    return out / WORK_FOLDER


def is_interrupted(out: Path) -> bool:
    """Return whether ``out`` holds an interrupted run, or one that is under way."""
    return not work_folder(out).is_symlink() and (work_folder(out) / _RUN_SPEC).exists()


def what_to_keep(end: BaseException) -> Kept:
    """Return which checkpoints to keep after a run that ended with this exception.

    A damaged input file will fail again, and a repaired one is a different input: nothing is kept. An input that could
    not be read because a disk or a server failed may be readable the next time: all is kept. If the user stopped the
    run, or the disk is full, large scratch files are removed. After any other error (a child process was killed,
    workers were lost, memory ran out) all is kept, since the next attempt may succeed.
    """
    if isinstance(end, BadInputError):
        return Kept.ALL if isinstance(end.__cause__, OSError) else Kept.NOTHING
    return Kept.FINISHED if isinstance(end, KeyboardInterrupt | OutputError | OSError) else Kept.ALL


@dataclass(frozen=True, slots=True)
class RunFolder:
    """The checkpoint folder of a run, with the run's inputs and settings."""

    path: Path
    run_spec: dict[str, Any]
    """``inputs``, ``settings`` and ``made with`` (versions, model ids), which must be the same in a resumed run. Other
    entries, such as ``cut`` (how files are split into chunks), are taken over from the interrupted run."""
    resumed: bool
    """True: checkpoints of an interrupted run are used."""

    @classmethod
    @contextmanager
    def opened(
        cls,
        out: Path,
        run_spec: Mapping[str, Any],
        *,
        overwrite: bool,
        finished: Callable[[Path], bool],
        advice: str,
        keep: Collection[str] = (),
        decide: Callable[[BaseException], Kept] = what_to_keep,
    ) -> Iterator["RunFolder"]:
        """Continue an interrupted run, or begin a new one in a new folder. The caller holds the lock of ``out``.

        The folder is removed if the body succeeds. If the body fails, it is removed if there is nothing ``finished`` or
        ``decide`` returns ``Kept.NOTHING``; otherwise ``advice`` is added to the exception as a note. ``out``: output
        folder of the run; ``run_spec``: inputs and settings of the run; see `RunFolder.run_spec`; ``overwrite``:
        whether to discard an interrupted run that had other inputs or settings; ``finished``: return whether the folder
        holds finished work; ``advice``: what the user can do with the checkpoints; ``keep``: names of files that stay
        when a new run replaces an interrupted one; ``decide``: return which checkpoints to keep after an exception.
        Raises UsageError: the interrupted run had other inputs or settings; OutputError: the folder cannot be written,
        is a link, or belongs to another user.
        """
        path = work_folder(out)
        with writing_to(path):
            with suppress(FileExistsError):
                path.mkdir(mode=0o700, parents=True)
            if not is_own_folder(path, path.parent):
                raise OutputError(
                    f"{path} is a link, a file or belongs to another user, and was not touched: a run keeps its "
                    "checkpoints there. Remove it, or choose another `out`"
                )
            path.chmod(0o700)
            before = read_record(path / _RUN_SPEC)
            if shape_fault(before, _SPEC_SHAPE):
                before = None  # damaged, as one that cannot be parsed: what is there cannot be trusted
            if before is not None and (found := differences(before, json.loads(json.dumps(dict(run_spec))))):
                if not overwrite:
                    raise UsageError(
                        f"{out} holds an interrupted run that was started with other inputs or settings:",
                        *(f"  {difference}" for difference in found),
                        "Use the same to continue it, choose another `out`, or pass `overwrite=True` to discard it",
                    )
                before = None
            more = {name: value for name, value in (before or {}).items() if name not in _COMPARED}
            record = json.loads(json.dumps({**run_spec, **more}))
            clean_folder(path, everything=before is None, keep=keep)
            if before is None:
                with atomic(path / _RUN_SPEC) as temporary:
                    temporary.write_text(json.dumps(record), encoding="utf-8")
        try:
            yield cls(path, record, before is not None)
        except BaseException as end:
            if decide(end) is not Kept.NOTHING and finished(path):
                end.add_note(advice)
            else:
                _remove(path)
            raise
        _remove(path)


def read_record(path: Path) -> dict[str, Any] | None:
    """Read a JSON object from a file; return None if the file is missing or damaged."""
    try:
        record = parse_json(read_regular(path).decode())
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def is_own_folder(path: Path, beside: Path) -> bool:
    """Return whether this is a folder, not a link, of this user or (if users are mapped) of the owner of ``beside``."""
    found = path.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid in {os.geteuid(), beside.stat().st_uid}


def clean_folder(path: Path, *, everything: bool = False, keep: Collection[str] = ()) -> None:
    """Remove partly written files and all symbolic links from a folder, or everything but the names in ``keep``.

    The folder is opened once, by descriptor, and refused if it is a link itself.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        for name in os.listdir(descriptor):  # noqa: PTH208 (takes a descriptor)
            if name.startswith(".") or (everything and name not in keep):
                remove_path(Path(name), descriptor)
        for _, folders, names, folder in os.fwalk(dir_fd=descriptor):
            for name in (*folders, *names):
                if stat.S_ISLNK(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
                    os.unlink(name, dir_fd=folder)
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    """Rename the folder, then delete it: a run that is killed meanwhile leaves nothing that could be resumed.

    The next run with the same output folder deletes what is left of the renamed folder.
    """
    renamed = path.with_name(f"{STAGED}{uuid4().hex}")
    with suppress(OSError):
        path.rename(renamed)
        remove_path(renamed)
