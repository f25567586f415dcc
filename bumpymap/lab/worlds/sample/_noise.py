"""Seeded closed forms for the synthetic quarry: smooth steps, sums of sines, scattered blocks.

Nothing is stored on a raster: every value is a formula of the coordinates, so heights are exact everywhere.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["BlockLayer", "Floats", "WaveField", "smooth_step"]

Floats = NDArray[np.float64]


def smooth_step(value: Floats, start: float, end: float) -> Floats:
    """Rise from 0 at ``start`` to 1 at ``end`` with level ends: 3 t^2 - 2 t^3.

    Parameters
    ----------
    value : array (n,) float64
    start, end : float
        In the unit of ``value``; with ``end`` below ``start`` the step falls.

    Returns
    -------
    array (n,) float64
        0..1, exactly 0 or 1 beyond the two ends.
    """
    share = np.clip((value - start) / (end - start), 0.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


@dataclass(frozen=True, slots=True)
class WaveField:
    """A random surface: sum of plane sine waves in evenly spread directions; longer waves are higher."""

    east: tuple[float, ...]
    """Angular frequency of each wave to the east, rad/m."""
    north: tuple[float, ...]
    """Angular frequency of each wave to the north, rad/m."""
    phase: tuple[float, ...]
    """rad."""
    amplitude: tuple[float, ...]
    """m."""

    @classmethod
    def seeded(cls, key: tuple[int, int], shortest: float, longest: float, deviation: float, waves: int = 14) -> Self:
        """Draw a field.

        Parameters
        ----------
        key : (int, int)
            Seed of the site, number of the field.
        shortest, longest : float
            Wavelengths, m: spread evenly on a logarithmic scale.
        deviation : float
            Standard deviation of the heights over a wide area, m.
        waves : int
            Number of waves.
        """
        rng = np.random.default_rng(key)
        steps = (np.arange(waves) + rng.random(waves)) / waves
        wavelength = shortest * (longest / shortest) ** steps
        direction = np.pi * (rng.permutation(waves) + rng.random(waves)) / waves
        weight = wavelength**0.8
        amplitude = deviation * weight * np.sqrt(2.0 / np.sum(weight**2))
        frequency = 2.0 * np.pi / wavelength
        return cls(
            east=tuple((frequency * np.cos(direction)).tolist()),
            north=tuple((frequency * np.sin(direction)).tolist()),
            phase=tuple((2.0 * np.pi * rng.random(waves)).tolist()),
            amplitude=tuple(amplitude.tolist()),
        )

    def __call__(self, x: Floats, y: Floats) -> Floats:
        """Return heights (n,) at local coordinates, m."""
        total = np.zeros(np.broadcast(x, y).shape)
        for east, north, phase, amplitude in zip(self.east, self.north, self.phase, self.amplitude, strict=True):
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
        """Return the height of the stone at each position, 0 between stones.

        Parameters
        ----------
        x, y : array (n,) float64
            Local coordinates, m.
        share : callable
            Probability of a stone as a function of its centre.

        Returns
        -------
        array (n,) float64
            m. A stone extends at most into the neighbouring cells, so nine cells are examined.
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
