"""Ride cost from texture and relief: the paper's method on a calibrated table.

For each texture the calibration knows ``C_r`` at a ladder of z ranges. A tile's ``C_r`` under one texture is read off
that ladder (straight lines in log-log); the network's probabilities then weigh the four answers. What is predicted is
the whole distribution, a mixture of four log-normals, so an interval and the probability of the class come with it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.calibration import Calibration
from bumpymap.types import NO_CLASS, CostMap, Georeference, PatchStack, Reason, TextureMap

__all__ = ["PAPER_TABLE", "rate", "rate_as_paper"]

_TAIL = 0.1
"""Probability below c_r_low and above c_r_high."""
_MIN_LOG_SD = 0.05
_FAIL = 0.5
"""A tile where at least this share of drives failed is class 3 whatever its C_r."""
_LEAST_COVERAGE = 0.7
"""Compat: with less than this share of the pixels filled a tile is class 3."""

PAPER_TABLE: dict[str, tuple[tuple[float, int], ...]] = {
    "flat": ((2.0, 0), (np.inf, 3)),
    "low_noise": ((0.5, 0), (2.5, 1), (np.inf, 3)),
    "noise_sin": ((0.5, 0), (1.0, 1), (2.5, 2), (np.inf, 3)),
    "high_noise": ((1.5, 1), (2.0, 2), (np.inf, 3)),
}
"""The paper's table: texture -> (raw z range below [m], class)."""


@dataclass(frozen=True, slots=True)
class _Ladder:
    """The calibration as arrays over (texture, z_range), without gaps."""

    log_range: NDArray[np.float64]
    log_c_r: NDArray[np.float64]
    log_sd: NDArray[np.float64]
    p_fail: NDArray[np.float64]


def rate(patches: PatchStack, textures: TextureMap, calibration: Calibration, georeference: Georeference) -> CostMap:
    """Rate tiles by texture and relief (``--rating table``).

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
    known = patches.reason == Reason.OK
    chance = textures.probability[known].astype(np.float64)
    log_c, sd, fail = _read_ladder(_ladder(calibration), patches.relief[known])
    c_r = np.sum(chance * np.exp(log_c), axis=1)
    p_fail = np.sum(chance * fail, axis=1)
    p_fail[patches.slope[known] > calibration.vehicle["slope_limit_deg"]] = 1.0
    klass = np.digitize(c_r, calibration.class_limits)
    klass[p_fail >= _FAIL] = 3
    log_mean = log_c - 0.5 * sd**2
    low, high = (_quantile(chance, log_mean, sd, q) for q in (_TAIL, 1.0 - _TAIL))
    edges = np.log([1e-12, *calibration.class_limits, 1e12])
    inside = _below(edges[klass + 1], chance, log_mean, sd) - _below(edges[klass], chance, log_mean, sd)
    confidence = np.where(p_fail >= _FAIL, p_fail, inside) * patches.coverage[known]
    return CostMap(
        georeference=georeference,
        patches=patches,
        textures=textures,
        klass=_spread_class(known, klass),
        c_r=_spread(known, c_r),
        c_r_low=_spread(known, np.minimum(low, c_r)),
        c_r_high=_spread(known, np.maximum(high, c_r)),
        p_fail=_spread(known, p_fail),
        confidence=_spread(known, confidence),
        ride_weight=float(calibration.vehicle["ride_weight"]),
    )


def rate_as_paper(
    patches: PatchStack, textures: TextureMap, calibration: Calibration, georeference: Georeference
) -> CostMap:
    """Rate tiles by the paper's rules (``--compat paper``): raw z range of the points, its table, its 30 % rule.

    Every tile with points gets a class; those that we would call unknown are class 3. ``c_r`` is the calibration's
    mean of the class, the interval is the class's own, ``confidence`` the probability of the winning texture.
    """
    calibration.require_grid(patches.grid.tile_size, patches.grid.pixels)
    chance = np.nan_to_num(textures.probability.astype(np.float64))
    raw_range = patches.z_max - patches.z_min
    by_texture = np.stack(
        [
            np.array([klass for _, klass in rule])[np.digitize(raw_range, [limit for limit, _ in rule[:-1]])]
            for rule in PAPER_TABLE.values()
        ],
        axis=1,
    )
    klass = np.take_along_axis(by_texture, chance.argmax(axis=1)[:, None], axis=1)[:, 0]
    judged = (patches.reason == Reason.OK) & (patches.coverage >= _LEAST_COVERAGE)
    klass = np.where(judged, klass, 3)
    measured = patches.reason != Reason.NO_GROUND
    edges = np.array([0.0, *calibration.class_limits, np.inf])
    p_fail = np.where(patches.slope > calibration.vehicle["slope_limit_deg"], 1.0, np.nan)
    high = np.where(klass == len(edges) - 2, np.nan, edges[klass + 1])
    return CostMap(
        georeference=georeference,
        patches=replace(patches, reason=np.where(measured, Reason.OK, patches.reason).astype(np.uint8)),
        textures=textures,
        klass=_spread_class(measured, klass[measured]),
        c_r=_spread(measured, np.array(calibration.class_c_r)[klass[measured]]),
        c_r_low=_spread(measured, edges[klass[measured]]),
        c_r_high=_spread(measured, high[measured]),
        p_fail=_spread(measured, p_fail[measured]),
        confidence=_spread(judged, chance.max(axis=1)[judged]),
        ride_weight=float(calibration.vehicle["ride_weight"]),
    )


def _ladder(calibration: Calibration) -> _Ladder:
    """Fill the gaps where no drive was completed from the last z range that has one; failure is certain there."""
    c_r = np.array(calibration.c_r, dtype=float)
    log_sd = np.array(calibration.c_r_log_sd, dtype=float)
    log_sd[:, 0] = np.where(np.isnan(log_sd[:, 0]), _MIN_LOG_SD, log_sd[:, 0])
    return _Ladder(
        log_range=np.log(np.array(calibration.z_range)),
        log_c_r=np.log(_carry_forward(c_r)),
        log_sd=np.maximum(_carry_forward(log_sd), _MIN_LOG_SD),
        p_fail=np.array(calibration.p_fail, dtype=float),
    )


def _carry_forward(table: NDArray[np.float64]) -> NDArray[np.float64]:
    last = np.maximum.accumulate(np.where(np.isnan(table), 0, np.arange(table.shape[1])), axis=1)
    carried: NDArray[np.float64] = np.take_along_axis(table, last, axis=1)
    return carried


def _read_ladder(
    ladder: _Ladder, relief: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Read ln C_r, its spread and p_fail of every texture at each relief, (n, textures) each.

    Below the ladder C_r is proportional to the relief (a small vehicle motion is linear in the ground's amplitude);
    above it the last rung is kept.
    """
    log_relief = np.log(np.maximum(relief, 1e-9))
    columns = range(len(ladder.log_c_r))
    read = [
        np.stack([np.interp(log_relief, ladder.log_range, table[k]) for k in columns], axis=1)
        for table in (ladder.log_c_r, ladder.log_sd, ladder.p_fail)
    ]
    read[0] += np.minimum(0.0, log_relief - ladder.log_range[0])[:, None]
    return read[0], read[1], read[2]


def _below(
    log_c: NDArray[np.float64], chance: NDArray[np.float64], log_mean: NDArray[np.float64], sd: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probability that C_r is below exp(log_c) under the mixture, (n,)."""
    from scipy.special import ndtr

    below: NDArray[np.float64] = np.sum(chance * ndtr((log_c[:, None] - log_mean) / sd), axis=1)
    return below


def _quantile(
    chance: NDArray[np.float64], log_mean: NDArray[np.float64], sd: NDArray[np.float64], q: float
) -> NDArray[np.float64]:
    """C_r below which a share q of the mixture lies, by bisection, (n,) rad/m."""
    low, high = (log_mean - 6.0 * sd).min(axis=1, initial=np.inf), (log_mean + 6.0 * sd).max(axis=1, initial=-np.inf)
    for _ in range(40):
        middle = 0.5 * (low + high)
        left = _below(middle, chance, log_mean, sd) < q
        low, high = np.where(left, middle, low), np.where(left, high, middle)
    quantile: NDArray[np.float64] = np.exp(0.5 * (low + high))
    return quantile


def _spread(known: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Put values of the known tiles into an array over all tiles; NaN elsewhere."""
    out = np.full(len(known), np.nan, np.float32)
    out[known] = values
    return out


def _spread_class(known: NDArray[np.bool_], klass: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Put classes of the known tiles into an array over all tiles; ``NO_CLASS`` elsewhere."""
    out = np.full(len(known), NO_CLASS, np.uint8)
    out[known] = klass
    return out
