"""Point cloud files with hand-counted points, written on the spot."""

import io
import struct
from pathlib import Path

import laspy
import lazrs
import numpy as np
import pytest
from pyproj import CRS

POINTS = np.array(
    [
        [500000.001, 4000000.002, 10.5],
        [500001.25, 4000000.75, 10.625],
        [500002.5, 4000003.0, 11.0],
        [500004.999, 4000004.999, 12.001],
        [500003.0, 4000001.5, 99.0],
        [500003.5, 4000001.5, -99.0],
        [500000.5, 4000002.5, 10.0],
    ]
)
CLASSES = np.array([2, 1, 2, 5, 7, 18, 2], np.uint8)
WITHHELD = np.array([0, 0, 0, 0, 0, 0, 1], bool)
COUNTING = [0, 1, 2, 3]
"""Rows of ``POINTS`` that count: not noise (4, 5), not withheld (6)."""


class LasMaker:
    """Writes LAS and LAZ files, and spoils them."""

    points, classes, withheld, counting = POINTS, CLASSES, WITHHELD, COUNTING

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(
        self, name="a.las", points=POINTS, *, version="1.2", fmt=1, scale=0.001, offset=(500000.0, 4000000.0, 0.0),
        classes=None, withheld=None, wkt=None, epsg=None, geokeys=None, wkt_bit=None, evlr_wkt=None,
    ):  # fmt: skip
        """A file of the points; ``epsg`` and ``geokeys`` make GeoTIFF keys, ``wkt`` a WKT record."""
        header = laspy.LasHeader(version=version, point_format=fmt)
        header.scales, header.offsets = np.broadcast_to(scale, 3).astype(float), np.array(offset, float)
        keys = dict(geokeys or {}) | ({1024: 1, 3072: epsg} if epsg else {})
        if keys:
            words = [1, 1, 0, len(keys)] + [word for key in sorted(keys) for word in (key, 0, 1, keys[key])]
            header.vlrs.append(laspy.VLR("LASF_Projection", 34735, "", np.array(words, "<u2").tobytes()))
        if wkt is not None:
            header.vlrs.append(laspy.VLR("LASF_Projection", 2112, "", wkt.encode() + b"\0"))
        header.global_encoding.wkt = bool(wkt) if wkt_bit is None else wkt_bit
        las = laspy.LasData(header)
        las.x, las.y, las.z = np.asarray(points, float).T
        if classes is not None:
            las.classification = classes
        if withheld is not None:
            las.withheld = withheld
        if evlr_wkt is not None:
            las.evlrs = laspy.vlrs.vlrlist.VLRList([laspy.VLR("LASF_Projection", 2112, "", evlr_wkt.encode() + b"\0")])
        path = self.folder / name
        las.write(path)
        return path

    @staticmethod
    def patch(path: Path, place: int, layout: str, *values):
        """Overwrite header bytes."""
        data = bytearray(path.read_bytes())
        struct.pack_into(layout, data, place, *values)
        path.write_bytes(data)
        return path


class LazMaker:
    """Compresses the points of LAS files in ways that laspy does not offer: chunks of any size, an octree."""

    @staticmethod
    def pack(path: Path, chunk=None, counts=None) -> Path:
        """LAZ with chunks of ``chunk`` points, or of ``counts`` points each."""
        with laspy.open(path) as file:
            header, points = file.header, file.read().points.array
        record = lazrs.LazVlr.new_for_compression(
            header.point_format.id, header.point_format.num_extra_bytes, counts is not None
        ).record_data()
        if chunk is not None:
            record = record[:12] + struct.pack("<I", chunk) + record[16:]
        stream = io.BytesIO()
        compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(record))
        if counts is None:
            compressor.compress_many(points.view(np.uint8))
        for part in np.split(points, np.cumsum(counts)[:-1]) if counts is not None else ():
            compressor.compress_many(part.view(np.uint8))
            compressor.finish_current_chunk()
        compressor.done()
        data = stream.getvalue()
        start = LazMaker.points_at(path, [len(record)])
        (table,) = struct.unpack_from("<q", data)
        return LazMaker.join(path, [(b"laszip encoded", 22204, record)], struct.pack("<q", table + start) + data[8:])

    @staticmethod
    def points_at(path: Path, lengths) -> int:
        """Where points start once records of such lengths are added."""
        return struct.unpack_from("<I", path.read_bytes(), 96)[0] + sum(54 + length for length in lengths)

    @staticmethod
    def join(path: Path, records, data: bytes) -> Path:
        """A compressed file: the header and records of ``path``, new records before them, other data."""
        head = bytearray(path.read_bytes())
        size, start, count = struct.unpack_from("<HII", head, 94)
        new = b"".join(
            struct.pack("<H16sHH32s", 0, user, number, len(body), b"") + body for user, number, body in records
        )
        struct.pack_into("<II", head, 96, start + len(new), count + len(records))
        head[104] |= 0x80
        out = path.with_suffix(".laz")
        out.write_bytes(bytes(head[:size]) + new + bytes(head[size:start]) + data)
        return out

    @staticmethod
    def octree(path: Path, levels=3, seed=0, page_levels=None) -> Path:
        """COPC: every point goes to the node around it on a random level. Pages begin below ``page_levels``."""
        with laspy.open(path) as file:
            header, las = file.header, file.read()
        half = float((header.maxs - header.mins).max()) / 2 + 1
        middle = (header.maxs + header.mins) / 2
        level = np.random.default_rng(seed).integers(0, levels + 1, len(las.points))
        cell = np.column_stack([las.x, las.y, las.z]) - (middle - half)
        cell = (cell // (2 * half / 2**level)[:, None]).astype(int)
        keys, node = np.unique(np.column_stack([level, cell]), axis=0, return_inverse=True)
        fmt, extra = header.point_format.id, header.point_format.num_extra_bytes
        record = lazrs.LazVlr.new_for_compression(fmt, extra, True).record_data()
        stream = io.BytesIO()
        compressor = lazrs.LasZipCompressor(stream, lazrs.LazVlr(record))
        compressor.reserve_offset_to_chunk_table()
        start = LazMaker.points_at(path, [160, len(record)])
        entries = []
        # In the file the nodes stand in another order than in space.
        for key in np.random.default_rng(seed + 1).permutation(len(keys)):
            points = las.points.array[node.ravel() == key]
            before = stream.tell()
            compressor.compress_many(points.view(np.uint8))
            compressor.finish_current_chunk()
            entries.append([*keys[key].tolist(), start + before, stream.tell() - before, len(points)])
        compressor.done()
        data = bytearray(stream.getvalue())
        struct.pack_into("<q", data, 0, struct.unpack_from("<q", data)[0] + start)
        pages = LazMaker.pages(entries, page_levels, start + len(data) + 60)
        info = struct.pack("<5d2Q2d11Q", *middle, half, 1.0, start + len(data) + 60, len(pages[0]), 0, 0, *[0] * 11)
        body = b"".join(pages)
        evlr = struct.pack("<H16sHQ32s", 0, b"copc", 1000, len(body), b"") + body
        out = LazMaker.join(path, [(b"copc", 1, info), (b"laszip encoded", 22204, record)], bytes(data) + evlr)
        LasMaker.patch(out, 235, "<QI", start + len(data), 1)
        return out.rename(out.with_suffix(".copc.laz"))

    @staticmethod
    def pages(entries, page_levels, start):
        """Pages of the hierarchy: the first, and one for each node at ``page_levels`` with all below it."""
        pack = struct.Struct("<4iQ2i").pack
        top = [entry for entry in entries if page_levels is None or entry[0] < page_levels]
        below = {}
        for entry in entries if page_levels is not None else ():
            if entry[0] >= page_levels:
                key = tuple(value >> (entry[0] - page_levels) for value in entry[1:4])
                below.setdefault(key, []).append(entry)
        place = start + 32 * (len(top) + len(below))
        further = []
        for key, held in below.items():
            top.append([page_levels, *key, place, 32 * len(held), -1])
            further.append(b"".join(pack(*entry) for entry in held))
            place += 32 * len(held)
        return [b"".join(pack(*entry) for entry in top), *further]


@pytest.fixture
def las(tmp_path):
    return LasMaker(tmp_path)


@pytest.fixture
def laz():
    return LazMaker()


@pytest.fixture
def batches():
    """Pieces of a reader as batches, in the order given, or in their own."""

    def read_chunks(reader, points=500_000, order=None):
        chunks = reader.chunks(points)
        chosen = chunks if order is None else [chunks[i] for i in order]
        return [reader.convert(chunk, reader.fetch(chunk)) for chunk in chosen]

    return read_chunks


@pytest.fixture
def table():
    """Points that count of some batches, (n, 4): easting, northing, upward, ground."""

    def join(found):
        clouds = [batch.cloud for batch in found]
        return np.concatenate([np.column_stack([c.easting, c.northing, c.upward, c.is_ground]) for c in clouds])

    return join


@pytest.fixture
def read():
    """All points that count, (n, 3) in metres, and which are ground, in one array each."""

    def read_all(reader, points=1_000_000):
        clouds = list(reader.clouds(points))
        if not clouds:
            return np.zeros((0, 3)), np.zeros(0, bool)
        table = [np.column_stack([c.easting, c.northing, c.upward]) for c in clouds]
        return np.concatenate(table), np.concatenate([c.is_ground for c in clouds])

    return read_all


@pytest.fixture
def utm_wkt():
    return CRS("EPSG:32614").to_wkt("WKT1_GDAL")
