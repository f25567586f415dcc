"""Fit what needs no drives again, and write it into calibrations: ``python -m bumpymap.lab.simulate.refit FILE...``.

The files are the shipped calibrations if none is named. The terrain library follows from the seed in the file, and the
file holds its drives: ride model, classes, model of thin surveys and that of other speeds are fitted to them, and tiles
with steps are rated anew. Tables stay.

*Crossings* lead once over one vertical wall between two levels, up or down, at an angle: the probability of failing
there. *Tiles* have a step across them, well inside, and are rated by the ride model of the calibration, which was
fitted to drives over such and other ground: their C_r and p_fail. A tile is bilinear between its pixels, which makes a
wall a ramp of 0.2 m; a crossing is not, so it shows which kerbs a wheel does not climb.

The heights are multiples of the wheel radius. Results depend only on the calibration and the seed.

*Classes*: their limits are the natural breaks (one-dimensional k-means, four groups, solved exactly) of the C_r of
terrains. They minimise the squared error of replacing C_r by a value per class; as the planner's cost is linear in C_r,
they also minimise the error of a planner that knows only the class. Terrains on which half of the drives fail are left
out: they are class 3 whatever their C_r, in a map too. The C_r is that of the ride model, on libraries that are the
same for every calibration; the roughest twentieth counts as its least, and the limits are the mean of the breaks of
each library. A few terrains that the vehicle just crosses have a C_r that would move the breaks of one library, driven
as it is, by 8 to 15 % (standard deviation), by which of them a seed draws.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASS_NAMES, FAIL_SHARE, BumpymapError, Floats, UsageError, atomic
from bumpymap.lab.settings import CalibrationSettings
from bumpymap.lab.simulate.drive import (
    Drive,
    PatchDrives,
    Start,
    calibrated_settings,
    drive_from,
    library_terrain,
    library_terrains,
    six_digits,
)
from bumpymap.lab.simulate.jobs import DriveJob, Key
from bumpymap.lab.simulate.model import relief_and_slope, require_scikit_learn
from bumpymap.lab.simulate.motion_fit import fit_means
from bumpymap.lab.simulate.ride_fit import MANY_POINTS, fit_ride, fit_thin_surveys
from bumpymap.lab.terrains import KINDS
from bumpymap.rating import Calibration, Correction, DrivenTerrain, RideModel, RideOperator, Vehicle, roll_over

_HEIGHTS = (0.02, 0.05, 0.08, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.7, 1.0)
"""Heights of crossings, m, for wheels of ``_WHEEL_M``; for other radii they are scaled."""
_TILE_HEIGHTS = (*_HEIGHTS, 1.4, 2.0)
"""Heights of the steps of tiles."""
_WHEEL_M = 0.3
"""Radius."""
_TILE_TURNS_DEG = (0.0, 15.0, 30.0, 45.0)
"""Directions of the steps of tiles."""
_TILE_OFFSETS = (-0.1, 0.0, 0.1)
"""Distances of the steps from the middle, in sides of the tile."""
_FAIL_QUANTILE = 0.8
"""p_fail of a tile is this quantile over places and directions: rather too careful than not enough."""
_ANGLES_DEG = (0.0, 20.0, 40.0)
"""Between the way and the normal of the wall. At a larger one, a small vehicle slides along the wall and gets as far as
if it had crossed it."""
_STREAM = 101
"""Number of the random stream of these drives; no texture and no kind of terrain has this index."""
_SUPERSAMPLE = 8
"""Samples along a side of a pixel, whose mean is its height."""


@dataclass(frozen=True, slots=True)
class WallGround:
    """Two levels with a wall along the line easting = 0: the eastern level is higher by ``rise``."""

    rise: float
    """m; negative if the eastern level is lower."""
    spacing: float
    """The wall is a ramp of this width, m."""
    extent: float = 1.0
    gradient: tuple[float, float] = (0.0, 0.0)

    def height(self, easting: NDArray[np.float64], northing: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of points, m."""
        share = np.clip(easting / self.spacing, 0.0, 1.0)
        return np.broadcast_to(self.rise * share, np.broadcast_shapes(easting.shape, northing.shape)).copy()


def crossing_jobs(profile: Vehicle) -> list[DriveJob]:
    """Return all crossings of a vehicle: of one wall at one angle in one direction each."""
    return [
        DriveJob(("crossing", repr(height), angle, int(up)), 1)
        for height in _heights(profile, _HEIGHTS)
        for angle in range(len(_ANGLES_DEG))
        for up in (True, False)
    ]


def run_crossing(settings: CalibrationSettings, job: DriveJob) -> PatchDrives:
    """Drive once over a wall; the start has its own random stream, derived from the seed and the job."""
    height, angle, up = float(job.key[1]), int(job.key[2]), int(job.key[3])
    stream = (_STREAM, _heights(settings.profile, _HEIGHTS).index(height), angle, up)
    rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
    ground = WallGround(height if up else -height, settings.profile.wheel.radius_m / 6)
    return PatchDrives.of([cross(settings, ground, math.radians(_ANGLES_DEG[angle]), rng.random(2))])


def fit_steps(calibration: Calibration, driven: Mapping[Key, Any]) -> dict[str, Any]:
    """Return the ``steps`` of a calibration with a ride model, as plain JSON: rated tiles, and shares of crossings.

    Shares have a row for each height and a column for each angle. ``driven`` holds the drives of `crossing_jobs`.
    """
    settings = calibrated_settings(calibration)
    heights = _heights(settings.profile, _HEIGHTS)
    up, down = (
        [
            [driven["crossing", repr(height), angle, way].failed for angle in range(len(_ANGLES_DEG))]
            for height in heights
        ]
        for way in (1, 0)
    )
    crossing = {"height": list(heights), "angle_deg": list(_ANGLES_DEG), "fail_up": up, "fail_down": down}
    return {"tile": _rated_tiles(calibration, settings), "crossing": crossing, "seed": settings.seed}


def _rated_tiles(calibration: Calibration, settings: CalibrationSettings) -> dict[str, list[float]]:
    """Return C_r [rad/m], the deviation of its logarithm, and p_fail of tiles with steps, as plain JSON."""
    model = RideModel(calibration)
    heights = _heights(settings.profile, _TILE_HEIGHTS)
    places = [(turn, offset) for turn in _TILE_TURNS_DEG for offset in _TILE_OFFSETS]
    unit = np.stack([step_tile(turn, offset, calibration.pixels) for turn, offset in places])
    rows = []
    none = np.zeros(len(unit))
    for height in heights:
        relief, slope = relief_and_slope(list(height * unit), calibration.tile_size)
        found = model.correction.predict(roll_over(relief, model.operator), slope, none, none + 10.0)
        logs = found.log_c_r
        rows.append(
            (float(np.exp(logs).mean()), float(np.std(logs, ddof=1)), float(np.quantile(found.p_fail, _FAIL_QUANTILE)))
        )
    c_r, sd, p_fail = ([float(f"{value:.6g}") for value in column] for column in zip(*rows, strict=True))
    return {"height": list(heights), "c_r": c_r, "c_r_log_sd": sd, "p_fail": p_fail}


def step_tile(turn_deg: float, offset: float, pixels: int) -> NDArray[np.float64]:
    """Return a tile (pixels, pixels) with a step of height 1; a pixel that it crosses has the mean of both levels."""
    fine = pixels * _SUPERSAMPLE
    axis = (np.arange(fine) + 0.5) / fine - 0.5
    turn = math.radians(turn_deg)
    beyond = axis[None, :] * math.cos(turn) - axis[:, None] * math.sin(turn) > offset
    shape = (pixels, _SUPERSAMPLE, pixels, _SUPERSAMPLE)
    return np.asarray(beyond.reshape(shape).mean(axis=(1, 3)), np.float64)


def _heights(profile: Vehicle, heights: tuple[float, ...]) -> tuple[float, ...]:
    scale = profile.wheel.radius_m / _WHEEL_M
    return tuple(float(f"{height * scale:.3g}") for height in heights)


def cross(settings: CalibrationSettings, ground: WallGround, angle: float, shift: NDArray[np.float64]) -> Drive:
    """Drive once over a wall, at an ``angle`` [rad] between the way and its normal.

    The measured way begins with the nose in front of the wall. A vehicle whose rear wheels have not passed it at the
    end is stuck. ``shift`` (2,), 0 to 1, moves the start along the way and along the wall.
    """
    profile, drive = settings.profile, settings.drive
    before, along = shift.tolist()
    # Along the way, from the first part of the vehicle that meets the wall to the last that leaves it.
    half = profile.length_m / 2 + profile.width_m / 2 * math.tan(angle)
    spare = profile.length_m / math.cos(angle)
    total = 2 * half + 2 * spare
    quiet = profile.speed_mps * (drive.ramp_s / 2 + drive.cruise_s)
    back = quiet + half + spare * (0.25 + 0.25 * before)
    start = Start(-back * math.cos(angle), along * ground.spacing - back * math.sin(angle), angle)
    passed = (2 * half + spare * 0.75) / total
    return drive_from(profile, ground, start, replace(drive, measure_s=total / profile.speed_mps, stuck_share=passed))


def fit_models(
    settings: CalibrationSettings, driven: Sequence[DrivenTerrain], like: Calibration | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Fit ride, classes and thin surveys to the drives over the library; ``like``: see `fit_classes`.

    Returns fields of a calibration, and entries of its ``settings``.
    """
    terrains = [library_terrain(settings, terrain.kind, terrain.index) for terrain in driven]
    ride, parts = fit_ride(settings.profile, terrains, driven)
    models, said = fit_classes(settings, ride, parts, like)
    record = ride.to_record()
    return models | {"ride": record, "thin": fit_thin_surveys(settings.profile, terrains, record)}, said


def refit(calibration: Calibration, like: Calibration | None = None) -> Calibration:
    """Return a calibration with newly fitted models of the ride, its classes, thin surveys and other speeds.

    ``like``: a calibration of the vehicle for tiles of another size, whose class limits are taken. Raises UsageError if
    the calibration holds no drives over the terrain library, or was moved to real drives, which a fit would forget; or
    if scikit-learn is not installed.
    """
    require_scikit_learn()
    moved = calibration.settings.get("moved_to_drives")
    if moved is not None:
        raise UsageError(
            f"the calibration {calibration.id} was moved to real drives, and a new fit to the simulated ones would "
            f"discard that. Fit the calibration {moved['calibration_id']}, which it was before, and move that again "
            "with: bumpymap check --refit"
        )
    if "library" not in calibration.settings:
        raise UsageError(
            f"the calibration {calibration.id} holds no drives over the terrain library. Make one with: "
            "bumpymap calibrate"
        )
    settings = calibrated_settings(calibration)
    rule = calibration.settings["class_rule"]
    if kept := like is None and rule.startswith(LIMITS_OF):  # that calibration is not given
        like = calibration
    models, said = fit_models(settings, library_terrains(calibration), like)
    said |= {"class_rule": rule} if kept else {}
    made = replace(calibration, settings=calibration.settings | said, **models)
    if made.steps:  # its crossings stay
        made = replace(made, steps=made.steps | {"tile": _rated_tiles(made, settings)})
    if made.motion:
        origin = made.motion["origin"]
        means = np.array(origin["driven"], np.float64)
        made = replace(made, motion=fit_means(settings, means, origin["starts"]).to_record())
    return made


_LIBRARIES, _TERRAINS = 25, 24
"""Libraries, with the seeds from 1, and terrains of each kind in one. Chosen: it takes 45 s; the standard deviation of
the breaks of one library, 8 to 11 %, becomes about 2 %."""
_ROUGHEST = 0.05
"""Share of the terrains whose C_r counts as the least among them. Chosen: by halves of the drives (12 times) the
standard error of the limits is 1.9 to 2.4 % of the Warthog and 3.7 % at most of the others; 4 to 10 % without it; with
a tenth 3.3 % at most, and the limits of the Warthog fall by another sixth."""
_LEAST_STEP = 0.001
"""Width of a class, rad/m. Chosen: classes closer together say nothing about the ground."""
_RULE = (
    f"natural breaks (exact one-dimensional k-means, 4 groups), mean of {_LIBRARIES} libraries of {_TERRAINS} terrains "
    f"of each kind, of the C_r that the ride model predicts where its p_fail is under {FAIL_SHARE:g}; the roughest "
    f"{100 * _ROUGHEST:g} % count as the least of them; heights uniform in their logarithm, half of the slopes up to 8 "
    "degrees and half up to 1.2 times the vehicle's limit; limits rounded to three digits"
)
LIMITS_OF = "those of the calibration "
"""How the rule of limits begins that are taken from a calibration for tiles of another size."""


def fit_classes(
    settings: CalibrationSettings, ride: Correction, parts: Sequence[Correction], like: Calibration | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return limits and mean C_r of the classes, as fields of a calibration, and entries of its ``settings``.

    ``parts``: ride models without a share of the drives each, see `fit_ride`; from their spread come the relative
    standard errors (jackknife) of the limits and of C_r, its median over the terrains. ``like``: a calibration for
    tiles of another size, whose limits are taken.

    Raises BumpymapError if the vehicle can cross too few terrains, or hardly pitches on any.
    """
    libraries = _LIBRARIES if like is None else 1
    tiles = [
        library_terrain(replace(settings, seed=1 + library), kind, index).heights
        for library in range(libraries)
        for kind in KINDS
        for index in range(_TERRAINS)
    ]
    relief, slope = relief_and_slope(tiles, settings.tile_size)
    rides = roll_over(relief, RideOperator.of(settings.profile, settings.tile_size, settings.pixels))
    none = np.zeros(len(slope))

    def predicted(model: Correction) -> tuple[Floats, Floats]:
        found = model.predict(rides, slope, none, none + MANY_POINTS)
        return np.exp(found.log_c_r).reshape(libraries, -1), found.p_fail.reshape(libraries, -1)

    c_r, p_fail = predicted(ride)
    limits = class_limits(c_r, p_fail) if like is None else like.class_limits
    crossed = c_r[p_fail < FAIL_SHARE]
    class_id = np.searchsorted(limits, crossed, side="right")
    others = [predicted(part) for part in parts]
    errors: dict[str, Any] = {"c_r": _rounded(np.median(_jackknife(np.log([each for each, _ in others]))))}
    if like is None:
        errors |= {"class_limits": [_rounded(x) for x in _jackknife([class_limits(*each) for each in others]) / limits]}
    means = tuple(six_digits(crossed[class_id == k].mean()) for k in range(len(CLASS_NAMES)))
    rule = _RULE if like is None else f"{LIMITS_OF}{like.id}, for tiles of {like.tile_size:g} m"
    return {"class_limits": limits, "class_c_r": means}, {"class_rule": rule, "relative_standard_errors": errors}


def _rounded(value: float) -> float:
    return float(f"{value:.3g}")


def _jackknife(values: Any) -> Floats:
    """Return the standard error of an estimate, (...), from its values (parts, ...) without a part of the data each."""
    values = np.asarray(values)
    return np.asarray(np.sqrt((len(values) - 1) * values.var(axis=0)))


def class_limits(c_r: Floats, p_fail: Floats) -> tuple[float, float, float]:
    """Return the three C_r limits between the classes, rad/m, from C_r [rad/m] and p_fail of terrains: (libraries, n).

    Raises BumpymapError if the vehicle can cross too few of a library, or hardly pitches on any.
    """
    crossed = [own[fails < FAIL_SHARE] for own, fails in zip(c_r, p_fail, strict=True)]
    fewest = min(crossed, key=len)
    if len(np.unique(fewest)) < len(CLASS_NAMES):
        raise BumpymapError(
            f"the vehicle crosses {len(fewest)} of {c_r.shape[1]} terrains of a library; classes need at least "
            f"{len(CLASS_NAMES)} with different C_r. Check its profile for a wrong number, such as a moment of inertia "
            "or a damping coefficient, or drive more terrains"
        )
    capped = (np.minimum(own, np.quantile(own, 1 - _ROUGHEST, method="lower")) for own in crossed)
    breaks = np.mean([natural_breaks(own, len(CLASS_NAMES)) for own in capped], axis=0)
    low, middle, high = (_rounded(limit) for limit in breaks)
    if min(low, middle - low, high - middle) < _LEAST_STEP:
        raise BumpymapError(
            f"the class limits are {low}, {middle}, {high} rad/m, too close together for four classes; "
            "the vehicle hardly pitches on this ground"
        )
    return low, middle, high


def natural_breaks(values: NDArray[np.float64], groups: int) -> list[float]:
    """Return the limits of the split of numbers into groups with the least sum of squared deviations from group means.

    They lie halfway between the means of neighbouring groups. Fisher's dynamic programming: the best split of the first
    i sorted numbers into k groups extends the best split of the first j into k - 1. It is exact and needs no random
    start. scikit-learn's KMeans with ten starts misses the best split of 33 in 200 drawn sets, and that of the car's
    driven terrains: 0.019, 0.040, 0.065 instead of 0.018, 0.040, 0.064.
    """
    values = np.sort(values)
    x, n = values - values.mean(), len(values)
    total, square = (np.concatenate(([0.0], np.cumsum(each))) for each in (x, x**2))
    first, end = np.arange(n + 1)[:, None], np.arange(n + 1)
    spread = square - square[:, None] - (total - total[:, None]) ** 2 / np.maximum(end - first, 1)
    spread = np.where(first < end, np.maximum(spread, 0.0), np.inf)  # of one group, from first to end
    best, cuts = spread[0], []
    for _ in range(groups - 1):
        each = best[:, None] + spread
        best = each.min(axis=0)
        cuts.append(each.argmin(axis=0))
    edges = [n]
    for cut in reversed(cuts):
        edges.append(int(cut[edges[-1]]))
    edges.append(0)
    centre = [float(values[a:b].mean()) for a, b in pairwise(edges[::-1])]
    return [(a + b) / 2 for a, b in pairwise(centre)]


def _refit_files(names: Sequence[str]) -> None:
    """Fit the named calibrations again, in place; the shipped ones if none is named."""
    shipped = Path(str(files("bumpymap.rating") / "data" / "calibrations"))
    paths = [Path(name) for name in names] or sorted(shipped.rglob("*.json"), key=lambda own: len(own.parts))
    for path in paths:
        of_other_tiles = path.resolve().parent.parent == shipped  # 5m/NAME.json has the class limits of NAME.json
        like = Calibration.load(shipped / path.name) if of_other_tiles else None
        text = refit(Calibration.load(path), like).to_json()
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    try:
        _refit_files(sys.argv[1:])
    except BumpymapError as error:
        sys.exit(f"Error: {error}")
