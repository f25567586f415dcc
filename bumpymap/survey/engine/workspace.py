"""The files of a run of the engine: finished tiles, waiting points, and a record of what was read.

They are in the folder of the run (see `bumpymap.core.run_folder`). Points may wait in another folder, with a random
name, on another disk; the run records its path.
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

from bumpymap.core import (
    Kept,
    RunFolder,
    atomic,
    clean_folder,
    is_own_folder,
    read_record,
    shielded,
    what_to_keep,
    writing_to,
)
from bumpytiles import Pack, PackError

__all__ = ["ADVICE", "Workspace"]

ADVICE = "Pass `resume=True` to the same command to continue from the finished tiles."
_READ, _SCRATCH, _OWNER = "read.json", "scratch.json", "owner.json"
_POINTS, _NEW_TILES = "points", "new-tiles"
_PREFIX = "bumpymap-"
"""Prefix of the folders that runs make in ``scratch``."""


@dataclass(frozen=True, slots=True)
class Workspace:
    """Paths and records of one run."""

    folder: Path
    scratch: Path
    """Folder for waiting points; may be on another disk."""
    run_spec: dict[str, Any]
    """What the results depend on, see `RunFolder`; and ``cut``, how files are cut into chunks: a resumed run uses
    that of the earlier one."""

    @classmethod
    @contextmanager
    def opened(
        cls, out: Path, scratch: Path | None, run_spec: Mapping[str, Any], *, resume: bool, advice: str = ADVICE
    ) -> Iterator["Workspace"]:
        """Resume the work of an earlier run, or start a new one. The caller holds the lock of ``out``.

        All files are deleted if the body succeeds. If it fails, they are kept as `what_is_kept` says, provided that
        tiles are finished or chunks are read.

        Raises
        ------
        UsageError
            The earlier run had other inputs or settings.
        OutputError
            The folders cannot be written.
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
            waiting: Path | None = None
            try:
                # A signal between making a folder and noting its name would leave the folder behind.
                with shielded(), writing_to(scratch or run.path, "`out` or `scratch`"):
                    waiting = _choose_points_folder(run, out, scratch)
                space = cls(run.path, waiting, run.run_spec)
                space._make_folders()
                yield space
            except BaseException as end:
                if waiting is not None and (what_to_keep(end) is not Kept.ALL or not _holds_work(run.path, out)):
                    shutil.rmtree(waiting, ignore_errors=True)
                raise
            with shielded():
                shutil.rmtree(waiting, ignore_errors=True)

    def _make_folders(self) -> None:
        shutil.rmtree(self.new_tiles, ignore_errors=True)  # leftovers of an earlier run
        for folder in (self.new_tiles, self.points_folder):
            folder.mkdir(mode=0o700, exist_ok=True)

    def tiles(self, kind: str = "*") -> list[Path]:
        """Return the packs of finished tiles of a kind (see `TileSink`), in the order of writing."""
        return _tiles(self.folder, kind)

    def tile_pack(self, kind: str, number: int) -> Path:
        """Return the path of a pack of finished tiles."""
        return self.folder / f"tiles-{kind}-{number:06d}.pack"

    @property
    def points_folder(self) -> Path:
        """Folder for packs of waiting points (absolute), with a subfolder for each worker or task."""
        return (self.scratch / _POINTS).absolute()

    @property
    def new_tiles(self) -> Path:
        """Folder for packs of tiles that are not checkpoints yet (absolute), with subfolders of workers or tasks."""
        return (self.folder / _NEW_TILES).absolute()

    def record(self, number: int) -> Path:
        """Return the path of a record of chunks that are read, see `Checkpoints`."""
        return self.scratch / f"read-{number:06d}.json"

    def records(self) -> list[Path]:
        """Return the records of chunks that are read, in the order of writing."""
        return _records(self.scratch)

    def save_checkpoint(self, record: Mapping[str, Any]) -> None:
        """Save the record of a run that has finished every block."""
        packs = [path.name for path in self.tiles()]
        with atomic(self.folder / _READ) as temporary:
            temporary.write_text(json.dumps({"packs": packs, "record": dict(record)}), encoding="utf-8")

    def checkpoint(self) -> dict[str, Any] | None:
        """Return the saved record; None if blocks are unfinished, or packs of tiles are missing."""
        noted = read_record(self.folder / _READ) or {}
        there = noted.get("packs") == [path.name for path in self.tiles()]
        return noted["record"] if there else None


def _tiles(folder: Path, kind: str = "*") -> list[Path]:
    return sorted(folder.glob(f"tiles-{kind}-[0-9][0-9][0-9][0-9][0-9][0-9].pack"))


def _records(folder: Path) -> list[Path]:
    return sorted(folder.glob("read-[0-9]*.json"))


def _holds_work(folder: Path, out: Path) -> bool:
    """Return whether there are finished tiles, or records of chunks that are read."""
    places = (folder / _POINTS, _earlier_points_folder(folder, out))
    return bool(_tiles(folder)) or any(_records(place) for place in places if place is not None)


def _drop_damaged(folder: Path) -> None:
    """Delete packs that a power cut has damaged; their blocks are rated again."""
    for path in _tiles(folder):
        try:
            Pack(path)
        except PackError:
            path.unlink()


def _choose_points_folder(run: RunFolder, out: Path, scratch: Path | None) -> Path:
    """Return the folder for waiting points: that of the earlier run if it is in the same place, else a new one.

    Points that an earlier run left elsewhere are deleted.
    """
    inside, earlier = run.path / _POINTS, _earlier_points_folder(run.path, out)
    if scratch is None:
        waiting = inside
        waiting.mkdir(mode=0o700, exist_ok=True)
    elif earlier is not None and run.resumed and earlier.parent.resolve() == scratch.resolve():
        waiting = earlier
    else:
        scratch.mkdir(parents=True, exist_ok=True)
        waiting = Path(mkdtemp(prefix=_PREFIX, dir=scratch.absolute()))
        owner = {"out": str(out.resolve()), "word": uuid4().hex}
        try:
            for path, record in ((run.path / _SCRATCH, {**owner, "path": str(waiting)}), (waiting / _OWNER, owner)):
                with atomic(path) as temporary:
                    temporary.write_text(json.dumps(record), encoding="utf-8")
        except BaseException:
            shutil.rmtree(waiting, ignore_errors=True)
            raise
    for left in (inside, earlier):
        if left is not None and left != waiting:
            shutil.rmtree(left, ignore_errors=True)
    clean_folder(waiting)
    return waiting


def _earlier_points_folder(folder: Path, out: Path) -> Path | None:
    """Return the folder with the waiting points of an earlier run; None unless its owner record names this output.

    The output may be a copy, and its record may name any folder.
    """
    noted = read_record(folder / _SCRATCH) or {}
    path = Path(str(noted.get("path")))
    owner = {"out": str(out.resolve()), "word": noted.get("word")}
    try:
        return path if is_own_folder(path, folder) and read_record(path / _OWNER) == owner else None
    except OSError:
        return None
