"""Small LAS and LAZ surveys, good ones and broken ones."""

import laspy
import numpy as np
from pyproj import CRS


def write_survey(path, *, epsg=32614, points=20_000, seed=0, side=20.0):
    """Nearly flat ground of some tiles; no CRS if ``epsg`` is None."""
    rng = np.random.default_rng(seed)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = (500_000, 4_000_000, 0), (0.001, 0.001, 0.001)
    if epsg is not None:
        header.add_crs(CRS.from_epsg(epsg))
    las = laspy.LasData(header)
    las.x, las.y = rng.uniform(500_001, 500_001 + side, points), rng.uniform(4_000_002, 4_000_002 + side, points)
    las.z = 100 + 0.02 * rng.standard_normal(points)
    path.parent.mkdir(parents=True, exist_ok=True)
    las.write(path)
    return path


def write_broken(path):
    """The first half of a survey."""
    data = write_survey(path).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path
