"""Grounds over which the motion of a vehicle is known: planes and sine waves."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PlaneGround:
    """A plane through the origin."""

    gradient: tuple[float, float]
    """Slope to the east and to the north, m/m."""
    extent: float = 1.0
    spacing: float = 0.5

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Heights of points, m."""
        return self.gradient[0] * easting + self.gradient[1] * northing


@dataclass(frozen=True, slots=True)
class SineGround:
    """Sine waves along the easting, constant along the northing."""

    amplitude: float
    """m."""
    wavelength: float
    """m."""
    gradient: tuple[float, float] = (0.0, 0.0)

    @property
    def extent(self) -> float:
        """One wave, m."""
        return self.wavelength

    @property
    def spacing(self) -> float:
        """A fortieth of the wavelength, m."""
        return self.wavelength / 40

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Heights of points, m."""
        waves = self.amplitude * np.sin(2 * np.pi / self.wavelength * easting)
        return np.broadcast_to(waves, np.broadcast_shapes(easting.shape, northing.shape)).astype(np.float64)


def sine_c_r(profile, amplitude, wavelength):
    """Return C_r of a vehicle whose axles follow a sine, rad/m.

    The axles are W apart, so the pitch is a sine of amplitude ``2 A sin(pi W / L) / W`` (small angles). In every wave
    the absolute pitch changes add up to four times that: ``C_r = 8 A sin(pi W / L) / (W L)``.
    """
    base = profile.wheelbase_m
    return 8 * amplitude * math.sin(math.pi * base / wavelength) / (base * wavelength)
