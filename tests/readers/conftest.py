"""Point cloud files with hand-counted points, written on the spot."""

import struct
from pathlib import Path

import numpy as np
import point_files
import pytest

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
"""Rows 0 to 3 of ``POINTS`` count: 4 and 5 are noise, 6 is withheld."""


class LasMaker:
    """Writes LAS and LAZ files, and spoils them; COPC, and LAZ with chunks of any size."""

    points, classes, withheld = POINTS, CLASSES, WITHHELD

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def write(self, name="a.las", points=POINTS, *, wkt=None, epsg=None, geokeys=None, evlr_wkt=None, **how):
        """A file of the points; ``epsg`` and ``geokeys`` make GeoTIFF keys, ``wkt`` a WKT record."""
        keys = dict(geokeys or {}) | ({1024: 1, 3072: epsg} if epsg else {})
        records = [*[point_files.geokeys(keys)] * bool(keys), *(point_files.wkt(one) for one in (wkt,) if one)]
        extended = [point_files.wkt(one) for one in (evlr_wkt,) if one]
        how = {"wkt_bit": bool(wkt), "records": records, "extended": extended} | how
        path = self.folder / name
        path.write_bytes(point_files.las_bytes(points, compress=name.endswith(".laz"), **how))
        return path

    @staticmethod
    def patch(path: Path, place: int, layout: str, *values):
        """Overwrite header bytes."""
        data = bytearray(path.read_bytes())
        struct.pack_into(layout, data, place, *values)
        path.write_bytes(data)
        return path

    @staticmethod
    def pack(path: Path, chunk=None, counts=None) -> Path:
        """LAZ of a LAS file, with chunks of ``chunk`` points, or of ``counts`` points each."""
        out = path.with_suffix(".laz")
        out.write_bytes(point_files.packed(path.read_bytes(), chunk, counts))
        return out

    @staticmethod
    def octree(path: Path, **how) -> Path:
        """COPC of a LAS file, see `point_files.octree`."""
        out = path.with_suffix(".copc.laz")
        out.write_bytes(point_files.octree(path.read_bytes(), **how))
        return out


@pytest.fixture
def las(tmp_path):
    return LasMaker(tmp_path)
