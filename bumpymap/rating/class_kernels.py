"""Compiled kernels: tiles and their textures in, ride costs out; see ``bumpymap.rating.cost`` for the model."""

import math
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpytiles import helper, kernel

__all__ = ["CostRules", "CostTables", "RatedTiles", "TilesToRate", "rate_tiles"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


class TilesToRate(NamedTuple):
    """Tiles."""

    known: Annotated[NDArray[np.bool_], 1]
    """(tiles,) whether to rate it."""
    chance: Annotated[Singles, 2]
    """(tiles, textures) probability of each texture."""
    relief: Annotated[Floats, 1]
    """(tiles,) m."""
    slope: Annotated[Floats, 1]
    """(tiles,) degrees."""
    coverage: Annotated[Floats, 1]
    """(tiles,) 0 to 1."""


class CostTables(NamedTuple):
    """What a calibration says of every texture."""

    log_range: Annotated[Floats, 1]
    """(rungs,) ln of the calibrated z ranges."""
    tables: Annotated[Floats, 3]
    """(3, textures, rungs) mean of ln C_r, its standard deviation, p_fail."""


class CostRules(NamedTuple):
    """How classes follow."""

    limits: Annotated[Floats, 1]
    """(classes - 1,) C_r between the classes, rad/m."""
    slope_limit: float
    """Steeper tiles fail for certain, degrees."""
    fail: float
    """A tile with at least this p_fail is of the last class."""
    tail: float
    """Probability below c_r_low and above c_r_high."""
    normal: float
    """That quantile of the standard normal."""


class RatedTiles(NamedTuple):
    """What is filled where a tile is known."""

    class_id: Annotated[NDArray[np.uint8], 1]
    """(tiles,) class."""
    rated: Annotated[Singles, 2]
    """(5, tiles) c_r, c_r_low, c_r_high, p_fail, confidence."""


@helper
def _share_below(log_c: float, chance: Singles, log_mean: Floats, log_sd: Floats) -> float:
    """Probability that C_r is below exp(log_c) under a mixture of log-normals."""
    below = 0.0
    for k in range(len(chance)):
        below += chance[k] * 0.5 * math.erfc((log_mean[k] - log_c) / (math.sqrt(2.0) * log_sd[k]))
    return below


@helper
def _mixture_density(log_c: float, chance: Singles, log_mean: Floats, log_sd: Floats) -> float:
    """Slope of ``_share_below``."""
    density = 0.0
    for k in range(len(chance)):
        u = (log_c - log_mean[k]) / log_sd[k]
        density += chance[k] * math.exp(-0.5 * u * u) / log_sd[k]
    return density / math.sqrt(2.0 * math.pi)


@helper
def mixture_quantile(share: float, normal: float, chance: Singles, log_mean: Floats, log_sd: Floats) -> float:
    """Find the ln C_r with a share of the mixture below it, to 1e-10; ``normal`` is the standard normal's quantile.

    Newton's steps inside a bracket, halved where a step leaves it or the density is as good as none. A mixture's
    quantile lies between those of its parts; the margin allows for probabilities that sum to 1 but for their rounding.
    """
    low, high, at = np.inf, -np.inf, 0.0
    for k in range(len(chance)):
        if chance[k] > 0.0:
            own = log_mean[k] + normal * log_sd[k]
            low, high = min(low, own - 1e-2 * log_sd[k]), max(high, own + 1e-2 * log_sd[k])
            at += chance[k] * own
    for _ in range(100):
        excess = _share_below(at, chance, log_mean, log_sd) - share
        if excess < 0.0:
            low = at
        else:
            high = at
        before = at
        at -= excess / _mixture_density(at, chance, log_mean, log_sd)
        if not low < at < high:
            at = 0.5 * (low + high)
        if abs(at - before) < 1e-10:
            break
    return at


@helper
def _read_ladder(relief: float, log_range: Floats, tables: Floats, rungs: Floats) -> None:
    """Read the tables (ln C_r, its spread, p_fail) of every texture at a relief [m] into ``rungs``.

    Straight lines between the rungs of ln z_range. Below the ladder C_r is proportional to the relief (a small vehicle
    motion is linear in the ground's amplitude); above it the last rung is kept.
    """
    last = len(log_range) - 1
    log_relief = math.log(max(relief, 1e-9))
    x = min(max(log_relief, log_range[0]), log_range[last])
    j = 0
    while j < last - 1 and x >= log_range[j + 1]:
        j += 1
    for q in range(tables.shape[0]):
        for k in range(tables.shape[1]):
            value = tables[q, k, j]
            if j < last:
                step = (tables[q, k, j + 1] - value) / (log_range[j + 1] - log_range[j])
                value += step * (x - log_range[j])
            rungs[q, k] = value
    for k in range(tables.shape[1]):
        rungs[0, k] += min(0.0, log_relief - log_range[0])


@helper
def _sureness(rank: int, limits: Floats, chance: Singles, log_mean: Floats, log_sd: Floats) -> float:
    """Probability that C_r lies between the limits of a class."""
    above = 1.0 if rank == len(limits) else _share_below(math.log(limits[rank]), chance, log_mean, log_sd)
    below = 0.0 if rank == 0 else _share_below(math.log(limits[rank - 1]), chance, log_mean, log_sd)
    return above - below


@kernel
def rate_tiles(
    tiles: TilesToRate, cost: CostTables, rules: CostRules, out: RatedTiles, rungs: Annotated[Floats, 2]
) -> None:
    """Rate the tiles that are known; see ``bumpymap.rating.cost`` for the model. Others keep what the results hold.

    ``rungs`` is scratch: (3, textures).
    """
    last = len(rules.limits)
    for t in range(len(tiles.known)):
        if not tiles.known[t]:
            continue
        _read_ladder(tiles.relief[t], cost.log_range, cost.tables, rungs)
        mean, sd, mine = rungs[0], rungs[1], tiles.chance[t]
        c_r = p_fail = 0.0
        for k in range(len(mine)):
            c_r += mine[k] * math.exp(mean[k])
            p_fail += mine[k] * rungs[2, k]
            mean[k] -= 0.5 * sd[k] * sd[k]  # of the logarithm, where the table's is the logarithm of the mean
        if tiles.slope[t] > rules.slope_limit:
            p_fail = 1.0
        low = math.exp(mixture_quantile(rules.tail, rules.normal, mine, mean, sd))
        high = math.exp(mixture_quantile(1.0 - rules.tail, -rules.normal, mine, mean, sd))
        rank = 0
        while rank < last and c_r >= rules.limits[rank]:
            rank += 1
        failing = p_fail >= rules.fail
        rank = last if failing else rank
        sure = p_fail if failing else _sureness(rank, rules.limits, mine, mean, sd)
        out.class_id[t] = rank
        out.rated[0, t], out.rated[1, t], out.rated[2, t] = c_r, min(low, c_r), max(high, c_r)
        out.rated[3, t], out.rated[4, t] = p_fail, sure * tiles.coverage[t]
