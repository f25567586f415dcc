"""Points of tiles that are thinned or moved, terrain as tiles, and what the steps of a tile cost."""

import time
import tracemalloc
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, FeatureSettings, Georeference, PatchStack, Progress, Reason, UsageError, counted
from bumpymap.lab.evaluate.rated_survey import MAPPED, MeasuredSurvey, Subject, Verdict
from bumpymap.lab.evaluate.survey_trial import uniform_by_key
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.plan import library_terrain
from bumpymap.lab.worlds.terrains import FINE, KINDS, Terrain
from bumpymap.patches import join_stacks, measure
from bumpymap.rating import Calibration, Vehicle, classify
from bumpytiles import TileBuckets, TilePoints


def require_unseen(calibration: Calibration, seed: int) -> None:
    """Raise UsageError if a calibration was made with terrain of the same seed."""
    if calibration.settings.get("seed") == seed:
        raise UsageError(
            f"--seed {seed} is that of the calibration {calibration.id}, so its terrain is not unseen. Choose another"
        )


def library_terrains(calibration: Calibration, profile: Vehicle, seed: int, each: int) -> list[Terrain]:
    """Make terrain with heights and slopes scaled to a vehicle: ``each`` of every kind, kind by kind."""
    made = CalibrationSettings(profile, seed=seed, tile_size=calibration.tile_size, pixels=calibration.pixels)
    return [library_terrain(made, kind, index) for kind in KINDS for index in range(each)]


def flat_terrains(calibration: Calibration, count: int) -> list[Terrain]:
    """Make perfectly flat ground."""
    side = calibration.pixels * FINE
    return [Terrain("dead flat", np.zeros((side, side)), calibration.tile_size)] * count


def measure_all(buckets: TileBuckets, features: FeatureSettings) -> PatchStack:
    """Measure all tiles; tiles in one row come in the order of their columns."""
    return join_stacks([measure(points, features, ground_only=False) for points in buckets.blocks()])


def rebuild_buckets(points: TilePoints) -> TileBuckets:
    """Sort points that were moved inside their tiles into the canonical order."""
    buckets = TileBuckets(points.grid)
    buckets.add(points.easting, points.northing, points.upward, points.flag)
    return buckets


@dataclass(frozen=True, slots=True)
class DensityRow:
    """One rating of the survey at one density, against the same rating of the whole survey."""

    rating: str
    density: float
    """Requested mean density of the classified tiles, points per m2."""
    share_of_points: float
    """Share of the points that were kept, 0..1."""
    tiles: int
    """Classified tiles of the whole survey."""
    still_judged: float
    """Share of them that can be classified with fewer points."""
    same_class: float
    """Share of those that keep their class."""
    same_by_class: float
    """The mean of the same share over the classes, so that all classes have the same weight."""
    off_two: float
    """Share of those that change by two classes or more."""
    c_r_ratio: float
    """Median ratio of C_r to that of the whole survey."""
    confidence_kept: float
    """Median confidence of tiles that keep their class; NaN without any."""
    confidence_moved: float
    """Median confidence of those that do not; NaN without any."""


def thin_points(points: TilePoints, share: float, seed: int) -> TilePoints:
    """Keep about a share of the points, chosen by a random number per point.

    The random number depends on the tile and the point's position in the canonical order of the tile, so points kept at
    a low density are also kept at higher ones. All tiles are kept, even without points.
    """
    count = np.diff(points.starts)
    place = np.arange(len(points.easting)) - np.repeat(points.starts[:-1], count)
    kept = uniform_by_key(seed, np.repeat(points.col, count), np.repeat(points.row, count), place) < share
    starts = np.concatenate(([0], np.cumsum(kept)))[points.starts]
    return replace(
        points,
        starts=starts,
        easting=points.easting[kept],
        northing=points.northing[kept],
        upward=points.upward[kept],
        flag=points.flag[kept],
    )


@dataclass(slots=True)
class _PairedVerdicts:
    """Results of one rating for classified tiles, with all points and with few."""

    full: list[Verdict]
    few: list[Verdict]


def density_sweep(
    survey: MeasuredSurvey,
    subject: Subject,
    mean_density: float,
    densities: Sequence[float],
    seed: int,
    progress: Progress,
) -> list[DensityRow]:
    """Thin a survey to several densities and rate it again.

    Parameters
    ----------
    survey : MeasuredSurvey
    subject : Subject
    mean_density : float
        Mean over its classified tiles, points per m2.
    densities : sequence of float
        Target densities; those that the survey does not exceed are skipped.
    seed : int
    progress : Progress
    """
    shares = {density: density / mean_density for density in densities if density < mean_density}
    names = [name for name in MAPPED if name in subject.ratings]
    seen = {(name, density): _PairedVerdicts([], []) for density in shares for name in names}
    progress.start("thinning blocks of tiles", survey.blocks if shares else 0)
    for points in survey.points() if shares else ():
        patches = survey.measured(points)
        judged = patches.reason == 0
        full = subject.judge(patches, names)
        for density, share in shares.items():
            few = subject.judge(survey.measured(thin_points(points, share, seed)), names)
            for name in names:
                seen[name, density].full.append(full[name].take(judged))
                seen[name, density].few.append(few[name].take(judged))
        progress.advance(1)
    return [
        _density_row(name, density, shares[density], Verdict.join(both.full), Verdict.join(both.few))
        for (name, density), both in seen.items()
    ]


def _density_row(name: str, density: float, share: float, full: Verdict, few: Verdict) -> DensityRow:
    judged = few.class_id != NO_CLASS
    before, after = full.take(judged), few.take(judged)
    away = np.abs(before.class_id.astype(np.int64) - after.class_id)
    return DensityRow(
        rating=name,
        density=density,
        share_of_points=share,
        tiles=len(judged),
        still_judged=float(judged.mean()),
        same_class=_share(away == 0),
        same_by_class=_share(np.array([np.mean(away[before.class_id == k] == 0) for k in np.unique(before.class_id)])),
        off_two=_share(away > 1),
        c_r_ratio=_median(after.c_r / before.c_r),
        confidence_kept=_median(after.confidence[away == 0]),
        confidence_moved=_median(after.confidence[away > 0]),
    )


def _share(right: NDArray[Any]) -> float:
    return float(right.mean()) if len(right) else float("nan")


def _median(values: NDArray[np.float64]) -> float:
    return float(np.median(values)) if len(values) else float("nan")


Floats = NDArray[np.float64]
_MOST_TILT_DEG = 10.0
_LIFT_M = 1000.0
_EDGE_M = 1e-6
"""Minimum distance of moved points from the edges of their tile, so that they stay in it."""

MOVES = ("turned by 90 degrees", "mirrored", "tilted by up to 10 degrees", "lifted by 1000 m")


@dataclass(frozen=True, slots=True)
class MoveRow:
    """Comparison of one rating before and after a move."""

    rating: str
    move: str
    tiles: int
    """Tiles that are classified and within the vehicle's slope limit, before and after."""
    same_class: float
    """Share of them that keep their class, 0..1; NaN without tiles."""
    c_r_change: float
    """Median of abs(C_r after / C_r before - 1)."""


def invariance(
    blocks: Iterable[TilePoints], measured: Callable[[TilePoints], PatchStack], subject: Subject, seed: int
) -> list[MoveRow]:
    """Move the points of each tile inside it and rate it again.

    Parameters
    ----------
    blocks : iterable of TilePoints
    measured : callable
        Function that measures a block.
    subject : Subject
    seed : int
        Seed of the tilts.
    """
    names = [name for name in MAPPED if name in subject.ratings]
    limit = subject.profile.slope_limit_deg
    found: dict[tuple[str, str], list[tuple[Verdict, Verdict]]] = {(name, move): [] for name in names for move in MOVES}
    for points in blocks:
        patches = measured(points)
        before = subject.judge(patches, names)
        for move in MOVES:
            again = measured(moved_points(points, move, seed))
            after = subject.judge(again, names)
            good = _within(patches, limit) & _within(again, limit)
            for name in names:
                found[name, move].append((before[name].take(good), after[name].take(good)))
    return [_row(name, move, pairs) for (name, move), pairs in found.items()]


def _within(patches: PatchStack, limit: float) -> NDArray[np.bool_]:
    good: NDArray[np.bool_] = (patches.reason == Reason.OK) & (patches.slope <= limit)
    return good


def _row(name: str, move: str, pairs: list[tuple[Verdict, Verdict]]) -> MoveRow:
    before, after = (Verdict.join(side) for side in zip(*pairs, strict=True))
    if not len(before.class_id):
        return MoveRow(name, move, 0, float("nan"), float("nan"))
    change = float(np.median(np.abs(after.c_r / before.c_r - 1)))
    return MoveRow(name, move, len(before.class_id), float(np.mean(before.class_id == after.class_id)), change)


def moved_points(points: TilePoints, move: str, seed: int) -> TilePoints:
    """Move the points of each tile; they stay in it."""
    size = points.grid.tile_size
    count = np.diff(points.starts)
    col, row = np.repeat(points.col, count), np.repeat(points.row, count)
    middle_east, middle_north = (col + 0.5) * size, (row + 0.5) * size
    east, north = points.easting - middle_east, points.northing - middle_north
    upward = points.upward
    if move == "turned by 90 degrees":
        east, north = -north, east
    elif move == "mirrored":
        east = -east
    elif move == "tilted by up to 10 degrees":
        tangent = np.tan(np.radians(_MOST_TILT_DEG * uniform_by_key(seed, col, row)))
        bearing = 2 * np.pi * uniform_by_key(seed + 1, col, row)
        upward = upward + tangent * (east * np.cos(bearing) + north * np.sin(bearing))
    else:
        upward = upward + _LIFT_M
    half = size / 2 - _EDGE_M
    moved = replace(
        points,
        easting=middle_east + np.clip(east, -half, half),
        northing=middle_north + np.clip(north, -half, half),
        upward=upward,
    )
    return next(rebuild_buckets(moved).blocks())


_LEAST_TILES = 256
_REPEATS = 7
PAPER = {
    "heightmap_ms": 12.257,
    "heightmap_kb": 0.084,
    "variance_and_residual_ms": 41.027,
}
"""The paper's Table II, per patch."""


@dataclass(frozen=True, slots=True)
class StepCost:
    """Cost of one step on a batch of tiles."""

    step: str
    tiles: int
    points: int
    processor_ms: float
    """CPU time per tile, median of the repeats."""
    peak_kb: float
    """Peak memory per tile allocated by the step, including its result but not its input."""
    result_kb: float
    """Size of the result per tile."""


def step_costs(survey: MeasuredSurvey, subject: Subject, progress: Progress) -> list[StepCost]:
    """Time the steps on one batch of tiles: the first block with enough of them, or the one with most.

    CPU time is measured rather than wall time, so that other programs on the machine have little influence.
    """
    points = next(survey.points())
    for candidate in survey.points():
        if len(candidate.col) > len(points.col):
            points = candidate
        if len(points.col) >= _LEAST_TILES:
            break
    patches = survey.measured(points)
    textures = classify(patches, subject.textures)
    steps: dict[str, Callable[[], Any]] = {
        "measure": lambda: survey.measured(points),
        "texture": lambda: classify(patches, subject.textures),
    }
    for name in MAPPED:
        if name in subject.ratings:
            rating = subject.ratings[name]
            steps[name] = lambda rating=rating: rating(patches, textures, Georeference(None))  # type: ignore[misc]
    tiles, count = len(points.col), int(patches.count.sum())
    progress.start("timing steps", len(steps))
    timed = counted(steps.items(), progress)
    return [StepCost(name, tiles, count, *_cost(step, patches, tiles)) for name, step in timed]


def _cost(step: Callable[[], Any], patches: PatchStack, tiles: int) -> tuple[float, float, float]:
    """Return milliseconds, peak kB and result kB per tile."""
    result = step()
    spent = []
    for _ in range(_REPEATS):
        begin = time.process_time_ns()
        step()
        spent.append(time.process_time_ns() - begin)
    own = {id(getattr(patches, f.name)) for f in fields(PatchStack)}
    size = sum(_bytes(getattr(result, f.name), own) for f in fields(result))
    return float(np.median(spent)) / 1e6 / tiles, peak_bytes(step) / 1000 / tiles, size / 1000 / tiles


def peak_bytes(step: Callable[[], Any]) -> int:
    """Return the peak memory that Python allocates while a step runs, bytes."""
    tracemalloc.start()
    try:
        step()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def _bytes(value: Any, own: set[int]) -> int:
    """Return the size of an array in bytes; 0 if it is part of the input."""
    return int(value.nbytes) if isinstance(value, np.ndarray) and id(value) not in own else 0
