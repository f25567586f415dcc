"""The folder in which a run keeps what it has done so far: finished tiles, points that wait, what it was asked.

It lies in the folder of the products. A run that is killed leaves it; ``--resume`` goes on from there. Everything in it
appears whole or not at all, so whatever can be seen can be used.
"""

import hashlib
import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4

try:
    import fcntl
except ImportError:  # not on Windows
    fcntl = None  # type: ignore[assignment]

from bumpymap.atomic import STAGED, atomic
from bumpymap.errors import OutputError, UsageError
from bumpymap.json_text import parse_json
from bumpytiles import Pack, PackError

__all__ = ["WORK_FOLDER", "Workspace", "broken_off", "work_folder"]

WORK_FOLDER = ".bumpymap-run"
"""In the folder of the products, while a run is under way or was broken off."""
_ASKED, _READ, _SCRATCH, _LOCK = "asked.json", "read.json", "scratch.json", "lock"
_POINTS = "points"


def work_folder(out: Path) -> Path:
    """Where a run with these products keeps its work."""
    return out / WORK_FOLDER


def broken_off(out: Path) -> bool:
    """Whether a run with these products was broken off (or is under way): it may go on, and replace what it may."""
    return (work_folder(out) / _ASKED).exists()


@dataclass(frozen=True, slots=True)
class Workspace:
    """Paths and records of one run."""

    folder: Path
    scratch: Path
    """Points that wait; may lie on another disk."""
    asked: dict[str, Any]
    """What the run was asked: groups of names and values. A run that goes on must have been asked the same, but for
    the group ``cut``, how files are cut into pieces: it keeps to the earlier one."""

    @classmethod
    @contextmanager
    def opened(
        cls, out: Path, scratch: Path | None, asked: Mapping[str, Any], *, resume: bool
    ) -> Iterator["Workspace"]:
        """Take up the work of an earlier run, or begin anew; hold a lock meanwhile.

        The folder goes away where the body succeeds or fails. Where it is interrupted (KeyboardInterrupt) and tiles are
        finished, these stay for ``--resume``; points that wait go away in any case.

        Raises
        ------
        UsageError
            Another process works there, or the earlier run was asked something else.
        OutputError
            The place cannot be written.
        """
        folder = work_folder(out)
        waiting = scratch / _scratch_name(out) if scratch else folder / _POINTS
        work = cls(folder, waiting, json.loads(json.dumps(dict(asked))))
        with _writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            work._begin(resume=resume)
            try:
                yield work
            except KeyboardInterrupt as end:
                shutil.rmtree(work.scratch, ignore_errors=True)
                if work.tiles():
                    end.add_note("Pass --resume to the same command to go on from the finished tiles.")
                else:
                    work._remove()
                raise
            except BaseException:
                work._remove()
                raise
            work._remove()

    def tiles(self, kind: str = "*") -> list[Path]:
        """Packs of finished tiles of a kind (see `TileSink`), in the order of writing."""
        return sorted(self.folder.glob(f"tiles-{kind}-[0-9][0-9][0-9][0-9][0-9][0-9].pack"))

    def points(self) -> list[Pack]:
        """Packs of points that wait, as far as they follow each other from the first lot on."""
        packs = []
        for path in sorted(self.scratch.glob("points-*.pack")):
            with suppress(PackError):
                packs.append(Pack(path))
        packs.sort(key=lambda pack: int(pack.meta["first"]))
        expected, chain = 0, []
        for pack in packs:
            if pack.meta["first"] == expected:
                chain.append(pack)
                expected = int(pack.meta["last"]) + 1
            else:
                pack.path.unlink(missing_ok=True)
        return chain

    def remember(self, record: Mapping[str, Any]) -> None:
        """Note that every block is finished, and what is to be said of the reading."""
        with atomic(self.folder / _READ) as temporary:
            temporary.write_text(json.dumps(dict(record)), encoding="utf-8")

    def remembered(self) -> dict[str, Any] | None:
        """Give what was noted; None where blocks are not all finished."""
        return _record(self.folder / _READ)

    def _begin(self, *, resume: bool) -> None:
        before = _record(self.folder / _ASKED)
        if resume and before is not None:
            self.asked["cut"] = before.get("cut")
            _refuse_other(before, self.asked)
        else:
            for left in self.folder.iterdir():
                if left.name not in (_LOCK, _SCRATCH) and left != self.scratch:
                    left.unlink(missing_ok=True) if left.is_file() else shutil.rmtree(left, ignore_errors=True)
            shutil.rmtree(self.scratch, ignore_errors=True)
        with _writing(self.scratch):
            self._note_scratch()
            self.scratch.mkdir(parents=True, exist_ok=True)
        for half_written in (*self.folder.glob(".*"), *self.scratch.glob(".*")):
            half_written.unlink(missing_ok=True)
        if not (resume and before is not None):
            with atomic(self.folder / _ASKED) as temporary:
                temporary.write_text(json.dumps(self.asked), encoding="utf-8")

    def _note_scratch(self) -> None:
        """Remember where points wait; those that an earlier run left elsewhere go away: nobody would find them."""
        here = self.scratch.resolve()
        earlier = Path((_record(self.folder / _SCRATCH) or {}).get("path", here))
        inside = self.folder.resolve() / _POINTS
        # A folder of another name belongs to another run: this output may be a copy.
        if earlier != here and (earlier == inside or earlier.name == _scratch_name(self.folder.parent)):
            shutil.rmtree(earlier, ignore_errors=True)
        with atomic(self.folder / _SCRATCH) as temporary:
            temporary.write_text(json.dumps({"path": str(here)}), encoding="utf-8")

    def _remove(self) -> None:
        """Remove everything, the folder at one stroke: a kill leaves nothing that looks like a run to go on with.

        Folders of that name are cleared away by the next run with the same output.
        """
        shutil.rmtree(self.scratch, ignore_errors=True)
        gone = self.folder.with_name(f"{STAGED}{uuid4().hex}")
        try:
            self.folder.rename(gone)
        except OSError:  # Windows keeps folders in place that hold an open file
            gone = self.folder
        shutil.rmtree(gone, ignore_errors=True)


def _scratch_name(out: Path) -> str:
    """One name for one output, so that a run that goes on finds its points."""
    return f"bumpymap-{hashlib.sha256(os.fsencode(out.resolve())).hexdigest()[:12]}"


@contextmanager
def _writing(folder: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"cannot write to the folder {folder}: {error.strerror or error}. Choose another with --out or --scratch"
        ) from error


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    with _writing(folder):
        descriptor = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT)
    try:
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise UsageError(
                f"another run is writing to {folder.parent}. Wait until it has ended, or choose another --out"
            ) from error
        yield
    finally:
        os.close(descriptor)


def _record(path: Path) -> dict[str, Any] | None:
    try:
        record = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def _refuse_other(before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """Raise where a run was asked something else than the one that wants to go on."""
    differences = [
        f"{group}: {name} was {_short(old.get(name))} and is {_short(new.get(name))}"
        for group in sorted({*before, *now})
        for old, new in [(before.get(group) or {}, now.get(group) or {})]
        for name in sorted({*old, *new})
        if old.get(name) != new.get(name)
    ]
    if differences:
        shown = differences if len(differences) <= 8 else [*differences[:8], f"and {len(differences) - 8} more"]
        raise UsageError(
            "the run cannot go on, since it was begun with something else:",
            *(f"  {difference}" for difference in shown),
            "Run it with the same inputs and settings, or pass --overwrite to start anew",
        )


def _short(value: Any) -> str:
    text = json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 80 else f"{text[:77]}..."
