"""Write frames/NAME.ply: the points of a scan with their classes."""

from pathlib import Path

import numpy as np

from bumpymap.core import ClassedSectors, Scan, point_classes, write_vertices
from bumpymap.layers.scan.style import SCAN_COLOURS, style_index

__all__ = ["write_cloud"]

_ABOUT = (
    "bumpymap scan: sensor frame, x forward, y left, z up, metres",
    "class 0 smooth, 1 fair, 2 rough, 255 not traversable or in no sector",
)


def write_cloud(scan: Scan, classed: ClassedSectors, path: Path) -> None:
    """Write binary little-endian PLY: x, y, z, red, green, blue, class; intensity and label if the scan has them."""
    kinds = [(axis, "<f4") for axis in "xyz"] + [(colour, "u1") for colour in ("red", "green", "blue", "class")]
    beside = {
        name: values for name, values in (("intensity", scan.intensity), ("label", scan.label)) if values is not None
    }
    kinds += [(name, values.dtype.newbyteorder("<").str) for name, values in beside.items()]
    vertex = np.empty(len(scan.points), kinds)
    colours = SCAN_COLOURS[style_index(classed.class_id, classed.sectors.point_sector)]
    for number, (axis, colour) in enumerate(zip("xyz", ("red", "green", "blue"), strict=True)):
        vertex[axis], vertex[colour] = scan.points[:, number], colours[:, number]
    vertex["class"] = point_classes(scan, classed)
    for name, values in beside.items():
        vertex[name] = values
    with path.open("wb") as stream:
        write_vertices(vertex, _ABOUT, stream)
