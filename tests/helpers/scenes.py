"""Made-up ground, solids and walls whose place is known: what a survey from above sees of them, and what is true.

A scene lies around its own middle. `survey_scene` turns and shifts it, drops pulses on it and returns what a LAS file
holds; `true_pixels` says what of its pixels must be closed and what must be free.

A ring is a square of what stands (walls, posts, mesh, cars) or of ground (a step up, a drop, a ditch). Its opening, if
it has one, is in the middle of the eastern side: a gap, with a bar overhead or not, or a bridge or ramp.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import rasterio
from scipy.ndimage import distance_transform_edt, label
from skimage.graph import MCP_Geometric
from small_surveys import write_las

import bumpymap
from bumpymap.core import CANOPY, FREE, POINT_BUILDING, POINT_GROUND, POINT_OTHER, POINT_PLANT, UNSEEN
from bumpymap.core.config import ExportSettings, FeatureSettings
from bumpymap.layers import open_map
from bumpymap.patches import find_in_relief, find_objects, measure, settle_solids
from bumpymap.rating import settle_objects
from bumpymap.views import export_map
from bumpytiles import Grid, TileBuckets, join_tiles

GROUND, PLANT, BUILDING, OTHER = 2, 5, 6, 1
"""LAS classes; the first code of plants is `PLANT`, for hedges 4."""
HEDGE = 4
PIXEL_M = Grid().pixel_size
LEAN = 0.25
"""Mean lean of pulses that see sides too: points per m2 of a side, as a share of those per m2 of ground."""


class Solid(NamedTuple):
    """A box that stands upright, or a cylinder; m and degrees."""

    x: float
    y: float
    length: float
    width: float
    """Of a cylinder, its diameter; ``length`` is not used."""
    top: float
    turn: float = 0.0
    bottom: float = 0.0
    class_id: int = OTHER
    stops: float = 1.0
    """Share of the pulses on it that return from it; the others see what is beneath."""
    soft: bool = False
    """Pulses return from anywhere between bottom and top, as those of leaves and wires do."""
    is_round: bool = False

    def inside(self, x, y, grow=0.0):
        """Whether places are in its footprint, grown by a distance, m."""
        if self.is_round:
            return np.hypot(x - self.x, y - self.y) <= 0.5 * self.width + grow
        c, s = math.cos(math.radians(self.turn)), math.sin(math.radians(self.turn))
        along, across = (x - self.x) * c + (y - self.y) * s, (y - self.y) * c - (x - self.x) * s
        return (np.abs(along) <= 0.5 * self.length + grow) & (np.abs(across) <= 0.5 * self.width + grow)

    def outline(self, count, rng):
        """Draw places on its sides."""
        if self.is_round:
            turn = rng.uniform(0, 2 * np.pi, count)
            return self.x + 0.5 * self.width * np.cos(turn), self.y + 0.5 * self.width * np.sin(turn)
        at = rng.uniform(0, 2 * (self.length + self.width), count)
        ends = np.cumsum([self.length, self.width, self.length])
        side = np.searchsorted(ends, at)
        rest = at - np.concatenate([[0], ends])[side]
        a, b = 0.5 * self.length, 0.5 * self.width
        along = np.select([side == 0, side == 1, side == 2], [rest - a, a, rest - a], -a)
        across = np.select([side == 0, side == 1, side == 2], [-b, rest - b, b], rest - b)
        c, s = math.cos(math.radians(self.turn)), math.sin(math.radians(self.turn))
        return self.x + along * c - across * s, self.y + along * s + across * c

    @property
    def around(self):
        """Length of its outline, m."""
        return math.pi * self.width if self.is_round else 2 * (self.length + self.width)


def level(x, y):
    """Gently sloping ground."""
    return 0.03 * x + 0.02 * y


def nowhere(x, y):
    return np.zeros(np.shape(x), bool)


@dataclass(frozen=True)
class Scene:
    """Solids on ground, around (0, 0)."""

    name: str
    solids: tuple[Solid, ...]
    half: float = 9.0
    """Half the side of the square, m."""
    ground: object = level
    relief: object = nowhere
    """Where the ground is not level (ditches, ramps)."""


class ScenePoints(NamedTuple):
    """Points (n,) of a survey of a scene, m, and LAS classes."""

    x: np.ndarray
    y: np.ndarray
    z: np.ndarray
    classification: np.ndarray


class Place(NamedTuple):
    """Where a scene lies: its heading in degrees, and the place of its middle, m."""

    heading: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def of_scene(self, x, y):
        """Turn places in a scene to places on the map."""
        c, s = math.cos(math.radians(self.heading)), math.sin(math.radians(self.heading))
        return self.x + x * c - y * s, self.y + x * s + y * c

    def in_scene(self, x, y):
        """Turn places on the map to places in the scene."""
        c, s = math.cos(math.radians(self.heading)), math.sin(math.radians(self.heading))
        return (x - self.x) * c + (y - self.y) * s, (y - self.y) * c - (x - self.x) * s


HERE = Place()


def survey_scene(scene, density, *, noise=0.0, classified=True, sides=False, place=HERE, seed=0, margin=0.0):
    """Survey a scene from straight above.

    ``density``: pulses per m2; ``noise``: standard deviation of points along each axis, m; ``classified``: else all
    points have class 1; ``sides``: some pulses lean, so that the sides of solids return points too; ``place``: where on
    the map the scene lies; ``margin``: level ground around the scene that is surveyed too, m.
    """
    rng = np.random.default_rng((seed, 77))
    half = scene.half + margin
    x, y = rng.uniform(-half, half, (2, rng.poisson(density * 4 * half * half)))
    z, kind = scene.ground(x, y), np.full(len(x), GROUND)
    for solid in sorted(scene.solids, key=lambda one: one.top):
        hit = solid.inside(x, y) & (rng.random(len(x)) < solid.stops)
        top = rng.uniform(solid.bottom, solid.top, len(x)) if solid.soft else solid.top
        z, kind = np.where(hit, scene.ground(x, y) + top, z), np.where(hit, solid.class_id, kind)
    rows = [np.stack([x, y, z, kind])]
    for solid in scene.solids if sides else ():
        count = rng.poisson(LEAN * density * solid.around * (solid.top - solid.bottom) * solid.stops)
        sx, sy = solid.outline(count, rng)
        up = scene.ground(sx, sy) + rng.uniform(solid.bottom, solid.top, count)
        rows.append(np.stack([sx, sy, up, np.full(count, solid.class_id)]))
    x, y, z, kind = np.concatenate(rows, axis=1)
    x, y = place.of_scene(x, y)
    x, y, z = (axis + noise * rng.standard_normal(len(axis)) for axis in (x, y, z))
    return ScenePoints(x, y, z, kind.astype(np.uint8) if classified else np.full(len(x), OTHER, np.uint8))


class TruePixels(NamedTuple):
    """Truth about the pixels of a window of tiles, (rows, cols) each, north row first."""

    closed: np.ndarray
    """Their middle is in the footprint of something in the vehicle's way, or of a roof that hides what is beneath; what
    is thinner is one pixel wide."""
    free: np.ndarray
    """Level ground, with nothing in the way within the tolerance: calling it an obstacle or unknown is wrong."""
    relief: np.ndarray
    """Ground that is not level, likewise. Unless it is steep as a wall, slopes and steps of tiles bar ways over it."""


def true_pixels(scene, west, south, pixels, *, place=HERE, high=1.38, tolerance=0.4):
    """Return what is true of a square of ``pixels`` along a side, whose south-west corner is ``west``, ``south``, m.

    ``place``: as surveyed; ``high``: height from 0.25 m to which a solid is in the way, m; ``tolerance``: pixels closer
    to a solid than this may be called closed, m.
    """
    axis = (np.arange(pixels) + 0.5) * PIXEL_M
    x, y = place.in_scene(*np.meshgrid(west + axis, (south + axis)[::-1]))
    closed, near = np.zeros((2, *x.shape), bool)
    for solid in scene.solids:
        in_the_way = solid.bottom < high and solid.top > 0.25
        if in_the_way or solid.stops == 1.0:  # what is under a closed roof is not seen
            closed |= solid.inside(x, y, max(0.0, 0.5 * (PIXEL_M - solid.width)))
            near |= solid.inside(x, y, tolerance)
    near |= np.maximum(np.abs(x), np.abs(y)) > scene.half - 1.0
    relief = scene.relief(x, y)
    return TruePixels(closed, ~near & ~relief, ~near & relief)


def ring(gap=0.0, thickness=0.3, side=9.0):
    """Four walls of 2 m around a yard, with a gap in the middle of the eastern one; m.

    The yard is ``side`` m wide inside. A vehicle gets in only through the gap, if it fits.
    """
    a, t = 0.5 * (side + thickness), thickness
    long = side + 2 * thickness
    walls = [Solid(0, a, long, t, 2.0), Solid(0, -a, long, t, 2.0), Solid(-a, 0, long, t, 2.0, turn=90)]
    part = 0.5 * (long - gap)
    east = [Solid(a, sign * 0.5 * (gap + part), part, t, 2.0, turn=90) for sign in (1, -1)]
    solids = tuple(wall._replace(class_id=BUILDING) for wall in walls + east)
    return Scene(f"ring of wall {thickness:g} m, gap {gap:g} m", solids, half=a + 6.0)


def wall(thickness, class_id=BUILDING, height=2.0, length=10.0):
    """A straight wall."""
    name = f"wall {thickness:g} m" + (", class 6" if class_id == BUILDING else "")
    return Scene(name, (Solid(0, 0, length, thickness, height, class_id=class_id),))


def fence(height=1.2, mesh=0.25, spacing=2.0, length=12.0):
    """Posts of 10 cm and wire mesh between them, of which a share of the pulses on its 4 cm returns."""
    places = np.arange(-0.5 * length, 0.5 * length + 0.1, spacing)
    posts = [Solid(x, 0, 0, 0.1, height, is_round=True) for x in places]
    return Scene("fence", (*posts, Solid(0, 0, length, 0.04, height, stops=mesh, soft=True)))


def crown(x, y, width, stops=0.7, bottom=2.5, top=6.0):
    """A tree's crown, that lets some pulses through."""
    return Solid(x, y, 0, width, top, bottom=bottom, class_id=PLANT, stops=stops, soft=True, is_round=True)


def _ditch(x, y):
    return level(x, y) - 0.6 * np.clip(1.5 - np.abs(y), 0.0, 1.0)


def _ramp(x, y):
    return level(x, y) + 0.25 * np.clip(x, 0.0, 4.0)


def _bank(x, y):
    return level(x, y) + 0.4 * (x > 0)


POSTS = tuple(Solid(x, y, 0, 0.3, 1.0, is_round=True) for x, y in ((-4, -4), (0, 3.1), (3.3, 0.4)))
CRATES = tuple(Solid(x, y, 0.7, 0.7, 0.7, turn=turn) for x, y, turn in ((-4, -3, 0), (0, 2, 20), (3, -1, 45)))
BALES = tuple(Solid(x, y, 0, 1.3, 1.2, is_round=True) for x, y in ((-4, -3), (0, 2), (3, -1)))
CROWNS = (crown(-4, 3, 4), crown(1, 2, 5), crown(3, -3, 3), crown(-3, -4, 4))
SCENES = (
    *(wall(thickness, class_id=OTHER) for thickness in (0.1, 0.2, 0.3, 0.6)),
    *(ring(gap=gap) for gap in (0.0, 1.0, 1.5, 2.0, 3.0)),
    wall(0.3),
    fence(),
    Scene("low wall 0.6 m high", (Solid(0, 0, 10, 0.3, 0.6),)),
    Scene("posts", POSTS),
    Scene("crates", CRATES),
    Scene("bales", BALES),
    Scene("vans", (Solid(-2, -2, 5, 2, 2.2), Solid(2, 3, 5, 2, 2.2, turn=30))),
    Scene("hut", (Solid(0, 0, 4, 3, 2.6, class_id=BUILDING),)),
    Scene("hut, unassigned", (Solid(0, 0, 4, 3, 2.6),)),
    Scene("hedge", (Solid(0, 0, 10, 1.0, 1.8, class_id=HEDGE, soft=True),)),
    Scene("carport", (Solid(0, 0, 6, 5, 3.0, bottom=2.6),)),
    Scene("bridge 5 m above ground, unassigned", (Solid(0, 0, 14, 4, 5.6, bottom=5.0, class_id=OTHER),)),
    Scene("footbridge 1 m above ground, unassigned", (Solid(0, 0, 14, 1.5, 1.2, bottom=1.0, class_id=OTHER),)),
    Scene("crowns over ground", CROWNS),
    Scene("crowns, unassigned", tuple(one._replace(class_id=OTHER) for one in CROWNS)),
    Scene("open ground", ()),
    Scene("ditch", (), ground=_ditch, relief=lambda x, y: np.abs(y) < 2.0),  # noqa: ARG005
    Scene("ramp", (), ground=_ramp, relief=lambda x, y: (x > -1) & (x < 5)),  # noqa: ARG005
    Scene("bank 0.4 m", (), ground=_bank, relief=lambda x, y: np.abs(x) < 1.0),  # noqa: ARG005
)


def seen_from_above(scene):
    """Return a scene of solids whose tops alone return: hedges and crowns too."""
    return replace(scene, solids=tuple(solid._replace(soft=False) for solid in scene.solids))


FAR = FeatureSettings().max_hole


def _mapped(points, body):
    """States of the pixels of tiles by themselves, as an image with a ring of missing tiles, and its corner [m]."""
    settings, ground = FeatureSettings(), points.classification == GROUND
    classified = bool(ground.any())
    kinds = np.select(
        [ground, points.classification == BUILDING, (points.classification >= 3) & (points.classification <= 5)],
        [POINT_GROUND, POINT_BUILDING, POINT_PLANT],
        POINT_OTHER,
    )
    buckets = TileBuckets(Grid())
    buckets.add(points.x, points.y, points.z, kinds.astype(np.uint8))
    tiles = join_tiles(list(buckets.blocks()))
    alone = measure(tiles, settings, ground_only=classified)
    stack = find_objects(tiles, alone, body) if classified else find_in_relief(tiles, alone, body)[0]
    west, south = int(tiles.col.min()) - 1, int(tiles.row.min()) - 1
    side = max(np.ptp(tiles.col), np.ptp(tiles.row)) + 3
    mosaic = np.full((side, 15, side, 15), UNSEEN, np.uint8)
    mosaic[south + side - 1 - tiles.row, :, tiles.col - west] = stack.objects
    return mosaic.reshape(side * 15, side * 15), 3.0 * west, 3.0 * south


def mapped_tiles(points, body):
    """Return the states of the pixels of tiles by themselves."""
    return _mapped(points, body)[0]


def seen_pixels(points, body):
    """Return what a survey of a scene says of its pixels, and the south-west corner of the image [m].

    As a run does it: tiles by themselves, then with their neighbours.
    """
    states, west, south = _mapped(points, body)
    return settle_objects(settle_solids(states, Grid(), FAR), 15), west, south


class Judgement(NamedTuple):
    """What surveys of a scene at several places say; NaN where nothing is asked."""

    closed: float
    """Share of the footprints that is closed."""
    barred: float
    """Share of level ground that is closed."""
    relief: float
    """Share of other ground that is closed."""
    joined: float
    """Share of the places where the vehicle gets from the middle of the scene to its rim."""


def judge(scene, density, noise, body, *, classified=True, sides=False, seeds=range(2)):
    """Hold the pixels of a scene against the truth at several places; every other place has a heading of its own."""
    hits, counts, joined = np.zeros(3), np.zeros(3), []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        place = Place(rng.uniform(0, 360) if seed % 2 else 0.0, *(1000 + rng.uniform(0, 3, 2)))
        points = survey_scene(
            scene, density, noise=noise, classified=classified, sides=sides, place=place, seed=seed, margin=3.0
        )
        image, west, south = seen_pixels(points, body)
        tolerance = max(0.4, 2.0 / math.sqrt(density))
        true = true_pixels(scene, west, south, len(image), place=place, high=body.height_m, tolerance=tolerance)
        shut = (image != FREE) & (image != CANOPY)
        hits += [(asked & shut).sum() for asked in true]
        counts += [asked.sum() for asked in true]
        joined.append(_gets_out(shut, body, place.x - west, place.y - south, scene.half))
    with np.errstate(invalid="ignore"):
        return Judgement(*(hits / counts).tolist(), float(np.mean(joined)))


def _gets_out(shut, body, east, north, half):
    """Whether a disc of the vehicle's width and margin gets from a place, m from a corner, to the rim of a scene."""
    room = distance_transform_edt(~shut) * PIXEL_M >= 0.5 * body.width_m + 0.1
    areas, _ = label(room)
    axis = (np.arange(len(shut)) + 0.5) * PIXEL_M
    far = np.hypot(axis - east, (axis[::-1] - north)[:, None])
    return bool(set(areas[(far < 2.0) & room]) & set(areas[(far > half - 2.0) & (far < half) & room]))


PIXELS, TILE_SIZE = 15, 3.0


@dataclass(frozen=True)
class Wall:
    """Two levels, on both sides of a line through a point; m and degrees."""

    height: float
    easting: float
    northing: float
    turn_deg: float
    slope: tuple[float, float] = (0.0, 0.0)

    def distance(self, easting, northing):
        """Distance to the wall, positive on the upper side."""
        turn = math.radians(self.turn_deg)
        return (easting - self.easting) * math.cos(turn) + (northing - self.northing) * math.sin(turn)

    def ground(self, easting, northing):
        """Heights of points."""
        return self.height * (self.distance(easting, northing) > 0) + self.slope[0] * easting + self.slope[1] * northing


def mosaic(wall, tiles):
    """Heights of tiles x tiles tiles from the origin on, north row first: the mean of each pixel."""
    fine = 8
    axis = (np.arange(tiles * PIXELS * fine) + 0.5) * TILE_SIZE / PIXELS / fine
    z = wall.ground(*np.meshgrid(axis, axis[::-1]))
    n = tiles * PIXELS
    return z.reshape(n, fine, n, fine).mean(axis=(1, 3)).astype(np.float32)


def crossed(wall, tiles, least=0.02):
    """Which of the inner tiles the wall crosses, at least that share of them on either side."""
    upper = mosaic(Wall(1.0, wall.easting, wall.northing, wall.turn_deg), tiles)
    share = upper.reshape(tiles, PIXELS, tiles, PIXELS).mean(axis=(1, 3))[1:-1, 1:-1]
    return (share >= least) & (share <= 1 - least)


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


def walks_across(ring, is_open, transform):
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
            found[name] = walks_across(ring, np.isfinite(raster.read(1)), raster.transform)
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
        found[f"Nav2, {resolution}s"] = walks_across(ring, is_open, step)
    return found


def write_points(points, path):
    """Write points of a scene as LAS."""
    corner, columns = (500_000, 5_700_000, 0), {"classification": points.classification}
    write_las(path, points.x, points.y, points.z + 100.0, crs="EPSG:32632", offset=corner, **columns)
