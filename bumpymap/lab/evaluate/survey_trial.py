"""Drive over patches of a survey in the simulation, and compare with what a map of it predicts."""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    REASON_TEXT,
    BadInputError,
    Ground,
    PatchStack,
    Progress,
    Reason,
    Steps,
    UsageError,
)
from bumpymap.lab.evaluate.agreement import (
    ClassTable,
    Comparison,
    DriveStats,
    VehicleOrder,
    class_table,
    compare,
    compare_order,
    plain_predictors,
)
from bumpymap.lab.evaluate.rated_survey import MAPPED, MeasuredSurvey, Subject, Verdict, load_survey
from bumpymap.lab.settings import EvaluateSettings
from bumpymap.lab.simulate.drive import PatchDrives, drive_patch
from bumpymap.lab.simulate.jobs import Journal, Key, drive_jobs
from bumpymap.lab.simulate.model import require_dart
from bumpymap.rating import Vehicle
from bumpymap.readers import ReadOptions, SurveyReader, identity
from bumpytiles import Grid

__all__ = ["ComparedPatches", "Findings", "TrialOptions", "evaluate_survey"]


_STEP = np.uint64(0x9E3779B97F4A7C15)
_MIX = (np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB))


def uniform_by_key(seed: int, *keys: NDArray[np.integer]) -> NDArray[np.float64]:
    """Return uniform random numbers in [0, 1) for integer keys (splitmix64).

    Parameters
    ----------
    seed : int
    keys : arrays (n,)
        Components of each key; the same key gives the same number.
    """
    state = np.full(len(keys[0]), seed, np.uint64)
    for key in keys:
        state = _mixed(state + key.astype(np.int64).view(np.uint64) * _STEP + _STEP)
    return (state >> np.uint64(11)).astype(np.float64) / float(1 << 53)


def _mixed(state: NDArray[np.uint64]) -> NDArray[np.uint64]:
    state = (state ^ (state >> np.uint64(30))) * _MIX[0]
    state = (state ^ (state >> np.uint64(27))) * _MIX[1]
    mixed: NDArray[np.uint64] = state ^ (state >> np.uint64(31))
    return mixed


Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

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
    """Choose the same number of patches from each stratum, as far as it has enough.

    Tiles of high priority remain chosen if predictions change a little or more patches are requested, so their drives
    can be reused.

    Parameters
    ----------
    stratum : array (n,)
    priority : array (n,)
        Tiles with lower values are chosen first.
    count : int
        Number of patches; if there are fewer tiles, all are chosen.

    Returns
    -------
    array (m,)
        Rows of the chosen tiles, alternating between the strata.
    """
    order = np.lexsort((priority, stratum))
    first = np.searchsorted(stratum[order], stratum[order], side="left")
    turn = np.arange(len(order)) - first
    return order[np.lexsort((stratum[order], turn))][:count]


@dataclass(frozen=True, slots=True)
class ComparedPatches:
    """The patches behind a comparison."""

    names: list[Key]
    """Tiles ``(col, row)``."""
    driven: DriveStats
    verdicts: dict[str, Verdict]


@dataclass(slots=True)
class Findings:
    """All results of an evaluation."""

    title: str
    facts: dict[str, Any]
    """Description of the survey."""
    vehicles: list[dict[str, Any]]
    """Name, calibration and class limits of each vehicle; the tables are about the first one."""
    settings: dict[str, Any]
    classes: dict[str, ClassTable] = field(default_factory=dict)
    """Rating -> Table I."""
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    """Vehicle -> comparison of predictions with drives."""
    patches: dict[str, ComparedPatches] = field(default_factory=dict)
    """Vehicle -> patches of the comparison."""
    orders: list[VehicleOrder] = field(default_factory=list)


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


def journal_settings(
    profile: Vehicle, settings: EvaluateSettings, tile_size: float, pixels: int, ground: dict[str, Any]
) -> dict[str, Any]:
    """Return everything that affects the drives of a patch, as JSON. The choice and rating of patches do not."""
    return {
        "vehicle": profile.to_dict(),
        "effort": asdict(settings.effort),
        "seed": settings.seed,
        "drive": asdict(settings.drive),
        "tile_size": tile_size,
        "pixels": pixels,
        "ground": ground,
        "versions": {name: version(name) for name in ("dartpy", "numpy")},
    }


@dataclass(frozen=True, slots=True)
class _PatchJob:
    """A patch to drive over; see `Job`."""

    key: Key
    heights: NDArray[np.floating]
    """(pixels, pixels) m, north row first, without NaN."""
    starts: int


def drive_job(profile: Vehicle, tile_size: float, settings: EvaluateSettings, job: _PatchJob) -> PatchDrives:
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


@dataclass(frozen=True, slots=True)
class PatchTrial:
    """Patches that can be classified, and the ground to drive over for each."""

    names: list[Key]
    """Names of n patches, such as ``(col, row)`` of a tile."""
    patches: PatchStack
    ground: NDArray[np.float64]
    """(n, pixels, pixels) m."""
    origin: dict[str, Any]
    """Everything that affects the ground, as JSON."""

    def run(
        self, subjects: Sequence[Subject], settings: EvaluateSettings, trial: TrialOptions, findings: Findings
    ) -> None:
        """Drive all vehicles over all patches and add the comparison to the findings."""
        driven: dict[str, DriveStats] = {}
        verdicts = {}
        plain = plain_predictors(self.patches)
        for subject in subjects:
            label = _label(subject, subjects)
            driven[label] = self._drive(subject, settings, trial)
            verdicts[label] = subject.judge(self.patches)
            too_steep = self.patches.slope > subject.profile.slope_limit_deg
            limits = subject.calibration.class_limits
            findings.comparisons[label] = compare(verdicts[label], plain, driven[label], too_steep, limits)
            findings.patches[label] = ComparedPatches(self.names, driven[label], verdicts[label])
        if len(subjects) > 1:
            ratings = [name for name in MAPPED if all(name in subject.ratings for subject in subjects)]
            for name in ratings:
                findings.orders.append(compare_order(name, {v: own[name] for v, own in verdicts.items()}, driven))

    def _drive(self, subject: Subject, settings: EvaluateSettings, trial: TrialOptions) -> DriveStats:
        size, pixels = self.patches.grid.tile_size, self.patches.grid.pixels
        recorded = journal_settings(subject.profile, settings, size, pixels, self.origin)
        trial.progress.start(f"driving {subject.name} over patches", len(self.names))
        require_dart()
        results = drive_jobs(
            partial(drive_job, subject.profile, size, settings),
            [
                _PatchJob(name, heights, settings.min_starts)
                for name, heights in zip(self.names, self.ground, strict=True)
            ],
            Steps(trial.progress, settings.min_starts),
            workers=trial.workers,
            journal=Journal(trial.out / f"drives-{subject.key}.jsonl", recorded),
            discard_other=trial.overwrite,
        )
        return DriveStats.of(list(results.values()))


def _label(subject: Subject, subjects: Sequence[Subject]) -> str:
    """Return the name of the vehicle, with the calibration if two subjects share the name."""
    alike = sum(other.name == subject.name for other in subjects)
    return subject.name if alike == 1 else f"{subject.name} {subject.calibration.id}"


_KEPT = ("col", "row", "count", "z_variance", "ransac_residual")


@dataclass(frozen=True, slots=True)
class _Tiles:
    """The classified tiles of a survey, (n,) each."""

    col: NDArray[np.int64]
    row: NDArray[np.int64]
    count: NDArray[np.int64]
    z_variance: NDArray[np.float64]
    ransac_residual: NDArray[np.float64]
    verdicts: dict[str, Verdict]
    unknown: dict[str, int]
    """Reason why tiles with points cannot be classified -> number of tiles."""


def evaluate_survey(
    readers: Sequence[SurveyReader],
    options: ReadOptions,
    ground: Ground,
    subjects: Sequence[Subject],
    settings: EvaluateSettings,
    trial: TrialOptions,
) -> Findings:
    """Evaluate maps of a survey.

    Parameters
    ----------
    readers : sequence of SurveyReader
        The survey files.
    options : ReadOptions
        Options with which they were opened.
    ground : Ground
        Which points are used as ground.
    subjects : sequence of Subject
        Vehicles; the choice of patches and the tables are based on the first one.
    settings : EvaluateSettings
    trial : TrialOptions

    Raises
    ------
    BadInputError
        A file is damaged, or no tile can be classified.
    """
    subject, grid = subjects[0], _grid(subjects)
    with load_survey(readers, ground, grid, settings.features, trial.out, trial.progress) as survey:
        tiles = _rate(survey, subject, trial)
        density = float(tiles.count.mean() / grid.tile_size**2)
        findings = _findings("survey", subjects, settings, _facts(readers, survey, tiles, density))
        for name in MAPPED:
            if name in tiles.verdicts:
                findings.classes[name] = class_table(tiles.verdicts[name], tiles.z_variance, tiles.ransac_residual)
        origin = _origin(readers, options, survey, settings)
        _trial(survey, tiles, subject, settings, origin).run(subjects, settings, trial, findings)
    return findings


def _grid(subjects: Sequence[Subject]) -> Grid:
    """Return the common tile grid of all calibrations."""
    grids = {(subject.calibration.tile_size, subject.calibration.pixels) for subject in subjects}
    if len(grids) > 1:
        listed = ", ".join(f"{size:g} m with {pixels} pixels" for size, pixels in sorted(grids))
        raise UsageError(f"the calibrations are for different tiles: {listed}. Compare vehicles on tiles of one size")
    return Grid(*grids.pop())


def _findings(title: str, subjects: Sequence[Subject], settings: EvaluateSettings, facts: dict[str, Any]) -> Findings:
    vehicles = [
        {
            "vehicle": subject.name,
            "calibration": subject.calibration.id,
            "class_limits": subject.calibration.class_limits,
            "slope_limit_deg": subject.profile.slope_limit_deg,
            "ratings": list(subject.ratings),
        }
        for subject in subjects
    ]
    return Findings(title, facts, vehicles, asdict(settings))


def _rate(survey: MeasuredSurvey, subject: Subject, trial: TrialOptions) -> _Tiles:
    """Rate all tiles; keep only a few values of each."""
    trial.progress.start("rating blocks of tiles", survey.blocks)
    columns: dict[str, list[NDArray[Any]]] = {name: [] for name in _KEPT}
    verdicts: list[dict[str, Verdict]] = []
    reasons = np.zeros(len(Reason), np.int64)
    for points in survey.points():
        patches = survey.measured(points)
        judged = patches.reason == Reason.OK
        reasons += np.bincount(patches.reason, minlength=len(Reason))
        verdicts.append({name: own.take(judged) for name, own in subject.judge(patches, MAPPED).items()})
        for name, parts in columns.items():
            parts.append(getattr(patches, name)[judged])
        trial.progress.advance(1)
    joined = {name: np.concatenate(parts) for name, parts in columns.items()}
    unknown = {REASON_TEXT[reason]: int(reasons[reason]) for reason in Reason if reason and reasons[reason]}
    if not len(joined["col"]):
        listed = ", ".join(f"{name}: {count}" for name, count in unknown.items())
        raise BadInputError(
            f"no tile of the survey can be classified ({listed}), so there is nothing to evaluate"
            + (". Only points of class 2 were measured; try `ground='all'`" if survey.ground_only else "")
        )
    return _Tiles(
        **joined,
        verdicts={name: Verdict.join([part[name] for part in verdicts]) for name in verdicts[0]},
        unknown=unknown,
    )


def _facts(readers: Sequence[SurveyReader], survey: MeasuredSurvey, tiles: _Tiles, density: float) -> dict[str, Any]:
    return {
        "files": [str(reader.info.path).replace("\\", "/").rpartition("/")[2] for reader in readers],
        "points": sum(reader.info.point_count for reader in readers),
        "ground_only": survey.ground_only,
        "judged_tiles": len(tiles.col),
        "unknown_tiles": tiles.unknown,
        "density": density,
    }


def _origin(
    readers: Sequence[SurveyReader], options: ReadOptions, survey: MeasuredSurvey, settings: EvaluateSettings
) -> dict[str, Any]:
    """Return everything that affects the heights of a survey's tiles; copies of a file are equivalent."""
    found = [identity(reader.info.path) for reader in readers]
    return {
        "files": sorted([str(file["size"]), file["digest"]] for file in found),
        "options": {"crs": options.force_crs or options.crs, "z_unit": options.z_unit},
        "ground_only": survey.ground_only,
        "features": asdict(settings.features),
    }


def _trial(
    survey: MeasuredSurvey, tiles: _Tiles, subject: Subject, settings: EvaluateSettings, origin: dict[str, Any]
) -> PatchTrial:
    """Choose patches over the whole range of roughness."""
    verdict = tiles.verdicts[subject.main]
    priority = uniform_by_key(settings.seed, tiles.col, tiles.row)
    rows = choose_patches(strata(verdict.c_r, verdict.p_fail), priority, settings.total_patches)
    col, row = tiles.col[rows], tiles.row[rows]
    patches = survey.patches(col, row)
    names: list[Key] = [(int(c), int(r)) for c, r in zip(col, row, strict=True)]
    return PatchTrial(names, patches, driven_ground(patches), origin)
