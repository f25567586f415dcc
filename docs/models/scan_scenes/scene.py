"""Scenes: ground with regions and objects, drawn from one seed. The sensor is at the origin."""

from dataclasses import dataclass, field, replace

import numpy as np

from bumpymap.lab.terrains import log_uniform
from scan_scenes import objects as make
from scan_scenes.objects import Blob, Floats, Height, Label, Region, SceneGround, Triangles, make_field

_END_M = 85.0
"""Things stand along the road up to this distance."""
_NEAREST_M = 2.5
"""Nothing but a crown is nearer to the robot."""


@dataclass(frozen=True, slots=True)
class Roadside:
    """Look of a road and its sides: ranges from which each scene draws."""

    half_width_m: tuple[float, float]
    kerb_m: tuple[float, float] = (0.0, 0.0)
    """Height of the kerbs; half of the roads have none."""
    pavement_m: tuple[float, float] = (0.0, 0.0)
    ditch_m: tuple[float, float] = (0.0, 0.0)
    """Depth of the ditches; half of the roads have none."""
    bank_m: float = 0.0
    """Greatest height of the ground beyond the verge, above or below the road."""
    bend_m: float = 4.0
    """Greatest amplitude of a bend."""
    parked: float = 0.0
    """Share of the parking places that are taken."""
    moving: float = 0.0
    """Vehicles per 100 m of a lane."""
    walls: float = 0.0
    """Share of the sides with houses."""
    rails: float = 0.0
    """Share of the sides with a crash rail."""
    fences: float = 0.0
    hedges: float = 0.0
    trees_m: tuple[float, float] = (0.0, 0.0)
    """Distance between the trees of a row; 0 without trees."""
    clear_m: tuple[float, float] = (2.2, 4.5)
    """Height of the lowest branches."""
    poles: float = 0.8
    """Share of the sides with poles and signs."""
    bushes: int = 0
    persons: int = 0


ROADSIDES = {
    "street": Roadside(
        half_width_m=(2.6, 5.5), kerb_m=(0.05, 0.2), pavement_m=(1.2, 3.5), parked=0.7, moving=2.0, walls=0.6,
        fences=0.3, hedges=0.35, trees_m=(7.0, 15.0), persons=10,
    ),
    "highway": Roadside(
        half_width_m=(6.0, 12.0), ditch_m=(0.3, 1.5), bank_m=5.0, bend_m=2.0, moving=2.0, rails=0.6, fences=0.3,
        hedges=0.4, bushes=40,
    ),
    "avenue": Roadside(
        half_width_m=(1.5, 4.0), kerb_m=(0.03, 0.15), ditch_m=(0.1, 0.6), bank_m=3.0, parked=0.15, moving=0.5,
        fences=0.25, hedges=0.3, trees_m=(3.5, 10.0), poles=0.5, bushes=40, persons=3,
    ),
}  # fmt: skip
"""By theme of the scene."""


def make_street(rng: np.random.Generator, side: Roadside) -> make.Road:
    """Draw the road past the origin, which lies in a lane, or at times on the pavement; most robots look along it."""
    half = float(rng.uniform(*side.half_width_m))
    bends = (
        (float(rng.uniform(0, side.bend_m)), 2 * np.pi / float(rng.uniform(90, 250)), float(rng.uniform(0, 6.28))),
    )
    pavement = float(rng.uniform(*side.pavement_m))
    stand = half * rng.uniform(-0.7, 0.7)
    if pavement and rng.uniform() < 0.35:
        stand = (half + 0.5 * pavement) * rng.choice([-1.0, 1.0])
    bearing = rng.normal(0, 0.15) if rng.uniform() < 0.7 else rng.uniform(0, 2 * np.pi)
    kerbed, ditched = rng.uniform(size=2) < 0.5
    kerb = float(rng.uniform(*side.kerb_m)) if kerbed or pavement else 0.0
    verge = float(rng.uniform(1.5, 4.5))
    high = rng.uniform(-1.0, 1.0, 2) * side.bank_m
    return make.Road(
        Label.ASPHALT if rng.uniform() < 0.85 else Label.CONCRETE,
        (float(np.cos(bearing)), float(np.sin(bearing))),
        float(-stand - sum(amplitude * np.sin(phase) for amplitude, _, phase in bends)),
        bends,
        half,
        log_uniform(rng, 0.001, 0.006),
        float(rng.uniform(0.02, 0.12)),
        kerb_m=kerb,
        pavement_m=pavement,
        ditch_m=float(rng.uniform(*side.ditch_m)) if ditched else 0.0,
        verge_m=verge,
        banks_m=(float(high[0]), float(high[1])),
        bank_width_m=float(max(2.0, 2.15 * np.abs(high).max() * rng.uniform(1.0, 3.0))),
    )


def roadside_objects(
    rng: np.random.Generator, side: Roadside, road: make.Road, height: Height
) -> list[tuple[Label, Triangles]]:
    """Draw what stands on a road and along it, as labels and triangles."""
    objects = _vehicles(rng, side, road, height)
    for way in (-1.0, 1.0):
        objects += _row(rng, side, road, way, height)
    edge = road.half_width_m + road.pavement_m
    for _ in range(int(rng.integers(0, side.persons + 1))):
        feet = _feet(road, rng.uniform(-30, 30, 1), rng.choice([-1, 1]) * rng.uniform(0.4, 1.0) * edge, height)
        objects.append((Label.PERSON, make.person(rng, feet[0, :3])))
    for _ in range(int(rng.integers(0, side.bushes + 1))):
        away = (edge + 1.5 * road.verge_m + rng.exponential(8.0)) * rng.choice([-1, 1])
        feet = _feet(road, rng.uniform(-60, 60, 1), away, height)
        objects.append((Label.BUSH, make.bush(rng, feet[0, :3], log_uniform(rng, 0.4, 2.5))))
    return [
        (label, soup)
        for label, soup in objects
        if label == Label.TREE or np.hypot(soup[..., 0], soup[..., 1]).min() > _NEAREST_M
    ]


def _feet(road: make.Road, along: Floats, across: float | Floats, height: Height) -> Floats:
    """Return (n, 4) x, y, z of the ground [m] and the heading of the road [rad]."""
    place = road.places(along, np.broadcast_to(np.asarray(across, float), along.shape))
    return np.column_stack([place[:, :2], height(place[:, 0], place[:, 1]), place[:, 2]])


def _vehicles(
    rng: np.random.Generator, side: Roadside, road: make.Road, height: Height
) -> list[tuple[Label, Triangles]]:
    """Draw parked vehicles along the margins, and moving ones in the lanes."""
    along, across = [np.empty(0)], [np.empty(0)]
    for way in (-1.0, 1.0):
        taken = side.parked * rng.uniform()
        slots = np.arange(-_END_M, _END_M, rng.uniform(5.8, 7.5))
        slots = slots[rng.uniform(size=len(slots)) < taken]
        along.append(slots + rng.uniform(-0.4, 0.4, len(slots)))
        across.append(np.full(len(slots), way * (road.half_width_m + rng.uniform(-1.1, 0.3))))
        count = rng.poisson(side.moving * 2 * _END_M / 100)
        along.append(rng.uniform(-_END_M, _END_M, count))
        across.append(np.full(count, way * road.half_width_m * rng.uniform(0.3, 0.6)))
    feet = _feet(road, np.concatenate(along), np.concatenate(across), height)
    far = np.hypot(feet[:, 0], feet[:, 1]) > 4.5
    return [(Label.VEHICLE, make.vehicle(rng, foot[:3], float(foot[3]))) for foot in feet[far]]


def _row(
    rng: np.random.Generator, side: Roadside, road: make.Road, way: float, height: Height
) -> list[tuple[Label, Triangles]]:
    """Draw the trees, poles, rails, fences, hedges and walls of one side, which is to the left if ``way`` is 1."""
    edge = road.half_width_m + road.pavement_m
    objects: list[tuple[Label, Triangles]] = []

    def stretch(step: float, across: float, longest: float) -> Floats:
        start, length = rng.uniform(-_END_M, 30.0), rng.uniform(10.0, longest)
        return _feet(road, np.arange(start, start + max(length, 2.5 * step), step), way * across, height)[:, :3]

    if side.trees_m[1] and rng.uniform() < 0.75:
        step, away = rng.uniform(*side.trees_m), road.half_width_m + rng.uniform(0.6, 2.5)
        feet = _feet(road, np.arange(-_END_M, _END_M, step) + rng.uniform(0, step), way * away, height)
        for foot in feet[rng.uniform(size=len(feet)) < 0.85]:
            clear = rng.uniform(*side.clear_m)
            objects.append((Label.TREE, make.tree(rng, foot[:3], clear + log_uniform(rng, 3.0, 10.0), clear)))
    if rng.uniform() < side.poles:
        away = road.half_width_m + rng.uniform(0.3, 1.0)
        feet = _feet(road, np.arange(-_END_M, _END_M, rng.uniform(15.0, 40.0)), way * away, height)
        objects += [(Label.BARRIER, make.pole(rng, foot[:3], float(foot[3]))) for foot in feet]
    if rng.uniform() < side.rails:
        objects.append((Label.BARRIER, make.guard_rail(stretch(rng.uniform(2.0, 4.0), road.half_width_m + 0.8, 150.0))))
    if rng.uniform() < side.fences:
        feet = stretch(rng.uniform(1.8, 3.0), edge + rng.uniform(0.8, 2 * road.verge_m), 60.0)
        objects.append((Label.FENCE, make.fence_along(rng, feet[:, :2], height)))
    if rng.uniform() < side.hedges:
        feet = stretch(rng.uniform(0.6, 1.2), edge + rng.uniform(1.0, 6.0), 50.0)
        objects.append((Label.BUSH, make.hedge(rng, feet)))
    if rng.uniform() < side.walls:
        away, start = edge + rng.uniform(0.3, 6.0), -_END_M
        while start < _END_M:
            long = rng.uniform(6.0, 25.0)
            feet = _feet(road, np.linspace(start, start + long, 6), way * (away + rng.uniform(0, 1.5)), height)
            objects.append((Label.BARRIER, make.wall(rng, feet[:, :3])))
            start += long + (rng.uniform(1.0, 8.0) if rng.uniform() < 0.6 else 0.0)
    return objects


@dataclass(frozen=True, slots=True)
class Theme:
    """Maximum numbers of regions and objects; each scene draws its numbers between 0 and these."""

    roads: int = 1
    mud: int = 1
    water: int = 0
    puddles: int = 2
    rubble: int = 0
    bare: int = 1
    herbs: int = 40
    """Low plants that annotators label as grass."""
    bushes: int = 25
    trees: int = 12
    persons: int = 3
    vehicles: int = 2
    fences: int = 1
    barriers: int = 1
    grassy: float = 0.7
    """Probability that the ground outside all regions is grass and not dirt."""
    floor_m: tuple[float, float] = (0.003, 0.03)
    """Range of the standard deviation of roots, tussocks and clods on grass and dirt, m."""
    slope_deg: float = 5.0
    """Greatest slope of the hillside around the robot."""
    banks: int = 0
    """Banks and terraces of up to 35 degrees."""
    street: bool = False
    """True if a road of ``ROADSIDES`` passes the robot."""


THEMES = {
    # roads, mud, water, puddles, rubble, bare, herbs, bushes, trees, persons, vehicles, fences, barriers, grassy, ...
    "meadow": Theme(2, 0, 0, 2, 0, 1, 40, 40, 40, 3, 2, 2, 1, 1.0, slope_deg=10.0),
    "forest": Theme(1, 0, 0, 2, 0, 1, 300, 80, 170, 1, 1, 1, 1, 0.4, floor_m=(0.005, 0.04), slope_deg=12.0),
    "bushland": Theme(1, 0, 0, 0, 0, 1, 120, 500, 20, 3, 2, 1, 1, 0.7),
    "mire": Theme(1, 5, 0, 8, 0, 1, 40, 15, 12, 3, 2, 1, 1, 0.7),
    "quarry": Theme(1, 0, 0, 3, 9, 1, 10, 8, 10, 4, 8, 1, 4, 0.15, banks=1),
    "shore": Theme(1, 1, 4, 4, 0, 1, 40, 50, 20, 3, 2, 1, 1, 0.7),
    "yard": Theme(3, 0, 0, 2, 2, 1, 40, 8, 20, 14, 20, 6, 6, 0.5),
    "street": Theme(0, 0, 0, 2, 0, 1, 10, 5, 5, 0, 2, 0, 0, 0.7, street=True),
    "highway": Theme(0, 0, 0, 1, 0, 1, 40, 60, 80, 0, 0, 0, 1, 1.0, street=True),
    "avenue": Theme(0, 0, 0, 2, 0, 1, 60, 80, 220, 0, 0, 0, 1, 0.7, street=True),
    "hillside": Theme(0, 0, 0, 0, 0, 1, 40, 60, 60, 3, 2, 2, 1, 0.7, slope_deg=25.0, banks=3),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Scene:
    """An outdoor scene."""

    theme: str
    ground: SceneGround
    objects: tuple[tuple[Label, Triangles], ...]
    """Objects on the ground: label and triangles (m, 3, 3), m."""
    seed: tuple[int, ...] = field(default=())
    """Seed from which it was drawn."""
    wet: float = 0.0
    """Share of the pulses that wet asphalt, concrete and dirt reflect away at low angles, 0..1."""
    mirror: float = 0.0
    """Share of the pulses that a smooth surface reflects away and that return from what they meet then, 0..1."""


def make_scene(seed: int, index: int, theme: str | None = None) -> Scene:
    """Draw a scene; seed and number of it in a set of scenes give the same bits. None: themes take turns."""
    name = list(THEMES)[index % len(THEMES)] if theme is None else theme
    rng = np.random.default_rng([seed, index, 0])
    ground = _draw_ground(rng, THEMES[name], name)
    objects = tuple(_draw_objects(rng, THEMES[name], ground))
    for region in ground.regions:
        if THEMES[name].street and isinstance(region, make.Road):
            objects += tuple(roadside_objects(rng, ROADSIDES[name], region, ground.height))
    wet = float(rng.uniform(0.1, 0.8)) if rng.uniform() < _WET else 0.0
    mirror = log_uniform(rng, 0.01, 0.5) if rng.uniform() < _MIRRORS else 0.0
    return Scene(name, ground, objects, (seed, index), wet, mirror)


_WET = 0.15
"""Share of the scenes after rain."""
_MIRRORS = 0.5
"""Share of the scenes with reflections in puddles, wet ground and glass."""


def _up_to(rng: np.random.Generator, most: float) -> int:
    return int(rng.integers(0, int(most) + 1))


def _place(rng: np.random.Generator, nearest: float, farthest: float) -> tuple[float, float]:
    """Draw a random position with uniform distance, so that near ground is as varied as far ground."""
    away, bearing = rng.uniform(nearest, farthest), rng.uniform(0, 2 * np.pi)
    return float(away * np.cos(bearing)), float(away * np.sin(bearing))


def _draw_slope(rng: np.random.Generator, theme: Theme) -> tuple[float, float]:
    """Draw the slope of the hillside, as rise per metre to the east and north."""
    rise, bearing = np.tan(np.radians(theme.slope_deg * rng.uniform() ** 2)), rng.uniform(0, 2 * np.pi)
    return float(rise * np.cos(bearing)), float(rise * np.sin(bearing))


def _draw_bank(rng: np.random.Generator) -> make.Bank:
    """Draw a bank that rises or falls by 0.1 to 6 m, at 8 to 35 degrees where it is steepest."""
    bearing, height = rng.uniform(0, 2 * np.pi), log_uniform(rng, 0.1, 6.0)
    steepest = np.tan(np.radians(rng.uniform(8, 35)))
    return make.Bank(
        (float(np.cos(bearing)), float(np.sin(bearing))),
        float(rng.uniform(-5, 25)),
        float(height * rng.choice([-1.0, 1.0])),
        float(1.5 * height / steepest),  # a smooth step is 1.5 times as steep in the middle as on average
        (float(rng.uniform(0, 2)), 2 * np.pi / float(rng.uniform(25, 80)), float(rng.uniform(0, 2 * np.pi))),
    )


def _draw_ground(rng: np.random.Generator, theme: Theme, name: str) -> SceneGround:
    cover = Label.GRASS if rng.uniform() < theme.grassy else Label.DIRT
    bare = SceneGround(
        hills=make_field(rng, 256, 1.0, 1.0, (25.0, 200.0)),
        hills_m=log_uniform(rng, 0.05, 0.6) if theme.street else log_uniform(rng, 0.1, 2.0),
        bumps=make_field(rng, 512, 0.25, 0.8, (2.0, 20.0)),
        bumps_m=log_uniform(rng, 0.02, 0.15),
        fine=make_field(rng, 1024, 0.04, 0.5, (0.1, 2.0)),
        cover=cover,
        cover_rough_m=log_uniform(rng, *theme.floor_m),
        regions=(),
        grass_m=log_uniform(rng, 0.01, 0.4),
        grass_tufts=make_field(rng, 512, 0.1, 0.4, (0.3, 8.0)),
        grass_path_m=log_uniform(rng, 0.08, 0.4),
        slope=_draw_slope(rng, theme),
        banks=tuple(_draw_bank(rng) for _ in range(_up_to(rng, theme.banks))),
    )
    regions: list[Region] = []
    other = Label.DIRT if cover == Label.GRASS else Label.GRASS
    for label, most, farthest, sizes, rough in (
        (other, theme.bare, 40, (6, 25), theme.floor_m),
        (Label.MUD, theme.mud, 30, (5, 22), (0.05, 0.1)),
        (Label.RUBBLE, theme.rubble, 30, (5, 20), (0.03, 0.1)),
    ):
        regions += [
            make.make_blob(rng, label, _place(rng, 2, farthest), rng.uniform(*sizes), log_uniform(rng, *rough))
            for _ in range(_up_to(rng, most))
        ]
    if theme.street:
        regions.append(make_street(rng, ROADSIDES[name]))
    for number in range(_up_to(rng, theme.roads)):
        label = (Label.DIRT, Label.ASPHALT, Label.CONCRETE)[rng.integers(3)]
        regions.append(make.make_road(rng, label, float(rng.normal(0, 3) if number == 0 else rng.uniform(-30, 30))))
    regions += _draw_water(rng, theme, bare)
    return replace(bare, regions=tuple(regions))


def _draw_water(rng: np.random.Generator, theme: Theme, bare: SceneGround) -> list[Region]:
    """Draw ponds and puddles, each level with its lowest bank and none at the robot's position."""
    drawn: list[Region] = []
    origin = np.zeros(1)
    kinds = [(Label.WATER, (6.0, 28.0), (8, 40))] * _up_to(rng, theme.water)
    kinds += [(Label.PUDDLE, (0.8, 3.5), (4, 20))] * _up_to(rng, theme.puddles)
    for label, sizes, places in kinds:
        radius = rng.uniform(*sizes)
        blob = make.make_blob(rng, label, _place(rng, *places), radius, log_uniform(rng, 0.001, 0.012), 0.0)
        bearing = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        bank = bare.height(blob.centre[0] + radius * np.cos(bearing), blob.centre[1] + radius * np.sin(bearing))
        if blob.reach(origin, origin)[0] < 1.5:
            continue
        level = float(bank.min()) - rng.uniform(0.0, 0.25 if label == Label.WATER else 0.05)
        drawn.append(replace(blob, level_m=level))
    return drawn


def _draw_objects(rng: np.random.Generator, theme: Theme, ground: SceneGround) -> list[tuple[Label, Triangles]]:
    height = ground.height
    objects: list[tuple[Label, Triangles]] = []
    for label, places, build, sizes in (
        (Label.GRASS, _spots(rng, _up_to(rng, theme.herbs), 2.0, 40.0), make.herb, (0.1, 0.4)),
        (Label.BUSH, _spots(rng, _up_to(rng, theme.bushes), 4.0, 80.0), make.bush, (0.4, 2.5)),
        (Label.TREE, _spots(rng, _up_to(rng, theme.trees), 4.5, 105.0), make.tree, (2.5, 14.0)),
        (Label.PERSON, _spots(rng, _up_to(rng, theme.persons), 4.0, 25.0), make.person, None),
        (Label.VEHICLE, _spots(rng, _up_to(rng, theme.vehicles), 6.0, 70.0), make.vehicle, None),
    ):
        z = height(places[:, 0], places[:, 1])
        for place, up in zip(places, z, strict=True):
            size = (log_uniform(rng, *sizes),) if sizes else ()
            objects.append((label, build(rng, np.array([*place, up]), *size)))
    for label, most, build in ((Label.FENCE, theme.fences, make.fence), (Label.BARRIER, theme.barriers, make.barrier)):
        lines = [build(rng, np.array(_place(rng, 5, 50)), height) for _ in range(_up_to(rng, most))]
        objects += [(label, soup) for soup in lines if np.hypot(soup[..., 0], soup[..., 1]).min() > 2.0]
    for region in ground.regions:
        if region.label == Label.RUBBLE and isinstance(region, Blob):
            build_field = make.stone_field if rng.uniform() < 0.35 else make.block_field
            objects.append((Label.RUBBLE, build_field(rng, _inside(rng, region, ground), height)))
    return [(label, soup) for label, soup in objects if len(soup)]


def _spots(rng: np.random.Generator, count: int, nearest: float, farthest: float) -> Floats:
    """Draw positions (count, 2), many of them in clusters, as of plants and people."""
    spots: list[tuple[float, float]] = []
    while len(spots) < count:
        x, y = _place(rng, nearest, farthest)
        clump = int(rng.integers(3, 30)) if rng.uniform() < 0.4 else 1
        wide = 0.7 * np.sqrt(clump) * rng.uniform(0.6, 1.5)
        for _ in range(clump):
            east, north = x + rng.normal(0, wide), y + rng.normal(0, wide)
            if np.hypot(east, north) > nearest:
                spots.append((float(east), float(north)))
    return np.array(spots[:count]).reshape(-1, 2)


def _inside(rng: np.random.Generator, blob: Blob, ground: SceneGround) -> Floats:
    """Draw positions for the stones of a blob, not under the robot and not on a road or puddle that covers it."""
    count = int(4 * blob.radius_m**2 * rng.uniform(1.0, 2.5))
    places = np.array(blob.centre) + rng.uniform(-1.4, 1.4, (count, 2)) * blob.radius_m
    x, y = places[:, 0], places[:, 1]
    free = (blob.reach(x, y) < 1.0) & (np.hypot(x, y) > 2.0) & (ground.sample(x, y)[1] == Label.RUBBLE)
    return places[free]
