"""The output folder of a scan run, checked before the run and cleared of an earlier one afterwards, and its files.

They hold one row per sector of all frames, an accumulated survey, and each frame's points.
"""

import json
import math
import os
import zipfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NamedTuple

import laspy
import lazrs
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import RasterioError

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
    NO_CLASS,
    NOT_TRAVERSABLE,
    ClassedSectors,
    Frame,
    OutputError,
    Scan,
    move_together,
    parse_json,
    sector_bounds,
    sync_file,
    write_remedy,
    write_vertices,
)
from bumpymap.layers.colours import CLASS_COLOURS
from bumpymap.layers.manifest import describe_file, describe_input, software_versions, write_manifest
from bumpymap.layers.products import EVERY_FILE, make_folder, refuse_present
from bumpymap.layers.tile_table import described_field, typed_array

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
FRAME_FILES = {"cloud": ".ply", "picture": ".png"}
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


_POINT_CLASSES, _RIDE_CLASSES = (*CLASS_NAMES[:CLASSES], "no class"), ("0", "1", "2", "3", "unknown")
"""Names of the counts of points, and of traversable sectors by their ride."""


def report_frame(
    frame: Frame, version: Mapping[str, Any] | None, scan: Scan, classed: ClassedSectors, seconds: float
) -> dict[str, Any]:
    """Return the entry of a frame in scan.json: its file, and counts of its points and sectors by name.

    ``version``: ``size`` and ``mtime_ns`` of its file before it was read; ``seconds``: wall time from reading the file
    to classed sectors. Raises BadInputError: the file is missing, or has changed since it was read.
    """
    version, message, pose, stack = version or {}, frame.message, frame.pose, classed.sectors
    file = {"path": str(frame.path), "bytes": version.get("size"), "mtime_ns": version.get("mtime_ns")}
    own = describe_input(file) if message is None else {"bytes": message.bytes, "sha256": None}
    points, height, ride = classed.point_class, stack.origin_height, classed.ride
    rated = None if ride is None else np.minimum(ride.class_id[stack.traversable], len(_RIDE_CLASSES) - 1)
    return {
        "name": frame.name,
        "path": file["path"],
        "message": None if message is None else asdict(message),
        "bytes": own["bytes"],
        "sha256": own["sha256"],
        "pose": None if pose is None else pose.tolist(),
        "points": len(scan.points),
        "dropped": asdict(scan.dropped),
        "airborne_count": int(stack.point_airborne.sum()),
        "origin_height_m": None if math.isnan(height) else round(height, 3),
        "sectors": _count(SCAN_CLASS_NAMES, class_index(classed)),
        "sector_states": _count(SECTOR_STATES, sector_states(classed)),
        "points_by_class": _count(_POINT_CLASSES, np.where(points == NOT_TRAVERSABLE, CLASSES, points)),
        "sectors_by_ride": None if rated is None else _count(_RIDE_CLASSES, rated),
        "seconds": round(seconds, 4),
        "mtime_ns": file["mtime_ns"],
    }


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


class FramePart(NamedTuple):
    """The part of a finished frame in the files of the run."""

    entry: dict[str, Any]
    """Of scan.json, see `report_frame`."""
    rows: pa.Table | None
    """Of sectors.parquet; None if that is not written."""
    arrays: dict[str, NDArray[Any]]
    """For the merged points and the grids of a bag, as far as these are written."""


def part_path(folder: Path, number: int) -> Path:
    """Return the checkpoint file of the frame with that number in the run."""
    return folder / f"frame-{number:06d}.npz"


def has_finished_parts(folder: Path) -> bool:
    """Return whether a folder holds the checkpoint of any frame."""
    return next(folder.glob("frame-*.npz"), None) is not None


def save_part(part: FramePart, path: Path, files: Iterable[Path]) -> None:
    """Write the checkpoint of a finished frame; the file appears only when it is complete.

    It is not flushed to the disk, which would take longer than classifying the frame. After a power cut it may be
    damaged, or complete while one of the ``files`` of the frame's own is not; `load_part` sees that by their sizes.
    """
    rows = np.empty(0, np.uint8)
    if part.rows is not None:
        sink = pa.BufferOutputStream()
        with pa.ipc.new_stream(sink, part.rows.schema) as stream:
            stream.write_table(part.rows)
        rows = np.frombuffer(sink.getvalue(), np.uint8)
    known = json.dumps([part.entry, _sizes(files)]).encode()
    temporary = path.with_name(f".{path.name}")  # removed by the next run if this one is killed
    arrays: dict[str, Any] = part.arrays
    np.savez(temporary, _known=np.frombuffer(known, np.uint8), _rows=rows, **arrays)
    os.replace(temporary, path)  # noqa: PTH105 (os.replace says that it overwrites)


def load_part(path: Path, name: str, files: Iterable[Path]) -> FramePart | None:
    """Read the checkpoint of the frame ``name``; None if that, or one of its ``files``, is missing or damaged."""
    try:
        with np.load(path, allow_pickle=False) as saved:
            arrays = dict(saved)
        entry, sizes = parse_json(arrays.pop("_known").tobytes().decode())
        rows = arrays.pop("_rows")
        if entry["name"] != name or sizes != _sizes(files):
            return None
        return FramePart(entry, pa.ipc.open_stream(rows.tobytes()).read_all() if rows.size else None, arrays)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, pa.ArrowException):
        return None


def _sizes(files: Iterable[Path]) -> dict[str, int]:
    return {path.name: path.stat().st_size for path in files}


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
    refuse_present(folder, _NAMES, overwrite=overwrite or unfinished, folders=(FRAME_FOLDER, MAP_FOLDER))
    frames = folder / FRAME_FOLDER
    if not frames.is_dir() or frames.is_symlink():
        return
    is_ours = unfinished or (folder / SCAN_MANIFEST_NAME).exists()
    others = (path for path in sorted(frames.iterdir()) if path.suffix not in FRAME_FILES.values())
    if foreign := next(others, None) if is_ours else frames:
        raise OutputError(
            f"{foreign} was not written by a complete scan run and would be deleted by `overwrite=True`. Move it away, "
            "or choose another `out`"
        )


def present_products(folder: Path) -> tuple[str, ...]:
    """Return the names of the products of a run that are in a folder, without the map of the drive."""
    return tuple(name for name in _NAMES if name != MAP_FOLDER and (folder / name).exists())


def move_products(staged: Path, out: Path) -> tuple[str, ...]:
    """Move all products from ``staged`` to ``out``; return their names. Those of an earlier run go, with its map."""
    with ThreadPoolExecutor(8) as pool:  # several at a time: the disk writes them in an order of its own
        list(pool.map(sync_file, (path for path in staged.rglob("*") if path.is_file())))
    files, is_link = present_products(staged), (out / MAP_FOLDER).is_symlink()
    of_map = [MAP_FOLDER] if is_link else [f"{MAP_FOLDER}/{name}" for name in EVERY_FILE]
    move_together(staged, out, SCAN_MANIFEST_NAME, (FRAME_FOLDER, SECTOR_TABLE_NAME, ACCUMULATED_NAME, *of_map))
    return files


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


def write_scan_manifest(folder: Path, known: Mapping[str, Any], frames: Sequence[Mapping[str, Any]]) -> None:
    """Write scan.json beside the products in ``folder``.

    ``known``: the run's own entries: settings, method, skipped frames, seconds; ``frames``: see `report_frame`.
    """
    present = [folder / name for name in (SECTOR_TABLE_NAME, ACCUMULATED_NAME) if (folder / name).exists()]
    record = {
        "format": "bumpymap-scan-run",
        "version": 1,
        **known,
        "versions": software_versions(),
        "files": [describe_file(path) | {"path": path.name} for path in present],
        "frames": frames,
    }
    write_manifest(record, folder / SCAN_MANIFEST_NAME)


_SCALE_M = 0.001
"""Step of the coordinates of gathered.laz, m: chosen."""
_GROUND, _UNCLASSIFIED = 2, 1
"""LAS classification codes."""


@contextmanager
def open_accumulated(
    path: Path, offset: NDArray[np.float64], crs: CRS | None
) -> Iterator[Callable[[NDArray[np.float64], NDArray[np.bool_]], None]]:
    """Open gathered.laz for writing: LAZ 1.4, point format 6, scale 1 mm.

    ``offset`` (3,): of its coordinates, m; ``crs``: CRS of the world frame; None: the file gets none. Yields what
    appends points (n, 3) in the frame of the world, m, and whether they are ground (n,): class 2, others class 1.
    """
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = np.full(3, _SCALE_M), offset
    header.creation_date = None  # the same drive gives the same bytes on any day
    header.generating_software = "bumpymap scan"
    if crs is not None:
        header.add_crs(crs)
    with path.open("w+b") as stream:
        writer = laspy.LasWriter(stream, header, do_compress=True, laz_backend=laspy.LazBackend.Lazrs, closefd=False)

        def add_points(world: NDArray[np.float64], is_ground: NDArray[np.bool_]) -> None:
            record = laspy.ScaleAwarePointRecord.zeros(len(world), header=writer.header)
            record.x, record.y, record.z = world.T
            record.classification = np.where(is_ground, _GROUND, _UNCLASSIFIED).astype(np.uint8)
            record.return_number = record.number_of_returns = np.ones(len(world), np.uint8)
            if len(world):
                writer.write_points(record)

        yield add_points
        writer.close()


ROW_GROUP = 65_536
"""Rows that are buffered before a row group is written."""
COLUMNS: tuple[tuple[str, pa.DataType, str, str], ...] = (
    ("frame", pa.string(), "", "name of the frame"),
    ("zone", pa.int16(), "", "zone of the polar grid, 0 is the innermost"),
    ("ring", pa.int16(), "", "ring inside the zone, 0 is the innermost"),
    ("sector", pa.int16(), "", "sector around the zone, counter-clockwise"),
    ("near", pa.float32(), "m", "horizontal distance from the sensor where the sector starts"),
    ("far", pa.float32(), "m", "horizontal distance where it ends"),
    ("right", pa.float32(), "rad", "azimuth where the sector starts, counter-clockwise from the x axis"),
    ("left", pa.float32(), "rad", "azimuth where it ends"),
    ("points", pa.int32(), "", "points in the sector"),
    ("ground_points", pa.int32(), "", "those of them that are ground"),
    ("normal_x", pa.float32(), "", "axis of the least spread of the ground points, in the frame of the sensor"),
    ("normal_y", pa.float32(), "", "the same, to the left"),
    ("normal_z", pa.float32(), "", "the same, upwards"),
    ("traversable", pa.bool_(), "", "whether there is ground, not too steep and not overhead"),
    ("obstacle", pa.bool_(), "", "whether something stands on the ground below vehicle height, or it drops"),
    ("obstacle_height", pa.float32(), "m", "top of it above the ground; null without an obstacle, at a drop"),
    ("clearance", pa.float32(), "m", "lowest object above vehicle height, above the ground; null if there is none"),
    ("stripes", pa.float32(), "", "stripe count of the filter method; null from the learned one"),
    ("class", pa.int8(), "", "0 smooth, 1 fair, 2 rough; null where not traversable"),
    ("c_r", pa.float32(), "rad/m", "ride of the vehicle, as in a survey's map; null where unknown"),
    ("c_r_low", pa.float32(), "rad/m", "lower end of its 80 % interval"),
    ("c_r_high", pa.float32(), "rad/m", "upper end"),
    ("ride_class", pa.int8(), "", "0 (flattest) to 3 (roughest) for the vehicle, as in a survey's map"),
    ("variance", pa.float32(), "m2", "population variance of z over the ground points"),
    ("residual", pa.float32(), "m", "mean perpendicular distance of the ground points to their plane"),
    ("coverage", pa.float32(), "", "share of the pixels of the heightmap that hold a ground point"),
    ("label", pa.int16(), "", "most frequent label of the points; null where the frame has none"),
)
"""Name, type, unit and description of each column."""
RIDE_COLUMNS = ("c_r", "c_r_low", "c_r_high", "ride_class")
"""Columns of the ride of a vehicle; null without one."""


@contextmanager
def open_table(path: Path) -> Iterator[Callable[[pa.Table], None]]:
    """Open sectors.parquet for writing; yields what appends rows from `sector_rows`: a row group at a time."""
    waiting: list[pa.Table] = []
    with pq.ParquetWriter(path, sector_schema(), compression="zstd") as writer:

        def flush() -> None:
            if waiting:
                writer.write_table(pa.concat_tables(waiting), row_group_size=2 * ROW_GROUP)
                waiting.clear()

        def add_rows(rows: pa.Table) -> None:
            waiting.append(rows)
            if sum(each.num_rows for each in waiting) >= ROW_GROUP:
                flush()

        yield add_rows
        flush()


def sector_schema() -> pa.Schema:
    """Return the columns of sectors.parquet, with what describes each."""
    nullable = {"obstacle_height", "clearance", "stripes", "class", "label", "variance", "residual", *RIDE_COLUMNS}
    return pa.schema(
        [described_field(name, kind, text, unit, nullable=name in nullable) for name, kind, unit, text in COLUMNS]
    )


def sector_rows(name: str, classed: ClassedSectors) -> pa.Table:
    """Return the rows of a frame."""
    stack, bounds = classed.sectors, sector_bounds(classed.sectors)
    count = len(stack.zone)
    columns: dict[str, Any] = {
        "frame": [name] * count,
        "points": stack.count,
        "ground_points": stack.ground_count,
        "class": pa.array(classed.class_id, pa.int8(), mask=classed.class_id == NOT_TRAVERSABLE),
        "label": pa.array(stack.label, pa.int16(), mask=stack.label < 0),
        "stripes": np.full(count, np.nan, np.float32) if classed.stripes is None else classed.stripes,
    }
    if classed.ride is None:
        columns |= {name: pa.nulls(count) for name in RIDE_COLUMNS}
    else:
        class_id = classed.ride.class_id
        columns |= {name: getattr(classed.ride, name) for name in RIDE_COLUMNS[:3]}
        columns["ride_class"] = pa.array(class_id, pa.int8(), mask=class_id == NO_CLASS)
    columns |= {f"normal_{axis}": stack.normal[:, number] for number, axis in enumerate("xyz")}
    columns |= {side: getattr(bounds, side).astype(np.float32) for side in ("near", "far", "right", "left")}
    schema = sector_schema()
    columns |= {name: getattr(stack, name) for name in schema.names if name not in columns}
    return pa.table([typed_array(columns[field.name], field) for field in schema], schema=schema)


_ABOUT = (
    "bumpymap scan: sensor frame, x forward, y left, z up, metres",
    "class 0 smooth, 1 fair, 2 rough: that of the sector; 255 not traversable or in no sector",
    "ground 1: the point is ground; height: above the ground of its sector, nan where no ground is known",
)
_COLOURS, _FLAGS = ("red", "green", "blue"), ("class", "ground")


def write_cloud(scan: Scan, classed: ClassedSectors, path: Path) -> None:
    """Write binary little-endian PLY, without flushing it to the disk.

    Each vertex has x, y, z, height, red, green, blue, class, ground; intensity and label if the scan has them.
    """
    stack = classed.sectors
    kinds = [(name, "<f4") for name in (*"xyz", "height")] + [(name, "u1") for name in (*_COLOURS, *_FLAGS)]
    beside = {
        name: values for name, values in (("intensity", scan.intensity), ("label", scan.label)) if values is not None
    }
    kinds += [(name, values.dtype.newbyteorder("<").str) for name, values in beside.items()]
    vertex = np.empty(len(scan.points), kinds)
    colours = SCAN_COLOURS[point_styles(classed)]
    for number, (axis, colour) in enumerate(zip("xyz", _COLOURS, strict=True)):
        vertex[axis], vertex[colour] = scan.points[:, number], colours[:, number]
    vertex["height"], vertex["ground"] = stack.point_height, stack.point_ground
    vertex["class"] = classed.point_class
    for name, values in beside.items():
        vertex[name] = values
    with path.open("wb") as stream:
        write_vertices(vertex, _ABOUT, stream)


def frame_files(name: str, folder: Path, products: Collection[str]) -> list[Path]:
    """Return the files of a frame's own."""
    endings = [ending for product, ending in FRAME_FILES.items() if product in products]
    return [folder / FRAME_FOLDER / f"{name}{ending}" for ending in endings]
