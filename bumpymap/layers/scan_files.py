"""Write the data of scans: one row per sector of all frames, an accumulated survey, and each frame's points."""

from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyproj import CRS

from bumpymap.core import (
    NO_CLASS,
    NOT_TRAVERSABLE,
    ClassedSectors,
    Scan,
    sector_bounds,
    write_vertices,
)
from bumpymap.layers.scan_folder import (
    FRAME_FILES,
    FRAME_FOLDER,
    SCAN_COLOURS,
    point_styles,
)
from bumpymap.layers.tile_table import described_field, typed_array

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
    """Write binary little-endian PLY.

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


def write_frame(scan: Scan, classed: ClassedSectors, files: Iterable[Path]) -> None:
    """Write those of the `frame_files` of a frame that are data, without flushing them to the disk."""
    for path in files:
        if path.suffix == FRAME_FILES["cloud"]:
            write_cloud(scan, classed, path)
