"""Write frames/NAME.ply: the points of a scan with their classes."""

from pathlib import Path

import numpy as np

from bumpymap.core import ClassedSectors, Scan, point_classes, write_vertices
from bumpymap.layers.scan.style import SCAN_COLOURS, point_styles

__all__ = ["write_cloud"]

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
