"""Ride cost from texture and relief: the paper's method on a calibrated table.

For each texture the calibration knows ``C_r`` at a ladder of z ranges. A tile's ``C_r`` under one texture is read off
that ladder (straight lines in log-log); the network's probabilities then weigh the four answers. What is predicted is
the whole distribution, a mixture of four log-normals, so an interval and the probability of the class come with it.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import FAIL_SHARE, NO_CLASS, TEXTURES, CostMap, Georeference, PatchStack, Reason, TextureMap
from bumpymap.rating.calibration import Calibration
from bumpymap.rating.vehicle_body import with_floor

__all__ = ["PAPER_TABLE", "rate", "rate_as_paper"]

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
    from bumpymap.rating.class_kernels import CostRules, CostTables, RatedTiles, TilesToRate, rate_tiles

    ladder = _ladder(calibration)
    tiles = len(patches.reason)
    class_id = np.full(tiles, NO_CLASS, np.uint8)
    rated = np.full((5, tiles), np.nan, np.float32)
    chance = np.ascontiguousarray(textures.probability, np.float32)
    x = [np.ascontiguousarray(column, np.float64) for column in (patches.relief, patches.slope, patches.coverage)]
    rate_tiles(
        TilesToRate(patches.reason == Reason.OK, chance, x[0], x[1], x[2]),
        CostTables(ladder.log_range, np.stack((ladder.log_c_r, ladder.log_sd, ladder.p_fail))),
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
    """Rate tiles by the paper's rules (``--compat paper``): raw z range of the points, its table, its 30 % rule.

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
    return CostMap(
        georeference=georeference,
        patches=replace(patches, reason=np.where(measured, Reason.OK, patches.reason).astype(np.uint8)),
        textures=textures,
        class_id=_spread_class(measured, class_id[measured]),
        c_r=_spread(measured, with_floor(np.array(calibration.class_c_r), calibration.map_floor)[class_id[measured]]),
        c_r_low=_spread(measured, edges[class_id[measured]]),
        c_r_high=_spread(measured, high[measured]),
        p_fail=_spread(measured, p_fail[measured]),
        confidence=_spread(judged, chance.max(axis=1)[judged]),
        rule=calibration.cost_rule,
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


def _spread(known: NDArray[np.bool_], values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Put values of the known tiles into an array over all tiles; NaN elsewhere."""
    out = np.full(len(known), np.nan, np.float32)
    out[known] = values
    return out


def _spread_class(known: NDArray[np.bool_], class_id: NDArray[np.integer]) -> NDArray[np.uint8]:
    """Put classes of the known tiles into an array over all tiles; ``NO_CLASS`` elsewhere."""
    out = np.full(len(known), NO_CLASS, np.uint8)
    out[known] = class_id
    return out
