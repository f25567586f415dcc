"""One tiny valid survey of each kind. Damage starts here."""

from functools import cache

from pyproj import CRS

from .las_file import cloud, las_file
from .text_file import pcd_file, ply_file

from las_files import geokeys, octree, wkt  # isort: skip (las_file finds it)


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
        "las14.las": las_file(xyz, fmt=7, vlrs=[utm()], evlrs=[("note", 7, b"n" * 40)], **varied),
        "laz12.laz": las_file(xyz, chunks=fifth, **fixed),
        "laz14.laz": las_file(xyz, fmt=6, chunks=fifth, evlrs=[utm()], **varied),
        "laz14v.laz": las_file(xyz, fmt=7, chunks=uneven, vlrs=[utm()], **varied),
        "copc.copc.laz": octree(las_file(xyz, minor=4, fmt=7, vlrs=[utm()]), levels=1, page_levels=1),
        "text.ply": ply_file(xyz, "ascii"),
        "little.ply": ply_file(xyz, "binary_little_endian"),
        "big.ply": ply_file(xyz, "binary_big_endian"),
        "text.pcd": pcd_file(xyz, "ascii"),
        "binary.pcd": pcd_file(xyz, "binary"),
        "packed.pcd": pcd_file(xyz, "binary_compressed"),
    }
