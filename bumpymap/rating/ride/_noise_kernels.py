"""Compiled loops: the noise of a heightmap, and what of it is ground; see ``bumpymap.rating.ride.noise`` for the model.

A patch goes through the cosine transform; its coefficients are gathered in bands of equal wave number, the likeliest
ground spectrum is fitted to the powers of the bands, and each coefficient shrinks to its share of ground. Nothing here
allocates: scratch arrays come from the caller. Sums run in one fixed order, so the same patch gives the same bits
wherever it stands among others.
"""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

__all__ = ["DenoisedPatches", "PatchesToDenoise", "Spectrum", "SpectrumScratch", "denoise_patches", "spectrum_scratch"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_LEAST_FREEDOM = 10.0
"""Points beyond one a pixel, that many at least, or the noise of a tile cannot be told."""
_SIGNIFICANT = 9.0
"""A coefficient whose square is that many times its noise is ground, whatever its neighbours say (p = 0.003)."""
_ROUNDS = 12
_MOST_NOISE = 0.01
"""Variance, m^2. Points that scatter by more than 0.1 m inside a pixel are leaves over ground, or blocks: a scanner is
better than that. What is beyond stays in the ground."""
_FILLED = 0.4
"""Noise variance of a pixel that was filled, over that of one that was seen: a mean of some neighbours."""
_TINY = 1e-12


class PatchesToDenoise(NamedTuple):
    """Patches as they were measured."""

    known: Annotated[NDArray[np.bool_], 1]
    """(tiles,) whether to treat it; others keep what the results hold."""
    relief: Annotated[Singles, 3]
    """(tiles, pixels, pixels) plane-removed relief, holes filled, m."""
    pixel_count: Annotated[Integers, 3]
    """(tiles, pixels, pixels) points of each pixel."""
    variance: Annotated[Singles, 3]
    """(tiles, pixels, pixels) variance of their heights above the tile's plane, m^2."""


class Spectrum(NamedTuple):
    """Cosines of a patch, and the ground spectra that are tried."""

    basis: Annotated[Floats, 2]
    """(pixels, pixels) orthonormal cosines."""
    band: Annotated[Integers, 2]
    """(pixels, pixels) band of each coefficient; -1 for the mean."""
    shapes: Annotated[Floats, 2]
    """(spectra, bands) power of each band for unit strength."""


class DenoisedPatches(NamedTuple):
    """What is filled."""

    clean: Annotated[Singles, 3]
    """(tiles, pixels, pixels) relief without noise, m."""
    noise: Annotated[Floats, 2]
    """(2, tiles) standard deviation of a point [m] and of a pixel's height [m]."""


class SpectrumScratch(NamedTuple):
    """Scratch, see `spectrum_scratch`."""

    bands: Annotated[Floats, 2]
    """(2, bands) mean square of the coefficients, and their number."""
    ground: Annotated[Floats, 1]
    """(bands,) likeliest power of the ground, m^2."""
    spreads: Annotated[Floats, 2]
    """(2, pixels^2) variances of pixels and their weights, sorted."""
    work: Annotated[Floats, 3]
    """(3, pixels, pixels) a patch, half transformed, transformed."""


def spectrum_scratch(pixels: int, bands: int) -> SpectrumScratch:
    """Make scratch for patches of so many pixels along a side."""
    return SpectrumScratch(
        np.empty((2, bands)), np.empty(bands), np.empty((2, pixels * pixels)), np.empty((3, pixels, pixels))
    )


@helper
def _sift_down(values: Floats, weights: Floats, start: int, end: int) -> None:
    root = start
    while 2 * root + 1 <= end:
        child = 2 * root + 1
        if child < end and values[child] < values[child + 1]:
            child += 1
        if values[root] >= values[child]:
            return
        values[root], values[child] = values[child], values[root]
        weights[root], weights[child] = weights[child], weights[root]
        root = child


@helper
def _sort_together(values: Floats, weights: Floats, n: int) -> None:
    """Heap sort of the first n values; the weights go with them."""
    for start in range(n // 2 - 1, -1, -1):
        _sift_down(values, weights, start, n - 1)
    for end in range(n - 1, 0, -1):
        values[0], values[end] = values[end], values[0]
        weights[0], weights[end] = weights[end], weights[0]
        _sift_down(values, weights, 0, end - 1)


@helper
def _point_noise(count: Integers, variance: Singles, values: Floats, weights: Floats) -> float:
    """Noise variance of a single point, m^2; NaN where too few pixels hold two points.

    The median of the pixels' own variances, each as often as it has degrees of freedom: an edge inside some pixels
    does not move it. A median of chi-square numbers is too low by (1 - 2 / (9 k))^3.
    """
    size = count.shape[0]
    n = 0
    total = squares = 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 1:
                weight = np.float64(count[r, c] - 1)
                values[n] = variance[r, c] * (weight + 1.0) / weight
                weights[n] = weight
                total += weight
                squares += weight * weight
                n += 1
    if total < _LEAST_FREEDOM:
        return np.nan
    _sort_together(values, weights, n)
    below = 0.0
    median = values[n - 1]
    for i in range(n):
        below += weights[i]
        if below >= 0.5 * total:
            median = values[i]
            break
    return min(median / (1.0 - 2.0 * total / (9.0 * squares)) ** 3, _MOST_NOISE)


@helper
def _pixel_noise(count: Integers, point: float) -> float:
    """Mean noise variance of the pixels' heights, m^2."""
    size = count.shape[0]
    seen, total = 0, 0.0
    for r in range(size):
        for c in range(size):
            if count[r, c] > 0:
                seen += 1
                total += point / count[r, c]
    if seen == 0:
        return np.nan
    filled = size * size - seen
    return (total + filled * _FILLED * total / seen) / (size * size)


@helper
def _turn(basis: Floats, patch: Floats, middle: Floats, out: Floats, forward: bool) -> None:
    """Cosine transform of a patch, or back."""
    size = basis.shape[0]
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += (basis[i, k] if forward else basis[k, i]) * patch[k, j]
            middle[i, j] = total
    for i in range(size):
        for j in range(size):
            total = 0.0
            for k in range(size):
                total += middle[i, k] * (basis[j, k] if forward else basis[k, j])
            out[i, j] = total


@helper
def _fit_strength(bands: Floats, noise: float, shape: Floats) -> float:
    """Strength A of a ground spectrum A * shape beside white noise, by weighted steps (Whittle's likelihood)."""
    power = shapes = 0.0
    for b in range(bands.shape[1]):
        power += bands[1, b] * (bands[0, b] - noise)
        shapes += bands[1, b] * shape[b]
    strength = max(power, 0.01 * noise) / shapes
    for _ in range(_ROUNDS):
        top = bottom = 0.0
        for b in range(bands.shape[1]):
            share = shape[b] / (strength * shape[b] + noise)
            weight = bands[1, b] * share * share
            top += weight * (bands[0, b] - noise) / shape[b]
            bottom += weight
        strength = max(top / bottom, _TINY)
    return strength


@helper
def _fit_spectrum(bands: Floats, noise: float, shapes: Floats, ground: Floats) -> None:
    """Fill ``ground`` with the likeliest power of each band, m^2."""
    best = np.inf
    for s in range(shapes.shape[0]):
        strength = _fit_strength(bands, noise, shapes[s])
        score = 0.0
        for b in range(bands.shape[1]):
            power = strength * shapes[s, b] + noise
            score += bands[1, b] * (bands[0, b] / power + math.log(power))
        if score < best:
            best = score
            for b in range(bands.shape[1]):
                ground[b] = strength * shapes[s, b]


@helper
def _band_powers(waves: Floats, band: Integers, bands: Floats) -> None:
    """Mean square of the coefficients of each band, and their number."""
    for b in range(bands.shape[1]):
        bands[0, b] = bands[1, b] = 0.0
    size = waves.shape[0]
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            if b >= 0:
                bands[0, b] += waves[i, j] * waves[i, j]
                bands[1, b] += 1.0
    for b in range(bands.shape[1]):
        bands[0, b] /= bands[1, b]


@helper
def _shrink(waves: Floats, band: Integers, ground: Floats, noise: float) -> None:
    """Shrink each coefficient to the power that is ground's."""
    size = waves.shape[0]
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            if b < 0:
                waves[i, j] = 0.0
                continue
            power = waves[i, j] * waves[i, j]
            stands_out = power > _SIGNIFICANT * noise
            kept = (power - noise) / power if stands_out else ground[b] / (ground[b] + noise)
            waves[i, j] *= math.sqrt(kept)


@kernel
def denoise_patches(
    patches: PatchesToDenoise, spectrum: Spectrum, out: DenoisedPatches, scratch: SpectrumScratch
) -> None:
    """Take the scan's noise out of patches."""
    size = spectrum.basis.shape[0]
    patch, middle, waves = scratch.work[0], scratch.work[1], scratch.work[2]
    for t in range(len(patches.known)):
        if not patches.known[t]:
            continue
        for i in range(size):
            for j in range(size):
                out.clean[t, i, j] = patches.relief[t, i, j]
                patch[i, j] = patches.relief[t, i, j]
        point = _point_noise(patches.pixel_count[t], patches.variance[t], scratch.spreads[0], scratch.spreads[1])
        pixel = _pixel_noise(patches.pixel_count[t], point)
        out.noise[0, t], out.noise[1, t] = math.sqrt(point), math.sqrt(pixel)
        if not pixel > _TINY:
            continue
        _turn(spectrum.basis, patch, middle, waves, True)
        _band_powers(waves, spectrum.band, scratch.bands)
        _fit_spectrum(scratch.bands, pixel, spectrum.shapes, scratch.ground)
        _shrink(waves, spectrum.band, scratch.ground, pixel)
        _turn(spectrum.basis, waves, middle, patch, False)
        for i in range(size):
            for j in range(size):
                out.clean[t, i, j] = patch[i, j]
