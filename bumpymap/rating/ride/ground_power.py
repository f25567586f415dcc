"""Tell the ground from the noise of a survey, by the points of tiles and their neighbours, at any number of points.

About its plane the ground is a sum of waves whose power falls with the cube of the wave number; noise is alike in all.
So the points of a tile make each pair of strengths, of its ground and of the noise of a point, more or less likely: a
long wave that is seen by many points is ground, what is left of points close together is noise. A tile of few points
says little of either, and its neighbours say the rest: strengths vary from place to place, and each tile's prior is how
they are spread around it, which follows from the same likelihoods (empirical Bayes, in a few rounds).
"""

from functools import cache, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, loops

_STEEPNESS = 3.0
"""Power of the ground's waves over their number: a Hurst exponent of a half. From 2.5 to 3.5 nothing changes much."""
_LONGEST, _SHORTEST = 4, 14
"""Half waves along a tile up to which waves are summed, one by one; and up to which the ground has power."""
WAVE_SUMS = 34
"""Numbers that are left of the points of a tile: degrees of freedom, and a tridiagonal matrix of 17 rows."""
_GROUND_M, _NOISE_M = np.exp(np.arange(-6.9, 0.5, 0.35)), np.exp(np.arange(-6.2, -2.9, 0.35))
"""Standard deviations that are tried: of ground about its plane, 1 mm to 1.2 m; of noise, 2 mm to 0.05 m: few
surveys have more, and rubble of which each stone holds one point must not pass for noise."""
_USUAL = ((-3.0, 1.5), (-4.2, 1.0))
"""Mean and standard deviation of ln of both strengths [m] before any neighbour is known: counts as one neighbour."""
_LEAST_SD = (0.3, 0.15)
"""Least standard deviation of both between neighbours."""
_FREEDOM = 4.0
"""Degrees of freedom of Student's distribution of strengths around a tile: a kerb is unlike its neighbours."""
_MOST_OWN = 0.6
"""Most that ln of a tile's noise differs from that around it: what is beyond, stones and tufts, is ground."""
_CLOSE_SHARE = 0.036
"""Share of the ground's power in the half mean square of height differences at 0.13 m, the mean distance of the pairs:
of that spectrum, in closed form."""
_PAIR_WEIGHT = 0.5
"""Degrees of freedom of a close pair: some of them share a point."""
_NEAR, _ROUNDS = 2, 3
"""Tiles to each side whose strengths are the prior of one, and how often it is improved."""
POWER_RING = _NEAR * _ROUNDS
"""Tiles to each side that have a part in the strengths of one."""


class Strength(NamedTuple):
    """How strong ground and noise are in n tiles; NaN where unknown."""

    ground: Floats
    """Mean of ln of the standard deviation of the ground about its plane, m."""
    ground_sd: Floats
    """Standard deviation of that logarithm."""
    noise: Floats
    """Mean of ln of the standard deviation of the height of a point, m."""


@cache
def _waves(pixels: int) -> tuple[Floats, float]:
    """Return plane and waves at the pixels, (pixels^2, 3 + 16), and the share of power in shorter waves."""
    order = np.arange(_SHORTEST + 1)
    number = np.hypot(order[:, None], order)
    power = np.where(number > 0, np.maximum(number, 1.0) ** -_STEEPNESS, 0.0)
    power /= power.sum()
    long = (number > 0) & (number <= _LONGEST)
    place = (np.arange(pixels) + 0.5) / pixels
    cosines = np.cos(np.pi * np.outer(order, place)) * np.where(order > 0, np.sqrt(2.0), 1.0)[:, None]
    down, across = np.nonzero(long)
    waves = (cosines[down][:, :, None] * cosines[across][:, None, :]).reshape(len(down), -1)
    y, x = (axis.ravel() for axis in np.meshgrid(place - 0.5, place - 0.5, indexing="ij"))
    columns = np.vstack((np.ones_like(x), x, y, waves * np.sqrt(power[long])[:, None]))
    return np.ascontiguousarray(columns.T), float(1.0 - power[long].sum())


def wave_sums(
    relief_map: NDArray[np.float32], count: NDArray[np.int32], variance: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Sum the points of n tiles over the waves, (n, ``WAVE_SUMS``); NaN for tiles with NaN or without a plane.

    All (n, pixels, pixels): mean height of the points of a pixel about the tile's plane, m, anything where there is
    none; their number; and their variance, m^2.
    """
    sums = np.empty((len(count), WAVE_SUMS), np.float32)
    known = np.asarray(np.isfinite(relief_map).all(axis=(1, 2)))
    relief, held, spread = np.ascontiguousarray(relief_map), np.ascontiguousarray(count), np.ascontiguousarray(variance)
    loops.sum_waves(known, relief, held, spread, _waves(count.shape[1])[0], sums)
    return sums


def find_strengths(sums: NDArray[np.float32], pairs: NDArray[np.float32]) -> tuple[Strength, Strength]:
    """Find the strengths of a rectangle of tiles, (rows, cols), from their sums, (rows, cols, ``WAVE_SUMS``).

    ``pairs`` (rows, cols, 2): sum of the squared height differences of close pairs of points, m^2, and their number.
    Twice: with the ground of neighbours, and of each tile alone under the noise that it shares with them.
    """
    known = np.isfinite(sums[..., 0])
    found = np.empty((known.size, len(_NOISE_M), len(_GROUND_M)), np.float32)
    flat = np.ascontiguousarray(sums.reshape(-1, WAVE_SUMS))
    loops.weigh_strengths(flat, _NOISE_M, _GROUND_M, _waves(_SHORTEST + 1)[1], found)
    squares, number = np.where(known.reshape(-1, 1), pairs.reshape(-1, 2), 0.0).T[..., None, None].astype(np.float32)
    near = 2.0 * (_NOISE_M[:, None] ** 2 + _CLOSE_SHARE * _GROUND_M**2).astype(np.float32)
    found -= 0.5 * _PAIR_WEIGHT * (number * np.log(near) + squares / near)
    likelihood = np.exp(found - found.max(axis=(1, 2), keepdims=True))
    (mean_a, sd_a), (mean_s, sd_s) = _USUAL
    usual = np.array([mean_a, sd_a**2, mean_s, sd_s**2])
    prior = np.broadcast_to(usual[:, None], (4, known.size)).copy()
    for _ in range(_ROUNDS):
        prior = _around(_posterior(likelihood, prior), known, usual)
    alone = prior.copy()
    alone[:2] = usual[:2, None]
    ends = (_posterior(likelihood, each, is_last=True) for each in (prior, alone))
    unknown = np.where(known.ravel(), 0.0, np.nan)
    return tuple(
        Strength(*((values + unknown).reshape(known.shape) for values in (a, np.sqrt(var_a), s)))
        for a, var_a, s, _ in ends
    )  # type: ignore[return-value]


def _posterior(likelihood: NDArray[np.float32], prior: Floats, *, is_last: bool = False) -> Floats:
    """Return mean and variance of ln of ground and noise, (4, n), under priors of the same form."""
    grids = np.log(_GROUND_M), np.log(_NOISE_M)
    of_ground, of_noise = (_student(grid, *own) for grid, own in zip(grids, (prior[:2], prior[2:]), strict=True))
    if is_last:
        of_noise = np.maximum(1.0 - ((grids[1] - prior[2][:, None]) / _MOST_OWN) ** 2, 0.0) ** 2
    ground = of_ground * np.matmul(of_noise[:, None].astype(np.float32), likelihood)[:, 0]
    noise = of_noise * np.matmul(likelihood, of_ground[:, :, None].astype(np.float32))[..., 0]
    found = []
    for share, grid in zip((ground, noise), grids, strict=True):
        total = share.sum(axis=1)
        mean = (share * grid).sum(axis=1) / total
        found += [mean, np.maximum((share * grid**2).sum(axis=1) / total - mean**2, 0.0)]
    return np.array(found)


def _student(grid: Floats, mean: Floats, variance: Floats) -> Floats:
    """Return Student's density, but for its scale, of ln of a strength around n tiles, (n, values of the grid)."""
    away = (grid - mean[:, None]) ** 2 / variance[:, None]
    return np.asarray((1.0 + away / _FREEDOM) ** (-0.5 * (_FREEDOM + 1.0)))


def _around(found: Floats, known: NDArray[np.bool_], usual: Floats) -> Floats:
    """Return the spread of the strengths around each tile, the usual one among them, (4, n)."""
    prior = []
    for at, least in zip((0, 2), _LEAST_SD, strict=True):
        mean, variance = found[at : at + 2]
        weight = np.where(known.ravel(), least**2 / (variance + least**2), 0.0)
        if at == 2:  # where the ground is smooth, the noise is known best: as means of squares are weighted
            weight = weight * np.exp(-3.0 * (mean - usual[2]))
        parts = np.stack([weight, weight * mean, weight * (variance + mean**2)]).reshape(3, *known.shape)
        total, first, second = sums_around(parts, _NEAR).reshape(3, -1) + least**2 / (
            usual[at + 1] + least**2
        ) * np.array([[1.0], [usual[at]], [usual[at + 1] + usual[at] ** 2]])
        middle = first / total
        prior += [middle, np.maximum(second / total - middle**2, least**2)]
    return np.array(prior)


def sums_around(values: Floats, reach: int) -> Floats:
    """Sum (..., rows, cols) over squares of ``reach`` tiles to each side; always in the same order."""
    rows, cols = values.shape[-2:]
    wide = np.zeros((*values.shape[:-2], rows + 2 * reach, cols + 2 * reach))
    wide[..., reach : reach + rows, reach : reach + cols] = values
    down = reduce(np.add, [wide[..., first : first + rows, :] for first in range(2 * reach + 1)])
    return np.asarray(reduce(np.add, [down[..., first : first + cols] for first in range(2 * reach + 1)]))
