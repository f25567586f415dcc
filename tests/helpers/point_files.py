"""LAS, LAZ and COPC of chosen points; PLY number by number, rasters by rasterio, one survey in every format."""

import io
import struct
from datetime import date

import laspy
import lazrs
import numpy as np
import rasterio
from pypcd4 import Encoding, PointCloud
from rasterio.transform import Affine

ENTRY = struct.Struct("<4iQ2i")
"""Entry of a COPC hierarchy: level, x, y, z, offset, bytes, points; -1 points: it stands for another page."""


def wkt(text):
    """Record of a CRS as text: user, number, data."""
    return "LASF_Projection", 2112, text if isinstance(text, bytes) else text.encode() + b"\0"


def geokeys(keys, count=None):
    """Record of GeoTIFF keys; ``count``: how many it claims, the truth by default."""
    words = [1, 1, 0, len(keys) if count is None else count]
    words += [word for key, value in sorted(keys.items()) for word in (key, 0, 1, value)]
    return "LASF_Projection", 34735, np.array(words, "<u2").tobytes()


def las_bytes(
    points, *, version="1.2", fmt=1, scale=0.001, offset=(500000.0, 4000000.0, 0.0), records=(), extended=(),
    wkt_bit=False, compress=False, **columns,
):  # fmt: skip
    """Bytes of a file; ``records`` are (user, number, data), ``columns`` have the names of laspy."""
    header = laspy.LasHeader(version=version, point_format=fmt)
    header.creation_date = date(2024, 1, 1)
    header.scales, header.offsets = np.broadcast_to(scale, 3).astype(float), np.array(offset, float)
    header.global_encoding.wkt = wkt_bit
    for user, number, data in records:
        header.vlrs.append(laspy.VLR(user, number, "", data))
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.asarray(points, float).T
    for name, values in columns.items():
        las[name] = values
    if extended:
        las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR(user, number, "", data) for user, number, data in extended])
    stream = io.BytesIO()
    las.write(stream, do_compress=compress)
    return stream.getvalue()


def _compressor(data, stream, chunk, variable):
    """Points of a LAS file, what compresses them, and the LASzip record."""
    with laspy.open(io.BytesIO(data)) as file:
        form, points = file.header.point_format, file.read().points.array
    record = lazrs.LazVlr.new_for_compression(form.id, form.num_extra_bytes, variable).record_data()
    if chunk is not None:
        record = record[:12] + struct.pack("<I", chunk) + record[16:]
    return points, lazrs.LasZipCompressor(stream, lazrs.LazVlr(record)), ("laszip encoded", 22204, record)


def packed(data, chunk=None, counts=None):
    """Compress a LAS file in chunks of ``chunk`` points, or of ``counts`` points each."""
    stream = io.BytesIO()
    points, compressor, record = _compressor(data, stream, chunk, counts is not None)
    for number, part in enumerate(np.split(points, np.cumsum(counts or [])[:-1])):
        if number:
            compressor.finish_current_chunk()
        compressor.compress_many(part.view(np.uint8))
    compressor.done()
    return _joined(data, stream.getvalue(), after=[record])


def _joined(data, body, before=(), after=()):
    """A compressed file: the header and records of a plain one, new records around these, other points."""
    head = bytearray(data)
    size, start, count = struct.unpack_from("<HII", head, 94)
    front, back = (
        b"".join(
            struct.pack("<H16sHH32s", 0, user.encode(), number, len(held), b"") + held for user, number, held in records
        )
        for records in (before, after)
    )
    moved, tail = start + len(front) + len(back), b""
    struct.pack_into("<II", head, 96, moved, count + len(before) + len(after))
    head[104] |= 0x80
    if head[25] >= 4:
        extended_at, extended = struct.unpack_from("<QI", data, 235)
        if extended:
            tail = data[extended_at:]
            struct.pack_into("<Q", head, 235, moved + len(body))
    table = struct.pack("<q", struct.unpack_from("<q", body)[0] + moved)
    return bytes(head[:size]) + front + bytes(head[size:start]) + back + table + body[8:] + tail


def octree(data, levels=3, seed=0, page_levels=None):
    """COPC of a LAS 1.4 file: a point goes to the node around it on a random level. Pages begin below ``page_levels``.

    In the file the nodes stand in another order than in space.
    """
    with laspy.open(io.BytesIO(data)) as file:
        header, las = file.header, file.read()
    half = float((header.maxs - header.mins).max()) / 2 + 1
    middle = (header.maxs + header.mins) / 2
    level = np.random.default_rng(seed).integers(0, levels + 1, len(las.points))
    cell = np.column_stack([las.x, las.y, las.z]) - (middle - half)
    cell = (cell // (2 * half / 2**level)[:, None]).astype(int)
    keys, node = np.unique(np.column_stack([level, cell]), axis=0, return_inverse=True)
    stream = io.BytesIO()
    points, compressor, record = _compressor(data, stream, None, True)
    compressor.reserve_offset_to_chunk_table()
    start = struct.unpack_from("<I", data, 96)[0] + 2 * 54 + 160 + len(record[2])
    entries = []
    for key in np.random.default_rng(seed + 1).permutation(len(keys)):
        own, before = points[node.ravel() == key], stream.tell()
        compressor.compress_many(own.view(np.uint8))
        compressor.finish_current_chunk()
        entries.append([*keys[key].tolist(), start + before, stream.tell() - before, len(own)])
    compressor.done()
    end = start + len(stream.getvalue())
    first, rest = _pages(entries, page_levels, end + 60)
    info = struct.pack("<5d2Q2d11Q", *middle, half, 1.0, end + 60, len(first), 0, 0, *[0] * 11)
    made = bytearray(_joined(data, stream.getvalue(), before=[("copc", 1, info)], after=[record]))
    struct.pack_into("<QI", made, 235, end, 1)
    return bytes(made) + struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(first + rest), b"") + first + rest


def _pages(entries, page_levels, start):
    """Pages of the hierarchy: the first, and one for each node at ``page_levels`` with all below it."""
    top = [entry for entry in entries if page_levels is None or entry[0] < page_levels]
    below = {}
    for entry in entries if page_levels is not None else ():
        if entry[0] >= page_levels:
            below.setdefault(tuple(value >> (entry[0] - page_levels) for value in entry[1:4]), []).append(entry)
    place, further = start + ENTRY.size * (len(top) + len(below)), b""
    for key, held in below.items():
        top.append([page_levels, *key, place, ENTRY.size * len(held), -1])
        further += b"".join(ENTRY.pack(*entry) for entry in held)
        place += ENTRY.size * len(held)
    return b"".join(ENTRY.pack(*entry) for entry in top), further


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
    data = las_bytes(points, version="1.4", fmt=7)
    if kind == "laz":
        data = packed(data, max(len(points) // 10, 1))
    path = folder / {"las": "a.las", "laz": "a.laz", "copc": "a.copc.laz"}[kind]
    path.write_bytes(octree(data) if kind == "copc" else data)
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
