"""Estimate the scan noise of heightmaps and remove it.

A pixel's height is the mean of its points. Their spread inside the pixel, less what the slope of the ground explains,
tells the noise of a point; a mean of n points errs by its n-th part (as variance), whether the spread is the scanner's
or that of gravel finer than a pixel. So the noise of the heightmap is known, and it is white: alike in all its cosines
(an orthonormal transform whose half-sample mirroring is that of the ride model). Ground is not white: its power falls
with the wave number k as k^-beta, beta from 2 to 4.5 over the Hurst exponents of natural surfaces. Strength and
exponent are fitted to each patch (Whittle's likelihood), and each cosine is shrunk to the power that is the ground's;
one that stands far out of the noise keeps what is above it, so that a kerb or a washboard stays.

What the points cannot tell: errors that neighbours share (photogrammetry, flight lines) look like ground, and stay.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack, Reason
from bumpymap.rating.ride._noise_kernels import (
    DenoisedPatches,
    PatchesToDenoise,
    Spectrum,
    denoise_patches,
    spectrum_scratch,
)
from bumpymap.rating.ride.operator import RideOperator, cosines

__all__ = ["CleanPatches", "denoise"]

_STEEPNESS = (2.0, 2.6, 3.2, 3.8, 4.5)
"""Exponents of the ground's spectrum that are tried: Hurst exponents from 0 to beyond 1."""


@dataclass(frozen=True, slots=True)
class CleanPatches:
    """Patches without the scan's noise."""

    relief_map: NDArray[np.float32]
    """(n, pixels, pixels) plane-removed relief, holes filled, m; NaN where a tile cannot be judged."""
    point_noise: NDArray[np.float64]
    """(n,) standard deviation of the height of a point, m; NaN where pixels hold too few points to tell."""
    pixel_noise: NDArray[np.float64]
    """(n,) the same of the height of a pixel."""
    noise_felt: NDArray[np.float64]
    """(n,) root mean square of the pitch change that such noise makes on level ground, rad/m."""


def denoise(patches: PatchStack, operator: RideOperator) -> CleanPatches:
    """Estimate the noise of every patch that can be judged, and take it off its relief."""
    tiles, pixels = len(patches.reason), patches.grid.pixels
    spectrum = _spectrum(pixels)
    clean = patches.relief_map.copy()
    noise = np.full((2, tiles), np.nan)
    denoise_patches(
        PatchesToDenoise(
            patches.reason == Reason.OK, patches.relief_map, patches.spread_count, patches.spread_variance
        ),
        spectrum,
        DenoisedPatches(clean, noise),
        spectrum_scratch(pixels, *spectrum.shapes.shape),
    )
    point, pixel = noise
    return CleanPatches(clean, point, pixel, pixel * operator.noise_gain)


@cache
def _spectrum(pixels: int) -> Spectrum:
    """Cosines, the band of each coefficient (by its wave number, -1 for the mean), spectra that are tried by band."""
    order = np.arange(pixels)
    wave = np.hypot(order[:, None], order[None, :])
    band = np.rint(wave).astype(np.int32) - 1
    members = [wave[band == b] for b in range(int(band.max()) + 1)]
    shapes = np.array([[float(np.mean(wave_numbers**-beta)) for wave_numbers in members] for beta in _STEEPNESS])
    basis = np.ascontiguousarray(cosines(pixels))
    return Spectrum(basis, np.ascontiguousarray(basis.T), band, shapes)
