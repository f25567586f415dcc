"""Point cloud files with hand-counted points, written on the spot."""

import struct
from pathlib import Path

import laspy
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


@pytest.fixture
def las(tmp_path):
    return LasMaker(tmp_path)


@pytest.fixture
def read():
    """All points that count, (n, 3) in metres, and which are ground, in one array each."""

    def read_all(reader, points=1_000_000):
        clouds = list(reader.chunks(points))
        if not clouds:
            return np.zeros((0, 3)), np.zeros(0, bool)
        table = [np.column_stack([c.easting, c.northing, c.upward]) for c in clouds]
        return np.concatenate(table), np.concatenate([c.is_ground for c in clouds])

    return read_all


@pytest.fixture
def utm_wkt():
    return CRS("EPSG:32614").to_wkt("WKT1_GDAL")
