"""The folder in which a run keeps what is finished, so that it can go on: ``.bumpymap-run`` beside its products.

A run that is killed leaves it; ``--resume`` goes on from there. Everything in it appears whole or not at all, so
whatever can be seen can be used. It is the user's own (mode 0700) and holds no links: nothing that is deleted or
written here lies elsewhere.
"""

import json
import os
import stat
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from enum import Enum, auto
from pathlib import Path
from typing import Any
from uuid import uuid4

from bumpymap.core.errors import BadInputError, OutputError, UsageError
from bumpymap.core.files import STAGED, atomic, remove_path
from bumpymap.core.json_text import parse_json
from bumpymap.core.run_spec import differences

__all__ = [
    "WORK_FOLDER",
    "Kept",
    "RunFolder",
    "check_interrupted",
    "clean_folder",
    "is_interrupted",
    "is_own_folder",
    "read_record",
    "refuse_other",
    "what_to_keep",
    "work_folder",
    "writing_to",
]

WORK_FOLDER = ".bumpymap-run"
"""In the folder of the products, while a run is under way or was broken off."""
_RUN_SPEC = "run_spec.json"


class Kept(Enum):
    """What stays of a run that ends early."""

    NOTHING = auto()
    """The same would happen again."""
    FINISHED = auto()
    """What is finished; what takes much room goes."""
    ALL = auto()
    """As after a kill."""


def work_folder(out: Path) -> Path:
    """Where a run with these products keeps its work."""
    return out / WORK_FOLDER


def is_interrupted(out: Path) -> bool:
    """Whether a run with these products was broken off (or is under way): it may go on, and replace what it may."""
    return not work_folder(out).is_symlink() and (work_folder(out) / _RUN_SPEC).exists()


def check_interrupted(out: Path, *, resume: bool, overwrite: bool) -> bool:
    """Say whether a run with these products was broken off; raises OutputError where nobody said what becomes of it."""
    if not is_interrupted(out):
        return False
    if resume or overwrite:
        return True
    raise OutputError(
        f"{out} holds an interrupted run. Pass `resume=True` to continue it, `overwrite=True` to start again, or "
        "choose another `out`"
    )


def what_to_keep(end: BaseException) -> Kept:
    """Say what stays of a run that ends with this.

    A bad input is as bad the next time, and one that was mended is another input: nothing is kept. One that could not
    be read because a disk or a server failed may be read the next time. A user who ends a run, and a full disk, want
    the room back. Anything else (a helper that was killed, workers that were lost, no memory) may be gone the next
    time.
    """
    if isinstance(end, BadInputError):
        return Kept.ALL if isinstance(end.__cause__, OSError) else Kept.NOTHING
    return Kept.FINISHED if isinstance(end, KeyboardInterrupt | OutputError | OSError) else Kept.ALL


@dataclass(frozen=True, slots=True)
class RunFolder:
    """Where a run keeps its work, and what it was asked."""

    path: Path
    run_spec: dict[str, Any]
    """``inputs``, ``settings``, ``made with``: what a run that goes on must have been asked too. Beside these what it
    takes over from the earlier one, such as ``cut``: how files are cut into pieces."""
    resumed: bool
    """Whether there is work of an earlier run."""

    @classmethod
    @contextmanager
    def opened(
        cls,
        out: Path,
        run_spec: Mapping[str, Any],
        *,
        resume: bool,
        finished: Callable[[Path], bool],
        advice: str,
        keep: Collection[str] = (),
        decide: Callable[[BaseException], Kept] = what_to_keep,
    ) -> Iterator["RunFolder"]:
        """Take up the work of an earlier run, or begin anew. The caller holds the lock of ``out``.

        The folder goes away where the body succeeds, and where it fails with nothing ``finished`` or nothing that
        ``decide`` would keep. Where it stays, the exception is given the ``advice`` as a note. Of an earlier run that
        does not go on, ``keep`` files alone stay.

        Raises
        ------
        UsageError
            The earlier run was asked something else.
        OutputError
            The place cannot be written, or is a link or somebody else's.
        """
        path = work_folder(out)
        with writing_to(path):
            _make_own(path)
            before = read_record(path / _RUN_SPEC) if resume else None
            if before is not None:
                refuse_other(before, run_spec, out)
            record = json.loads(json.dumps({**run_spec, **_taken_over(before)}))
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


def refuse_other(before: Mapping[str, Any], now: Mapping[str, Any], out: Path) -> None:
    """Raise UsageError where a run was asked something else than the one that wants to go on."""
    found = differences(before, json.loads(json.dumps(dict(now))))
    if found:
        raise UsageError(
            f"the run in {out} cannot be resumed, because it was started with other inputs or settings:",
            *(f"  {difference}" for difference in found),
            "Use the same inputs and settings, or pass `overwrite=True` instead of `resume=True` to start again",
        )


def read_record(path: Path) -> dict[str, Any] | None:
    """Read a JSON object; None where there is none, or a damaged one."""
    try:
        record = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def is_own_folder(path: Path, beside: Path) -> bool:
    """Whether this is a folder, no link, and of this user, or of whoever owns ``beside``: disks may map users."""
    found = path.lstat()
    return stat.S_ISDIR(found.st_mode) and found.st_uid in {os.geteuid(), beside.stat().st_uid}


def clean_folder(path: Path, *, everything: bool = False, keep: Collection[str] = ()) -> None:
    """Take away what is half-written in a folder, or everything, and every link. It is opened once, and no link."""
    place = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        for name in os.listdir(place):  # noqa: PTH208 (of the opened folder)
            if name.startswith(".") or (everything and name not in keep):
                remove_path(Path(name), place)
        for _, folders, names, folder in os.fwalk(dir_fd=place):
            for name in (*folders, *names):
                if stat.S_ISLNK(os.stat(name, dir_fd=folder, follow_symlinks=False).st_mode):
                    os.unlink(name, dir_fd=folder)
    finally:
        os.close(place)


def _taken_over(before: Mapping[str, Any] | None) -> dict[str, Any]:
    return {} if before is None else {k: v for k, v in before.items() if k not in {"inputs", "settings", "made with"}}


def _make_own(path: Path) -> None:
    with suppress(FileExistsError):
        path.mkdir(mode=0o700, parents=True)
    if not is_own_folder(path, path.parent):
        raise OutputError(
            f"{path} is a link, a file or belongs to another user, and was not touched: a run keeps its checkpoints "
            "there. Remove it, or choose another `out`"
        )
    path.chmod(0o700)


def _remove(path: Path) -> None:
    """Remove everything at one stroke: a kill leaves nothing that looks like a run to go on with.

    Folders of that name are cleared away by the next run with the same output.
    """
    gone = path.with_name(f"{STAGED}{uuid4().hex}")
    with suppress(OSError):
        path.rename(gone)
        remove_path(gone)


@contextmanager
def writing_to(folder: Path, options: str = "`out`") -> Iterator[None]:
    """Turn what goes wrong while a folder is written to into an OutputError; ``options`` name another one."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. Choose another with {options}"
        ) from error
