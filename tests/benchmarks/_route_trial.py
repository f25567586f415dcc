"""Plan ways over the layers of a map, drive along them in the simulation, compare with what the map predicts.

The map predicts C_r of the ground without the survey's noise; the drives run over heights that contain it. The
prediction without noise correction is for the same heights as the drives, so the ratio of both predictions is the part
of the noise in the difference between map and drive.
"""

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Barred, Progress, Steps, TileField, UsageError
from bumpymap.lab.evaluate.survey_trial import TrialOptions, uniform_by_key
from bumpymap.lab.simulate.drive import DriveSettings
from bumpymap.lab.simulate.jobs import Journal, Key, drive_jobs
from bumpymap.rating import Calibration, RideModel, Vehicle, roll_over
from bumpymap.rating.vehicle_body import less_floor
from bumpymap.route import CostSettings
from bumpymap.route.ground import CostGround
from bumpymap.route.places import on_grid, place_in_window
from bumpymap.route.planner import Planner
from bumpytiles import TileWindow

sys.path.append(str(Path(__file__).resolve().parents[1] / "worlds"))

from driven_ways import ReliefGround, WayDrive, drive_way, fill_gaps

if TYPE_CHECKING:
    from bumpymap.layers import MapReader


@dataclass(frozen=True, slots=True)
class RouteTrialSettings:
    """All settings that affect the numbers, apart from map and vehicle."""

    total_pairs: int = 20
    """Pairs of a start and a goal."""
    repeats: int = 4
    """Drives along each way, each a little to the left or right of it."""
    seed: int = 7
    least_m: float = 40.0
    """Shortest distance between start and goal, m."""
    most_m: float = 150.0
    """Longest."""
    offset_m: float = 0.1
    """The drives are up to this far beside the way, m: the margin beside the vehicle with which tiles are passable."""
    most_shared: float = 0.8
    """Largest share of the best way's length that may lie in tiles of the straight line; else there is nothing to
    compare."""
    drive: DriveSettings = field(default_factory=DriveSettings)

    def __post_init__(self) -> None:
        for name, value, least in (
            ("pairs", self.total_pairs, 1),
            ("repeats", self.repeats, 1),
            ("seed", self.seed, 0),
        ):
            if value < least:
                raise UsageError(f"`{name}` is {value}; it must be {least} or more")
        if not 0 < self.least_m <= self.most_m:
            raise UsageError(
                f"distances are {self.least_m} to {self.most_m} m; the first must be above 0 and no larger"
            )
        if not 0 <= self.offset_m < self.drive.margin_m:
            raise UsageError(f"offset_m is {self.offset_m}; it must be 0 to {self.drive.margin_m} m")


Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class TilePieces:
    """The pieces of a line between the borders of tiles, in order."""

    row: NDArray[np.int64]
    """(n,) from the north of the window."""
    col: NDArray[np.int64]
    """(n,) from its west."""
    length: Floats
    """(n,) in tiles, above 0."""


@dataclass(frozen=True, slots=True)
class LineFigures:
    """Prediction for a whole line."""

    length_m: float
    c_r: float
    """Mean along the line where it is known, rad/m; NaN if it is known nowhere (so are the next three)."""
    c_r_low: float
    """Mean of the lower ends of the 80 % intervals: as if all tiles erred to the same side."""
    c_r_high: float
    c_r_raw: float
    """Mean of the prediction without noise correction, for the heights as they were measured, rad/m."""
    hazard: float
    """Integral of the hazard; infinite across ground on which all drives fail."""
    cost_m: float
    """Length and the detours that shaking and risk are worth, m; infinite across such ground."""
    barred_m: float
    """Length in tiles that are not passable."""
    unknown_m: float
    """Length in tiles without C_r."""
    obstacle_m: float
    """Length in tiles that hold an obstacle."""
    tight_turns_deg: float = 0.0
    """As in `bumpymap.core.RouteFigures`."""

    @property
    def p_arrives(self) -> float:
        """As in `bumpymap.core.RouteFigures`; obstacles bar tiles."""
        return math.exp(-self.hazard - self.tight_turns_deg / 100)


def tile_cost(field: TileField) -> Floats:
    """Return the cost per metre of each tile at the weights of the map, (rows, cols); infinite where barred."""
    with np.errstate(invalid="ignore"):
        cost = field.rule.cost(field.c_r.astype(np.float64), field.rule.hazard(field.p_fail))
    return np.where((field.barred == Barred.NO) & np.isfinite(cost), cost, np.inf)


def cut_at_tiles(line: Floats) -> TilePieces:
    """Cut a line at the borders of tiles.

    Parameters
    ----------
    line : array (n, 2)
        Field coordinates of its corners: distance to the south and to the east of the window's corner, tiles. A piece
        along a border belongs to the tile in the south or east of it.
    """
    parts = [_cut_segment(a, b) for a, b in pairwise(line)]
    row, col, length = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return TilePieces(row, col, length)


def _cut_segment(a: Floats, b: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
    cuts = [np.array([0.0, 1.0])]
    for start, end in zip(a.tolist(), b.tolist(), strict=True):
        low, high = sorted((start, end))
        borders = np.arange(math.floor(low) + 1, math.ceil(high))
        cuts.append((borders - start) / (end - start) if len(borders) else np.empty(0))
    at = np.unique(np.concatenate(cuts))
    middle = a + (b - a) * ((at[1:] + at[:-1]) / 2)[:, None]
    length = np.diff(at) * math.hypot(*(b - a))
    row, col = np.floor(middle).astype(np.int64).T
    long = length > 0
    return row[long], col[long], length[long]


def predict_line(field: TileField, line: Floats, c_r_raw: NDArray[np.floating]) -> LineFigures:
    """Sum the layers along a line.

    Parameters
    ----------
    field : TileField
    line : array (n, 2)
        Field coordinates; all of it lies in the window.
    c_r_raw : array (rows, cols)
        Prediction without noise correction, rad/m.
    """
    pieces = cut_at_tiles(line)
    at = pieces.row, pieces.col
    length = pieces.length * field.grid.tile_size
    known = np.isfinite(field.c_r[at])
    hazard = np.nan_to_num(field.rule.hazard(field.p_fail[at]), nan=0.0, posinf=np.inf)
    risk = float(hazard @ length)
    c_r, low, high, raw = (
        _mean(band[at], length, known) for band in (field.c_r, field.c_r_low, field.c_r_high, c_r_raw)
    )
    whole = float(length.sum())
    return LineFigures(
        length_m=whole,
        c_r=c_r,
        c_r_low=low,
        c_r_high=high,
        c_r_raw=raw,
        hazard=risk,
        cost_m=whole * (1 + field.rule.ride_weight * c_r) + field.rule.fail_weight * risk,
        barred_m=float(length[field.barred[at] != Barred.NO].sum()),
        unknown_m=float(length[~known].sum()),
        obstacle_m=float(length[field.obstacle[at] > 0].sum()),
    )


def shared_length(line: Floats, other: Floats) -> float:
    """Return the share of a line's length that lies in tiles of another line, 0..1; field coordinates."""
    own, met = cut_at_tiles(line), cut_at_tiles(other)
    tiles = set(zip(met.row.tolist(), met.col.tolist(), strict=True))
    shared = [place in tiles for place in zip(own.row.tolist(), own.col.tolist(), strict=True)]
    return float(own.length[shared].sum() / own.length.sum())


def _mean(values: NDArray[np.floating], length: Floats, known: NDArray[np.bool_]) -> float:
    good = known & np.isfinite(values)
    return float(values[good].astype(np.float64) @ length[good] / length[good].sum()) if good.any() else math.nan


_MANY_POINTS = 10.0
"""Points per pixel; without a correction of noise they have no effect."""


def driven_field(field: TileField, floor: float) -> TileField:
    """Return a map's tiles without the floor of the vehicle [rad/m], which simulated drives do not have."""
    ends = (field.c_r, field.c_r_low, field.c_r_high)
    c_r, low, high = (less_floor(values, floor).astype(np.float32) for values in ends)
    return replace(field, c_r=c_r, c_r_low=low, c_r_high=high)


def ride_without_correction(model: RideModel, heights: NDArray[np.floating], known: NDArray[np.bool_]) -> Floats:
    """Predict C_r of tiles from their heights as measured, as if these had no noise.

    Parameters
    ----------
    model : RideModel
    heights : array (rows * pixels, cols * pixels)
        m, NaN where no point fell; gaps are filled tile by tile.
    known : bool (rows, cols)
        Tiles to predict; each holds a known height.

    Returns
    -------
    array (rows, cols)
        rad/m; NaN elsewhere.
    """
    pixels, size = model.calibration.pixels, model.calibration.tile_size
    rows, cols = known.shape
    tiles = heights.reshape(rows, pixels, cols, pixels).swapaxes(1, 2)[known]
    out = np.full(known.shape, math.nan)
    if not len(tiles):
        return out
    filled = np.stack([fill_gaps(tile) for tile in tiles])
    axis = np.arange(pixels) - (pixels - 1) / 2
    norm = pixels * float(axis @ axis)
    east, south = filled.sum(axis=1) @ axis / norm, filled.sum(axis=2) @ axis / norm
    plane = filled.mean(axis=(1, 2))[:, None, None] + east[:, None, None] * axis + south[:, None, None] * axis[:, None]
    slope = np.degrees(np.arctan(np.hypot(east, south) * pixels / size))
    rides = roll_over((filled - plane).astype(np.float32), model.operator)
    found = model.correction.predict(rides, slope, np.zeros(len(tiles)), np.full(len(tiles), _MANY_POINTS))
    out[known] = np.exp(found.log_c_r)
    return out


@dataclass(frozen=True, slots=True)
class RoutePlanner:
    """Plans the cheapest way as ``bumpymap route`` does; a `PlanWay`."""

    planner: Planner

    @classmethod
    def of(cls, route_map: "MapReader") -> "RoutePlanner":
        """Return the planner of a map, with the settings of its vehicle."""
        return cls(Planner(CostGround(route_map, CostSettings(), route_map.window.cols * route_map.window.rows)))

    def __call__(self, start: Floats, goal: Floats) -> Floats | None:
        """Plan a way; see `PlanWay`. None too if the vehicle does not fit where it begins or ends."""
        site = self.planner.ground.site
        ends = on_grid(np.array([start, goal]), site.grid, site.window)
        line = self.planner.line(*ends)
        if line is None:
            return None
        placed = np.array([place_in_window(corner, site.grid, site.window) for corner in line])
        placed[0], placed[-1] = start, goal
        return placed


PlanWay = Callable[[Floats, Floats], Floats | None]
"""Plans a way over the map: start and goal (2,) in field coordinates, that is tiles from its north and from its west.
Returns the corners (n, 2) from start to goal, or None if there is no way."""

_MOST_TRIED = 5000


@dataclass(frozen=True, slots=True)
class WayPair:
    """Two ways between the same places, in field coordinates."""

    best: Floats
    """(n, 2) the planned way."""
    straight: Floats
    """(2, 2) the straight line."""

    def lines(self) -> dict[str, Floats]:
        """Return both by name."""
        return {"best": self.best, "straight": self.straight}


def choose_pairs(
    field: TileField, plan: PlanWay, settings: RouteTrialSettings, progress: Progress
) -> list[WayPair]:  # fmt: skip
    """Draw starts and goals at centres of passable tiles between which a way exists.

    A pair is kept if C_r is known along all of the straight line, which may cross barred ground, and if the best way is
    another one. The pairs depend on the map, the planner and the settings only.

    Parameters
    ----------
    field : TileField
        The whole map.
    plan : PlanWay
    settings : RouteTrialSettings
    progress : Progress

    Raises
    ------
    BadInputError
        The map has no such pair.
    """
    cost = tile_cost(field)
    known = np.isfinite(field.c_r)
    found: list[WayPair] = []
    progress.start("planning ways", settings.total_pairs)
    for start, goal in _candidates(np.isfinite(cost), field.grid.tile_size, settings):
        straight = np.stack([start, goal])
        pieces = cut_at_tiles(straight)
        if not known[pieces.row, pieces.col].all():
            continue
        best = plan(start, goal)
        if best is None or shared_length(best, straight) > settings.most_shared:
            continue
        found.append(WayPair(np.asarray(best, np.float64), straight))
        progress.advance(1)
        if len(found) == settings.total_pairs:
            break
    if not found:
        raise BadInputError(
            f"the map has no two passable tiles {settings.least_m:g} to {settings.most_m:g} m apart with a way between "
            "them other than the straight line. Give the layers of a larger survey"
        )
    return found


def _candidates(
    passable: NDArray[np.bool_], tile_size: float, settings: RouteTrialSettings
) -> Iterator[tuple[Floats, Floats]]:
    """Yield random centres of passable tiles that are joined side by side, at the wanted distance."""
    from scipy.ndimage import label

    part, _ = label(passable)
    tiles = np.argwhere(passable)
    rng = np.random.default_rng(settings.seed)
    for _ in range(_MOST_TRIED if len(tiles) else 0):
        first, second = tiles[rng.integers(len(tiles), size=2)]
        metres = float(np.hypot(*(second - first))) * tile_size
        if settings.least_m <= metres <= settings.most_m and part[tuple(first)] == part[tuple(second)]:
            yield first + 0.5, second + 0.5


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


WAYS = ("best", "straight")
_ROOM_TILES = 2
"""Tiles around a way whose heights are read."""


@dataclass(frozen=True, slots=True)
class WayJob:
    """One drive along one way."""

    key: Key
    line: NDArray[np.float64]
    """(n, 2) field coordinates."""
    offset: float
    """m to the left."""
    starts: int = 1


@dataclass(frozen=True)
class DrivenMap:
    """What all drives share."""

    route_map: "MapReader"
    profile: Vehicle
    drive: DriveSettings


def drive_pairs(
    route_map: "MapReader",
    profile: Vehicle,
    pairs: Sequence[WayPair],
    settings: RouteTrialSettings,
    options: TrialOptions,
) -> dict[Key, WayDrive]:
    """Drive along both ways of every pair, ``repeats`` times each.

    Parameters
    ----------
    route_map : MapReader
        The map, for its heights and obstacles.
    profile : Vehicle
    pairs : sequence of WayPair
        In field coordinates of the window of the map.
    settings : RouteTrialSettings
    options : TrialOptions

    Returns
    -------
    dict
        (number of the pair, ``best`` or ``straight``, number of the drive) -> drive.
    """
    jobs = [
        WayJob((number, name, repeat), line, _offset(settings, number, repeat))
        for number, pair in enumerate(pairs)
        for name, line in pair.lines().items()
        for repeat in range(settings.repeats)
    ]
    options.progress.start(f"driving {profile.name} along ways", len(jobs))
    return drive_jobs(
        partial(run_way, DrivenMap(route_map, profile, settings.drive)),
        jobs,
        Steps(options.progress),
        workers=options.workers,
        journal=Journal(
            options.out / f"ways-{profile.name}.jsonl",
            _recorded(route_map, profile, pairs, settings),
            WayDrive.from_record,
        ),
        discard_other=options.overwrite,
    )


def run_way(driven: DrivenMap, job: WayJob) -> WayDrive:
    """Read the heights around a way and drive along it; ``tiles`` of the result are columns and rows of the map."""
    route_map, grid = driven.route_map, driven.route_map.grid
    whole = route_map.window
    low, high = job.line.min(axis=0) - _ROOM_TILES, job.line.max(axis=0) + _ROOM_TILES
    (top, left), (bottom, right) = np.floor(low).astype(int).tolist(), np.ceil(high).astype(int).tolist()
    window = TileWindow(whole.col + left, whole.row + whole.rows - bottom, right - left, bottom - top)
    ground = ReliefGround.from_heightmap(route_map.heights(window), grid.pixel_size, route_map.objects(window))
    corners = np.stack([job.line[:, 1] - left, bottom - job.line[:, 0]], axis=1) * grid.tile_size
    made = drive_way(driven.profile, ground, corners, grid.tile_size, job.offset, driven.drive)
    # From tiles of the small window, counted from the south, to those of the map's arrays.
    made.tiles = [(col + left, bottom - 1 - row, path, pitch) for col, row, path, pitch in made.tiles]
    return made


def _offset(settings: RouteTrialSettings, number: int, repeat: int) -> float:
    share = uniform_by_key(settings.seed, np.array([number]), np.array([repeat]))[0]
    return float(settings.offset_m * (2 * share - 1))


def _recorded(
    route_map: "MapReader", profile: Vehicle, pairs: Sequence[WayPair], settings: RouteTrialSettings
) -> dict[str, Any]:
    """Return everything that affects the drives, as JSON."""
    files = [
        {
            file["path"]: file["sha256"]
            for file in manifest["files"]
            if file["path"] in ("heightmap.tif", "obstacle.tif")
        }
        for manifest in route_map.manifests
    ]
    return {
        "vehicle": profile.to_dict(),
        "files": files,
        "lines": [{name: line.round(9).tolist() for name, line in pair.lines().items()} for pair in pairs],
        "seed": settings.seed,
        "repeats": settings.repeats,
        "offset_m": settings.offset_m,
        "drive": asdict(settings.drive),
        "versions": {name: version(name) for name in ("dartpy", "numpy")},
    }


@dataclass(frozen=True, slots=True)
class RouteFindings:
    """All results of an evaluation of routes."""

    facts: dict[str, Any]
    settings: dict[str, Any]
    ways: list[WayResult]
    agreement: dict[str, WayAgreement]
    """``best``, ``straight`` -> agreement of C_r."""
    arrivals: dict[str, Arrivals]
    order: PairOrder
    ground: list[GroundRow]

    def of(self, name: str) -> list[WayResult]:
        """Return the ways of one kind, in the order of the pairs."""
        return [way for way in self.ways if way.name == name]


def require_calibration(route_map: "MapReader", calibration: Calibration) -> None:
    """Raise BadInputError if the map was made with another calibration."""
    if route_map.calibration_id != calibration.id:
        raise BadInputError(
            f"the layers were made with the calibration {route_map.calibration_id} of {route_map.vehicle.name}; the "
            f"given one is {calibration.id} of {calibration.vehicle['name']}. Give its file with --calibration, or map "
            "the survey again"
        )


def evaluate_routes(
    route_map: "MapReader",
    calibration: Calibration,
    plan: PlanWay,
    settings: RouteTrialSettings,
    options: TrialOptions,
) -> RouteFindings:
    """Plan the best ways between random places of a map, drive them and the straight lines, and compare.

    Parameters
    ----------
    route_map : MapReader
    calibration : Calibration
        The one that the map was made with; it has a ride model.
    plan : callable
        See `PlanWay`.
    settings : RouteTrialSettings
    options : TrialOptions

    Raises
    ------
    BadInputError
        The map was made with another calibration, is damaged, or has no two places with a way between them.
    """
    require_calibration(route_map, calibration)
    field = route_map.read(route_map.window)
    pairs = choose_pairs(field, plan, settings, options.progress)
    c_r_raw = _raw(route_map, calibration, field, pairs)
    lines = {(number, name): line for number, pair in enumerate(pairs) for name, line in pair.lines().items()}
    profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")
    field = driven_field(field, calibration.floor)
    predicted = {
        key: replace(predict_line(field, line, c_r_raw), tight_turns_deg=_tight_turns_deg(route_map, line))
        for key, line in lines.items()
    }
    driven = drive_pairs(route_map, profile, pairs, settings, options)
    ways = results_of(field, lines, predicted, driven)
    best, straight = ([way for way in ways if way.name == name] for name in WAYS)
    facts = {
        "vehicle": route_map.vehicle.name,
        "calibration": calibration.id,
        "inputs": [str(one["path"]).rpartition("/")[2] for each in route_map.manifests for one in each["inputs"]],
        "tiles": int(np.isfinite(field.c_r).sum()),
        "passable": int((field.barred == 0).sum()),
        "pairs": len(pairs),
    }
    return RouteFindings(
        facts=facts,
        settings=asdict(settings),
        ways=ways,
        agreement={"best": agree(best), "straight": agree(straight)},
        arrivals={"best": arrivals(best), "straight": arrivals(straight)},
        order=order(best, straight),
        ground=by_class(field, c_r_raw, best, calibration.class_limits),
    )


def _tight_turns_deg(route_map: "MapReader", line: Floats) -> float:
    ground = RoutePlanner.of(route_map).planner.ground
    return ground.tight_turns_deg(on_grid(np.asarray(line, np.float64), route_map.grid, route_map.window))


def _raw(
    route_map: "MapReader", calibration: Calibration, field: TileField, pairs: Sequence[WayPair]
) -> NDArray[np.float64]:
    """Predict without noise correction the tiles along and beside the ways."""
    from scipy.ndimage import binary_dilation

    near = np.zeros(field.c_r.shape, np.bool_)
    for pair in pairs:
        for line in pair.lines().values():
            for a, b in pairwise(line):
                share = np.linspace(0, 1, int(np.hypot(*(b - a)) * 4) + 2)[:, None]
                row, col = np.floor(a + share * (b - a)).astype(np.int64).T
                near[row, col] = True
    known = binary_dilation(near, iterations=2) & np.isfinite(field.c_r)
    return ride_without_correction(RideModel(calibration), route_map.heights(route_map.window), known)
