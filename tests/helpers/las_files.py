"""LAS, LAZ and COPC files of points that a test chooses: the one writer of tests that look at bytes."""

import io
import struct
from datetime import date

import laspy
import lazrs
import numpy as np

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
