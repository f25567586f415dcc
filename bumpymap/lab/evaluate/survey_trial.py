"""The map under evaluation, measured block by block and rated; drives over some of its patches; their comparison."""

import hashlib
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    REASON_TEXT,
    BadInputError,
    CostMap,
    FeatureSettings,
    Georeference,
    Ground,
    PatchStack,
    Progress,
    Reason,
    Steps,
    TextureMap,
    UsageError,
    common_georeference,
    decide_ground,
)
from bumpymap.lab.evaluate.agreement import (
    Comparison,
    DriveStats,
    Verdict,
    class_table,
    compare,
    plain_predictors,
)
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import PatchDrives, drive_patch
from bumpymap.lab.simulate.jobs import DriveJob, Journal, Key, drive_jobs
from bumpymap.lab.simulate.model import require_dart
from bumpymap.patches import decks_as_ground, join_stacks, measure
from bumpymap.rating import Calibration, RideModel, TextureModel, Vehicle, classify, rate
from bumpymap.readers import Location, PointStats, ReadOptions, SurveyReader, find_surveys, identity, open_survey
from bumpytiles import BLOCK_TILES, Grid, TileBuckets, TilePoints

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Rate = Callable[[PatchStack, TextureMap, Georeference], CostMap]
_PLACELESS = Georeference(None)


@dataclass(frozen=True)
class Subject:
    """A calibrated vehicle and its ratings."""

    calibration: Calibration
    profile: Vehicle
    ratings: Mapping[str, Rate]
    """Name -> rating: ``ride``, ``table``. Patches are chosen by the first."""
    textures: TextureModel

    @classmethod
    def of(cls, calibration: Calibration, textures: TextureModel) -> "Subject":
        """Make the ratings of a calibration.

        Raises
        ------
        UsageError
            The texture network is for other tiles.
        """
        textures.require_grid(calibration.tile_size, calibration.pixels)
        calibration = calibration.without_floor()  # it is held against simulated drives, which have none
        profile = Vehicle.from_dict(calibration.vehicle, f"calibration {calibration.id}")

        def by_table(patches: PatchStack, seen: TextureMap, place: Georeference) -> CostMap:
            return rate(patches, seen, calibration, place)

        return cls(calibration, profile, {"ride": RideModel(calibration).rate, "table": by_table}, textures)

    @property
    def name(self) -> str:
        """Name of the vehicle."""
        return str(self.calibration.vehicle["name"])

    @property
    def key(self) -> str:
        """Name of the vehicle and eight digits of the hash of its profile, which determines its drives."""
        text = json.dumps(self.calibration.vehicle, sort_keys=True)
        return f"{self.name}-{hashlib.sha256(text.encode()).hexdigest()[:8]}"

    def judge(self, patches: PatchStack) -> dict[str, Verdict]:
        """Rate tiles with all ratings."""
        seen = classify(patches, self.textures)
        return {name: Verdict.of(rating(patches, seen, _PLACELESS)) for name, rating in self.ratings.items()}


def open_readers(surveys: Sequence[Location], options: ReadOptions, *, local: bool) -> list[SurveyReader]:
    """Open survey files and check that they share one CRS.

    Raises
    ------
    BadInputError
        A file cannot be read, files have different CRS, or there is no CRS and ``local`` is False.
    """
    readers = [open_survey(path, options) for path in find_surveys(surveys)]
    if common_georeference([reader.info for reader in readers]).crs is None and not local:
        raise BadInputError(
            f"{readers[0].info.path} has no CRS, so the unit of its coordinates is unknown. Pass `crs='EPSG:CODE'`, "
            "or `local=True` if they are metres"
        )
    return readers


@dataclass(frozen=True, slots=True)
class MeasuredSurvey:
    """All points of a survey, by block."""

    buckets: TileBuckets
    ground_only: bool
    """True if only ground points are measured."""
    features: FeatureSettings

    def measured(self, parts: Iterable[TilePoints]) -> Iterator[PatchStack]:
        """Measure the tiles of blocks; a dense block comes in several parts."""
        for points in parts:
            yield measure(decks_as_ground(points), self.features, ground_only=self.ground_only)

    def patches(self, col: Ints, row: Ints) -> PatchStack:
        """Measure the given tiles (at least one, all with points), in the given order."""
        wanted = {tile: i for i, tile in enumerate(zip(col.tolist(), row.tolist(), strict=True))}
        stacks = []
        for key in sorted({(row // BLOCK_TILES, col // BLOCK_TILES) for col, row in wanted}):
            for stack in self.measured(self.buckets.block(key)):
                tiles = zip(stack.col.tolist(), stack.row.tolist(), strict=True)
                stacks.append(take_tiles(stack, np.array([tile in wanted for tile in tiles])))
        joined = join_stacks(stacks)
        place = {tile: i for i, tile in enumerate(zip(joined.col.tolist(), joined.row.tolist(), strict=True))}
        return take_tiles(joined, np.array([place[tile] for tile in wanted]))


def take_tiles(patches: PatchStack, rows: NDArray[np.integer] | NDArray[np.bool_]) -> PatchStack:
    """Select tiles of a stack."""
    return PatchStack(patches.grid, *(getattr(patches, f.name)[rows] for f in fields(PatchStack) if f.name != "grid"))


def load_survey(
    readers: Sequence[SurveyReader], ground: Ground, grid: Grid, features: FeatureSettings, progress: Progress
) -> MeasuredSurvey:
    """Read surveys into memory, 14 to 26 bytes a point.

    Raises
    ------
    BadInputError
        A file is damaged, or no point is left.
    UsageError
        The ground is that of a cloth.
    """
    if ground == "csf":
        raise UsageError("`ground='csf'` is supported by map only. Use `ground='all'` or `ground='class'` here")
    buckets = TileBuckets(grid)
    progress.start("reading points", sum(reader.info.point_count for reader in readers))
    for reader in readers:
        stats = PointStats()
        for chunk in reader.chunks():
            batch = reader.convert(chunk, reader.fetch(chunk))
            stats = stats.merge(batch.stats)
            buckets.add_chunk(batch.grouped(grid))
            progress.advance(chunk.points)
        reader.verify(stats)
    if not len(buckets):
        raise BadInputError("no point is left: every point is withheld, noise or without return")
    # For a single tile, the share of ground points replaces the count of tiles with ground points.
    ground_only = decide_ground(ground, 1, 0.0 if ground == "all" else buckets.flagged_share())
    return MeasuredSurvey(buckets, ground_only, features)


_KEPT = ("col", "row", "count", "z_variance", "ransac_residual")
"""Columns of all tiles that are kept while a survey is rated."""
_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


def uniform_by_key(seed: int, *keys: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return uniform random numbers in [0, 1) for integer keys, (n,) each (splitmix64): a key keeps its number."""
    state = np.full(len(keys[0]), seed, np.uint64)
    for key in keys:
        state = state + key.astype(np.int64).view(np.uint64) * _STEP + _STEP
        state = (state ^ (state >> np.uint64(30))) * _MIX[0]
        state = (state ^ (state >> np.uint64(27))) * _MIX[1]
        state = state ^ (state >> np.uint64(31))
    return (state >> np.uint64(11)).astype(np.float64) / float(1 << 53)


BINS = 10
_QUANTILES = (0.02, 0.98)
FAILING = 0.5
"""Ground with at least this p_fail is a separate stratum."""


def strata(c_r: Floats, p_fail: Floats) -> Ints:
    """Return the stratum of each tile: bins of equal ratio in C_r, and a last one for ground with expected failures.

    Parameters
    ----------
    c_r, p_fail : array (n,)
        Predicted; not NaN. The bins span the 2 % to the 98 % quantile of the ground that can be crossed; values
        beyond belong to the first and the last bin.
    """
    fails = p_fail >= FAILING
    fine = c_r[~fails] if not fails.all() else c_r
    low, high = np.quantile(np.log(fine), _QUANTILES)
    place = np.floor(BINS * (np.log(c_r) - low) / max(high - low, 1e-9))
    return np.where(fails, BINS, np.clip(place, 0, BINS - 1)).astype(np.int64)


def choose_patches(stratum: Ints, priority: Floats, count: int) -> Ints:
    """Choose ``count`` tiles, the same number from each stratum as far as it has enough; all if there are fewer.

    Of a stratum those of the lowest ``priority`` (n,) come first: they remain chosen if predictions change a little or
    more patches are requested, so their drives can be reused. Returns rows (m,), alternating between the strata.
    """
    order = np.lexsort((priority, stratum))
    first = np.searchsorted(stratum[order], stratum[order], side="left")
    turn = np.arange(len(order)) - first
    return order[np.lexsort((stratum[order], turn))][:count]


@dataclass(frozen=True, slots=True)
class Findings:
    """All results of an evaluation."""

    title: str
    facts: dict[str, Any]
    """Description of the survey."""
    vehicle: dict[str, Any]
    """Its name, calibration and class limits."""
    settings: dict[str, Any]
    classes: dict[str, dict[str, Any]]
    """Rating -> Table I, see `class_table`."""
    comparison: Comparison
    """Predictions and drives."""
    patches: dict[str, Any]
    """Patches of the comparison: their ``names``, tiles ``(col, row)``, their `DriveStats` as ``driven``, and their
    ``verdicts`` by rating."""


def driven_ground(patches: PatchStack) -> Floats:
    """Return the ground to drive over: the relief of each patch, holes filled, on its plane; (n, pixels, pixels), m.

    The plane is the difference between the heights and the relief; its mean height is irrelevant and left out.
    """
    px = patches.grid.pixels
    axis = np.arange(px) - (px - 1) / 2
    east, south = np.meshgrid(axis, axis)
    terms = np.stack([np.ones(px * px), east.ravel(), south.ravel()], axis=1)
    ground = np.empty(patches.relief_map.shape)
    for tile, (relief, heights) in enumerate(zip(patches.relief_map, patches.heights, strict=True)):
        plane = (heights.astype(np.float64) - relief).ravel()
        known = np.isfinite(plane)
        (_, to_east, to_south), *_ = np.linalg.lstsq(terms[known], plane[known], rcond=None)
        ground[tile] = relief + to_east * east + to_south * south
    return ground


@dataclass(frozen=True, slots=True)
class PatchJob(DriveJob):
    """Drives over one patch of the survey."""

    heights: NDArray[np.floating]
    """(pixels, pixels) m, north row first, without NaN."""


def drive_job(profile: Vehicle, tile_size: float, settings: EvaluateSettings, job: PatchJob) -> PatchDrives:
    """Drive over one patch until its mean C_r reaches the target error; its starts depend on seed and key alone."""
    # A hash of the key: the numbers of a random stream are neither text nor negative.
    digest = hashlib.sha256(json.dumps(job.key).encode()).digest()
    stream = tuple(int.from_bytes(digest[at : at + 4], "little") for at in (0, 4, 8))
    return drive_patch(profile, job.heights, tile_size, settings.seed, settings.effort, settings.drive, stream=stream)


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """How the drives are run and where they are recorded."""

    out: Path
    """Folder of the report; journals of the drives are written to it and kept."""
    workers: int
    overwrite: bool
    """Discard a journal written with other settings."""
    progress: Progress


def evaluate_survey(
    readers: Sequence[SurveyReader],
    options: ReadOptions,
    ground: Ground,
    subject: Subject,
    settings: EvaluateSettings,
    trial: TrialOptions,
) -> Findings:
    """Evaluate a map of a survey.

    Parameters
    ----------
    readers : sequence of SurveyReader
        The survey files.
    options : ReadOptions
        Options with which they were opened.
    ground : Ground
        Which points are used as ground.
    subject : Subject
        The vehicle.
    settings : EvaluateSettings
    trial : TrialOptions

    Raises
    ------
    BadInputError
        A file is damaged, or no tile can be classified.
    """
    grid = Grid(subject.calibration.tile_size, subject.calibration.pixels)
    survey = load_survey(readers, ground, grid, settings.features, trial.progress)
    tiles, rated, unknown = _rate(survey, subject, trial.progress)
    classes = {name: class_table(own, tiles["z_variance"], tiles["ransac_residual"]) for name, own in rated.items()}
    main = rated[next(iter(rated))]
    priority = uniform_by_key(settings.seed, tiles["col"], tiles["row"])
    rows = choose_patches(strata(main.c_r, main.p_fail), priority, settings.total_patches)
    patches = survey.patches(tiles["col"][rows], tiles["row"][rows])
    facts = {
        "files": [str(reader.info.path).replace("\\", "/").rpartition("/")[2] for reader in readers],
        "points": sum(reader.info.point_count for reader in readers),
        "ground_only": survey.ground_only,
        "judged_tiles": len(tiles["col"]),
        "unknown_tiles": unknown,
        "density": float(tiles["count"].mean() / grid.tile_size**2),
    }
    origin = {
        "files": sorted([str(file["size"]), file["digest"]] for file in (identity(r.info.path) for r in readers)),
        "options": {"crs": options.force_crs or options.crs, "xy_unit": options.xy_unit, "z_unit": options.z_unit},
        "ground_only": survey.ground_only,
        "features": asdict(settings.features),
    }
    vehicle = {
        "vehicle": subject.name,
        "calibration": subject.calibration.id,
        "class_limits": subject.calibration.class_limits,
        "slope_limit_deg": subject.profile.slope_limit_deg,
        "ratings": list(subject.ratings),
    }
    comparison = _compare_drives(patches, subject, settings, trial, origin)
    return Findings("survey", facts, vehicle, asdict(settings), classes, *comparison)


def _rate(
    survey: MeasuredSurvey, subject: Subject, progress: Progress
) -> tuple[dict[str, NDArray[Any]], dict[str, Verdict], dict[str, int]]:
    """Rate all tiles.

    Returns a few columns of the tiles that can be classified (n,), their verdicts by rating, and the number of the
    other tiles by reason.
    """
    progress.start("rating blocks of tiles", len(survey.buckets))
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in _KEPT}
    verdicts: list[dict[str, Verdict]] = []
    reasons = np.zeros(len(Reason), np.int64)
    for patches in survey.measured(survey.buckets.blocks()):
        judged = patches.reason == Reason.OK
        reasons += np.bincount(patches.reason, minlength=len(Reason))
        verdicts.append({name: own.take(judged) for name, own in subject.judge(patches).items()})
        for name, parts in columns.items():
            parts.append(getattr(patches, name)[judged])
        progress.advance(1)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    unknown = {REASON_TEXT[reason]: int(reasons[reason]) for reason in Reason if reason and reasons[reason]}
    if not len(joined["col"]):
        listed = ", ".join(f"{name}: {count}" for name, count in unknown.items())
        raise BadInputError(
            f"no tile of the survey can be classified ({listed}), so there is nothing to evaluate"
            + (". Only ground points were measured; try `ground='all'`" if survey.ground_only else "")
        )
    return joined, {name: Verdict.join([part[name] for part in verdicts]) for name in verdicts[0]}, unknown


def _compare_drives(
    patches: PatchStack, subject: Subject, settings: EvaluateSettings, trial: TrialOptions, origin: dict[str, Any]
) -> tuple[Comparison, dict[str, Any]]:
    """Drive the vehicle over all patches and compare.

    ``origin`` is everything that affects the ground, as JSON. Choice and rating of patches do not affect their drives,
    so the journal does not hold them.
    """
    keys: list[Key] = list(zip(patches.col.tolist(), patches.row.tolist(), strict=True))
    jobs = [
        PatchJob(key, settings.min_starts, heights) for key, heights in zip(keys, driven_ground(patches), strict=True)
    ]
    recorded = {
        "vehicle": subject.profile.to_dict(),
        "effort": asdict(settings.effort),
        "seed": settings.seed,
        "drive": asdict(settings.drive),
        "tile_size": patches.grid.tile_size,
        "pixels": patches.grid.pixels,
        "ground": origin,
        "versions": {library: version(library) for library in ("dartpy", "numpy")},
    }
    trial.progress.start(f"driving {subject.name} over patches", len(keys))
    require_dart()
    results = drive_jobs(
        partial(drive_job, subject.profile, patches.grid.tile_size, settings),
        jobs,
        Steps(trial.progress, settings.min_starts),
        workers=trial.workers,
        journal=Journal(trial.out / f"drives-{subject.key}.jsonl", recorded, PatchDrives.read),
        discard_other=trial.overwrite,
    )
    driven, verdicts = DriveStats.of(list(results.values())), subject.judge(patches)
    too_steep = patches.slope > subject.profile.slope_limit_deg
    found = compare(verdicts, plain_predictors(patches), driven, too_steep, subject.calibration.class_limits)
    return found, {"names": keys, "driven": driven, "verdicts": verdicts}
