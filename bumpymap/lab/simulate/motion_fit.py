"""Drive at several speeds and fit what that teaches: C_r at other speeds, and weighted acceleration.

Every start over the terrain library is driven at every speed, so that what a terrain does at one place does not blur
what the speed does. The pitch rate is that of an on-board gyroscope, sampled as for C_r. The vertical
velocity of the chassis' centre of mass is recorded at every time step; its weighted acceleration is computed in the
frequency domain from the start of the vehicle on, so that the filter has settled before the measurement begins.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats
from bumpymap.lab.settings import CalibrationSettings, DriveSettings, Physics
from bumpymap.lab.simulate.drive import Start, draw_start, drive_strip, follow, library_terrain, six_digits
from bumpymap.lab.simulate.jobs import DriveJob, Key
from bumpymap.lab.simulate.model import DartVehicle, DrivenGround, PatchGround, Strip, relief_and_slope
from bumpymap.lab.terrains import KINDS
from bumpymap.rating import (
    QUANTITIES,
    MotionFit,
    MotionModel,
    MotionOperator,
    RideOperator,
    Vehicle,
    felt_response,
    motion_terms,
    move_over,
    plain_terms,
    roll_over,
)

_SETTLE_S = 0.02
"""End of the record that the cut-off of the velocity changes."""


class _RecordedVehicle(DartVehicle):
    """A vehicle that notes its motion while it is driven."""

    def __init__(self, profile: Vehicle, ground: DrivenGround, strip: Strip, physics: Physics) -> None:
        super().__init__(profile, ground, strip, physics)
        self.upward: list[float] = []
        """Vertical velocity, m/s, one for each time step."""

    def advance(self, steps: int) -> None:
        """Simulate and record time steps."""
        for _ in range(steps):
            super().advance(1)
            self.upward.append(float(self.chassis.getCOMLinearVelocity()[2]))


def drive_motion(
    profile: Vehicle, ground: DrivenGround, start: Start, speed: float, settings: DriveSettings
) -> tuple[float, float]:
    """Drive from a given start at a given speed and measure ``QUANTITIES``; NaN unless completed.

    The integral of the absolute pitch rate over the way, rad/m, and the root mean square of the weighted vertical
    acceleration, m/s2.

    ``speed``: m/s, in the place of the profile's; the measured way is as long as at that, ``measure_s`` of the
    settings.
    """
    settings = replace(settings, measure_s=settings.measure_s * profile.speed_mps / speed)
    own = replace(profile, speed_mps=speed)
    strip = drive_strip(own, start, settings)
    vehicle = _RecordedVehicle(own, ground, strip, settings.physics)
    made = follow(vehicle, strip, own, settings)
    if made.outcome != "completed":
        return math.nan, math.nan
    before = round((settings.settle_s + settings.ramp_s + settings.cruise_s) * settings.sample_hz)
    step = settings.physics.time_step
    quiet = round(settings.settle_s / step)
    felt = weighted_acceleration(np.array(vehicle.upward[quiet:]), step)
    measured = felt[before * settings.steps_per_sample - quiet : -round(_SETTLE_S / step)]
    return made.c_r, float(np.sqrt(np.mean(measured**2)))


def weighted_acceleration(velocity: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return the weighted acceleration (n,) [m/s2] of a vertical velocity (n,) [m/s] every ``step`` s from rest on."""
    long = 2 * len(velocity)
    frequency = np.fft.rfftfreq(long, step)
    to_velocity: NDArray[Any] = 2j * np.pi * np.maximum(frequency, frequency[1] / 2)  # 0 Hz weighs nothing
    spectrum = np.fft.rfft(velocity, long) * felt_response(frequency) / to_velocity
    return np.asarray(np.fft.irfft(spectrum, long)[: len(velocity)])


_STREAM = 102
"""Number of the random stream of these drives."""


SPEED_RATIOS = (0.5, 1.0, 2.0)
"""Speeds of each start over the profile's."""


@dataclass(frozen=True, slots=True)
class MotionRecord:
    """Drives over one terrain: ``[start][speed]``; None unless completed."""

    c_r: tuple[tuple[float | None, ...], ...]
    """rad/m."""
    a_w: tuple[tuple[float | None, ...], ...]
    """m/s2."""

    @classmethod
    def of(cls, drives: list[list[tuple[float, float]]]) -> "MotionRecord":
        """Collect drives, ``[start][speed]``."""
        return cls(*(tuple(tuple(six_digits(made[k]) for made in row) for row in drives) for k in range(2)))

    @classmethod
    def read(cls, fields: dict[str, Any]) -> "MotionRecord":
        """Read the fields of a journal."""
        return cls(*(tuple(tuple(row) for row in fields[name]) for name in cls.__slots__))


def motion_jobs(settings: CalibrationSettings) -> list[DriveJob]:
    """Return all jobs: a quarter of the library, index by index, so that a part of them has all kinds."""
    drives, terrains = settings.motion_starts * len(SPEED_RATIOS), max(2, settings.terrains // 4)
    return [DriveJob(("motion", kind, index), drives) for index in range(terrains) for kind in KINDS]


def run_motion(settings: CalibrationSettings, job: DriveJob) -> MotionRecord:
    """Drive over a terrain; every start has its own random stream, derived from the seed and the job."""
    profile, kind, index = settings.profile, str(job.key[1]), int(job.key[2])
    ground = PatchGround.from_heights(library_terrain(settings, kind, index).heights, settings.tile_size)
    made = []
    for number in range(settings.motion_starts):
        stream = (_STREAM, KINDS.index(kind), index, number)
        rng = np.random.default_rng(np.random.SeedSequence(settings.seed, spawn_key=stream))
        start = draw_start(ground, rng)
        speeds = [ratio * profile.speed_mps for ratio in SPEED_RATIOS]
        made.append([drive_motion(profile, ground, start, speed, DriveSettings()) for speed in speeds])
    return MotionRecord.of(made)


SPEED_RANGE = (0.4, 2.5)
"""Speeds that may be asked for, as shares of the profile's: a quarter beyond those that are driven."""
_LEAST_C_R = 0.002
"""Below this, the simulation's contacts are felt as much as the ground, rad/m."""


def fit_motion(settings: CalibrationSettings, driven: Mapping[Key, Any]) -> MotionModel:
    """Fit the model to the drives of `motion_jobs` (key of a job -> its record)."""
    records = [driven[job.key] for job in motion_jobs(settings)]
    means = np.array([[getattr(record, name) for name in QUANTITIES] for record in records], np.float64).mean(axis=2)
    # As they are recorded, so that a later fit to the record gives the same bits.
    recorded = [[list(map(six_digits, row)) for row in one] for one in means.swapaxes(1, 2).tolist()]
    return fit_means(settings, np.array(recorded, np.float64), settings.motion_starts)


def fit_means(settings: CalibrationSettings, means: Floats, starts: int) -> MotionModel:
    """Fit the model to drives over the library; terrains where a drive failed are left out.

    ``means`` (terrains, speeds, 2 or 3): over the starts of each of ``QUANTITIES``, in the order of `motion_jobs`; NaN
    where a drive failed; a number between the two, of older calibrations, does not count. ``starts``: drives over
    each at each speed, for the record.
    """
    own = SPEED_RATIOS.index(1.0)
    c_r = means[:, own, 0]
    used = np.isfinite(means).all(axis=(1, 2)) & (c_r > _LEAST_C_R)
    places = [divmod(number, len(KINDS)) for number in np.flatnonzero(used).tolist()]
    tiles = [library_terrain(settings, KINDS[kind], index).heights for index, kind in places]
    vehicle = settings.profile
    relief, _ = relief_and_slope(tiles, settings.tile_size)
    speeds = tuple(ratio * vehicle.speed_mps for ratio in SPEED_RATIOS)
    motions = move_over(relief, MotionOperator.of(vehicle, settings.tile_size, settings.pixels, speeds))
    pitch = roll_over(relief, RideOperator.of(vehicle, settings.tile_size, settings.pixels)).pitch_change
    log_speed, c_r = np.log(np.array(SPEED_RATIOS)), c_r[used]
    ranges = [(float(f"{np.log(each).min():.6g}"), float(f"{np.log(each).max():.6g}")) for each in (pitch, c_r)]
    terms, plain = motion_terms(motions, pitch, log_speed, ranges[0]), plain_terms(c_r, log_speed, ranges[1])
    wanted = np.log(means[used][..., [0, -1]] / c_r[:, None, None])
    fits = {
        name: _fit(terms[name], plain[name], wanted[..., number], own if name == "c_r" else None)
        for number, name in enumerate(QUANTITIES)
    }
    origin = {
        "terrains": len(means),
        "used": int(used.sum()),
        "starts": starts,
        "ratios": list(SPEED_RATIOS),
        "seed": settings.seed,
        "driven": [[list(map(six_digits, row)) for row in terrain] for terrain in means.tolist()],
    }
    return MotionModel(SPEED_RANGE, ranges[0], ranges[1], fits["c_r"], fits["a_w"], origin)


def _fit(terms: Floats, plain: Floats, wanted: Floats, anchor: int | None) -> MotionFit:
    """Fit both sets of terms to logarithms (n, speeds); the speed ``anchor`` has no error and says nothing of it."""
    free = np.arange(wanted.shape[1]) != anchor
    values = wanted[:, free].ravel()
    coefficients: list[tuple[float, ...]] = []
    spread: list[float] = []
    for columns in (terms, plain):
        flat = columns[:, free].reshape(-1, columns.shape[-1])
        rounded = tuple(float(f"{value:.6g}") for value in np.linalg.lstsq(flat, values, rcond=None)[0])
        left = values - flat @ np.array(rounded)
        coefficients.append(rounded)
        spread.append(float(f"{np.sqrt((left**2).sum() / max(len(values) - len(rounded), 1)):.4g}"))
    return MotionFit(coefficients[0], coefficients[1], spread[0], spread[1])
