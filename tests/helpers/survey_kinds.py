"""One survey in every format that is read."""

import las_files
import numpy as np
from ply_files import write_ply
from pypcd4 import Encoding, PointCloud

KINDS = ("las", "laz", "copc", "ply", "text ply", "pcd", "text pcd", "packed pcd")
STREAMED = ("text ply", "text pcd", "packed pcd")
"""Kinds that are not read by ranges of bytes."""
_ENCODINGS = {"pcd": Encoding.BINARY, "text pcd": Encoding.ASCII, "packed pcd": Encoding.BINARY_COMPRESSED}


def write_kind(kind, folder, points):
    """Write points (n, 3) as a survey of one of the ``KINDS``, always to the same path of a folder; return it."""
    points = np.asarray(points, float)
    if kind in _ENCODINGS:
        path = folder / "a.pcd"
        PointCloud.from_points([*points.T], [*"xyz"], [np.float64] * 3).save(str(path), _ENCODINGS[kind])
        return path
    if kind.endswith("ply"):
        vertex = np.rec.fromarrays(points.T, names="x,y,z")
        return write_ply(folder / "a.ply", vertex, order="=" if kind == "text ply" else ">")
    data = las_files.las_bytes(points, version="1.4", fmt=7)
    if kind == "laz":
        data = las_files.packed(data, max(len(points) // 10, 1))
    path = folder / {"las": "a.las", "laz": "a.laz", "copc": "a.copc.laz"}[kind]
    path.write_bytes(las_files.octree(data) if kind == "copc" else data)
    return path
