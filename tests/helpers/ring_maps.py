"""Who gets out of a ring that was mapped: tools that read the map."""

from pathlib import Path

import numpy as np
import rasterio
from scipy.ndimage import distance_transform_edt
from skimage.graph import MCP_Geometric
from small_surveys import write_las

import bumpymap
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

LETHAL = 98
"""Above this value of a cell, planners of Nav2 do not plan."""


def crossed(ring, is_open, transform):
    """Whether a least-cost tool that steps to all eight neighbours gets from the yard to the ground around it."""
    rows, cols = np.nonzero(is_open)
    x, y = ring.place.in_scene(*(transform * (cols + 0.5, rows + 0.5)))
    far = np.maximum(np.abs(x), np.abs(y))
    places = np.column_stack([rows, cols])
    yard, around = places[far < 9.0], places[far > 14.0]
    if not (len(yard) and len(around)):
        raise AssertionError("nothing is open on one side of the wall, so nothing is asked")
    reached = MCP_Geometric(np.where(is_open, 1.0, -1.0)).find_costs(yard)[0]
    return bool(np.isfinite(reached[tuple(around.T)]).any())


def crossed_by_tools(ring, layers):
    """Return by name which tools get across the ring."""
    site, found = open_map(layers), {}
    export_map(site, layers.parent / "pixels", ExportSettings(to="cost"))
    for name, folder in (("cost.tif", layers), ("cost.tif on pixels", layers.parent / "pixels")):
        with rasterio.open(folder / "cost.tif") as raster:
            found[name] = crossed(ring, np.isfinite(raster.read(1)), raster.transform)
            corner = raster.transform
    for resolution in ("tile", "pixel"):
        folder = layers.parent / f"nav2_{resolution}"
        export_map(site, folder, ExportSettings(to="nav2", resolution=resolution))
        cells = read_pgm(folder / "map.pgm")
        cell = site.grid.tile_size if resolution == "tile" else site.grid.pixel_size
        is_open = cells <= LETHAL
        if resolution == "pixel":  # as the inflation layer does, by half the vehicle's width
            is_open &= distance_transform_edt(is_open) * cell > 0.5 * site.vehicle.width_m
        step = rasterio.Affine(cell, 0.0, corner.c, 0.0, -cell, corner.f)
        found[f"Nav2, {resolution}s"] = crossed(ring, is_open, step)
    return found


def is_reached(ring, layers):
    """Whether what can be reached from the middle of a ring holds the ground around it."""
    start, goal = ring.ends
    reach = bumpymap.map_reach(layers, start, snap=6.0)
    return bool(np.isfinite(reach.cost.sel(x=goal[0], y=goal[1], method="nearest")))


def write_points(points, path):
    """Write points of a scene as LAS."""
    corner, columns = (500_000, 5_700_000, 0), {"classification": points.classification}
    write_las(path, points.x, points.y, points.z + 100.0, crs="EPSG:32632", offset=corner, **columns)


def read_pgm(path):
    """Read a binary image."""
    header, _, rest = Path(path).read_bytes().partition(b"\n255\n")
    cols, rows = map(int, header.split()[1:3])
    return np.frombuffer(rest, np.uint8).reshape(rows, cols)
