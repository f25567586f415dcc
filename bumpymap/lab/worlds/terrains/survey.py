"""Simulate the survey of a terrain: points at random positions, with the errors of a scanner or of photogrammetry."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from bumpymap.core import UsageError
from bumpymap.lab.worlds.terrains.library import Terrain

__all__ = ["ScanEffects", "TerrainPoints", "survey_terrain"]

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ScanEffects:
    """The errors of a survey."""

    density: float = 100.0
    """Points per m2."""
    noise_m: float = 0.0
    """Standard deviation of the heights."""
    noise_length_m: float = 0.0
    """Correlation length of the errors (photogrammetry, flight lines); 0: errors are independent."""
    hole_share: float = 0.0
    """Share of the tile without points, in round holes of 0.2 to 0.5 m radius; 0..1."""
    smoothing_m: float = 0.0
    """Standard deviation of the Gaussian that blurs the surface before it is sampled, as photogrammetry does."""

    def __post_init__(self) -> None:
        for name in ("noise_m", "noise_length_m", "smoothing_m"):
            if not getattr(self, name) >= 0:
                raise UsageError(f"{name} is {getattr(self, name)}; it must be 0 m or more")
        if not self.density > 0:
            raise UsageError(f"density is {self.density}; it must be above 0 points per m2")
        if not 0 <= self.hole_share < 1:
            raise UsageError(f"hole_share is {self.hole_share}; it must be 0 or more, and below 1")


@dataclass(frozen=True, slots=True)
class TerrainPoints:
    """Points (n,) of a tile with its south-west corner at the origin, m."""

    easting: Floats
    northing: Floats
    upward: Floats


def survey_terrain(terrain: Terrain, effects: ScanEffects, rng: np.random.Generator) -> TerrainPoints:
    """Draw the points of a survey; the same generator state gives the same bits."""
    side, surface = terrain.tile_size, terrain.surface
    step = side / len(surface)
    if effects.smoothing_m > 0:
        surface = gaussian_filter(surface, effects.smoothing_m / step, mode="nearest")
    count = int(rng.poisson(effects.density * side**2))
    place = rng.uniform(0.0, side, (2, count))
    kept = ~_in_holes(place, effects.hole_share, side, rng)
    easting, northing = place[:, kept]
    where = np.array([(side - northing) / step - 0.5, easting / step - 0.5])
    upward: Floats = map_coordinates(surface, where, order=1, mode="nearest")
    return TerrainPoints(easting, northing, upward + _noise(where, surface.shape, step, effects, rng))


def _noise(
    where: Floats, shape: tuple[int, ...], step: float, effects: ScanEffects, rng: np.random.Generator
) -> Floats:
    """Draw height errors of points at ``where`` (2, n), in samples of the surface."""
    if effects.noise_length_m <= 0:
        return np.asarray(effects.noise_m * rng.standard_normal(where.shape[1]))
    sigma = effects.noise_length_m / step
    margin = int(np.ceil(4 * sigma))
    white = rng.standard_normal([side + 2 * margin for side in shape])
    field = gaussian_filter(white, sigma, mode="wrap")[margin : margin + shape[0], margin : margin + shape[1]]
    errors: Floats = map_coordinates(field, where, order=1, mode="nearest")
    return errors * (effects.noise_m / _blurred_sd(sigma))


def _blurred_sd(sigma: float) -> float:
    """Return the standard deviation of unit white noise after the blur, computed from the kernel."""
    impulse = np.zeros(2 * int(np.ceil(4 * sigma)) + 1)
    impulse[len(impulse) // 2] = 1.0
    return float((gaussian_filter(impulse, sigma, mode="constant") ** 2).sum())


def _in_holes(place: Floats, share: float, side: float, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Return which points (2, n) lie in holes; holes are added until they cover about ``share`` of the points."""
    gone = np.zeros(place.shape[1], np.bool_)
    while share > 0 and gone.size and gone.mean() < share:
        middle, radius = rng.uniform(0.0, side, (2, 1)), rng.uniform(0.2, 0.5)
        gone |= ((place - middle) ** 2).sum(axis=0) < radius**2
    return gone
