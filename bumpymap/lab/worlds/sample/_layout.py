"""Layout of the synthetic quarry: distances to each feature in local metres (x east, y north from the corner).

A feature has a core, in which its surface is exact, and a blend of a few metres around it, which belongs to no zone.
Every ``outside_*`` function returns the distance from the core in metres: zero or less inside.
"""

import numpy as np

from bumpymap.lab.worlds.sample._noise import Floats

__all__ = [
    "BANK_WIDTH",
    "BLEND",
    "EAST_WEST",
    "KERB_BAND",
    "LANDING_NORTH",
    "NORTH_SOUTH",
    "PAD",
    "RAMP",
    "ROAD_HALF_WIDTH",
    "RUTS",
    "STOCKPILES",
    "WASHBOARD",
    "along_bank",
    "outside_box",
    "outside_pond",
    "outside_ramp",
    "outside_rubble",
    "outside_spur",
    "outside_stockpile",
    "road_offset",
]

EAST_WEST, NORTH_SOUTH = 126.0, 102.0
"""Size of the site, m."""
ROAD_HALF_WIDTH = 6.0
WASHBOARD = (48.0, 80.0)
"""West and east end of the washboard, m east of the corner."""
RUTS = (84.0, EAST_WEST)
PAD = (58.4, 44.3, 76.4, 59.3)
"""West, south, east, north edge of the concrete pad; no edge lies on a border of 3 m tiles."""
KERB_BAND = 2.9
"""The zone 'step' extends this far to both sides of the pad's edge, m."""
RAMP = (12.0, 50.0, 26.0, 76.0)
LANDING_NORTH = 85.0
"""Northern end of the level landing of the ramp, at the upper bench, m."""
BANK_WIDTH = 12.0
STOCKPILES = ((42.6, 46.5, 6.2), (47.2, 51.6, 4.2))
"""x, y and radius of the gravel heaps, m."""
BLEND = {"road": 3.0, "spur": 3.0, "ramp": 5.0, "pad": 7.0, "pond": 3.5}
"""Width of the blend around a core, m. The pad's apron is flat over the first ``KERB_BAND`` metres of its blend."""

_POND = (37.0, 61.5, 5.0, 4.0)
_RUBBLE = (99.0, 53.5, 19.0, 12.5)


def road_offset(x: Floats, y: Floats) -> Floats:
    """Distance to the north of the road's centreline, m (measured across the road)."""
    turn = 2.0 * np.pi / 140.0
    centre = 26.0 + 4.0 * np.sin(turn * (x - 10.0))
    gradient = 4.0 * turn * np.cos(turn * (x - 10.0))
    return (y - centre) / np.sqrt(1.0 + gradient**2)


def along_bank(x: Floats, y: Floats) -> Floats:
    """Distance to the north of the foot of the bench wall, m; the wall is ``BANK_WIDTH`` wide."""
    arc = 71.0 - 9.0 * ((x - 63.0) / 63.0) ** 4
    return y - (arc + 1.6 * np.sin(2.0 * np.pi * x / 61.0 + 0.6) + 0.8 * np.sin(2.0 * np.pi * x / 23.0))


def outside_box(x: Floats, y: Floats, box: tuple[float, float, float, float]) -> Floats:
    """Distance to a (west, south, east, north) box, m; inside it is minus the distance to the edge."""
    west, south, east, north = box
    from_x, from_y = np.maximum(west - x, x - east), np.maximum(south - y, y - north)
    corner = np.hypot(np.maximum(from_x, 0.0), np.maximum(from_y, 0.0))
    return corner + np.minimum(np.maximum(from_x, from_y), 0.0)


def outside_ramp(x: Floats, y: Floats) -> Floats:
    """Distance to the ramp and its landing, m."""
    return outside_box(x, y, (*RAMP[:3], LANDING_NORTH))


def outside_spur(x: Floats, y: Floats) -> Floats:
    """Distance to the spur that leads from the road to the foot of the ramp, m."""
    return outside_box(x, y, (RAMP[0], 26.0, RAMP[2], RAMP[1]))


def outside_pond(x: Floats, y: Floats) -> Floats:
    """Approximate distance to the 10 x 8 m ellipse of the pond, m; the sign is exact."""
    x0, y0, half_x, half_y = _POND
    return (np.hypot((x - x0) / half_x, (y - y0) / half_y) - 1.0) * half_y


def outside_rubble(x: Floats, y: Floats) -> Floats:
    """Approximate distance to the lobed outline of the rubble field, m; the sign is exact."""
    x0, y0, half_x, half_y = _RUBBLE
    angle = np.arctan2((y - y0) / half_y, (x - x0) / half_x)
    lobes = 1.0 + 0.07 * np.sin(3.0 * angle + 0.8) + 0.05 * np.sin(7.0 * angle)
    return (np.hypot((x - x0) / half_x, (y - y0) / half_y) / lobes - 1.0) * half_y


def outside_stockpile(x: Floats, y: Floats) -> Floats:
    """Distance to the foot of the nearest gravel heap, m."""
    distances = [np.hypot(x - x0, y - y0) - radius for x0, y0, radius in STOCKPILES]
    return np.minimum(distances[0], distances[1])
