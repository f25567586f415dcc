"""How a memory budget is divided, what a run will take (memory, disk space, time), and the files of a run.

The shares were measured: a waiting point takes 14 or 26 bytes, one that is being read up to 95 (its record, its
coordinates, its index in a block), one that is being sorted 63. Waiting points may reach one and a half times their
limit while the older half is written to disk. The bounds of the estimate follow from that; rates, and memory outside
the budget, were measured on two cores of an AMD EPYC server, on synthetic surveys of 1 to 20 million points and on real
ones.

*Files.* Finished tiles, waiting points, and a record of what was read. They are in the folder of the run (see
`bumpymap.core.run_folder`). Points may wait in another folder, with a random name, on another disk; the run records its
path.
"""

import json
import math
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import mkdtemp
from typing import Any
from uuid import uuid4

from bumpymap.core import (
    Kept,
    MapConfig,
    RunFolder,
    atomic,
    auto_memory,
    clean_folder,
    is_auto,
    is_own_folder,
    memory_bytes,
    neighbour_columns,
    rated_columns,
    read_record,
    shielded,
    what_to_keep,
    writing_to,
)
from bumpymap.readers import SurveyInfo
from bumpytiles import BLOCK_TILES, Grid, Pack, PackError

_ADVICE = "Run the same again to continue from the finished tiles."
_READ, _SCRATCH, _OWNER, _SKIPPED = "read.json", "scratch.json", "owner.json", "skipped.json"
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
    """Everything that the results depend on, see `RunFolder`; and ``cut``, how files are cut into chunks: a resumed run
    uses that of the earlier one."""

    @classmethod
    @contextmanager
    def opened(
        cls, out: Path, scratch: Path | None, run_spec: Mapping[str, Any], *, overwrite: bool
    ) -> Iterator["Workspace"]:
        """Continue the work of an interrupted run, or start anew. The caller holds the lock of ``out``.

        All files are deleted if the body succeeds. If it fails, they are kept as `what_is_kept` says, provided that
        tiles are finished or chunks are read. Raises UsageError: the earlier run had other inputs or settings;
        OutputError: the folders cannot be written.
        """
        with RunFolder.opened(
            out,
            run_spec,
            overwrite=overwrite,
            finished=lambda path: _holds_work(path, out),
            advice=_ADVICE,
            keep=(_SCRATCH,),
        ) as run:
            for path in _tiles(run.path):
                try:
                    Pack(path)
                except PackError:  # damaged by a power cut: its blocks are rated again
                    path.unlink()
            waiting: Path | None = None
            try:
                # A signal between making a folder and noting its name would leave the folder behind.
                with shielded(), writing_to(scratch or run.path, "`out` or `scratch`"):
                    waiting = _choose_points_folder(run, out, scratch)
                space = cls(run.path, waiting, run.run_spec)
                shutil.rmtree(space.new_tiles, ignore_errors=True)  # leftovers of an earlier run
                for folder in (space.new_tiles, space.points_folder):
                    folder.mkdir(mode=0o700, exist_ok=True)
                yield space
            except BaseException as end:
                if waiting is not None and (what_to_keep(end) is not Kept.ALL or not _holds_work(run.path, out)):
                    shutil.rmtree(waiting, ignore_errors=True)
                raise
            with shielded():
                shutil.rmtree(waiting, ignore_errors=True)

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

    def skipped(self) -> dict[str, str]:
        """Return the files that an earlier run has skipped while it read them, with the reason."""
        return read_record(self.folder / _SKIPPED) or {}

    def forget_points(self, skipped: Mapping[str, str]) -> None:
        """Delete what was read, tiles first; note last which files are skipped.

        After a kill in between the bad file is read again and found again. Workers may still write to their folders.
        """
        for path in (*self.tiles(), *self.records()):
            path.unlink()
        for folder in (self.points_folder, self.new_tiles):
            for own in folder.iterdir():
                if own.is_dir():
                    shutil.rmtree(own, ignore_errors=True)
        with atomic(self.folder / _SKIPPED) as temporary:
            temporary.write_text(json.dumps(dict(skipped)), encoding="utf-8")

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


_ELSEWHERE = 1 << 30
"""``auto`` for a worker of a scheduler, bytes: it may be on another machine."""
POINT_BYTES = 14
"""Size of a waiting point of LAS or LAZ, in memory or on disk."""
FLOAT_POINT_BYTES = 26
"""The same for points whose coordinates are no integers: of PLY and PCD, and corrected ones."""
_READING_BYTES, _SORTING_BYTES = 95, 63
"""Memory of a point while it is read and while it is sorted, bytes (measured, see the module)."""
_DECODING_BYTES = 45
"""Size of a point that is being decoded: its record, compressed and not."""
_MOST_WAITING, _READING, _SORTING, _AHEAD = 0.55, 0.15, 0.15, 0.08
"""Shares of the budget of points that wait, are read, are sorted, and are measured for the blocks beside theirs."""
_PIECE_POINTS, _LEAST_PIECE = 500_000, 50_000
"""Points of a chunk, at most and at least."""
_LAZ_CHUNK, _LAZ_CHUNKS_A_THREAD, _MOST_REQUESTS = 50_000, 3, 8
"""Usual points of a LAZ chunk, which one thread decodes; how many of them are decoded at a time."""


def with_memory(config: MapConfig) -> MapConfig:
    """Return settings of which ``memory`` is a size: ``auto`` is replaced by that of this machine at this moment.

    It is a quarter of the free memory, within the limits above; for the workers of a scheduler it is always the same.
    Raises UsageError: ``memory`` is neither a size nor ``auto``.
    """
    if not is_auto(config.memory):
        memory_bytes(config.memory)
        return config
    size = _ELSEWHERE if config.scheduler is not None else auto_memory()
    return replace(config, memory=f"{size >> 20}MB")


def requests_at_once(points: int, threads: int) -> int:
    """Return the number of chunks that are fetched at a time, so that every thread has LAZ chunks to decode."""
    wanted = math.ceil(_LAZ_CHUNKS_A_THREAD * threads * _LAZ_CHUNK / max(points, 1))
    return max(min(wanted, threads, _MOST_REQUESTS), 1)


@dataclass(frozen=True, slots=True)
class Budget:
    """Shares of a memory budget, in points."""

    memory: int
    """Bytes, in addition to what the interpreter and its libraries take."""
    threads: int

    @property
    def waiting_points(self) -> int:
        """Most points of LAS or LAZ that wait in memory until their block is complete."""
        return int(_MOST_WAITING / 1.5 * self.memory / POINT_BYTES)

    @property
    def waiting_bytes(self) -> int:
        """Most memory for points that wait."""
        return self.waiting_points * POINT_BYTES

    @property
    def block_points(self) -> int:
        """Most points of one block that a thread sorts together."""
        return int(_SORTING * self.memory / _SORTING_BYTES / self.threads)

    @property
    def ahead_bytes(self) -> int:
        """Most memory for blocks that were measured for their neighbours, and are rated later."""
        return int(_AHEAD * self.memory)

    @property
    def chunk_points(self) -> int:
        """Points in a chunk of a file; each thread holds one chunk, and one or more are being decoded."""
        fitting = int(_READING * self.memory / _READING_BYTES / (self.threads + 1))
        return max(_LEAST_PIECE, min(_PIECE_POINTS, fitting))

    def most_bytes(self, points: int, waiting: int) -> int:
        """Return the most bytes of the budget that a survey can take; ``waiting``: those of all its points."""
        waiting = min(waiting, int(1.5 * self.waiting_bytes))
        reading = _READING_BYTES * min(points, self.chunk_points * (self.threads + 1))
        further = requests_at_once(self.chunk_points, self.threads) - 1
        reading += _DECODING_BYTES * min(points, self.chunk_points * further)
        sorting = _SORTING_BYTES * min(points, self.block_points * self.threads)
        return max(reading, min(self.memory, waiting + reading + sorting))


_READING_BASE, _WRITING_BASE = 330 << 20, 980 << 20
"""Interpreter, libraries and decoder while points are read and measured, and the most while layers are written, bytes:
with the caches of the libraries that write them and what rasters and tables hold at the same time."""
_DECODER = 10 << 20
"""Each further decoder process (measured: 9 MB), bytes."""
_PACK_BYTES, _ENTRY_BYTES = 8192, 24
"""Size of the header of a pack, and of its index entry of a block, bytes."""
_LAYER_HEIGHTS, _LAYER_NUMBERS = 9, 350
"""Layers before compression: bytes per pixel of a heightmap (stored twice) and of obstacle.tif, and other bytes per
tile."""
_START_S = 1.6
"""Time for imports, checks and the files that every run writes, s."""
_POINT_NS = {"LAZ": 330.0, "COPC": 330.0, "LAS": 130.0, "PLY": 180.0, "PCD": 100.0, "GeoT": 350.0}
"""CPU time per point by format: decoding, grouping, measuring, ns."""
_TEXT_POINT_NS, _SPILLED_POINT_NS, _TILE_NS = 600.0, 100.0, 30_000.0
"""CPU time per point of text; per point that is written to disk and read again; per tile, to classify and write it."""
_WRITERS = 2
"""Cores that are used while layers are written."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """The resources that ``map`` needs on one machine."""

    points: int
    """Number according to the headers."""
    tiles: int | None
    """Upper bound; None if the bounds of the points are not known."""
    memory: int
    """Upper bound of resident memory, helper processes included, bytes."""
    scratch: int
    """Upper bound of the points on disk, bytes; less if blocks are complete early."""
    out: int | None
    """Upper bound of the folder of the layers, finished tiles and layers together, bytes."""
    seconds: float
    """Approximate wall time."""


def estimate(infos: Sequence[SurveyInfo], grid: Grid, budget: Budget, tiles: int | None = None) -> Estimate:
    """Estimate the resources of a run.

    ``infos``: from the headers of its files (at least one); ``tiles``: number of tiles with points, if they were
    counted.
    """
    points = sum(info.point_count for info in infos)
    most = tiles if tiles is not None else _most_tiles(infos, points, grid)
    waiting, scratch, work = 0, 0, 0.0
    for info in infos:
        plain = info.format.startswith(("LAS", "LAZ", "COPC"))
        waiting += info.point_count * (POINT_BYTES if plain else FLOAT_POINT_BYTES)
        is_text = "text" in info.format or "ascii" in info.format
        work += info.point_count * (_TEXT_POINT_NS if is_text else _POINT_NS[info.format[:4].rstrip(" ,")])
    if waiting > budget.waiting_bytes:  # every block waits until the end, at worst
        blocks = _most_tiles(infos, points, Grid(grid.tile_size * BLOCK_TILES, grid.pixels)) or most or points
        packs = 2 * waiting // budget.waiting_bytes + 1 + len(infos)  # half of what may wait each; the last of a file
        entries = packs * len(infos) + min(points, packs * blocks)
        scratch = waiting + packs * _PACK_BYTES + entries * _ENTRY_BYTES
        work += points * _SPILLED_POINT_NS
    tile_bytes = 2 * sum(column.row_bytes for column in rated_columns(grid.pixels))  # measured both ways, at worst
    tile_bytes += sum(column.row_bytes for column in neighbour_columns(grid.pixels))
    tile_bytes += _LAYER_HEIGHTS * grid.pixels**2 + _LAYER_NUMBERS
    seconds = work / budget.threads + (most or 0) * _TILE_NS / min(budget.threads, _WRITERS)
    further = requests_at_once(budget.chunk_points, budget.threads) - 1
    memory = _READING_BASE + further * _DECODER + budget.most_bytes(points, waiting)
    out = None if most is None else most * tile_bytes
    return Estimate(points, most, max(memory, _WRITING_BASE), scratch, out, _START_S + 1e-9 * seconds)


def _most_tiles(infos: Sequence[SurveyInfo], points: int, grid: Grid) -> int | None:
    """Return the most tiles that points of these files can fall into; None if the bounds of one are not known."""
    total, size = 0, grid.tile_size
    for info in infos:
        if (box := info.bounds) is None:
            return None
        cols = box.east // size - box.west // size + 1
        total += int(cols * (box.north // size - box.south // size + 1))
    return min(total, points)
