"""The site of the sample survey: a synthetic quarry with relief in closed form.

Coordinates are local metres, x east and y north from the corner; heights are above the datum. Every value is a formula
of the coordinates, nothing is stored on a raster, so heights are exact everywhere. A feature has a core, in which its
surface is exact, and a blend of a few metres around it, which belongs to no zone. Every ``outside_*`` function returns
the distance from the core in metres: zero or less inside. `height` and ``BOUNDS`` are in coordinates of the
CRS.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpytiles import Bounds

Floats = NDArray[np.float64]


def smooth_step(value: Floats, start: float, end: float) -> Floats:
    """Rise from 0 at ``start`` to 1 at ``end`` with level ends; with ``end`` below ``start`` the step falls."""
    share = np.clip((value - start) / (end - start), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


class WaveField:
    """A random surface: sum of plane sine waves in evenly spread directions; longer waves are higher."""

    def __init__(self, key: tuple[int, int], shortest: float, longest: float, deviation: float, waves: int = 14):
        """Draw a field of ``waves`` wavelengths [m], spread evenly on a logarithmic scale, from seed and number."""
        rng = np.random.default_rng(key)
        steps = (np.arange(waves) + rng.random(waves)) / waves
        wavelength = shortest * (longest / shortest) ** steps
        direction = np.pi * (rng.permutation(waves) + rng.random(waves)) / waves
        weight = wavelength**0.8
        amplitude = deviation * weight * np.sqrt(2.0 / np.sum(weight**2))
        frequency = 2.0 * np.pi / wavelength
        phase = 2.0 * np.pi * rng.random(waves)
        east, north = frequency * np.cos(direction), frequency * np.sin(direction)
        self._waves = np.stack([amplitude, east, north, phase], axis=1).tolist()

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return heights (n,) at local coordinates, m."""
        total = np.zeros(np.broadcast(x, y).shape)
        for amplitude, east, north, phase in self._waves:
            total += amplitude * np.sin(east * x + north * y + phase)
        return total


@dataclass(frozen=True, slots=True)
class BlockLayer:
    """Angular stones of similar size: at most one per lattice cell, at a random position and angle."""

    key: int
    """Seed of the layer."""
    cell: float
    """Side of a lattice cell, m. A stone is 0.5 to 1.1 cells long."""
    lowest: float
    """Height of the smallest stone, m."""
    highest: float
    """Height of the tallest stone, m."""

    def height(self, x: Floats, y: Floats, share: Callable[[Floats, Floats], Floats]) -> Floats:
        """Return the height (n,) of the stone at each position [m], 0 between stones.

        ``share`` is the probability of a stone by its centre. It reaches at most into the neighbouring cells.
        """
        column, line = np.floor(x / self.cell).astype(np.int64), np.floor(y / self.cell).astype(np.int64)
        top = np.zeros(x.shape)
        for step_x in (-1, 0, 1):
            for step_y in (-1, 0, 1):
                np.maximum(top, self._stone(x, y, column + step_x, line + step_y, share), out=top)
        return top

    def _stone(
        self,
        x: Floats,
        y: Floats,
        column: NDArray[np.int64],
        line: NDArray[np.int64],
        share: Callable[[Floats, Floats], Floats],
    ) -> Floats:
        """Return the height of the stone of one cell at each position, (n,) m."""
        draw = [uniform(column, line, self.key + number) for number in range(8)]
        centre_x, centre_y = (column + draw[0]) * self.cell, (line + draw[1]) * self.cell
        half_length, half_width = self.cell * (0.25 + 0.3 * draw[2]), self.cell * (0.2 + 0.2 * draw[3])
        cosine, sine = np.cos(np.pi * draw[4]), np.sin(np.pi * draw[4])
        along = (cosine * (x - centre_x) + sine * (y - centre_y)) / half_length
        across = (cosine * (y - centre_y) - sine * (x - centre_x)) / half_width
        inside = 1.0 - np.maximum(np.abs(along), np.abs(across))
        flanks = np.clip(inside / 0.3, 0.0, 1.0)
        tilted_top = 1.0 - 0.35 * draw[5] * (1.0 + along) / 2.0
        height = self.lowest + (self.highest - self.lowest) * draw[6] ** 2
        return np.where(draw[7] < share(centre_x, centre_y), height * tilted_top * flanks, 0.0)


def uniform(column: NDArray[np.int64], line: NDArray[np.int64], key: int) -> Floats:
    """Hash lattice cells to uniform numbers 0..1 (n,), identical on all machines."""
    mixed = column.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15) + line.astype(np.uint64) * np.uint64(
        0xC2B2AE3D27D4EB4F
    )
    mixed += np.uint64((key * 0x165667B19E3779F9) % 2**64)
    for shift, factor in ((32, 0xD6E8FEB86659FD93), (29, 0xA0761D6478BD642F)):
        mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
    mixed ^= mixed >> np.uint64(32)
    return (mixed >> np.uint64(11)).astype(np.float64) * 2.0**-53


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


DATUM = 412.0
CROWN = 0.02
"""Cross fall of the road to both sides of its centreline, m/m."""
WASHBOARD_AMPLITUDE = 0.02
"""Half of the crest-to-trough height, m."""
WASHBOARD_LENGTH = 0.7
"""Crest to crest along the easting, m."""
RUT_DEPTH = 0.16
"""Mean depth along the rut, m."""
KERB_HEIGHT = 0.25
"""Height of the pad above its apron on all four sides, m."""
RAMP_SLOPE_DEG = 15.0
BENCH_HEIGHT = 7.0
"""Height of the upper bench above the quarry floor, m."""
_RUT_OFFSETS = (-3.8, -1.4, 1.4, 3.8)
_RUT_WIDTH = 0.24


_SEED = 1
_FLOOR = WaveField((_SEED, 1), 0.8, 20.0, 0.04, waves=24)
_ROAD = WaveField((_SEED, 2), 0.6, 4.0, 0.004)
_UNDULATION = WaveField((_SEED, 3), 12.0, 34.0, 0.17, waves=9)
_TUSSOCKS = WaveField((_SEED, 4), 0.5, 1.6, 0.012, waves=24)
_ROCK = WaveField((_SEED, 5), 0.7, 6.0, 0.24, waves=36)
_GRAVEL = WaveField((_SEED, 6), 0.4, 2.5, 0.05)
_SMALL_BLOCKS = BlockLayer(_SEED * 64, 0.6, 0.10, 0.25)
_LARGE_BLOCKS = BlockLayer(_SEED * 64 + 32, 1.25, 0.20, 0.50)


def relief(x: Floats, y: Floats) -> Floats:
    """Return the height of the ground, (n,) m, at local coordinates ``x``, ``y`` (n,) m."""
    z = _open_ground(x, y)
    z = _overlay(z, x, y, outside_stockpile(x, y) < 0.0, lambda z, x, y: z + _stockpile(x, y))
    z = _overlay(z, x, y, _stone_share(x, y, 2.0) > 0.0, lambda z, x, y: z + _rubble(x, y))
    z = _overlay(z, x, y, outside_pond(x, y) < BLEND["pond"], _pond)
    z = _overlay(z, x, y, outside_box(x, y, PAD) < BLEND["pad"], _pad)
    z = _overlay(z, x, y, outside_ramp(x, y) < BLEND["ramp"], _ramp)
    z = _overlay(z, x, y, outside_spur(x, y) < BLEND["spur"], _spur)
    near_road = np.abs(road_offset(x, y)) < ROAD_HALF_WIDTH + BLEND["road"]
    return _overlay(z, x, y, near_road, _road)


def _overlay(
    z: Floats, x: Floats, y: Floats, where: np.ndarray, surface: Callable[[Floats, Floats, Floats], Floats]
) -> Floats:
    """Overlay a surface on the ground where ``where`` is True, and evaluate it only there."""
    if where.any():
        z[where] = surface(z[where], x[where], y[where])
    return z


def _base(x: Floats, y: Floats) -> Floats:
    """Return the quarry floor without roughness: a plane that falls to the south-west."""
    return DATUM + 0.012 * x + 0.006 * y


def _meadow_share(x: Floats, y: Floats) -> Floats:
    """Return 1 on vegetated ground (south strip, upper bench), 0 on the quarry floor."""
    south = smooth_step(road_offset(x, y), -6.0, -9.0)
    return np.maximum(south, smooth_step(along_bank(x, y), BANK_WIDTH - 1.5, BANK_WIDTH))


def _open_ground(x: Floats, y: Floats) -> Floats:
    """Floor, meadow and the bench wall: two rough faces with a narrow berm between them."""
    north = along_bank(x, y)
    faces = 3.7 * smooth_step(north, 0.0, 5.0) + (BENCH_HEIGHT - 3.7) * smooth_step(north, 7.0, BANK_WIDTH)
    meadow = _meadow_share(x, y)
    z = _base(x, y) + faces + 0.5 * smooth_step(road_offset(x, y), -7.0, -22.0)
    z = _overlay(z, x, y, meadow < 1.0, lambda z, x, y: z + (1.0 - _meadow_share(x, y)) * _FLOOR(x, y))
    z = _overlay(z, x, y, meadow > 0.0, lambda z, x, y: z + _meadow_share(x, y) * (_UNDULATION(x, y) + _TUSSOCKS(x, y)))
    return _overlay(z, x, y, (north > -1.0) & (north < BANK_WIDTH), lambda z, x, y: z + _rock(x, y))


def _rock(x: Floats, y: Floats) -> Floats:
    """Broken rock on the faces: folded waves give ribs and gullies, fading at the foot and at the edge."""
    north = along_bank(x, y)
    strength = smooth_step(north, -1.0, 0.8) * smooth_step(north, BANK_WIDTH, BANK_WIDTH - 1.2)
    waves = _ROCK(x, y)
    return strength * (waves - 0.6 * np.abs(waves))


def _stockpile(x: Floats, y: Floats) -> Floats:
    """Gravel heaps at 32 degrees with rounded tops, m above the floor."""
    tops: list[Floats] = [
        np.tan(np.radians(32.0)) * np.maximum(radius - np.sqrt((x - x0) ** 2 + (y - y0) ** 2 + 0.6) + 0.05, 0.0)
        for x0, y0, radius in STOCKPILES
    ]
    heap = np.maximum(tops[0], tops[1])
    return heap + np.minimum(heap, 1.0) * _GRAVEL(x, y)


def _stone_share(x: Floats, y: Floats, reach: float = 0.0) -> Floats:
    """Return the probability of a stone per lattice cell: high in the rubble field, lower around it and below the wall.

    ``reach`` [m] widens both areas, to find all positions that a stone inside may cover.
    """
    field = smooth_step(outside_rubble(x, y), 4.0 + reach, 0.0)
    north = along_bank(x, y)
    talus = smooth_step(north, -4.0 - reach, 0.0) * smooth_step(north, 5.0 + reach, 1.0)
    return np.maximum(0.92 * field, 0.22 * talus)


def _rubble(x: Floats, y: Floats) -> Floats:
    """Blocks over smaller blocks, m above the ground."""
    small = _SMALL_BLOCKS.height(x, y, _stone_share)
    return np.maximum(small, _LARGE_BLOCKS.height(x, y, lambda x, y: 0.6 * _stone_share(x, y)))


def _pond(z: Floats, x: Floats, y: Floats) -> Floats:
    """Return a pond 0.9 m below the floor; surveys have no points inside its shore."""
    share = smooth_step(outside_pond(x, y), BLEND["pond"], -1.0)
    return (1.0 - share) * z + share * (_base(x, y) - 0.9)


def _pad(z: Floats, x: Floats, y: Floats) -> Floats:
    """Concrete slab on a flat apron: a clean kerb of ``KERB_HEIGHT`` all around."""
    outside = outside_box(x, y, PAD)
    share = smooth_step(outside, BLEND["pad"], KERB_BAND)
    apron = DATUM + 1.1 + 0.004 * (x - PAD[0]) + 0.010 * (y - PAD[1])
    return (1.0 - share) * z + share * apron + np.where(outside <= 0.0, KERB_HEIGHT, 0.0)


def _ramp(z: Floats, x: Floats, y: Floats) -> Floats:
    """Return an exact plane of ``RAMP_SLOPE_DEG`` that climbs to the north, with a level landing at the top."""
    share = smooth_step(outside_ramp(x, y), BLEND["ramp"], 0.0)
    climb = np.clip(y - RAMP[1], 0.0, RAMP[3] - RAMP[1])
    plane: Floats = DATUM + 0.75 + np.tan(np.radians(RAMP_SLOPE_DEG)) * climb
    return (1.0 - share) * z + share * plane


def _spur(z: Floats, x: Floats, y: Floats) -> Floats:
    """Graded track from the road to the ramp; its blend stops at the ramp's toe."""
    share = smooth_step(outside_spur(x, y), BLEND["spur"], 0.0) * smooth_step(y, RAMP[1], RAMP[1] - 3.0)
    return (1.0 - share) * z + share * (DATUM + 0.75 + 0.006 * (y - RAMP[1]) + _ROAD(x, y))


def _road(z: Floats, x: Floats, y: Floats) -> Floats:
    """Crowned haul road with a washboard and a rutted section, and a windrow along its southern edge."""
    offset = road_offset(x, y)
    share = smooth_step(np.abs(offset), ROAD_HALF_WIDTH + BLEND["road"], ROAD_HALF_WIDTH)
    crown = -CROWN * (np.sqrt(offset**2 + 0.5) - np.sqrt(0.5))
    surface: Floats = DATUM + 0.6 + 0.012 * x + crown + _ROAD(x, y)
    surface += _washboard(x, offset) + _ruts(x, offset)
    windrow = 0.45 * np.exp(-(((offset + 7.4) / 0.55) ** 2)) * (1.0 - smooth_step(-offset, 6.6, 6.0))
    return (1.0 - share) * z + share * surface + np.where(offset < -ROAD_HALF_WIDTH, windrow, 0.0)


def _washboard(x: Floats, offset: Floats) -> Floats:
    """Sine crests across the road, slightly bent, full height between the ends of ``WASHBOARD``, m."""
    west, east = WASHBOARD
    strength = smooth_step(x, west - 4.0, west) * smooth_step(x, east + 4.0, east)
    bend = 0.12 * np.sin(2.0 * np.pi * offset / 9.0)
    return WASHBOARD_AMPLITUDE * strength * np.sin(2.0 * np.pi * (x + bend) / WASHBOARD_LENGTH)


def _ruts(x: Floats, offset: Floats) -> Floats:
    """Two parallel troughs in each of the two lanes, with pushed-up shoulders, wandering a little, m."""
    strength = smooth_step(x, RUTS[0] - 4.0, RUTS[0]) * (1.0 + 0.25 * np.sin(2.0 * np.pi * x / 11.0))
    wander = offset + 0.12 * np.sin(2.0 * np.pi * x / 17.0)
    total = np.zeros(x.shape)
    for trough in _RUT_OFFSETS:
        from_trough = (wander - trough) / _RUT_WIDTH
        total += -np.exp(-0.5 * from_trough**2) + 0.3 * np.exp(-0.5 * (np.abs(from_trough) - 2.2) ** 2 / 0.5)
    return RUT_DEPTH * strength * total


_WEST, _SOUTH = 512_340.0, 5_403_210.0
BOUNDS = Bounds(_WEST, _SOUTH, _WEST + EAST_WEST, _SOUTH + NORTH_SOUTH)
"""Extent of the site in WGS 84 / UTM zone 32N, m; a whole number of 3 m tiles. The location is arbitrary."""


def height(easting: Floats, northing: Floats) -> Floats:
    """Return the height of the bare ground at any places, m; continuous except at the kerb of the pad."""
    x, y = _local(easting, northing)
    return relief(x.ravel(), y.ravel()).reshape(x.shape)


def tiles_of(symbol: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return columns and rows (k,) of the 3 m tiles with a symbol in the map of zones of the samples' README."""
    text = (Path(__file__).resolve().parents[2] / "sample_data" / "README.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in text.partition("## Map of zones")[2].splitlines() if line.startswith("    ")]
    from_north, from_west = np.nonzero(np.array([list(line) for line in lines]) == symbol)
    return from_west + round(BOUNDS.west / 3), round(BOUNDS.north / 3) - 1 - from_north


def _local(easting: Floats, northing: Floats) -> tuple[Floats, Floats]:
    """Return coordinates relative to the south-west corner, m, broadcast to a common shape."""
    x, y = np.broadcast_arrays(np.asarray(easting, np.float64), np.asarray(northing, np.float64))
    return x - _WEST, y - _SOUTH
