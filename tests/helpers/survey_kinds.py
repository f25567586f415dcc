"""One survey in every format that is read; what a reader gives of it, joined."""

import las_files
import numpy as np
from ply_files import write_ply
from pypcd4 import Encoding, PointCloud

KINDS = ("las", "laz", "copc", "ply", "text ply", "pcd", "text pcd", "packed pcd")
TABLES = {
    "ply ascii": "=",
    "ply little": "<",
    "ply big": ">",
    "pcd ascii": Encoding.ASCII,
    "pcd binary": Encoding.BINARY,
    "pcd binary_compressed": Encoding.BINARY_COMPRESSED,
}
_FORMS = {
    "ply": "ply big",
    "text ply": "ply ascii",
    "pcd": "pcd binary",
    "text pcd": "pcd ascii",
    "packed pcd": "pcd binary_compressed",
}


def write_table(path, form, columns, **how):
    """Write columns, by their names, in a form of the ``TABLES``; ``how``: see `write_ply`."""
    names, arrays = [*columns], [*columns.values()]
    if form.startswith("ply"):
        return write_ply(path, np.rec.fromarrays(arrays, names=names), order=TABLES[form], **how)
    PointCloud.from_points(arrays, names, [array.dtype for array in arrays]).save(str(path), TABLES[form])
    return path


def write_kind(kind, folder, points):
    """Write points (n, 3) as a survey of one of the ``KINDS``, always to the same path of a folder; return it."""
    points = np.asarray(points, float)
    if kind in _FORMS:
        form = _FORMS[kind]
        return write_table(folder / f"a.{form[:3]}", form, dict(zip("xyz", points.T, strict=True)))
    data = las_files.las_bytes(points, version="1.4", fmt=7)
    if kind == "laz":
        data = las_files.packed(data, max(len(points) // 10, 1))
    path = folder / {"las": "a.las", "laz": "a.laz", "copc": "a.copc.laz"}[kind]
    path.write_bytes(las_files.octree(data) if kind == "copc" else data)
    return path


def batches_of(reader, points=500_000, order=None):
    """Chunks of a reader as batches, in the order given, or in their own."""
    chunks = reader.chunks(points)
    chosen = chunks if order is None else [chunks[i] for i in order]
    return [reader.convert(chunk, reader.fetch(chunk)) for chunk in chosen]


def table_of(clouds):
    """Easting, northing, upward and kind of the points that count, (n, 4)."""
    tables = [np.column_stack([cloud.easting, cloud.northing, cloud.upward, cloud.kind]) for cloud in clouds]
    return np.concatenate([np.zeros((0, 4)), *tables])


def read_points(reader, points=1_000_000):
    """All points that count, (n, 3) in metres, and which are ground."""
    clouds = list(reader.clouds(points))
    return table_of(clouds)[:, :3], np.concatenate([np.zeros(0, bool), *(cloud.is_ground for cloud in clouds)])
