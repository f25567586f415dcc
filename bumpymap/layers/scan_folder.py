"""The output folder of a scan run: check it before the run, remove stale files of an earlier run afterwards."""

import json
import math
import os
import zipfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, fields, replace
from os.path import lexists
from pathlib import Path
from typing import Any, Self

import lazrs
import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from rasterio.errors import RasterioError

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
    NOT_TRAVERSABLE,
    ClassedSectors,
    Dropped,
    Frame,
    OutputError,
    Scan,
    parse_json,
    remove_path,
    sync_file,
    write_remedy,
    write_together,
)
from bumpymap.layers.colours import CLASS_COLOURS
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file, describe_input, software_versions, write_manifest
from bumpymap.layers.products import EVERY_FILE, make_folder

SCAN_CLASS_NAMES: tuple[str, ...] = (*CLASS_NAMES[:CLASSES], "not traversable")
"""Name of each class of a sector; see `class_index`."""
SECTOR_STATES = ("free", "obstacle", "rough", "not ground")
"""States of a sector for a robot; see `sector_states`."""
OBSTACLE_POINT, OTHER_POINT = CLASSES, CLASSES + 1
"""Styles of points that are not ground. Those of ground points are the classes of their sectors."""
SCAN_COLOURS: NDArray[np.uint8] = np.array(
    # Obstacles are red: the worst class of a map would be too dark on the dark picture of a scan.
    [*(CLASS_COLOURS[class_id][:3] for class_id in range(CLASSES)), (215, 25, 28), (140, 140, 140)],
    np.uint8,
)
"""(5, 3) red, green, blue of each style of a point."""


def class_index(classed: ClassedSectors) -> NDArray[np.int64]:
    """Return the place of each sector's class in ``SCAN_CLASS_NAMES``, (n,)."""
    return np.where(classed.class_id == NOT_TRAVERSABLE, CLASSES, classed.class_id).astype(np.int64)


def sector_states(classed: ClassedSectors) -> NDArray[np.int64]:
    """Return the place of each sector's state in ``SECTOR_STATES``, (n,).

    Free: class 0 or 1, and nothing stands on it. Obstacle: ground of any class on which something stands. Rough: class
    2 without an obstacle. Not ground: no class.
    """
    rough, no_ground = classed.class_id == CLASSES - 1, classed.class_id == NOT_TRAVERSABLE
    return np.select([no_ground, classed.sectors.obstacle, rough], [3, 1, 2], 0).astype(np.int64)


def point_styles(classed: ClassedSectors) -> NDArray[np.uint8]:
    """Return the style of each point, (m,): an index into ``SCAN_COLOURS``.

    Ground has its class; an obstacle is a point between belly and vehicle height above the ground;
    everything else is of one style: overhead, low but not ground, without a class.
    """
    stack, settings = classed.sectors, classed.sectors.settings
    with np.errstate(invalid="ignore"):
        stands = (stack.point_height >= settings.belly_m) & (stack.point_height <= settings.height_m)
    never = stack.point_ground | stack.point_airborne
    style = np.where(stands & ~never, np.uint8(OBSTACLE_POINT), np.uint8(OTHER_POINT))
    own = classed.point_class
    return np.where(stack.point_ground & (own < CLASSES), own, style)


FRAME_FOLDER = "frames"
FRAME_FILES = {"polygons": ".json", "cloud": ".ply", "picture": ".png"}
"""File suffix of each product that is written per frame."""


def name_frames(sources: Sequence[Frame]) -> list[Frame]:
    """Give each frame a unique name.

    Names are the stems of their files; of those in a bag, their time, seconds and nanoseconds
    (``1700000000_250000000``). In a stem that is not valid UTF-8, every byte beyond ASCII becomes ``%`` and two hex
    digits (``caf%E9``), because names are written to Parquet and to file names. If two stems are equal (ignoring case,
    as some file systems do), all names start with the number of the frame in the run: ``000000_STEM``, ``000001_STEM``.
    """
    names = [_stem(source) for source in sources]
    if len({name.casefold() for name in names}) < len(names):
        names = [f"{number:06d}_{name}" for number, name in enumerate(names)]
    return [replace(source, name=name) for name, source in zip(names, sources, strict=True)]


def _stem(source: Frame) -> str:
    if source.message is not None:
        return "{}_{:09d}".format(*divmod(source.message.stamp_ns, 1_000_000_000))
    stem = source.path.stem
    try:
        stem.encode()
    except UnicodeEncodeError:
        return "".join(chr(byte) if byte < 128 else f"%{byte:02X}" for byte in os.fsencode(stem))
    return stem


_RIDE_CLASSES = ("0", "1", "2", "3", "unknown")


@dataclass(frozen=True, slots=True)
class FrameReport:
    """The file of a frame, and numbers of its points and sectors, by the names that they have in scan.json."""

    frame: Frame
    bytes: int
    """Size of its file or message."""
    sha256: str | None
    """Of its file; None for a message."""
    points: int
    """Points that were kept."""
    dropped: Dropped
    """Returns that were dropped, by reason."""
    airborne_count: int
    """Points that lie alone above the ground: rain, dust, insects."""
    origin_height_m: float | None
    """Height of the frame's origin above the ground, m; None without level ground."""
    sectors: Mapping[str, int]
    """Sectors by ``SCAN_CLASS_NAMES``."""
    sector_states: Mapping[str, int]
    """Sectors by ``SECTOR_STATES``."""
    points_by_class: Mapping[str, int]
    """Points of class 0 to 2, then of no class."""
    sectors_by_ride: Mapping[str, int] | None
    """Traversable sectors of class 0 to 3 for the vehicle, then unknown; None without a vehicle."""
    seconds: float
    """Wall time from reading the file to classed sectors."""

    @classmethod
    def of(cls, frame: Frame, record: Mapping[str, Any]) -> Self:
        """Restore a report from its `record`."""
        own = {each.name: record[each.name] for each in fields(cls)[1:]}
        return cls(frame, **own | {"dropped": Dropped(**record["dropped"])})

    def record(self) -> dict[str, Any]:
        """Return the entry of the frame in scan.json."""
        message = None if self.frame.message is None else asdict(self.frame.message)
        head = {"name": self.frame.name, "path": str(self.frame.path), "message": message, "bytes": self.bytes}
        own = {each.name: getattr(self, each.name) for each in fields(self)[1:]}
        return head | {"sha256": self.sha256, "pose": self.frame.pose} | own | {"dropped": asdict(self.dropped)}


def report_frame(
    frame: Frame, version: Mapping[str, Any] | None, scan: Scan, classed: ClassedSectors, seconds: float
) -> FrameReport:
    """Count the points and sectors of a frame.

    ``version``: ``size`` and ``mtime_ns`` of its file before it was read; not needed for a message. Raises
    BadInputError: the file is missing, or has changed since it was read.
    """
    points = classed.point_class
    file: Mapping[str, Any]
    if frame.message is not None:
        file = {"bytes": frame.message.bytes, "sha256": None}
    else:
        known = version or {}
        file = describe_input({"path": frame.path, "bytes": known.get("size"), "mtime_ns": known.get("mtime_ns")})
    ride = None
    if classed.ride is not None:
        rated = classed.ride.class_id[classed.sectors.traversable]
        ride = _count(_RIDE_CLASSES, np.minimum(rated, len(_RIDE_CLASSES) - 1))
    return FrameReport(
        frame,
        file["bytes"],
        file["sha256"],
        len(scan.points),
        scan.dropped,
        int(classed.sectors.point_airborne.sum()),
        None if math.isnan(classed.sectors.origin_height) else round(classed.sectors.origin_height, 3),
        _count(SCAN_CLASS_NAMES, class_index(classed)),
        _count(SECTOR_STATES, sector_states(classed)),
        _count((*SCAN_CLASS_NAMES[:CLASSES], "no class"), np.where(points == NOT_TRAVERSABLE, CLASSES, points)),
        ride,
        round(seconds, 4),
    )


def _count(names: Sequence[str], places: NDArray[np.integer]) -> dict[str, int]:
    """Count by name; ``places`` are positions in ``names``."""
    return dict(zip(names, np.bincount(places, minlength=len(names)).tolist(), strict=True))


def explain_empty_scan(scan: Scan, classed: ClassedSectors) -> str:
    """Explain why a scan has no sectors or no traversable ones; return an empty string if it has."""
    stack, settings = classed.sectors, classed.sectors.settings
    if len(stack.zone):
        if stack.traversable.any():
            return ""
        return f"none of its {len(stack.zone):,} sectors is traversable. Does its z axis point up?"
    if not len(scan.points):
        lost = scan.dropped
        return (
            f"it holds no points: {lost.no_return:,} returns at (0, 0, 0) or NaN, {lost.not_finite:,} not finite, "
            f"{lost.on_robot:,} on the robot"
        )
    near, far = settings.zone_starts_m[0], settings.end_m
    distance = np.hypot(*scan.points[:, :2].T.astype(np.float64))
    inside = int(((distance >= near) & (distance < far)).sum())
    return (
        f"none of its sectors holds more than {settings.least_points} points: {inside:,} of {len(scan.points):,} "
        f"points lie {near:g} to {far:g} m from the sensor"
    )


@dataclass(frozen=True, slots=True)
class FramePart:
    """Rows and points that a finished frame adds to the files of the drive."""

    report: FrameReport
    rows: pa.Table | None
    """Rows for sectors.parquet; None if that is not written."""
    points: NDArray[np.float32]
    """(n, 3) m, in the sensor frame, for gathered.laz; empty if that is not written."""
    is_ground: NDArray[np.bool_]
    """(n,) whether each of them is ground."""
    cells: Mapping[str, NDArray[Any]]
    """Square cells around the sensor, for the grids of a bag; empty if those are not written."""
    files: Mapping[str, int] = field(default_factory=dict)
    """Size of each file of the frame's own by its name, bytes."""


def file_sizes(paths: Iterable[Path]) -> dict[str, int] | None:
    """Return the sizes of files by their names, bytes; None if one is missing."""
    try:
        return {path.name: path.stat().st_size for path in paths}
    except OSError:
        return None


def part_path(folder: Path, number: int) -> Path:
    """Return the checkpoint file of the frame with that number in the run."""
    return folder / f"frame-{number:06d}.npz"


def has_finished_parts(folder: Path) -> bool:
    """Return whether a folder holds the checkpoint of any frame."""
    return next(folder.glob("frame-*.npz"), None) is not None


_CELLS = "cells_"


def save_part(part: FramePart, path: Path) -> None:
    """Write the checkpoint of a finished frame; the file appears only when it is complete.

    It is not flushed to the disk, which would take longer than classifying the frame. After a power cut it may be
    damaged, or complete while a file of the frame is not; `load_part` and the sizes of the files show that.
    """
    rows = np.empty(0, np.uint8)
    if part.rows is not None:
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, part.rows.schema) as stream:
            stream.write_table(part.rows)
        rows = np.frombuffer(sink.getvalue(), np.uint8)
    record = {"report": part.report.record() | {"pose": None}, "files": dict(part.files)}
    known = np.frombuffer(json.dumps(record).encode(), np.uint8)
    temporary = path.with_name(f".{path.name}")  # removed by the next run if this one is killed
    cells: dict[str, Any] = {f"{_CELLS}{name}": values for name, values in part.cells.items()}
    np.savez(temporary, known=known, rows=rows, points=part.points, is_ground=part.is_ground, **cells)
    os.replace(temporary, path)  # noqa: PTH105 (os.replace says that it overwrites)


def load_part(path: Path, frame: Frame) -> FramePart | None:
    """Read the checkpoint of a frame; None if it is missing, damaged or of another frame."""
    try:
        with np.load(path, allow_pickle=False) as saved:
            record = parse_json(saved["known"].tobytes().decode())
            rows = pa.ipc.open_stream(saved["rows"].tobytes()).read_all() if saved["rows"].size else None
            if record["report"]["name"] != frame.name:
                return None
            report = FrameReport.of(frame, record["report"])
            cells = {name.removeprefix(_CELLS): saved[name] for name in saved.files if name.startswith(_CELLS)}
            return FramePart(report, rows, saved["points"], saved["is_ground"], cells, record["files"])
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, pa.ArrowException):
        return None


SCAN_MANIFEST_NAME, SECTOR_TABLE_NAME, ACCUMULATED_NAME = "scan.json", "sectors.parquet", "gathered.laz"
MAP_FOLDER = "map"
_NAMES = (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, MAP_FOLDER, SCAN_MANIFEST_NAME)


def check_scan_folder(folder: Path, inputs: Iterable[Path] = (), *, overwrite: bool, unfinished: bool = False) -> None:
    """Check that the files of a scan run can be written to a folder; create the folder if it is missing.

    A file that is a symbolic link will be replaced as a link; its target is not touched. ``inputs``: input files of
    this run, which must not be where the output goes; ``overwrite``: allow files of any earlier run to be replaced;
    ``unfinished``: allow files of the run that is being resumed to be replaced: it may have been killed after it moved
    them here. Raises OutputError: the folder cannot be created or written, or holds files that must not be replaced: of
    an earlier run, inputs of this run, or files that no scan run wrote.
    """
    taken = (folder / FRAME_FOLDER).resolve()
    inside = next((path for path in inputs if taken in path.resolve().parents), None)
    if inside is not None:
        raise OutputError(f"{inside} is an input of this run, and the output would replace it. Choose another `out`")
    make_folder(folder)
    present = [name for name in _NAMES if lexists(folder / name)]
    if present and not (overwrite or unfinished):
        raise OutputError(
            f"{folder} already holds {', '.join(present)}. Choose another `out`, or pass `overwrite=True` to replace "
            "them"
        )
    for name in present:
        is_link = (folder / name).is_symlink()
        if not is_link and (folder / name).is_dir() != (name in {FRAME_FOLDER, MAP_FOLDER}):
            raise OutputError(f"{folder / name} is not what a scan run writes. Choose another `out`")
    foreign = _foreign_file(folder, unfinished=unfinished)
    if foreign:
        raise OutputError(
            f"{foreign} was not written by a complete scan run and would be deleted by `overwrite=True`. Move it away, "
            "or choose another `out`"
        )


def remove_stale_products(folder: Path, kept: Sequence[str]) -> None:
    """Remove the files of an earlier run, except ``kept``, the names that this run has just written."""
    for name in _NAMES:
        if name in kept or not lexists(folder / name):
            continue
        if name == MAP_FOLDER and not (folder / name).is_symlink():
            with write_together(folder / name, MANIFEST_NAME, EVERY_FILE):
                pass  # none of these files is written again
            with suppress(OSError):  # a folder with other files in it stays
                (folder / name).rmdir()
        else:
            remove_path(folder / name)


@contextmanager
def output_errors(folder: Path) -> Iterator[None]:
    """Convert errors of the libraries that write files into an OutputError."""
    try:
        yield
    except (OSError, lazrs.LazrsError, pa.ArrowException, RasterioError) as error:
        raise OutputError(
            f"cannot write to {folder}: {error}. {write_remedy(error, 'Free some space, or choose another `out`')}; "
            "nothing half-written was left there"
        ) from error


def sync_to_disk(paths: Iterable[Path]) -> None:
    """Flush files to the disk (fsync), several at a time: the disk then writes them in an order of its own."""
    with ThreadPoolExecutor(8) as pool:
        for _ in pool.map(sync_file, paths):
            pass


def _foreign_file(folder: Path, *, unfinished: bool) -> Path | None:
    """Return a file in ``frames`` that no scan run wrote (``frames`` itself if there is no run here), or None."""
    frames = folder / FRAME_FOLDER
    if frames.is_symlink() or not frames.is_dir():
        return None
    if not (unfinished or (folder / SCAN_MANIFEST_NAME).exists()):
        return frames
    return next((path for path in sorted(frames.iterdir()) if path.suffix not in FRAME_FILES.values()), None)


def write_scan_manifest(
    folder: Path, known: Mapping[str, Any], frames: Iterable[FrameReport], identities: Mapping[str, Mapping[str, Any]]
) -> None:
    """Write scan.json beside the products in ``folder``.

    ``known``: the run's own entries: settings, method, skipped frames, seconds. They are kept. ``identities``: identity
    of each input file by its path, see `bumpymap.readers.identity`.
    """
    files = [
        describe_file(folder / name) | {"path": name}
        for name in (SECTOR_TABLE_NAME, ACCUMULATED_NAME)
        if (folder / name).exists()
    ]
    times = {path: identity["mtime_ns"] for path, identity in identities.items()}
    record = {
        "format": "bumpymap-scan-run",
        "version": 1,
        **known,
        "versions": software_versions(),
        "files": files,
        "frames": [{**frame.record(), "mtime_ns": times.get(str(frame.frame.path))} for frame in frames],
    }
    write_manifest(record, folder / SCAN_MANIFEST_NAME)
