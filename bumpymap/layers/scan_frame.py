"""Write the data of one frame: its sectors as polygons, its points with their classes."""

import json
import math
from collections.abc import Collection
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from bumpymap.core import (
    ClassedSectors,
    PolarSettings,
    Scan,
    SectorStack,
    point_classes,
    sector_bounds,
    write_vertices,
)
from bumpymap.layers.scan_folder import (
    FRAME_FILES,
    FRAME_FOLDER,
    SCAN_CLASS_NAMES,
    SCAN_COLOURS,
    class_index,
    point_styles,
)
from bumpymap.layers.scan_table import RIDE_COLUMNS, sector_rows

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
    vertex["class"] = point_classes(scan, classed)
    for name, values in beside.items():
        vertex[name] = values
    with path.open("wb") as stream:
        write_vertices(vertex, _ABOUT, stream)


_MAX_DEVIATION_M = 0.01
"""Largest distance between an arc and the line segments that approximate it."""


def outlines(stack: SectorStack) -> list[NDArray[np.float64]]:
    """Return the outline of each sector: (k, 2) x and y, m, counter-clockwise, last vertex equal to the first.

    Adjacent sectors of a zone share their vertices.
    """
    bounds = sector_bounds(stack)
    found: list[NDArray[np.float64]] = []
    for zone, steps in enumerate(_steps(stack.settings)):
        here = stack.zone == zone
        azimuth = np.linspace(bounds.right[here], bounds.left[here], steps + 1, axis=1)
        arc = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=2)
        near, far = bounds.near[here][:, None, None], bounds.far[here][:, None, None]
        outline = np.concatenate([far * arc, near * arc[:, ::-1], far * arc[:, :1]], axis=1)
        # A sector that starts at the sensor has one vertex there.
        tip = np.r_[: steps + 2, 2 * steps + 2]
        found += [one if start > 0.0 else one[tip] for one, start in zip(outline, bounds.near[here], strict=True)]
    return found


def _steps(settings: PolarSettings) -> list[int]:
    """Return the number of line segments per arc in each zone."""
    ends = [*settings.zone_starts_m[1:], settings.end_m]
    pairs = zip(ends, settings.sectors, strict=True)
    return [math.ceil(math.pi / sectors / math.acos(max(1.0 - _MAX_DEVIATION_M / end, -1.0))) for end, sectors in pairs]


_PLACE = (
    "metres in the frame of the sensor, x forward, y to the left; no longitude and latitude, so this is not a file of "
    "RFC 7946"
)


def write_polygons(name: str, classed: ClassedSectors, path: Path) -> None:
    """Write the sectors of the frame ``name`` in the order of the stack, with coordinates rounded to 1 mm."""
    stack = classed.sectors
    found = outlines(stack)
    # All are rounded and converted at once, which takes a tenth of the time.
    vertices = iter(np.round(np.concatenate([*found, np.empty((0, 2))]), 3).tolist())
    rings = [list(islice(vertices, len(outline))) for outline in found]
    record = {
        "type": "FeatureCollection",
        "frame": name,
        "coordinates_in": _PLACE,
        "method": classed.method,
        "features": [
            {"type": "Feature", "properties": properties, "geometry": {"type": "Polygon", "coordinates": [ring]}}
            for properties, ring in zip(_properties(classed), rings, strict=True)
        ],
    }
    path.write_text(json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _properties(classed: ClassedSectors) -> list[dict[str, Any]]:
    """Return the columns of the table without those that the outlines tell, a dict for each sector."""
    rows = sector_rows("", classed).drop_columns(["frame", "near", "far", "right", "left"])
    if classed.ride is None:
        rows = rows.drop_columns(RIDE_COLUMNS)
    columns = {
        name: _numbers(values.to_numpy()) if values.type == pa.float32() else values.to_pylist()
        for name, values in zip(rows.column_names, rows.columns, strict=True)
    }
    columns["normal"] = list(zip(*(columns.pop(f"normal_{axis}") for axis in "xyz"), strict=True))
    columns["class_name"] = [SCAN_CLASS_NAMES[place] for place in class_index(classed).tolist()]
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _numbers(values: NDArray[np.float32]) -> list[float | None]:
    """Round to the seven digits of a float32; what is not finite becomes None, since JSON has no NaN."""
    exact = values.astype(np.float64)
    known = np.isfinite(exact)
    with np.errstate(divide="ignore", invalid="ignore"):
        digits = 6 - np.floor(np.log10(np.abs(exact)))
    # Above 10^22 a power of ten is not exact; such numbers stay as they are.
    scaled = known & (exact != 0.0) & (np.abs(digits) <= 22)
    power = 10.0 ** np.abs(digits, where=scaled, out=np.zeros_like(exact))
    up = digits >= 0
    whole = np.rint(np.where(up, exact * power, exact / power))
    rounded = np.where(scaled, np.where(up, whole / power, whole * power), exact)
    return [value if ok else None for value, ok in zip(rounded.tolist(), known.tolist(), strict=True)]


def frame_files(name: str, folder: Path, products: Collection[str]) -> list[Path]:
    """Return the files of a frame's own."""
    endings = [ending for product, ending in FRAME_FILES.items() if product in products]
    return [folder / FRAME_FOLDER / f"{name}{ending}" for ending in endings]


def has_files(name: str, folder: Path, products: Collection[str]) -> bool:
    """Return whether all files of a frame's own exist."""
    return all(path.is_file() for path in frame_files(name, folder, products))


def write_frame(name: str, scan: Scan, classed: ClassedSectors, folder: Path, products: Collection[str]) -> None:
    """Write those ``products`` that are data of a frame to ``folder / "frames"``, without flushing them to the disk.

    Parameters
    ----------
    name : str
        Name of the frame and of its files.
    scan : Scan
    classed : ClassedSectors
    folder : Path
    products : collection of str
        Polygons and cloud; others, such as the picture, are not written here.
    """
    for path in frame_files(name, folder, products):
        path.parent.mkdir(exist_ok=True)
        if path.suffix == FRAME_FILES["polygons"]:
            write_polygons(name, classed, path)
        elif path.suffix == FRAME_FILES["cloud"]:
            write_cloud(scan, classed, path)
