"""Rings around a place, surveyed and mapped: is there a way out where there is none, and is one found where there is?

A ring is a square of what stands (walls, posts, mesh, cars) or of ground (a step up, a drop, a ditch). Its opening, if
it has one, is in the middle of the eastern side: a gap, with a bar overhead or not, or a bridge or ramp.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import rasterio
from scenes import LEAN, OTHER, Place, Scene, ScenePoints, Solid, fence, survey_scene
from scipy.ndimage import distance_transform_edt
from skimage.graph import MCP_Geometric
from small_surveys import write_las

import bumpymap
from bumpymap.core import ExportSettings
from bumpymap.layers import open_map
from bumpymap.views import export_map

HALF_M, SURVEYED_M = 12.0, 20.0
"""From the middle to the ring, and to the edge of the survey, along the axes of the ring, m."""
GROUND_KINDS = {"step up .5 m": 0.5, "drop 1.2 m": -1.2, "ditch 1 m": 1.0, "ditch 2 m": 2.0}
"""Height of the ground outside, or width of a ditch that is 1 m deep, m."""
STANDING_KINDS = ("wall .1 m", "wall .3 m", "posts", "mesh", "cars")
_DEPTH_M, _GRADE = 1.0, 0.15
"""Depth of ditches, and slope of ramps."""


@dataclass(frozen=True)
class Ring:
    """A ring and how it is surveyed."""

    kind: str
    """One of `STANDING_KINDS` or `GROUND_KINDS`."""
    opening_m: float
    """Width of the gap, bridge or ramp; 0: the ring is closed."""
    density: float
    """Points per m2."""
    noise_m: float = 0.0
    classified: bool = False
    """Ground has class 2, else all points have class 1."""
    sides: bool = False
    """Sides return points too, else the ring is seen from above alone."""
    bar_m: float | None = None
    """Height of a bar of 0.3 m over the gap; half of the pulses on it reach the ground beneath. None: there is none."""
    seed: int = 0

    @property
    def place(self) -> Place:
        """Where it lies: one of five headings, anywhere in a tile."""
        rng = np.random.default_rng((self.seed, 5))
        return Place(18.0 * (self.seed % 5), *(place + rng.uniform(0, 3) for place in (500_000, 5_700_000)))

    def ground(self, x, y):
        """Height of the ground at places in the ring's own frame, m."""
        far = np.maximum(np.abs(x), np.abs(y))
        size = GROUND_KINDS.get(self.kind, 0.0)
        if self.kind.startswith("ditch"):
            height = np.where(np.abs(far - HALF_M) < 0.5 * size, -_DEPTH_M, 0.0)
            across = np.zeros_like(height)
        else:
            height = np.where(far > HALF_M, size, 0.0)
            across = size * np.clip((x - HALF_M) * _GRADE / max(abs(size), 1e-9), 0.0, 1.0)
        return np.where(self._opens(x, y), across, height)

    def _opens(self, x, y):
        return (x > 0) & (np.abs(y) < 0.5 * self.opening_m)

    @property
    def solids(self) -> tuple[Solid, ...]:
        """What stands on the ring."""
        if self.kind in GROUND_KINDS:
            return ()
        solids = [solid for side in range(4) for solid in self._side(90.0 * side)]
        if self.bar_m is not None:
            length = self.opening_m + 1.0
            solids.append(Solid(HALF_M, 0, length, 0.3, self.bar_m + 0.2, turn=90, bottom=self.bar_m, stops=0.5))
        return tuple(solids)

    def _side(self, turn):
        """Return the parts of one side; the first one, to the east, has the gap."""
        gap = self.opening_m if turn == 0.0 else 0.0
        parts = [(-HALF_M, HALF_M)] if gap == 0.0 else [(-HALF_M, -0.5 * gap), (0.5 * gap, HALF_M)]
        for first, last in parts:
            for solid in self._along(first, last):
                c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
                x, y = HALF_M * c - solid.x * s, HALF_M * s + solid.x * c
                yield solid._replace(x=x, y=y, turn=solid.turn + turn + 90.0)

    def _along(self, first, last):
        """Return solids along the x axis."""
        middle, length = 0.5 * (first + last), last - first
        if self.kind.startswith("wall"):
            return [Solid(middle, 0, length, float(self.kind.split()[1]), 2.0, class_id=OTHER)]
        if self.kind == "posts":
            return [Solid(x, 0, 0, 0.1, 1.5, is_round=True) for x in np.linspace(first, last, round(length) + 1)]
        if self.kind == "mesh":
            return [solid._replace(x=solid.x + middle) for solid in fence(height=1.5, length=length).solids]
        count = math.ceil((length + 0.8) / 5.2)  # at most 0.8 m apart
        return [Solid(x, 0, 4.4, 1.8, 1.5) for x in np.linspace(first + 2.2, last - 2.2, count)]

    def survey(self) -> ScenePoints:
        """Survey it."""
        scene = Scene(self.kind, self.solids, half=SURVEYED_M, ground=self.ground)
        seen = {"noise": self.noise_m, "classified": self.classified, "sides": self.sides}
        points = survey_scene(scene, self.density, **seen, place=self.place, seed=self.seed)
        return self._with_faces(points) if self.sides and self.kind in GROUND_KINDS else points

    def _with_faces(self, points):
        """Add the points of the sides of steps and ditches."""
        rng = np.random.default_rng((self.seed, 6))
        wide = 0.5 * GROUND_KINDS[self.kind] if self.kind.startswith("ditch") else 0.0
        rows = []
        for far in {HALF_M - wide, HALF_M + wide}:
            count = rng.poisson(LEAN * self.density * 8 * far)  # of a side 1 m high
            along, side = rng.uniform(-far, far, count), rng.integers(0, 4, count)
            x = np.select([side == 0, side == 1], [far, -far], along)
            y = np.select([side == 2, side == 3], [far, -far], along)
            low, high = np.sort([self.ground(x * scale, y * scale) for scale in (1 - 1e-6, 1 + 1e-6)], axis=0)
            z = np.where(rng.random(count) < high - low, rng.uniform(low, high), np.nan)
            rows.append(np.stack([*self.place.of_scene(x, y), z])[:, np.isfinite(z)])
        more = np.concatenate(rows, axis=1)
        more += self.noise_m * rng.standard_normal(more.shape)
        kind = np.full(more.shape[1], points.classification.min() if not self.classified else 2, np.uint8)
        return ScenePoints(*(np.concatenate(pair) for pair in zip(points, (*more, kind), strict=True)))

    @property
    def ends(self):
        """Places in its middle, and beyond its eastern side."""
        return [tuple(map(float, self.place.of_scene(x, 0.0))) for x in (0.0, HALF_M + 5.0)]

    def map(self, folder, **settings):
        """Survey and map it; returns the folder of the layers."""
        write_points(self.survey(), folder / "ring.las")
        bumpymap.map_survey(folder / "ring.las", folder / "layers", **settings)
        return folder / "layers"

    def way_out(self, layers):
        """Return the route out of it, or None."""
        try:
            (route,) = bumpymap.find_routes(layers, *self.ends, snap=6.0)
        except bumpymap.BadInputError as error:
            if "there is no way" not in str(error):
                raise
            return None
        return route

    def leads_through(self, route):
        """Whether a route leaves it through the opening."""
        dense = np.concatenate([np.linspace(*pair, 200) for pair in pairwise(np.asarray(route.line))])
        x, y = self.place.in_scene(*dense.T)
        out = np.flatnonzero(np.diff(np.maximum(np.abs(x), np.abs(y)) > HALF_M))
        return bool(self._opens(x[out], y[out]).all())


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
        header, _, rest = (folder / "map.pgm").read_bytes().partition(b"\n255\n")
        cells = np.frombuffer(rest, np.uint8).reshape([int(side) for side in header.split()[2:0:-1]])
        cell = site.grid.tile_size if resolution == "tile" else site.grid.pixel_size
        is_open = cells <= LETHAL
        if resolution == "pixel":  # as the inflation layer does, by half the vehicle's width
            is_open &= distance_transform_edt(is_open) * cell > 0.5 * site.vehicle.width_m
        step = rasterio.Affine(cell, 0.0, corner.c, 0.0, -cell, corner.f)
        found[f"Nav2, {resolution}s"] = crossed(ring, is_open, step)
    return found


def write_points(points, path):
    """Write points of a scene as LAS."""
    corner, columns = (500_000, 5_700_000, 0), {"classification": points.classification}
    write_las(path, points.x, points.y, points.z + 100.0, crs="EPSG:32632", offset=corner, **columns)
