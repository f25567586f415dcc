"""A made-up site for routes: a wall of steep ground with a gap, and a patch of unknown ground."""

from dataclasses import replace

import numpy as np
from cost_maps import make_map
from pyproj import Transformer

from bumpymap.core import NO_CLASS, Reason, TextureMap
from bumpytiles import Grid

ROWS, COLS = 24, 30
WEST, SOUTH = 160_000, 712_000
TO_DEGREES = Transformer.from_crs("EPSG:32614", "EPSG:4326", always_xy=True)


def place(row, col):
    """Easting and northing of field coordinates, as text."""
    return f"{(WEST + col) * 3.0},{(SOUTH + ROWS - row) * 3.0}"


def lonlat(row, col):
    lon, lat = TO_DEGREES.transform((WEST + col) * 3.0, (SOUTH + ROWS - row) * 3.0)
    return f"{lon:.9f},{lat:.9f}"


def site(*, seed=1):
    """A wall of steep ground in the middle, with a gap in the north; a patch of unknown ground in the south-west."""
    row, col = (index.ravel() for index in np.mgrid[0:ROWS, 0:COLS])
    unknown = (row > 18) & (col < 5)
    reason = np.where(unknown, Reason.TOO_FEW_POINTS, Reason.OK)
    class_id = np.where(unknown, NO_CLASS, 0)
    made = make_map(WEST + col, SOUTH + ROWS - 1 - row, class_id, reason, grid=Grid(3.0, 4), seed=seed, easy=True)
    wall = (col == 15) & (row > 2)
    slope = np.where(wall, 60.0, 2.0)
    c_r = np.where(unknown, np.nan, 0.1 + 0.05 * (seed - 1)).astype(np.float32)
    p_fail = np.where(unknown, np.nan, 0.01).astype(np.float32)
    patches = replace(made.patches, slope=slope)
    nothing = TextureMap.unknown(len(col))
    return replace(
        made, patches=patches, textures=nothing, c_r=c_r, c_r_low=c_r * 0.8, c_r_high=c_r * 1.2, p_fail=p_fail
    )
