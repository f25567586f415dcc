"""Yards within walls, surveyed and mapped, and who gets out of them: routes, and tools that read the map."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from scenes import Place, ring, survey_scene
from scipy.ndimage import distance_transform_edt
from skimage.graph import MCP_Geometric
from small_surveys import write_las

import bumpymap
from bumpymap.layers import open_map
from bumpymap.views import ExportSettings, export_map

SIDE_M = 24.0
LETHAL = 98
"""Above this value of a cell, planners of Nav2 do not plan."""
TOOLS = ("cost.tif", "cost.tif on pixels", "Nav2, tiles", "Nav2, pixels")


@dataclass(frozen=True)
class Yard:
    """A square of walls 2 m high; the gap is in the middle of the eastern one."""

    gap: float
    thickness: float
    density: float
    classified: bool
    seed: int
    noise: float = 0.01

    @property
    def place(self):
        """Where it lies, at any heading."""
        rng = np.random.default_rng(self.seed)
        return Place(rng.uniform(0, 90), 500_000 + rng.uniform(0, 3), 5_700_000 + rng.uniform(0, 3))

    @property
    def ends(self):
        """Places in the middle of the yard, and beyond the eastern wall."""
        return [tuple(map(float, self.place.of_scene(x, 0.0))) for x in (0.0, 0.5 * SIDE_M + 5.0)]

    def map(self, folder, **settings):
        """Survey it and map it with some settings; returns the folder of the layers."""
        scene = ring(gap=self.gap, thickness=self.thickness, side=SIDE_M)
        points = survey_scene(
            scene,
            self.density,
            classified=self.classified,
            sides=True,
            place=self.place,
            noise=self.noise,
            seed=self.seed,
            margin=6.0,
        )
        write_points(points, folder / "yard.las")
        bumpymap.map_survey(folder / "yard.las", folder / "layers", **settings)
        return folder / "layers"

    def crossed(self, is_open, transform):
        """Whether a least-cost tool that steps to all eight neighbours gets from the yard to the ground around it."""
        rows, cols = np.nonzero(is_open)
        x, y = self.place.in_scene(*(transform * (cols + 0.5, rows + 0.5)))
        far = np.maximum(np.abs(x), np.abs(y))
        places = np.column_stack([rows, cols])
        yard, around = places[far < 0.5 * SIDE_M - 3.0], places[far > 0.5 * SIDE_M + 2.0]
        if not (len(yard) and len(around)):
            raise AssertionError("nothing is open on one side of the wall, so nothing is asked")
        reached = MCP_Geometric(np.where(is_open, 1.0, -1.0)).find_costs(yard)[0]
        return bool(np.isfinite(reached[tuple(around.T)]).any())

    def crossed_by_tools(self, layers):
        """Return by name which of `TOOLS` get across the wall."""
        site, found = open_map(layers), {}
        export_map(site, layers.parent / "pixels", ExportSettings(to="cost"))
        for name, folder in zip(TOOLS[:2], (layers, layers.parent / "pixels"), strict=True):
            with rasterio.open(folder / "cost.tif") as raster:
                found[name] = self.crossed(np.isfinite(raster.read(1)), raster.transform)
                corner = raster.transform
        for name, resolution in zip(TOOLS[2:4], ("tile", "pixel"), strict=True):
            folder = layers.parent / f"nav2_{resolution}"
            export_map(site, folder, ExportSettings(to="nav2", resolution=resolution))
            cells = read_pgm(folder / "map.pgm")
            cell = site.grid.tile_size if resolution == "tile" else site.grid.pixel_size
            is_open = cells <= LETHAL
            if resolution == "pixel":  # as the inflation layer does, by half the vehicle's width
                is_open &= distance_transform_edt(is_open) * cell > 0.5 * site.vehicle.width_m
            step = rasterio.Affine(cell, 0.0, corner.c, 0.0, -cell, corner.f)
            found[name] = self.crossed(is_open, step)
        return found

    def way_out(self, layers):
        """Return the line of the route out of the yard, (n, 2) in its own frame, and its m on obstacles; or None."""
        try:
            (route,) = bumpymap.find_routes(layers, *self.ends, snap=6.0)
        except bumpymap.BadInputError as error:
            if "there is no way" not in str(error):
                raise
            return None
        return np.column_stack(self.place.in_scene(*route.line.T)), route.figures.obstacle_m

    def is_reached(self, layers):
        """Whether what can be reached from the yard holds the ground around it."""
        start, goal = self.ends
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
