"""The cost field of a route: what each tile costs per metre, and which tiles are closed."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import OPEN_THROUGH, Barred, TileField, UsageError

__all__ = ["TileChoice", "cost_of"]

_STRIP = 256
"""Rows that are computed at once, so that the float64 arrays in between stay small."""


@dataclass(frozen=True, slots=True)
class TileChoice:
    """Tiles that the user keeps a route out of or within, for one window."""

    avoid: NDArray[np.bool_] | None = None
    """(rows, cols) True where no way may lead."""
    only: NDArray[np.bool_] | None = None
    """(rows, cols) True where a way may lead, and nowhere else."""

    def closed(self, rows: slice) -> NDArray[np.bool_] | bool:
        """Return which tiles of some rows are closed."""
        avoided = False if self.avoid is None else self.avoid[rows]
        return avoided if self.only is None else avoided | ~self.only[rows]


def cost_of(
    field: TileField,
    *,
    risk_m: float | None = None,
    robust: bool = False,
    unknown_cost: float | None = None,
    choice: TileChoice | None = None,
    through: bool = False,
) -> NDArray[np.float32]:
    """Return the cost of one metre on each tile: ``1 + ride_weight c_r + risk_m hazard``; infinite where closed.

    Closed are tiles that are not passable, and those that ``choice`` excludes. Unknown tiles, which hold points but
    have no class, are closed unless ``unknown_cost`` is given; even then, those in which an obstacle was seen. Tiles
    without points are closed in any case: around a survey there are as many of them as its bounding rectangle
    happens to hold, and inside it they are mostly water and shade, of which nothing at all is known.

    Parameters
    ----------
    field : TileField
        (rows, cols) tiles. Only ``barred``, ``p_fail`` and ``c_r`` (``c_r_high`` if ``robust``) are used, and
        ``obstacle`` of unknown tiles.
    risk_m : float, optional
        The detour that one certain failure is worth, m; default: ``fail_weight`` of the vehicle, which gives the
        values of cost.tif. An unknown hazard counts as 0.
    robust : bool
        Plan on ``c_r_high``, the upper end of the interval, in the place of ``c_r``. A tile without one is closed.
    unknown_cost : float, optional
        Cost of a metre on unknown tiles, at least 1.
    choice : TileChoice, optional
        Tiles to avoid, or to keep within.
    through : bool
        Leave tiles open that obstacles or unseen pixels close: a way leads through them where the vehicle fits.

    Returns
    -------
    float32 (rows, cols)
        At least 1.

    Raises
    ------
    UsageError
        ``risk_m`` is negative or not finite, or ``unknown_cost`` is not a finite number of at least 1.
    """
    rule = field.rule
    risk = rule.fail_weight if risk_m is None else risk_m
    _check(risk, unknown_cost)
    weighed = type(rule)(rule.ride_weight, risk, rule.drive_m, rule.slope_limit_deg)
    shaking = field.c_r_high if robust else field.c_r
    cost = np.empty(field.barred.shape, np.float32)
    for start in range(0, len(cost), _STRIP):
        rows = slice(start, start + _STRIP)
        barred = field.barred[rows]
        factor = weighed.cost(shaking[rows].astype(np.float64), weighed.hazard(field.p_fail[rows]))
        is_closed = (~np.isin(barred, OPEN_THROUGH) if through else barred != Barred.NO) | ~np.isfinite(factor)
        cost[rows] = np.where(is_closed, np.inf, factor)
        if unknown_cost is not None:
            cost[rows][(barred == Barred.UNKNOWN) & ~(field.obstacle[rows] > 0.0)] = unknown_cost
        if choice is not None:
            cost[rows] = np.where(choice.closed(rows), np.float32(np.inf), cost[rows])
    return cost


def _check(risk_m: float, unknown_cost: float | None) -> None:
    if not (math.isfinite(risk_m) and risk_m >= 0.0):
        raise UsageError(
            f"`risk={risk_m:g}` is not allowed: it is the detour in metres that one certain failure is worth, from 0 up"
        )
    if unknown_cost is not None and not (math.isfinite(unknown_cost) and unknown_cost >= 1.0):
        raise UsageError(
            f"`unknown={unknown_cost:g}` is not allowed: it is the cost of a metre on unknown ground, at least 1 (that "
            "of smooth ground), such as `unknown=10`"
        )
