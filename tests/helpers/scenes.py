"""Made-up ground, solids and walls whose place is known: what a survey from above sees of them, and what is true.

A scene lies around its own middle. `survey_scene` turns and shifts it, drops pulses on it and returns what a LAS file
holds; `true_pixels` says what of its pixels must be closed and what must be free.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.ndimage import distance_transform_edt, label

from bumpymap.core import CANOPY, FREE, POINT_BUILDING, POINT_GROUND, POINT_OTHER, POINT_PLANT, UNSEEN, FeatureSettings
from bumpymap.patches import find_in_relief, find_objects, measure, settle_solids
from bumpymap.rating import settle_objects
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
