"""The surfaces of the synthetic quarry, overlaid in order: heights above the datum in metres, closed forms only."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from bumpymap.lab.worlds.sample import _layout as lay
from bumpymap.lab.worlds.sample._noise import BlockLayer, Floats, WaveField, smooth_step

__all__ = ["CROWN", "KERB_HEIGHT", "RAMP_SLOPE_DEG", "RUT_DEPTH", "WASHBOARD_AMPLITUDE", "WASHBOARD_LENGTH", "relief"]

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


@dataclass(frozen=True, slots=True)
class _Roughness:
    """Seeded random fields of one site."""

    floor: WaveField
    road: WaveField
    undulation: WaveField
    tussocks: WaveField
    rock: WaveField
    gravel: WaveField
    small_blocks: BlockLayer
    large_blocks: BlockLayer


@lru_cache(maxsize=8)
def _roughness(seed: int) -> _Roughness:
    return _Roughness(
        floor=WaveField.seeded((seed, 1), 0.8, 20.0, 0.04, waves=24),
        road=WaveField.seeded((seed, 2), 0.6, 4.0, 0.004),
        undulation=WaveField.seeded((seed, 3), 12.0, 34.0, 0.17, waves=9),
        tussocks=WaveField.seeded((seed, 4), 0.5, 1.6, 0.012, waves=24),
        rock=WaveField.seeded((seed, 5), 0.7, 6.0, 0.24, waves=36),
        gravel=WaveField.seeded((seed, 6), 0.4, 2.5, 0.05),
        small_blocks=BlockLayer(seed * 64, 0.6, 0.10, 0.25),
        large_blocks=BlockLayer(seed * 64 + 32, 1.25, 0.20, 0.50),
    )


def relief(seed: int, x: Floats, y: Floats) -> Floats:
    """Return the height of the ground, (n,) m, at local coordinates ``x``, ``y`` (n,) m."""
    z = _open_ground(seed, x, y)
    z = _overlay(z, x, y, lay.outside_stockpile(x, y) < 0.0, lambda z, x, y: z + _stockpile(seed, x, y))
    z = _overlay(z, x, y, _stone_share(x, y, 2.0) > 0.0, lambda z, x, y: z + _rubble(seed, x, y))
    z = _overlay(z, x, y, lay.outside_pond(x, y) < lay.BLEND["pond"], _pond)
    z = _overlay(z, x, y, lay.outside_box(x, y, lay.PAD) < lay.BLEND["pad"], _pad)
    z = _overlay(z, x, y, lay.outside_ramp(x, y) < lay.BLEND["ramp"], _ramp)
    z = _overlay(z, x, y, lay.outside_spur(x, y) < lay.BLEND["spur"], lambda z, x, y: _spur(seed, z, x, y))
    near_road = np.abs(lay.road_offset(x, y)) < lay.ROAD_HALF_WIDTH + lay.BLEND["road"]
    return _overlay(z, x, y, near_road, lambda z, x, y: _road(seed, z, x, y))


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
    south = smooth_step(lay.road_offset(x, y), -6.0, -9.0)
    return np.maximum(south, smooth_step(lay.along_bank(x, y), lay.BANK_WIDTH - 1.5, lay.BANK_WIDTH))


def _open_ground(seed: int, x: Floats, y: Floats) -> Floats:
    """Floor, meadow and the bench wall: two rough faces with a narrow berm between them."""
    rough = _roughness(seed)
    north = lay.along_bank(x, y)
    faces = 3.7 * smooth_step(north, 0.0, 5.0) + (BENCH_HEIGHT - 3.7) * smooth_step(north, 7.0, lay.BANK_WIDTH)
    meadow = _meadow_share(x, y)
    z = _base(x, y) + faces + 0.5 * smooth_step(lay.road_offset(x, y), -7.0, -22.0)
    z = _overlay(z, x, y, meadow < 1.0, lambda z, x, y: z + (1.0 - _meadow_share(x, y)) * rough.floor(x, y))
    grown = rough.undulation
    z = _overlay(z, x, y, meadow > 0.0, lambda z, x, y: z + _meadow_share(x, y) * (grown(x, y) + rough.tussocks(x, y)))
    return _overlay(z, x, y, (north > -1.0) & (north < lay.BANK_WIDTH), lambda z, x, y: z + _rock(seed, x, y))


def _rock(seed: int, x: Floats, y: Floats) -> Floats:
    """Broken rock on the faces: folded waves give ribs and gullies, fading at the foot and at the edge."""
    north = lay.along_bank(x, y)
    strength = smooth_step(north, -1.0, 0.8) * smooth_step(north, lay.BANK_WIDTH, lay.BANK_WIDTH - 1.2)
    waves = _roughness(seed).rock(x, y)
    return strength * (waves - 0.6 * np.abs(waves))


def _stockpile(seed: int, x: Floats, y: Floats) -> Floats:
    """Gravel heaps at 32 degrees with rounded tops, m above the floor."""
    tops: list[Floats] = [
        np.tan(np.radians(32.0)) * np.maximum(radius - np.sqrt((x - x0) ** 2 + (y - y0) ** 2 + 0.6) + 0.05, 0.0)
        for x0, y0, radius in lay.STOCKPILES
    ]
    heap = np.maximum(tops[0], tops[1])
    return heap + np.minimum(heap, 1.0) * _roughness(seed).gravel(x, y)


def _stone_share(x: Floats, y: Floats, reach: float = 0.0) -> Floats:
    """Return the probability of a stone per lattice cell: high in the rubble field, lower around it and below the wall.

    ``reach`` [m] widens both areas, to find all positions that a stone inside may cover.
    """
    field = smooth_step(lay.outside_rubble(x, y), 4.0 + reach, 0.0)
    north = lay.along_bank(x, y)
    talus = smooth_step(north, -4.0 - reach, 0.0) * smooth_step(north, 5.0 + reach, 1.0)
    return np.maximum(0.92 * field, 0.22 * talus)


def _rubble(seed: int, x: Floats, y: Floats) -> Floats:
    """Blocks over smaller blocks, m above the ground."""
    rough = _roughness(seed)
    small = rough.small_blocks.height(x, y, _stone_share)
    return np.maximum(small, rough.large_blocks.height(x, y, lambda x, y: 0.6 * _stone_share(x, y)))


def _pond(z: Floats, x: Floats, y: Floats) -> Floats:
    """Return a pond 0.9 m below the floor; surveys have no points inside its shore."""
    share = smooth_step(lay.outside_pond(x, y), lay.BLEND["pond"], -1.0)
    return (1.0 - share) * z + share * (_base(x, y) - 0.9)


def _pad(z: Floats, x: Floats, y: Floats) -> Floats:
    """Concrete slab on a flat apron: a clean kerb of ``KERB_HEIGHT`` all around."""
    outside = lay.outside_box(x, y, lay.PAD)
    share = smooth_step(outside, lay.BLEND["pad"], lay.KERB_BAND)
    apron = DATUM + 1.1 + 0.004 * (x - lay.PAD[0]) + 0.010 * (y - lay.PAD[1])
    return (1.0 - share) * z + share * apron + np.where(outside <= 0.0, KERB_HEIGHT, 0.0)


def _ramp(z: Floats, x: Floats, y: Floats) -> Floats:
    """Return an exact plane of ``RAMP_SLOPE_DEG`` that climbs to the north, with a level landing at the top."""
    share = smooth_step(lay.outside_ramp(x, y), lay.BLEND["ramp"], 0.0)
    climb = np.clip(y - lay.RAMP[1], 0.0, lay.RAMP[3] - lay.RAMP[1])
    plane: Floats = DATUM + 0.75 + np.tan(np.radians(RAMP_SLOPE_DEG)) * climb
    return (1.0 - share) * z + share * plane


def _spur(seed: int, z: Floats, x: Floats, y: Floats) -> Floats:
    """Graded track from the road to the ramp; its blend stops at the ramp's toe."""
    share = smooth_step(lay.outside_spur(x, y), lay.BLEND["spur"], 0.0) * smooth_step(y, lay.RAMP[1], lay.RAMP[1] - 3.0)
    return (1.0 - share) * z + share * (DATUM + 0.75 + 0.006 * (y - lay.RAMP[1]) + _roughness(seed).road(x, y))


def _road(seed: int, z: Floats, x: Floats, y: Floats) -> Floats:
    """Crowned haul road with a washboard and a rutted section, and a windrow along its southern edge."""
    offset = lay.road_offset(x, y)
    share = smooth_step(np.abs(offset), lay.ROAD_HALF_WIDTH + lay.BLEND["road"], lay.ROAD_HALF_WIDTH)
    crown = -CROWN * (np.sqrt(offset**2 + 0.5) - np.sqrt(0.5))
    surface: Floats = DATUM + 0.6 + 0.012 * x + crown + _roughness(seed).road(x, y)
    surface += _washboard(x, offset) + _ruts(x, offset)
    windrow = 0.45 * np.exp(-(((offset + 7.4) / 0.55) ** 2)) * (1.0 - smooth_step(-offset, 6.6, 6.0))
    return (1.0 - share) * z + share * surface + np.where(offset < -lay.ROAD_HALF_WIDTH, windrow, 0.0)


def _washboard(x: Floats, offset: Floats) -> Floats:
    """Sine crests across the road, slightly bent, full height between the ends of ``WASHBOARD``, m."""
    west, east = lay.WASHBOARD
    strength = smooth_step(x, west - 4.0, west) * smooth_step(x, east + 4.0, east)
    bend = 0.12 * np.sin(2.0 * np.pi * offset / 9.0)
    return WASHBOARD_AMPLITUDE * strength * np.sin(2.0 * np.pi * (x + bend) / WASHBOARD_LENGTH)


def _ruts(x: Floats, offset: Floats) -> Floats:
    """Two parallel troughs in each of the two lanes, with pushed-up shoulders, wandering a little, m."""
    strength = smooth_step(x, lay.RUTS[0] - 4.0, lay.RUTS[0]) * (1.0 + 0.25 * np.sin(2.0 * np.pi * x / 11.0))
    wander = offset + 0.12 * np.sin(2.0 * np.pi * x / 17.0)
    total = np.zeros(x.shape)
    for trough in _RUT_OFFSETS:
        from_trough = (wander - trough) / _RUT_WIDTH
        total += -np.exp(-0.5 * from_trough**2) + 0.3 * np.exp(-0.5 * (np.abs(from_trough) - 2.2) ** 2 / 0.5)
    return RUT_DEPTH * strength * total
