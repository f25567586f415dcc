"""Strengths of ground and noise: the likelihood is that of normal heights, and neighbours say what a tile cannot."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from bumpymap.core import loops
from bumpymap.rating import find_strengths
from bumpymap.rating.ride.thin import THIN_RING, WAVE_SUMS, wave_sums

PIXELS, SIDE = 15, 20
NO_PAIRS = np.zeros((SIDE, SIDE, 2), np.float32)


def cosine_waves():
    """Plane and waves of four half waves and fewer at the pixels, and the power of each; all others are white."""
    place = (np.arange(PIXELS) + 0.5) / PIXELS
    number = {(i, j): np.hypot(i, j) for i in range(15) for j in range(15) if i + j > 0}
    total = sum(k**-3.0 for k in number.values())
    long = {ij: k**-3.0 / total for ij, k in number.items() if k <= 4}
    basis = [
        np.outer(*(np.cos(np.pi * order * place) * (np.sqrt(2) if order else 1) for order in ij)).ravel() for ij in long
    ]
    return np.array(basis).T, np.array(list(long.values()))


def tiles(rng, count, ground, noise, points=36):
    """Reliefs, points and variances of the pixels of made-up tiles: waves of a strength [m] under noise [m]."""
    basis, power = cosine_waves()
    heights = ground * (basis @ (np.sqrt(power)[:, None] * rng.standard_normal((len(power), count)))).T
    heights += ground * np.sqrt(1 - power.sum()) * rng.standard_normal(heights.shape)
    held = rng.multinomial(points, np.full(PIXELS**2, PIXELS**-2.0), count).astype(np.int32)
    mean = heights + noise * rng.standard_normal(heights.shape) / np.sqrt(np.maximum(held, 1))
    variance = np.where(held > 1, noise**2 * rng.chisquare(np.maximum(held - 1, 1)) / np.maximum(held, 1), 0.0)
    shape = (count, PIXELS, PIXELS)
    return mean.reshape(shape).astype("f4"), held.reshape(shape), variance.reshape(shape).astype("f4")


def square(ground, noise, seed=1, points=36):
    sums = wave_sums(*tiles(np.random.default_rng(seed), SIDE**2, ground, noise, points))
    return sums.reshape(SIDE, SIDE, WAVE_SUMS)


@pytest.mark.parametrize("points", [18, 36, 90, 225])
@pytest.mark.parametrize("ground", [0.01, 0.05])
def test_noise_and_ground_are_distinguished_at_any_number_of_points(points, ground):
    around, _ = find_strengths(square(ground, 0.02, points=points), NO_PAIRS)
    assert np.exp(np.median(around.ground)) == pytest.approx(ground, rel=0.3)
    assert np.exp(np.median(around.noise)) == pytest.approx(0.02, rel=0.15 if ground < 0.02 else 0.5)


def test_neighbours_say_what_a_tile_cannot():
    around, alone = find_strengths(square(0.01, 0.02), NO_PAIRS)
    inner = np.s_[5:-5, 5:-5]
    truth = np.log(0.01)
    assert np.std(around.ground[inner]) < 0.8 * np.std(alone.ground[inner])
    assert np.sqrt(np.mean((around.ground[inner] - truth) ** 2)) < 0.4
    assert (around.ground_sd < alone.ground_sd)[inner].mean() > 0.8


def test_what_close_pairs_share_is_ground():
    """Short waves and noise are alike far apart: pairs of points close together differ by the noise alone."""
    sums, pairs = square(0.01, 0.02), np.zeros((SIDE, SIDE, 2), np.float32)
    pairs[..., 1], pairs[..., 0] = 40, 40 * 2 * 0.008**2
    apart, together = (find_strengths(sums, each)[0] for each in (NO_PAIRS, pairs))
    assert np.exp(np.median(together.noise)) == pytest.approx(0.008, rel=0.4)
    assert np.median(together.ground) > np.median(apart.ground) + 0.5


def test_a_rough_tile_stays_rough_among_smooth_ones():
    sums = square(0.01, 0.01)
    sums[10, 10] = wave_sums(*tiles(np.random.default_rng(5), 1, 0.15, 0.01))[0]
    around, alone = find_strengths(sums, NO_PAIRS)
    assert around.ground[10, 10] > alone.ground[10, 10] - 0.15
    assert around.ground[10, 10] > np.median(around.ground) + 1.5


def test_tiles_beyond_the_ring_have_no_part():
    sums = square(0.02, 0.02)
    other = sums.copy()
    far = np.ones((SIDE, SIDE), np.bool_)
    far[10 - THIN_RING : 11 + THIN_RING, 10 - THIN_RING : 11 + THIN_RING] = False
    other[far] = np.nan
    for found, again in zip(find_strengths(sums, NO_PAIRS), find_strengths(other, NO_PAIRS), strict=True):
        assert [values[10, 10] for values in found] == [values[10, 10] for values in again]


def test_a_tile_without_a_plane_is_unknown():
    relief, held, variance = tiles(np.random.default_rng(3), 3, 0.05, 0.02)
    held[0] = 0
    held[1], held[1, 4, :4] = 0, 2  # on a line
    relief[2] = np.nan
    sums = wave_sums(relief, held, variance)
    assert np.isnan(sums).all()
    assert all(np.isnan(values).all() for each in find_strengths(sums[None], NO_PAIRS[:1, :3]) for values in each)


def test_the_likelihood_is_that_of_normal_heights():
    """Up to a constant; the plane of the tile counts as known to nobody."""
    rng, (basis, power) = np.random.default_rng(2), cosine_waves()
    relief, held, _ = tiles(rng, 1, 0.05, 0.02)
    held = np.minimum(held, 1)
    sums = wave_sums(relief, held, np.zeros_like(relief))
    grounds, noises = np.array([0.01, 0.05, 0.2]), np.array([0.01, 0.03])
    found = np.empty((1, 2, 3), np.float32)
    loops.weigh_strengths(sums, noises, grounds, 1.0 - power.sum(), found)
    seen = held.ravel() > 0
    z, waves = relief.ravel()[seen].astype(float), basis[seen]
    row, col = np.divmod(np.flatnonzero(seen), PIXELS)
    plane = np.column_stack((np.ones(len(z)), row, col)) / PIXELS
    rest = np.linalg.svd(plane)[0][:, 3:]  # contrasts that no plane changes
    wanted = np.empty((2, 3))
    for (s, noise), (a, ground) in ((n, g) for n in enumerate(noises) for g in enumerate(grounds)):
        white = noise**2 + (1.0 - power.sum()) * ground**2
        covariance = ground**2 * (waves * power) @ waves.T + white * np.eye(len(z))
        wanted[s, a] = multivariate_normal.logpdf(rest.T @ z, cov=rest.T @ covariance @ rest)
    np.testing.assert_allclose(found[0] - found[0, 0, 0], wanted - wanted[0, 0], rtol=1e-3, atol=2e-3)
