"""Ride cost from texture and relief: the paper's method on a calibrated table.

For each texture the calibration knows ``C_r`` at a ladder of z ranges. A tile's ``C_r`` under one texture is read off
that ladder (straight lines in log-log); the network's probabilities then weigh the four answers. What is predicted is
the whole distribution, a mixture of four log-normals, so an interval and the probability of the class come with it.
"""

import math
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FAIL_SHARE, NO_CLASS, TEXTURES, CostMap, Georeference, PatchStack, Reason, TextureMap
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.vehicle_body import with_floor
from bumpytiles import helper, kernel

__all__ = ["PAPER_TABLE", "CostRules", "CostTables", "RatedTiles", "TilesToRate", "rate", "rate_as_paper", "rate_tiles"]

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
    """Table of a calibration, for every texture."""

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
    """Arrays that are filled where a tile is known."""

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


_TAIL = 0.1
"""Probability below c_r_low and above c_r_high."""
_NORMAL_TAIL = -1.2815515655446004
"""That quantile of the standard normal."""
_MIN_LOG_SD = 0.05
_LEAST_COVERAGE = 0.7
"""Compat: with less than this share of the pixels filled a tile is class 3."""

PAPER_TABLE: dict[str, tuple[tuple[float, int], ...]] = {
    "flat": ((2.0, 0), (np.inf, 3)),
    "low_noise": ((0.5, 0), (2.5, 1), (np.inf, 3)),
    "noise_sin": ((0.5, 0), (1.0, 1), (2.5, 2), (np.inf, 3)),
    "high_noise": ((1.5, 1), (2.0, 2), (np.inf, 3)),
}
"""The paper's table: texture -> (raw z range below [m], class)."""


def rate(patches: PatchStack, textures: TextureMap, calibration: Calibration, georeference: Georeference) -> CostMap:
    """Rate tiles by texture and relief (``rating = "table"``).

    Parameters
    ----------
    patches : PatchStack
        n tiles; ``relief`` and ``slope`` are used.
    textures : TextureMap
        (n, 4) probabilities.
    calibration : Calibration
        Of the vehicle that will drive.
    georeference : Georeference
        Travels with the result.

    Raises
    ------
    UsageError
        The calibration was made for tiles of another size or another number of pixels.
    """
    calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)

    tiles = len(patches.reason)
    class_id = np.full(tiles, NO_CLASS, np.uint8)
    rated = np.full((5, tiles), np.nan, np.float32)
    chance = np.ascontiguousarray(textures.probability, np.float32)
    x = [np.ascontiguousarray(column, np.float64) for column in (patches.relief, patches.slope, patches.coverage)]
    rate_tiles(
        TilesToRate(patches.reason == Reason.OK, chance, x[0], x[1], x[2]),
        _ladder(calibration),
        CostRules(
            np.array(calibration.class_limits),
            slope_limit=float(calibration.vehicle["slope_limit_deg"]),
            fail=FAIL_SHARE,
            tail=_TAIL,
            normal=_NORMAL_TAIL,
        ),
        RatedTiles(class_id, rated),
        np.empty((3, len(TEXTURES))),
    )
    c_r, c_r_low, c_r_high = with_floor(rated[:3], calibration.map_floor).astype(np.float32)
    p_fail, confidence = rated[3:]
    return CostMap(
        georeference=georeference,
        patches=patches,
        textures=textures,
        class_id=class_id,
        c_r=c_r,
        c_r_low=c_r_low,
        c_r_high=c_r_high,
        p_fail=p_fail,
        confidence=confidence,
        rule=calibration.cost_rule,
    )


def rate_as_paper(
    patches: PatchStack, textures: TextureMap, calibration: Calibration, georeference: Georeference
) -> CostMap:
    """Rate tiles by the paper's rules (``compat = "paper"``): raw z range of the points, its table, its 30 % rule.

    Every tile with points gets a class; those that we would call unknown are class 3. ``c_r`` is the calibration's
    mean of the class, the interval is the class's own, ``confidence`` the probability of the winning texture.
    """
    calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
    chance = np.nan_to_num(textures.probability.astype(np.float64))
    raw_range = patches.z_max - patches.z_min
    by_texture = np.stack(
        [
            np.array([class_id for _, class_id in rule])[np.digitize(raw_range, [limit for limit, _ in rule[:-1]])]
            for rule in PAPER_TABLE.values()
        ],
        axis=1,
    )
    class_id = np.take_along_axis(by_texture, chance.argmax(axis=1)[:, None], axis=1)[:, 0]
    judged = (patches.reason == Reason.OK) & (patches.coverage >= _LEAST_COVERAGE)
    class_id = np.where(judged, class_id, 3)
    measured = patches.reason != Reason.NO_GROUND
    edges = with_floor(np.array([0.0, *calibration.class_limits, np.inf]), calibration.map_floor)
    p_fail = np.where(patches.slope > calibration.vehicle["slope_limit_deg"], 1.0, np.nan)
    high = np.where(class_id == len(edges) - 2, np.nan, edges[class_id + 1])
    out = np.full(len(measured), NO_CLASS, np.uint8)
    out[measured] = class_id[measured]
    return CostMap(
        georeference=georeference,
        patches=replace(patches, reason=np.where(measured, Reason.OK, patches.reason).astype(np.uint8)),
        textures=textures,
        class_id=out,
        c_r=_spread(measured, with_floor(np.array(calibration.class_c_r), calibration.map_floor)[class_id[measured]]),
        c_r_low=_spread(measured, edges[class_id[measured]]),
        c_r_high=_spread(measured, high[measured]),
        p_fail=_spread(measured, p_fail[measured]),
        confidence=_spread(judged, chance.max(axis=1)[judged]),
        rule=calibration.cost_rule,
    )


def _ladder(calibration: Calibration) -> CostTables:
    """Fill the gaps where no drive was completed from the last z range that has one; failure is certain there."""
    c_r = np.array(calibration.c_r, dtype=float)
    log_sd = np.array(calibration.c_r_log_sd, dtype=float)
    log_sd[:, 0] = np.where(np.isnan(log_sd[:, 0]), _MIN_LOG_SD, log_sd[:, 0])
    tables = (np.log(_carry_forward(c_r)), np.maximum(_carry_forward(log_sd), _MIN_LOG_SD))
    return CostTables(np.log(np.array(calibration.z_range)), np.stack((*tables, np.array(calibration.p_fail, float))))


def _carry_forward(table: NDArray[np.float64]) -> NDArray[np.float64]:
    last = np.maximum.accumulate(np.where(np.isnan(table), 0, np.arange(table.shape[1])), axis=1)
    carried: NDArray[np.float64] = np.take_along_axis(table, last, axis=1)
    return carried


def _spread(known: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Put values of the known tiles into an array over all tiles; NaN elsewhere."""
    out = np.full(len(known), np.nan, np.float32)
    out[known] = values
    return out
