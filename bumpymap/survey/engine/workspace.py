"""What a run of the engine keeps: finished tiles, points that wait, what is to be said of the reading.

It lies in the folder of the run (see `bumpymap.core.run_folder`). Points may wait in a folder of the run's own on
another disk, whose name nobody can tell beforehand; the run notes where.
"""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from uuid import uuid4

from bumpymap.core import Kept, RunFolder, atomic, is_own_folder, read_record, tidy, what_is_kept, writing_in
from bumpytiles import Pack, PackError

__all__ = ["ADVICE", "Workspace"]

ADVICE = "Pass `resume=True` to the same command to continue from the finished tiles."
_READ, _SCRATCH, _OWNER = "read.json", "scratch.json", "owner.json"
_POINTS = "points"
_PREFIX = "bumpymap-"
"""How the names of folders begin that runs make in ``--scratch``."""


@dataclass(frozen=True, slots=True)
class Workspace:
    """Paths and records of one run."""

    folder: Path
    scratch: Path
    """Points that wait; may lie on another disk."""
    run_spec: dict[str, Any]
    """What the run was asked, see `RunFolder`. Beside it ``cut``, how files are cut into pieces: a run that goes on
    keeps to the earlier one."""

    @classmethod
    @contextmanager
    def opened(
        cls, out: Path, scratch: Path | None, run_spec: Mapping[str, Any], *, resume: bool, advice: str = ADVICE
    ) -> Iterator["Workspace"]:
        """Take up the work of an earlier run, or begin anew. The caller holds the lock of ``out``.

        All of it goes away where the body succeeds. Where it ends early, it is kept as `what_is_kept` says, if tiles
        are finished.

        Raises
        ------
        UsageError
            The earlier run was asked something else.
        OutputError
            The place cannot be written.
        """
        with RunFolder.opened(
            out, run_spec, resume=resume, finished=lambda path: bool(_tiles(path)), advice=advice, spared=(_SCRATCH,)
        ) as run:
            _drop_damaged(run.path)
            with writing_in(scratch or run.path, "`out` or `scratch`"):
                waiting = _waiting(run, out, scratch)
            try:
                yield cls(run.path, waiting, run.run_spec)
            except BaseException as end:
                if what_is_kept(end) is not Kept.ALL or not _tiles(run.path):
                    shutil.rmtree(waiting, ignore_errors=True)
                raise
            shutil.rmtree(waiting, ignore_errors=True)

    def tiles(self, kind: str = "*") -> list[Path]:
        """Packs of finished tiles of a kind (see `TileSink`), in the order of writing."""
        return _tiles(self.folder, kind)

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
        packs = [path.name for path in self.tiles()]
        with atomic(self.folder / _READ) as temporary:
            temporary.write_text(json.dumps({"packs": packs, "record": dict(record)}), encoding="utf-8")

    def remembered(self) -> dict[str, Any] | None:
        """Give what was noted; None where blocks are not all finished, or are not all there any more."""
        noted = read_record(self.folder / _READ) or {}
        there = noted.get("packs") == [path.name for path in self.tiles()]
        return noted["record"] if there else None


def _tiles(folder: Path, kind: str = "*") -> list[Path]:
    return sorted(folder.glob(f"tiles-{kind}-[0-9][0-9][0-9][0-9][0-9][0-9].pack"))


def _drop_damaged(folder: Path) -> None:
    """Take away packs that a power cut has spoilt; their blocks are finished anew."""
    for path in _tiles(folder):
        try:
            Pack(path)
        except PackError:
            path.unlink()


def _waiting(run: RunFolder, out: Path, scratch: Path | None) -> Path:
    """Give the folder in which points wait: that of the earlier run where it lies in the same place, else a new one.

    Points that an earlier run left elsewhere go away: nobody would find them.
    """
    inside, earlier = run.path / _POINTS, _earlier(run.path, out)
    if scratch is None:
        waiting = inside
        waiting.mkdir(mode=0o700, exist_ok=True)
    elif earlier is not None and run.goes_on and earlier.parent.resolve() == scratch.resolve():
        waiting = earlier
    else:
        scratch.mkdir(parents=True, exist_ok=True)
        waiting = Path(mkdtemp(prefix=_PREFIX, dir=scratch.absolute()))
        owner = {"out": str(out.resolve()), "word": uuid4().hex}
        for path, record in ((run.path / _SCRATCH, {**owner, "path": str(waiting)}), (waiting / _OWNER, owner)):
            with atomic(path) as temporary:
                temporary.write_text(json.dumps(record), encoding="utf-8")
    for left in (inside, earlier):
        if left is not None and left != waiting:
            shutil.rmtree(left, ignore_errors=True)
    tidy(waiting)
    return waiting


def _earlier(folder: Path, out: Path) -> Path | None:
    """Give the folder in which the points of an earlier run wait; None unless it says that it is of this output.

    This output may be a copy, and what is noted in it may name any folder.
    """
    noted = read_record(folder / _SCRATCH) or {}
    path = Path(str(noted.get("path")))
    owner = {"out": str(out.resolve()), "word": noted.get("word")}
    try:
        return path if is_own_folder(path, folder) and read_record(path / _OWNER) == owner else None
    except OSError:
        return None
