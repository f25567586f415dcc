"""What a run of the engine keeps: finished tiles, points that wait, what is to be said of the reading.

It lies in the folder of the run (see `bumpymap.core.run_folder`). Points may wait in a folder of the run's own on
another disk, whose name nobody can tell beforehand; the run notes where.
"""

import json
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from uuid import uuid4

from bumpymap.core import Kept, RunFolder, atomic, clean_folder, is_own_folder, read_record, what_to_keep, writing_to
from bumpytiles import Pack, PackError

__all__ = ["ADVICE", "Workspace"]

ADVICE = "Pass `resume=True` to the same command to continue from the finished tiles."
_READ, _SCRATCH, _OWNER = "read.json", "scratch.json", "owner.json"
_POINTS, _NEW_TILES = "points", "new-tiles"
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

        All of it goes away where the body succeeds. Where it ends early, it is kept as `what_to_keep` says, if tiles
        are finished or chunks are read.

        Raises
        ------
        UsageError
            The earlier run was asked something else.
        OutputError
            The place cannot be written.
        """
        with RunFolder.opened(
            out,
            run_spec,
            resume=resume,
            finished=lambda path: _holds_work(path, out),
            advice=advice,
            keep=(_SCRATCH,),
        ) as run:
            _drop_damaged(run.path)
            with writing_to(scratch or run.path, "`out` or `scratch`"):
                waiting = _waiting(run, out, scratch)
            try:
                space = cls(run.path, waiting, run.run_spec)
                space._make_folders()
                yield space
            except BaseException as end:
                if what_to_keep(end) is not Kept.ALL or not _holds_work(run.path, out):
                    shutil.rmtree(waiting, ignore_errors=True)
                raise
            shutil.rmtree(waiting, ignore_errors=True)

    def _make_folders(self) -> None:
        shutil.rmtree(self.new_tiles, ignore_errors=True)  # an earlier run's, which do not count
        for folder in (self.new_tiles, self.points_folder):
            folder.mkdir(mode=0o700, exist_ok=True)

    def tiles(self, kind: str = "*") -> list[Path]:
        """Packs of finished tiles of a kind (see `TileSink`), in the order of writing."""
        return _tiles(self.folder, kind)

    def tile_pack(self, kind: str, number: int) -> Path:
        """Path of a pack of finished tiles."""
        return self.folder / f"tiles-{kind}-{number:06d}.pack"

    @property
    def points_folder(self) -> Path:
        """Folder for packs of points that wait (absolute), with a folder for each worker or task."""
        return (self.scratch / _POINTS).absolute()

    @property
    def new_tiles(self) -> Path:
        """Folder for packs of tiles that do not count yet (absolute), with a folder for each worker or task."""
        return (self.folder / _NEW_TILES).absolute()

    def record(self, number: int) -> Path:
        """Path of a record of chunks that are read, see `Checkpoints`."""
        return self.scratch / f"read-{number:06d}.json"

    def records(self) -> list[Path]:
        """Give the records of chunks that are read, in the order of writing."""
        return _records(self.scratch)

    def save_checkpoint(self, record: Mapping[str, Any]) -> None:
        """Note that every block is finished, and what is to be said of the reading."""
        packs = [path.name for path in self.tiles()]
        with atomic(self.folder / _READ) as temporary:
            temporary.write_text(json.dumps({"packs": packs, "record": dict(record)}), encoding="utf-8")

    def checkpoint(self) -> dict[str, Any] | None:
        """Give what was noted; None where blocks are not all finished, or are not all there any more."""
        noted = read_record(self.folder / _READ) or {}
        there = noted.get("packs") == [path.name for path in self.tiles()]
        return noted["record"] if there else None


def _tiles(folder: Path, kind: str = "*") -> list[Path]:
    return sorted(folder.glob(f"tiles-{kind}-[0-9][0-9][0-9][0-9][0-9][0-9].pack"))


def _records(folder: Path) -> list[Path]:
    return sorted(folder.glob("read-[0-9]*.json"))


def _holds_work(folder: Path, out: Path) -> bool:
    """Whether there are finished tiles, or records of chunks that are read."""
    places = (folder / _POINTS, _earlier(folder, out))
    return bool(_tiles(folder)) or any(_records(place) for place in places if place is not None)


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
    elif earlier is not None and run.resumed and earlier.parent.resolve() == scratch.resolve():
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
    clean_folder(waiting)
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
