"""Semantic ids of RELLIS-3D, and the reflection of their surfaces near 900 nm."""

from dataclasses import dataclass
from enum import IntEnum

__all__ = ["REFLECTIONS", "Label", "Reflection"]


class Label(IntEnum):
    """Ids of the ``.label`` files of the data set."""

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
class Reflection:
    """Reflection of a laser pulse by a surface."""

    reflectivity: tuple[float, float]
    """Range of the reflectivity, 0..1; each scene draws its own value."""
    specular_loss: tuple[float, float] = (0.0, 0.0)
    """Range of the share of pulses that a smooth wet or painted surface reflects away from the sensor."""


REFLECTIONS = {
    Label.DIRT: Reflection((0.2, 0.4)),
    Label.GRASS: Reflection((0.3, 0.6)),
    Label.TREE: Reflection((0.3, 0.6)),
    Label.WATER: Reflection((0.05, 0.2), (0.75, 0.97)),
    Label.VEHICLE: Reflection((0.2, 0.7), (0.05, 0.35)),
    Label.ASPHALT: Reflection((0.1, 0.25)),
    Label.PERSON: Reflection((0.2, 0.6)),
    Label.FENCE: Reflection((0.2, 0.5)),
    Label.BUSH: Reflection((0.3, 0.6)),
    Label.CONCRETE: Reflection((0.25, 0.5)),
    Label.BARRIER: Reflection((0.25, 0.5)),
    Label.PUDDLE: Reflection((0.05, 0.25), (0.7, 0.95)),
    Label.MUD: Reflection((0.1, 0.25), (0.05, 0.4)),
    Label.RUBBLE: Reflection((0.2, 0.45)),
}
"""Open water returns little light at the low angles of a ground robot, wet mud less than dry dirt."""
