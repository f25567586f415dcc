"""Evaluate ratings on a survey or on unseen terrain of the library."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import REASON_TEXT, BadInputError, Ground, Reason, UsageError, counted
from bumpymap.lab.evaluate.classes import class_table
from bumpymap.lab.evaluate.compare import by_kind
from bumpymap.lab.evaluate.density import density_sweep
from bumpymap.lab.evaluate.drives import driven_ground
from bumpymap.lab.evaluate.findings import Findings
from bumpymap.lab.evaluate.invariance import invariance
from bumpymap.lab.evaluate.keyed_random import uniform_by_key
from bumpymap.lab.evaluate.library import library_terrains, measure_all, require_unseen
from bumpymap.lab.evaluate.noise import noise_sweep
from bumpymap.lab.evaluate.settings import EvaluateSettings
from bumpymap.lab.evaluate.strata import choose_patches, strata
from bumpymap.lab.evaluate.subject import MAPPED, Subject, Verdict
from bumpymap.lab.evaluate.survey import MeasuredSurvey, load_survey, take_tiles
from bumpymap.lab.evaluate.timing import step_costs
from bumpymap.lab.evaluate.trial import PatchTrial, TrialOptions
from bumpymap.lab.simulate import Key, survey_terrains
from bumpymap.lab.worlds import KINDS, ScanEffects, Terrain
from bumpymap.patches import measure
from bumpymap.readers import ReadOptions, SurveyReader, identity
from bumpytiles import Grid

__all__ = ["evaluate_library", "evaluate_survey"]

_CLEAN = ScanEffects(density=1000.0)
"""Survey settings for predictions on the library."""
_MOVED = ScanEffects(density=100.0, noise_m=0.02)
"""Survey settings for the tiles that are rotated, mirrored, tilted and lifted."""


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
        if "drives" not in settings.skip:
            origin = _origin(readers, options, survey, settings)
            _trial(survey, tiles, subject, settings, origin).run(subjects, settings, trial, findings)
        if "density" not in settings.skip:
            findings.densities = density_sweep(
                survey, subject, density, settings.densities, settings.seed, trial.progress
            )
        if "invariance" not in settings.skip:
            trial.progress.start("moving blocks of tiles", survey.blocks)
            findings.moves = invariance(
                counted(survey.points(), trial.progress), survey.measured, subject, settings.seed
            )
        if "timing" not in settings.skip:
            findings.timing = step_costs(survey, subject, trial.progress)
    return findings


def evaluate_library(subjects: Sequence[Subject], settings: EvaluateSettings, trial: TrialOptions) -> Findings:
    """Evaluate ratings on terrain of the library that their calibrations were not made with."""
    subject = subjects[0]
    _grid(subjects)
    each = -(-settings.total_patches // len(KINDS))
    for one in subjects:
        require_unseen(one.calibration, settings.seed)
    terrains = library_terrains(subject.calibration, subject.profile, settings.seed, each)
    facts = {"terrains": len(terrains), "kinds": list(KINDS), "seed": settings.seed}
    findings = _findings("library", subjects, settings, facts)
    driven_c_r = None
    if "drives" not in settings.skip:
        _library_trial(terrains, each, subject, settings).run(subjects, settings, trial, findings)
        driven = next(iter(findings.patches.values()))
        kinds = [str(name[0]) for name in driven.names]
        findings.kinds = by_kind(kinds, driven.verdicts[subject.main], driven.driven)
        driven_c_r = np.where(driven.driven.comparable, driven.driven.c_r, np.nan)
    if "noise" not in settings.skip and subject.ride is not None:
        findings.noise = noise_sweep(
            terrains, subject, subject.ride, driven_c_r, settings.features, settings.seed, trial.progress
        )
    if "invariance" not in settings.skip:
        ground = survey_terrains(terrains, _MOVED, settings.seed)
        trial.progress.start("moving blocks of tiles", len(ground.keys()))
        blocks = counted(ground.blocks(), trial.progress)
        findings.moves = invariance(
            blocks, lambda points: measure(points, settings.features, ground_only=False), subject, settings.seed
        )
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


def _library_trial(terrains: Sequence[Terrain], each: int, subject: Subject, settings: EvaluateSettings) -> PatchTrial:
    """Drive over the terrain itself; predict from a dense survey of it without noise."""
    patches = measure_all(survey_terrains(terrains, _CLEAN, settings.seed), settings.features)
    rows = patches.col[patches.reason == Reason.OK]
    names: list[Key] = [(terrains[i].kind, int(i) % each) for i in rows]
    ground = np.stack([terrains[i].heights for i in rows])
    limit = subject.profile.slope_limit_deg
    origin = {"library": settings.seed, "wheel_radius_m": subject.profile.wheel.radius_m, "slope_limit_deg": limit}
    return PatchTrial(names, take_tiles(patches, patches.reason == Reason.OK), ground, origin)
