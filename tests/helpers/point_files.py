"""PLY number by number, rasters by rasterio, one survey in every format: nothing of the package takes part."""

import struct

import las_files
import numpy as np
import rasterio
from pypcd4 import Encoding, PointCloud
from rasterio.transform import Affine

__all__ = ["ply_bytes", "read_vertices", "write_ply"]

_FORMATS = {"=": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}
_KINDS = {
    "b": "char", "B": "uchar", "h": "short", "H": "ushort", "i": "int", "I": "uint", "f": "float", "d": "double",
}  # fmt: skip
"""Letter of the module struct: name in a header."""


def write_ply(path, vertex, *, order="<", before=(), after=(), name="vertex"):
    """Write a file; a column of objects holds lists of int, whose lengths are uchar."""
    path.write_bytes(ply_bytes([*before, (name, vertex), *after], order))
    return path


def ply_bytes(elements, order):
    """Bytes of a file with elements (name, structured array); order ``=`` is text."""
    lines = ["ply", f"format {_FORMATS[order]} 1.0", "comment made by hand"]
    data = []
    for name, rows in elements:
        letters = [rows.dtype[column].char for column in rows.dtype.names]
        lines.append(f"element {name} {len(rows)}")
        lines += [
            f"property {'list uchar int' if letter == 'O' else _KINDS[letter]} {column}"
            for column, letter in zip(rows.dtype.names, letters, strict=True)
        ]
        data += [_row(row, letters, order) for row in rows.tolist()]
    return "\n".join([*lines, "end_header", ""]).encode() + b"".join(data)


def read_vertices(path):
    """Rows of a binary little-endian file that holds one element, ``vertex``, without lists."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    lines = head.decode("ascii").splitlines()
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"]
    lines = [line for line in lines[2:] if not line.startswith("comment ")]
    element, vertex, count = lines[0].split()
    assert (element, vertex) == ("element", "vertex")
    letters = {name: letter for letter, name in _KINDS.items()}
    words = [line.split() for line in lines[1:]]
    assert {word for word, _, _ in words} == {"property"}
    dtype = np.dtype([(name, f"<{np.dtype(letters[kind]).str[1:]}") for _, kind, name in words])
    assert len(body) == int(count) * dtype.itemsize
    return np.frombuffer(body, dtype)


def _row(values, letters, order):
    """Text, or bytes, of one row."""
    flat, kinds = [], ""
    for value, letter in zip(values, letters, strict=True):
        entries = [len(value), *(int(entry) for entry in value)] if letter == "O" else [value]
        flat += entries
        kinds += "B" + "i" * (len(entries) - 1) if letter == "O" else letter
    if order == "=":
        return (" ".join(repr(value) for value in flat) + "\n").encode()
    return struct.pack(order + kinds, *flat)


WEST, NORTH = 500_001.0, 4_000_031.0


def write_raster(path, bands, *, pixel=0.2, crs="EPSG:32614", transform=None, scale=None, mask=None, **profile):
    """Write bands, (rows, cols) or (bands, rows, cols), north row first, with the corner at ``WEST``, ``NORTH``."""
    bands = np.atleast_3d(bands) if np.ndim(bands) == 3 else np.asarray(bands)[None]
    transform = Affine(pixel, 0, WEST, 0, -pixel, NORTH) if transform is None else transform
    count, height, width = bands.shape
    how = {"driver": "GTiff", "dtype": bands.dtype, "count": count, "height": height, "width": width, "crs": crs}
    path.parent.mkdir(parents=True, exist_ok=True)
    with (
        rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"),
        rasterio.open(path, "w", transform=transform, **how | profile) as f,
    ):
        f.write(bands)
        if scale is not None:
            f.scales, f.offsets = (scale,) * count, (100.0,) * count
        if mask is not None:
            f.write_mask(mask)
    return path


def ground(rows=150, cols=140, seed=3):
    """Rolling ground with a step, on whole centimetres, m."""
    y, x = np.mgrid[:rows, :cols] * 0.2
    bumps = 0.05 * np.random.default_rng(seed).standard_normal((rows, cols))
    return np.round(100.0 + 0.1 * np.sin(2.0 * x) + 0.05 * y + bumps + 0.6 * (x > 20.0), 2)


def middles(shape, pixel=0.2):
    """Easting and northing of the middles of pixels, (rows, cols) each."""
    row, col = np.indices(shape)
    return WEST + (col + 0.5) * pixel, NORTH - (row + 0.5) * pixel


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
