"""Compare what the map predicts for whole ways with drives along them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import TileField
from bumpymap.lab.evaluate.routes.predicted import LineFigures, cut_at_tiles
from bumpymap.lab.simulate import WayDrive

__all__ = [
    "Arrivals",
    "GroundRow",
    "PairOrder",
    "WayAgreement",
    "WayResult",
    "agree",
    "arrivals",
    "by_class",
    "order",
    "results_of",
    "stopped_at_obstacle",
    "wilson",
]

Floats = NDArray[np.float64]
_NORMAL = 1.959963984540054
"""97.5 % quantile of the standard normal."""
_LEAST_PATH_M = 1.0
"""Tiles with less driven path are not compared: the axles were mostly in other tiles."""
_NEAR_M = 1.5
"""What stops a vehicle is this close to its middle, m."""


@dataclass(frozen=True, slots=True)
class WayResult:
    """A way: what the map says, and the drives along it."""

    pair: int
    name: str
    """``best`` or ``straight``."""
    predicted: LineFigures
    drives: list[WayDrive]
    obstacle_stops: int = 0
    """Number of drives that ended at a tile that holds an obstacle: it is passable beside it."""

    @property
    def arrived(self) -> int:
        """Number of drives that reached the end."""
        return sum(made.outcome == "completed" for made in self.drives)

    @property
    def c_r(self) -> float:
        """Mean C_r of those drives, rad/m; NaN if there are none."""
        values = [made.c_r for made in self.drives if made.outcome == "completed"]
        return math.fsum(values) / len(values) if values else math.nan

    @property
    def spread(self) -> float:
        """Standard deviation of their C_r as a share of the mean; NaN with fewer than two."""
        values = [made.c_r for made in self.drives if made.outcome == "completed"]
        return float(np.std(values, ddof=1)) / self.c_r if len(values) > 1 else math.nan

    @property
    def turning_share(self) -> float:
        """Share of the pitch motion of those drives in which the vehicle was turning; NaN if there is none."""
        done = [made for made in self.drives if made.outcome == "completed"]
        whole = math.fsum(made.pitched_rad for made in done)
        return math.fsum(made.turning_rad for made in done) / whole if whole > 0 else math.nan


@dataclass(frozen=True, slots=True)
class WayAgreement:
    """Predicted against driven C_r of the ways on which a drive arrived; NaN without ways."""

    ways: int
    median_error: float
    """Median of abs(predicted - driven) / driven."""
    median_ratio: float
    """Median of predicted / driven."""
    held: float
    """Share of the ways whose driven C_r is in the predicted interval."""
    raw_error: float
    """Median error of the prediction without noise correction."""
    raw_ratio: float
    noise_ratio: float
    """Median of the prediction without over the one with noise correction."""
    spread: float
    """Median spread between the drives along a way, as a share of their mean."""
    turning_share: float
    """Mean share of the pitch motion in which the vehicle was turning."""


@dataclass(frozen=True, slots=True)
class PairOrder:
    """Whether the map says rightly which of both ways is the rougher one."""

    pairs: int
    compared: int
    """Pairs with a difference: both ways driven to the end, or only one of them."""
    right: int
    by_c_r: int
    """Compared pairs of which both ways were driven to the end."""
    by_c_r_right: int
    by_arrival: int
    """Compared pairs of which only one way was driven to the end; it counts as the better one."""
    by_arrival_right: int
    dearer_straight: int
    """Pairs whose straight line costs more than the best way according to the map."""


@dataclass(frozen=True, slots=True)
class Arrivals:
    """Predicted and driven arrivals of the ways of one kind."""

    ways: int
    drives: int
    expected: float
    """Mean of P(arrives), 0..1."""
    arrived: float
    """Share of the drives that arrived, 0..1."""
    low: float
    """95 % interval (Wilson) of that share. Drives along one way are alike, so each way counts as one trial."""
    high: float
    held: bool
    """Whether ``expected`` is in the interval."""
    obstacle_stops: int
    """Drives that ended at a tile that holds an obstacle."""
    ways_held: int
    """Ways whose own P(arrives) is in the interval of their own drives."""


@dataclass(frozen=True, slots=True)
class GroundRow:
    """Tiles of one class that drives along ways crossed."""

    class_id: int
    tiles: int
    path_m: float
    predicted: float
    """Mean C_r, weighted by the driven path, rad/m."""
    driven: float
    raw: float
    """Mean of the prediction without noise correction."""
    median_error: float
    """Median over the tiles of abs(predicted - driven) / driven."""


def agree(ways: Sequence[WayResult]) -> WayAgreement:
    """Compare C_r of whole ways."""
    good = [way for way in ways if way.arrived and way.c_r > 0 and math.isfinite(way.predicted.c_r)]
    driven = np.array([way.c_r for way in good])
    c_r, low, high, raw = (
        np.array([getattr(way.predicted, name) for way in good]) for name in ("c_r", "c_r_low", "c_r_high", "c_r_raw")
    )
    held = (driven >= low) & (driven <= high)
    turning = np.array([way.turning_share for way in good])
    return WayAgreement(
        ways=len(good),
        median_error=_median(np.abs(c_r - driven) / driven),
        median_ratio=_median(c_r / driven),
        held=float(held.mean()) if good else math.nan,
        raw_error=_median(np.abs(raw - driven) / driven),
        raw_ratio=_median(raw / driven),
        noise_ratio=_median(raw / c_r),
        spread=_median(np.array([way.spread for way in good])),
        turning_share=float(turning.mean()) if good else math.nan,
    )


def order(best: Sequence[WayResult], straight: Sequence[WayResult]) -> PairOrder:
    """Compare the order of both ways of each pair: predicted by cost and C_r, driven by arrival and C_r.

    Where both ways were driven to the end, predicted and driven C_r are compared. Where one was, the way of lower cost
    on the map must be that one. Pairs on which no drive arrived have no order.
    """
    by_c_r, by_arrival = [], []
    for one, other in zip(best, straight, strict=True):
        if one.arrived and other.arrived:
            by_c_r.append((one.c_r < other.c_r) == (one.predicted.c_r < other.predicted.c_r))
        elif one.arrived or other.arrived:
            by_arrival.append((one.arrived > 0) == (one.predicted.cost_m < other.predicted.cost_m))
    return PairOrder(
        pairs=len(best),
        compared=len(by_c_r) + len(by_arrival),
        right=sum(by_c_r) + sum(by_arrival),
        by_c_r=len(by_c_r),
        by_c_r_right=sum(by_c_r),
        by_arrival=len(by_arrival),
        by_arrival_right=sum(by_arrival),
        dearer_straight=sum(a.predicted.cost_m < b.predicted.cost_m for a, b in zip(best, straight, strict=True)),
    )


def arrivals(ways: Sequence[WayResult]) -> Arrivals:
    """Compare P(arrives) with the share of drives that arrived; at least one way."""
    shares = [way.arrived / len(way.drives) for way in ways]
    expected = float(np.mean([way.predicted.p_arrives for way in ways]))
    low, high = wilson(math.fsum(shares), len(ways))
    own = [wilson(way.arrived, len(way.drives)) for way in ways]
    held = [low_ <= way.predicted.p_arrives <= high_ for way, (low_, high_) in zip(ways, own, strict=True)]
    return Arrivals(
        ways=len(ways),
        drives=sum(len(way.drives) for way in ways),
        expected=expected,
        arrived=float(np.mean(shares)),
        low=low,
        high=high,
        held=low <= expected <= high,
        obstacle_stops=sum(way.obstacle_stops for way in ways),
        ways_held=sum(held),
    )


def wilson(successes: float, trials: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by E. B. Wilson (1927), 0..1."""
    share, square = successes / trials, _NORMAL**2
    middle = (share + square / (2 * trials)) / (1 + square / trials)
    half = _NORMAL / (1 + square / trials) * math.sqrt(share * (1 - share) / trials + square / (4 * trials**2))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def by_class(
    field: TileField, c_r_raw: Floats, ways: Sequence[WayResult], limits: Sequence[float]
) -> list[GroundRow]:  # fmt: skip
    """Compare C_r tile by tile, by the class of the predicted C_r, over the drives that arrived."""
    drives = [made for way in ways for made in way.drives if made.outcome == "completed"]
    row, col, path, pitch = _driven_tiles(field, drives).T
    at = row.astype(np.int64), col.astype(np.int64)
    predicted, raw = field.c_r[at].astype(np.float64), c_r_raw[at]
    class_id = np.searchsorted(np.array(limits), predicted, side="right")
    rows = []
    for number in range(len(limits) + 1):
        own = (class_id == number) & (path >= _LEAST_PATH_M) & (pitch > 0)
        metres = path[own].sum()
        driven = pitch[own] / path[own]
        means = [float(values[own] @ path[own] / metres) if own.any() else math.nan for values in (predicted, raw)]
        error = np.abs(predicted[own] - driven) / driven
        whole = float(pitch[own].sum() / metres) if own.any() else math.nan
        rows.append(GroundRow(number, int(own.sum()), float(metres), means[0], whole, means[1], _median(error)))
    return rows


def results_of(
    field: TileField,
    lines: Mapping[tuple[int, str], Floats],
    predicted: Mapping[tuple[int, str], LineFigures],
    driven: Mapping[tuple[str | int, ...], WayDrive],
) -> list[WayResult]:
    """Join predictions and drives of all ways; ``lines`` are in field coordinates."""
    results = []
    for (pair, name), figures in predicted.items():
        drives = [made for key, made in driven.items() if key[:2] == (pair, name)]
        ends = [stopped_at_obstacle(field, lines[pair, name], made) for made in drives]
        results.append(WayResult(pair, name, figures, drives, sum(ends)))
    return results


def stopped_at_obstacle(field: TileField, line: Floats, made: WayDrive) -> bool:
    """Return whether a drive failed within 1.5 m of the way in a tile that holds an obstacle."""
    if made.outcome == "completed":
        return False
    pieces = cut_at_tiles(line)
    end = np.cumsum(pieces.length) * field.grid.tile_size
    begin = end - pieces.length * field.grid.tile_size
    near = (begin < made.reached_m + _NEAR_M) & (end > made.reached_m - _NEAR_M)
    return bool((field.obstacle[pieces.row[near], pieces.col[near]] > 0).any())


def _driven_tiles(field: TileField, drives: Sequence[WayDrive]) -> Floats:
    """Return the tiles that drives crossed, one row each: row, column, path [m], pitch motion [rad], summed."""
    shape = field.c_r.shape
    sums = np.zeros((2, *shape))
    for made in drives:
        for col, row, path, pitch in made.tiles:
            if 0 <= row < shape[0] and 0 <= col < shape[1]:
                sums[:, row, col] += path, pitch
    at = np.nonzero(np.isfinite(field.c_r) & (sums[0] > 0))
    return np.stack([*at, sums[0][at], sums[1][at]], axis=1)


def _median(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan
