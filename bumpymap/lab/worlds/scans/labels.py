"""Semantic ids of RELLIS-3D, and how surfaces of each answer a laser near 900 nm."""

from dataclasses import dataclass
from enum import IntEnum

__all__ = ["ANSWERS", "Answer", "Label"]


class Label(IntEnum):
    """Ids as the data set writes them into its ``.label`` files."""

    VOID = 0
    DIRT = 1
    GRASS = 3
    TREE = 4
    WATER = 6
    VEHICLE = 8
    ASPHALT = 10
    PERSON = 17
    FENCE = 18
    BUSH = 19
    CONCRETE = 23
    BARRIER = 27
    PUDDLE = 31
    MUD = 33
    RUBBLE = 34


@dataclass(frozen=True, slots=True)
class Answer:
    """How a surface sends light back."""

    reflectivity: tuple[float, float]
    """From and to, share of the light; each scene draws its own."""
    mirror: tuple[float, float] = (0.0, 0.0)
    """Share of the pulses that a smooth wet or painted surface throws away, from and to."""


ANSWERS = {
    Label.DIRT: Answer((0.2, 0.4)),
    Label.GRASS: Answer((0.3, 0.6)),
    Label.TREE: Answer((0.3, 0.6)),
    Label.WATER: Answer((0.05, 0.2), (0.75, 0.97)),
    Label.VEHICLE: Answer((0.2, 0.7), (0.05, 0.35)),
    Label.ASPHALT: Answer((0.1, 0.25)),
    Label.PERSON: Answer((0.2, 0.6)),
    Label.FENCE: Answer((0.2, 0.5)),
    Label.BUSH: Answer((0.3, 0.6)),
    Label.CONCRETE: Answer((0.25, 0.5)),
    Label.BARRIER: Answer((0.25, 0.5)),
    Label.PUDDLE: Answer((0.05, 0.25), (0.7, 0.95)),
    Label.MUD: Answer((0.1, 0.25), (0.05, 0.4)),
    Label.RUBBLE: Answer((0.2, 0.45)),
}
"""Open water sends little back at the low angles of a ground robot, wet mud less than dry dirt."""
