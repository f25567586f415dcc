"""Streets, highways and avenues: a road past the robot, and what stands along it."""

from dataclasses import dataclass

import numpy as np

from bumpymap.lab.worlds.scans._fields import Floats, log_uniform
from bumpymap.lab.worlds.scans._solids import Triangles
from bumpymap.lab.worlds.scans.labels import Label
from bumpymap.lab.worlds.scans.objects import Height, fence_along, guard_rail, person, pole, vehicle, wall
from bumpymap.lab.worlds.scans.plants import bush, hedge, tree
from bumpymap.lab.worlds.scans.regions import Road

__all__ = ["ROADSIDES", "Roadside", "make_street", "roadside_things"]

_END_M = 85.0
"""Things stand along the road up to this distance."""
_NEAREST_M = 2.5
"""Nothing but a crown is nearer to the robot."""


@dataclass(frozen=True, slots=True)
class Roadside:
    """What a road and its sides look like: ranges from which each scene draws."""

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
        half_width_m=(2.6, 5.5),
        kerb_m=(0.05, 0.2),
        pavement_m=(1.2, 3.5),
        parked=0.7,
        moving=2.0,
        walls=0.6,
        fences=0.3,
        hedges=0.35,
        trees_m=(7.0, 15.0),
        persons=10,
    ),
    "highway": Roadside(
        half_width_m=(6.0, 12.0),
        ditch_m=(0.3, 1.5),
        bank_m=5.0,
        bend_m=2.0,
        moving=2.0,
        rails=0.6,
        fences=0.3,
        hedges=0.4,
        bushes=40,
    ),
    "avenue": Roadside(
        half_width_m=(1.5, 4.0),
        kerb_m=(0.03, 0.15),
        ditch_m=(0.1, 0.6),
        bank_m=3.0,
        parked=0.15,
        moving=0.5,
        fences=0.25,
        hedges=0.3,
        trees_m=(3.5, 10.0),
        poles=0.5,
        bushes=40,
        persons=3,
    ),
}
"""By theme of the scene."""


def make_street(rng: np.random.Generator, side: Roadside) -> Road:
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
    return Road(
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


def roadside_things(
    rng: np.random.Generator, side: Roadside, road: Road, height: Height
) -> list[tuple[Label, Triangles]]:
    """Draw what stands on a road and along it, as labels and triangles."""
    things = _vehicles(rng, side, road, height)
    for way in (-1.0, 1.0):
        things += _row(rng, side, road, way, height)
    edge = road.half_width_m + road.pavement_m
    for _ in range(int(rng.integers(0, side.persons + 1))):
        feet = _feet(road, rng.uniform(-30, 30, 1), rng.choice([-1, 1]) * rng.uniform(0.4, 1.0) * edge, height)
        things.append((Label.PERSON, person(rng, feet[0, :3])))
    for _ in range(int(rng.integers(0, side.bushes + 1))):
        away = (edge + 1.5 * road.verge_m + rng.exponential(8.0)) * rng.choice([-1, 1])
        feet = _feet(road, rng.uniform(-60, 60, 1), away, height)
        things.append((Label.BUSH, bush(rng, feet[0, :3], log_uniform(rng, 0.4, 2.5))))
    return [
        (label, soup)
        for label, soup in things
        if label == Label.TREE or np.hypot(soup[..., 0], soup[..., 1]).min() > _NEAREST_M
    ]


def _feet(road: Road, along: Floats, across: float | Floats, height: Height) -> Floats:
    """Return (n, 4) x, y, z of the ground [m] and the heading of the road [rad]."""
    place = road.places(along, np.broadcast_to(np.asarray(across, float), along.shape))
    return np.column_stack([place[:, :2], height(place[:, 0], place[:, 1]), place[:, 2]])


def _vehicles(rng: np.random.Generator, side: Roadside, road: Road, height: Height) -> list[tuple[Label, Triangles]]:
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
    return [(Label.VEHICLE, vehicle(rng, foot[:3], float(foot[3]))) for foot in feet[far]]


def _row(
    rng: np.random.Generator, side: Roadside, road: Road, way: float, height: Height
) -> list[tuple[Label, Triangles]]:
    """Draw the trees, poles, rails, fences, hedges and walls of one side, which is to the left if ``way`` is 1."""
    edge = road.half_width_m + road.pavement_m
    things: list[tuple[Label, Triangles]] = []

    def stretch(step: float, across: float, longest: float) -> Floats:
        start, length = rng.uniform(-_END_M, 30.0), rng.uniform(10.0, longest)
        return _feet(road, np.arange(start, start + max(length, 2.5 * step), step), way * across, height)[:, :3]

    if side.trees_m[1] and rng.uniform() < 0.75:
        step, away = rng.uniform(*side.trees_m), road.half_width_m + rng.uniform(0.6, 2.5)
        feet = _feet(road, np.arange(-_END_M, _END_M, step) + rng.uniform(0, step), way * away, height)
        for foot in feet[rng.uniform(size=len(feet)) < 0.85]:
            clear = rng.uniform(*side.clear_m)
            things.append((Label.TREE, tree(rng, foot[:3], clear + log_uniform(rng, 3.0, 10.0), clear)))
    if rng.uniform() < side.poles:
        away = road.half_width_m + rng.uniform(0.3, 1.0)
        feet = _feet(road, np.arange(-_END_M, _END_M, rng.uniform(15.0, 40.0)), way * away, height)
        things += [(Label.BARRIER, pole(rng, foot[:3], float(foot[3]))) for foot in feet]
    if rng.uniform() < side.rails:
        things.append((Label.BARRIER, guard_rail(stretch(rng.uniform(2.0, 4.0), road.half_width_m + 0.8, 150.0))))
    if rng.uniform() < side.fences:
        feet = stretch(rng.uniform(1.8, 3.0), edge + rng.uniform(0.8, 2 * road.verge_m), 60.0)
        things.append((Label.FENCE, fence_along(rng, feet[:, :2], height)))
    if rng.uniform() < side.hedges:
        things.append((Label.BUSH, hedge(rng, stretch(rng.uniform(0.6, 1.2), edge + rng.uniform(1.0, 6.0), 50.0))))
    if rng.uniform() < side.walls:
        away, start = edge + rng.uniform(0.3, 6.0), -_END_M
        while start < _END_M:
            long = rng.uniform(6.0, 25.0)
            feet = _feet(road, np.linspace(start, start + long, 6), way * (away + rng.uniform(0, 1.5)), height)
            things.append((Label.BARRIER, wall(rng, feet[:, :3])))
            start += long + (rng.uniform(1.0, 8.0) if rng.uniform() < 0.6 else 0.0)
    return things
