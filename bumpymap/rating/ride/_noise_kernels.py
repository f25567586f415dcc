"""Compiled loops: the noise of a heightmap, and what of it is ground; see ``bumpymap.rating.ride.rate`` for the model.

A patch goes through the cosine transform; its coefficients are gathered in bands of equal wave number, the likeliest
ground spectrum is fitted to the powers of the bands, and each coefficient shrinks to its share of ground. Nothing here
allocates: scratch arrays come from the caller. Sums run in one fixed order, so the same patch gives the same bits
wherever it stands among others.
"""

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.rating.ride._ride_kernels import (
    LANES,
    Lanes,
    add,
    add_part,
    add_square,
    each2,
    each3,
    each4,
    load,
    over,
    same,
    store,
)
from bumpytiles import helper, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int32]

_LEAST_FREEDOM = 10.0
"""Points beyond one a pixel, that many at least, or the noise of a tile cannot be told."""
_MOST_NOISE = 0.01
"""Variance, m^2. Points that scatter by more than 0.1 m inside a pixel are leaves over ground, or blocks: a scanner is
better than that. What is beyond stays in the ground."""
_FILLED = 0.4
"""Noise variance of a pixel that was filled, over that of one that was seen: a mean of some neighbours."""


@helper
def _split(values: Floats, weights: Floats, first: int, last: int, pivot: float, with_equal: bool) -> tuple[int, float]:
    """Bring what is below the pivot, or equal to it if asked, to the front of a part.

    Returns where the rest begins, and the weight of what is before it.
    """
    at, total = first, 0.0
    for i in range(first, last):
        value, weight = values[i], weights[i]
        values[i], weights[i] = values[at], weights[at]
        values[at], weights[at] = value, weight
        low = (value < pivot) | (with_equal & (value == pivot))
        at += low
        total += weight if low else 0.0
    return at, total


@helper
def _weighted_median(values: Floats, weights: Floats, n: int, half: float) -> float:
    """Return the first of n values in order at which the sum of the weights, integers, reaches ``half``.

    The order of the values is changed.
    """
    first, last, below = 0, n, 0.0
    while True:
        a, b, c = values[first], values[(first + last) // 2], values[last - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        at, lower = _split(values, weights, first, last, pivot, False)
        if below + lower >= half:
            last = at
            continue
        first, equal = _split(values, weights, at, last, pivot, True)
        below += lower + equal
        if below >= half or equal == 0.0:  # nothing equals NaN
            return float(pivot)


@helper
def point_noise(count: Integers, variance: Singles, values: Floats, weights: Floats) -> float:
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
    median = _weighted_median(values, weights, n, 0.5 * total)
    noise: float = min(median / (1.0 - 2.0 * total / (9.0 * squares)) ** 3, _MOST_NOISE)
    return noise


@helper
def pixel_noise(count: Integers, point: float) -> float:
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
    mean: float = (total + filled * _FILLED * total / seen) / (size * size)
    return mean


Patches = NDArray[np.float64]
"""(pixels, pixels, group)."""

_SIGNIFICANT = 9.0
"""A coefficient whose square is that many times its noise is ground, whatever its neighbours say (p = 0.003)."""
_ROUNDS = 12
"""Steps to the strength of the ground's spectrum."""
_TINY = 1e-12
"""Strengths of a spectrum, and powers of a pixel, below this are none."""


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
    turned: Annotated[Floats, 2]
    """The same, rows and columns exchanged."""
    band: Annotated[Integers, 2]
    """(pixels, pixels) band of each coefficient; -1 for the mean."""
    shapes: Annotated[Floats, 2]
    """(spectra, bands) power of each band for unit strength."""


class DenoisedPatches(NamedTuple):
    """Arrays that are filled."""

    clean: Annotated[Singles, 3]
    """(tiles, pixels, pixels) relief without noise, m."""
    noise: Annotated[Floats, 2]
    """(2, tiles) standard deviation of a point [m] and of a pixel's height [m]."""


class SpectrumScratch(NamedTuple):
    """Scratch, see `spectrum_scratch`; ``group`` are the patches that are treated side by side."""

    members: Annotated[NDArray[np.int64], 1]
    """(group,) which patches these are."""
    noise: Annotated[Floats, 1]
    """(group,) noise variance of a pixel's height, m^2."""
    number: Annotated[Floats, 1]
    """(bands,) coefficients of each band."""
    powers: Annotated[Floats, 2]
    """(bands, group) mean square of the coefficients."""
    strengths: Annotated[Floats, 2]
    """(spectra, group) likeliest strength of each spectrum."""
    ground: Annotated[Floats, 2]
    """(bands, group) likeliest power of the ground, m^2."""
    spreads: Annotated[Floats, 2]
    """(2, pixels^2) variances of the pixels of one patch, and their weights."""
    work: Annotated[Floats, 4]
    """(3, pixels, pixels, group) patches, half transformed, transformed."""


def spectrum_scratch(pixels: int, spectra: int, bands: int) -> SpectrumScratch:
    """Make scratch for patches of so many pixels along a side."""
    return SpectrumScratch(
        np.empty(LANES, np.int64),
        np.ones(LANES),
        np.empty(bands),
        np.empty((bands, LANES)),
        np.empty((spectra, LANES)),
        np.empty((bands, LANES)),
        np.empty((2, pixels * pixels)),
        np.ones((3, pixels, pixels, LANES)),
    )


@helper
def _turn(left: Floats, right: Floats, patches: Patches, middle: Patches, out: Patches) -> None:
    """Multiply patches by a matrix from the left and by one from the right: the cosine transform, or back."""
    size = left.shape[0]
    for i in range(size):
        for j in range(size):
            total = same(0.0)
            for k in range(size):
                total = add_part(total, left[i, k], load(patches[k, j], 0))
            store(total, middle[i, j], 0)
    for i in range(size):
        for j in range(size):
            total = same(0.0)
            for k in range(size):
                total = add_part(total, right[k, j], load(middle[i, k], 0))
            store(total, out[i, j], 0)


@helper
def _difference(power: Any, noise: Any) -> Any:
    return power - noise


@helper
def _first_strength(power: Any, noise: Any, shapes: Any) -> Any:
    return max(power, 0.01 * noise) / shapes


@helper
def _weight(strength: Any, noise: Any, number: Any, shape: Any) -> Any:
    """Precision of a band's power over that of the strength."""
    share = shape / (strength * shape + noise)
    return number * share * share


@helper
def _add_strength(top: Any, weight: Any, excess: Any, shape: Any) -> Any:
    return top + weight * excess / shape


@helper
def _strength(top: Any, bottom: Any) -> Any:
    return max(top / bottom, _TINY)


@helper
def _fit_strength(shape: Floats, scratch: SpectrumScratch) -> Lanes:
    """Strength A of a ground spectrum A * shape beside white noise, by weighted steps (Whittle's likelihood)."""
    powers, number, noise = scratch.powers, scratch.number, load(scratch.noise, 0)
    power, shapes = same(0.0), 0.0
    for b in range(len(number)):
        power = add_part(power, number[b], each2(_difference, load(powers[b], 0), noise))
        shapes += number[b] * shape[b]
    strength = each3(_first_strength, power, noise, same(shapes))
    for _ in range(_ROUNDS):
        top = bottom = same(0.0)
        for b in range(len(number)):
            weight = each4(_weight, strength, noise, same(number[b]), same(shape[b]))
            excess = each2(_difference, load(powers[b], 0), noise)
            top, bottom = each4(_add_strength, top, weight, excess, same(shape[b])), add(bottom, weight)
        strength = each2(_strength, top, bottom)
    return strength


@helper
def _misfit(lane: int, s: int, shapes: Floats, scratch: SpectrumScratch) -> float:
    """How unlikely the powers of a patch are with one of the spectra."""
    score = 0.0
    for b in range(len(scratch.number)):
        power = scratch.strengths[s, lane] * shapes[s, b] + scratch.noise[lane]
        score += scratch.number[b] * (scratch.powers[b, lane] / power + math.log(power))
    return score


@helper
def _fit_spectra(shapes: Floats, scratch: SpectrumScratch) -> None:
    """Fill ``ground`` with the likeliest power of each band, m^2."""
    for s in range(shapes.shape[0]):
        store(_fit_strength(shapes[s], scratch), scratch.strengths[s], 0)
    for lane in range(LANES):
        best, likeliest = np.inf, 0
        for s in range(shapes.shape[0]):
            score = _misfit(lane, s, shapes, scratch)
            if score < best:
                best, likeliest = score, s
        for b in range(shapes.shape[1]):
            scratch.ground[b, lane] = scratch.strengths[likeliest, lane] * shapes[likeliest, b]


@helper
def _band_powers(waves: Patches, band: Integers, scratch: SpectrumScratch) -> None:
    """Mean square of the coefficients of each band, and their number."""
    powers, number = scratch.powers, scratch.number
    for b in range(len(number)):
        number[b] = 0.0
        store(same(0.0), powers[b], 0)
    size = waves.shape[0]
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            if b >= 0:
                store(add_square(load(powers[b], 0), load(waves[i, j], 0)), powers[b], 0)
                number[b] += 1.0
    for b in range(len(number)):
        store(each2(over, load(powers[b], 0), same(number[b])), powers[b], 0)


@helper
def _shrunk(wave: Any, ground: Any, noise: Any) -> Any:
    """Return a coefficient shrunk to the power that is ground's."""
    power = wave * wave
    stands_out = power > _SIGNIFICANT * noise
    kept = (power - noise) / power if stands_out else ground / (ground + noise)
    return wave * math.sqrt(kept)


@helper
def _shrink(waves: Patches, band: Integers, scratch: SpectrumScratch) -> None:
    """Shrink each coefficient, the mean to nothing."""
    size, noise = waves.shape[0], load(scratch.noise, 0)
    for i in range(size):
        for j in range(size):
            b = band[i, j]
            shrunk = each3(_shrunk, load(waves[i, j], 0), load(scratch.ground[max(b, 0)], 0), noise)
            store(shrunk if b >= 0 else same(0.0), waves[i, j], 0)


@helper
def _clean_group(held: int, spectrum: Spectrum, out: DenoisedPatches, scratch: SpectrumScratch) -> None:
    """Take the noise out of the patches of a group."""
    patch, middle, waves = scratch.work[0], scratch.work[1], scratch.work[2]
    _turn(spectrum.basis, spectrum.turned, patch, middle, waves)
    _band_powers(waves, spectrum.band, scratch)
    _fit_spectra(spectrum.shapes, scratch)
    _shrink(waves, spectrum.band, scratch)
    _turn(spectrum.turned, spectrum.basis, waves, middle, patch)
    size = patch.shape[0]
    for lane in range(held):
        for i in range(size):
            for j in range(size):
                out.clean[scratch.members[lane], i, j] = patch[i, j, lane]


@kernel
def denoise_patches(
    patches: PatchesToDenoise, spectrum: Spectrum, out: DenoisedPatches, scratch: SpectrumScratch
) -> None:
    """Take the scan's noise out of patches."""
    size, held = spectrum.basis.shape[0], 0
    for t in range(len(patches.known)):
        if patches.known[t]:
            point = point_noise(patches.pixel_count[t], patches.variance[t], scratch.spreads[0], scratch.spreads[1])
            pixel = pixel_noise(patches.pixel_count[t], point)
            out.noise[0, t], out.noise[1, t] = math.sqrt(point), math.sqrt(pixel)
            for i in range(size):
                for j in range(size):
                    out.clean[t, i, j] = patches.relief[t, i, j]
                    scratch.work[0, i, j, held] = patches.relief[t, i, j]
            scratch.members[held], scratch.noise[held] = t, pixel
            # Without noise the patch stays as it is; the next one takes its place in the group.
            held += pixel > _TINY
        if held == LANES or (held > 0 and t == len(patches.known) - 1):
            _clean_group(held, spectrum, out, scratch)
            held = 0
