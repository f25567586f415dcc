"""One tiny valid survey of each kind. Damage starts here."""

from functools import cache

import numpy as np
from pyproj import CRS

from .copc_file import copc_file
from .las_file import Vlr, cloud, las_file
from .text_file import pcd_file, ply_file

__all__ = ["bases", "geokeys", "utm", "wkt"]


def wkt(text):
    """Record of a CRS as text."""
    return Vlr(b"LASF_Projection", 2112, text if isinstance(text, bytes) else text.encode() + b"\0")


def geokeys(keys, count=None):
    """Record of GeoTIFF keys; ``count``: how many it claims, the truth by default."""
    words = [1, 1, 0, len(keys) if count is None else count]
    words += [word for key, value in sorted(keys.items()) for word in (key, 0, 1, value)]
    return Vlr(b"LASF_Projection", 34735, np.array(words, "<u2").tobytes())


def utm():
    """Record of the CRS that the LAS 1.4 surveys have."""
    return wkt(CRS.from_epsg(32614).to_wkt("WKT1_GDAL"))


@cache
def bases(count=400):
    """Name to bytes: surveys of ``count`` points, a multiple of 20 and at least 40."""
    xyz = cloud(count)
    keys = geokeys({1024: 1, 3072: 32614})
    fifth = count // 5
    uneven = [fifth // 2, fifth + fifth // 2, fifth, fifth - fifth // 4, count - 3 * fifth - (fifth - fifth // 4)]
    fixed = {"minor": 2, "fmt": 3, "vlrs": [keys]}
    varied = {"minor": 4, "wkt_bit": True}
    return {
        "las12.las": las_file(xyz, **fixed),
        "las14.las": las_file(xyz, fmt=7, vlrs=[utm()], evlrs=[Vlr(b"note", 7, b"n" * 40)], **varied),
        "laz12.laz": las_file(xyz, chunks=fifth, **fixed),
        "laz14.laz": las_file(xyz, fmt=6, chunks=fifth, evlrs=[utm()], **varied),
        "laz14v.laz": las_file(xyz, fmt=7, chunks=uneven, vlrs=[utm()], **varied),
        "copc.copc.laz": copc_file(xyz, [utm()]).data,
        "text.ply": ply_file(xyz, "ascii"),
        "little.ply": ply_file(xyz, "binary_little_endian"),
        "big.ply": ply_file(xyz, "binary_big_endian"),
        "text.pcd": pcd_file(xyz, "ascii"),
        "binary.pcd": pcd_file(xyz, "binary"),
        "packed.pcd": pcd_file(xyz, "binary_compressed"),
    }
