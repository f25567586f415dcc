"""Terrains: random ground of one kind on a slope, as a fine surface and as the heightmap of a perfect survey."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.worlds.terrains._shapes import ON_ROUGH_GROUND, SHAPES, fractal, log_uniform

__all__ = ["FINE", "KINDS", "Terrain", "make_terrain"]

Floats = NDArray[np.float64]

KINDS = tuple(SHAPES)
"""All kinds of ground, starting with the paper's four textures."""
FINE = 4
"""Number of samples of the surface along the side of a pixel."""
_GENTLE_DEG = 8.0
_STEEP = 1.2
"""Half of the terrains lie on slopes up to this multiple of ``slope_limit_deg``, the others on gentle ones."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """The ground of one tile."""

    kind: str
    surface: Floats
    """(pixels * FINE, pixels * FINE) heights, m; north row first."""
    tile_size: float
    """m."""

    @property
    def pixels(self) -> int:
        """Pixels along a side."""
        return len(self.surface) // FINE

    @property
    def heights(self) -> Floats:
        """(pixels, pixels) mean height of each pixel, m; north row first; as from a perfect, noise-free survey."""
        means: Floats = self.surface.reshape(self.pixels, FINE, self.pixels, FINE).mean(axis=(1, 3))
        return means


def make_terrain(
    kind: str,
    seed: int,
    index: int,
    *,
    height_scale: float = 1.0,
    slope_limit_deg: float = 30.0,
    tile_size: float = 3.0,
    pixels: int = 15,
) -> Terrain:
    """Make one terrain.

    The same arguments give the same bits.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    seed, index : int
        Seed of the library, and number of the terrain in its kind.
    height_scale : float
        Factor on all heights; a small vehicle is calibrated on lower ground.
    slope_limit_deg : float
        Slope limit of the vehicle, degrees; slopes of half of the terrains range to slightly beyond it.
    tile_size : float
        m.
    pixels : int
        Along a side, at least 4.

    Raises
    ------
    UsageError
        The kind is unknown, or there are too few pixels.
    """
    if kind not in SHAPES:
        raise UsageError(f"terrain kind is '{kind}'; it must be one of {', '.join(KINDS)}")
    if pixels < 4:
        raise UsageError(f"a terrain of {pixels} pixels; it must have 4 at least")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(KINDS.index(kind), index)))
    samples = pixels * FINE
    axis = (np.arange(samples) + 0.5) * tile_size / samples - tile_size / 2
    x, y = np.meshgrid(axis, axis[::-1])
    surface = SHAPES[kind](rng, x, y, FINE)
    if kind in ON_ROUGH_GROUND:
        surface = surface + fractal(rng, x, rng.uniform(0.3, 0.8), log_uniform(rng, 0.001, 0.012))
    slope = rng.uniform(0.0, _GENTLE_DEG if rng.random() < 0.5 else _STEEP * slope_limit_deg)
    bearing = rng.uniform(0, 2 * np.pi)
    plane = np.tan(np.radians(slope)) * (np.cos(bearing) * x + np.sin(bearing) * y)
    return Terrain(kind, surface * height_scale + plane, tile_size)
