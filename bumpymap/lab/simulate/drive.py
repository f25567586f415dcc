"""Simulate one drive: settle, accelerate, drive straight ahead at the profile's speed and record the pitch rate.

C_r is the integral of abs(omega_y) dt over the drive, divided by the horizontal length of the path (rad/m): the ride
cost of the BumpyPatch paper, here with omega_y in the body frame.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.simulate.model import DartVehicle, DrivenGround, PatchGround, Physics, Pose, Strip, VehicleModel
from bumpymap.rating import Vehicle

Outcome = Literal["completed", "stuck", "rolled"]

_YAW_GAIN = 1.0
"""Yaw rate per heading error, 1/s."""
_SIDE_GAIN = 0.5
"""Tangent of the commanded heading correction per metre of lateral offset, 1/m."""
_MAX_STEERING = 0.5
"""Largest speed difference that steering may command, as a share of the speed."""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """Settings shared by all drives of a calibration."""

    physics: Physics = field(default_factory=Physics)
    settle_s: float = 1.0
    """Time with wheels locked at the start."""
    ramp_s: float = 1.0
    """Time of linear acceleration from rest to full speed."""
    cruise_s: float = 0.5
    """Time at full speed before the measurement, for the pitch from the acceleration to decay."""
    measure_s: float = 10.0
    sample_hz: float = 100.0
    """Sampling rate of the gyroscope and of the steering."""
    stuck_share: float = 0.2
    """A drive that covers less than this share of its distance counts as stuck."""
    rolled_deg: float = 60.0
    """A chassis that tilts further counts as rolled over."""
    margin_m: float = 1.5
    """Width of ground beyond the wheels. A vehicle pushed further than this off its line counts as stuck."""

    def __post_init__(self) -> None:
        ratio = 1 / (self.sample_hz * self.physics.time_step)
        if round(ratio) < 1 or not math.isclose(ratio, round(ratio), rel_tol=1e-9):
            raise UsageError(
                f"a time step of {self.physics.time_step} s does not divide the {1 / self.sample_hz} s between "
                "samples; choose 0.01, 0.005, 0.002, 0.001 or 0.0005 s"
            )

    @property
    def steps_per_sample(self) -> int:
        """Time steps between two samples."""
        return round(1 / (self.sample_hz * self.physics.time_step))


@dataclass(frozen=True, slots=True)
class Start:
    """Start position and heading of a drive."""

    easting: float
    """m."""
    northing: float
    """m."""
    heading: float
    """Radians from east to north."""


@dataclass(frozen=True, slots=True)
class Drive:
    """Result of one drive."""

    outcome: Outcome
    c_r: float
    """rad/m; NaN unless completed."""
    path_m: float
    """Horizontal length of the chassis' path during the measurement."""


def drive(profile: Vehicle, ground: DrivenGround, seed: int, settings: DriveSettings) -> Drive:
    """Drive over unbounded ground from a start and at a heading that are drawn from a seed.

    The same seed gives the same bits in any process.
    """
    return drive_from(profile, ground, draw_start(ground, np.random.default_rng(seed)), settings)


def draw_start(ground: DrivenGround, rng: np.random.Generator) -> Start:
    """Draw a start within the extent of the ground, at any heading."""
    easting, northing, turn = rng.random(3).tolist()
    return Start(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi)


def drive_from(profile: Vehicle, ground: DrivenGround, start: Start, settings: DriveSettings) -> Drive:
    """Drive over unbounded ground from a given start."""
    strip = drive_strip(profile, start, settings)
    return follow(DartVehicle(profile, ground, strip, settings.physics), strip, profile, settings)


def drive_strip(profile: Vehicle, start: Start, settings: DriveSettings) -> Strip:
    """Return the ground that a drive needs."""
    return Strip(
        easting=start.easting,
        northing=start.northing,
        heading=start.heading,
        length=profile.speed_mps * (settings.ramp_s / 2 + settings.cruise_s + settings.measure_s),
        half_width=profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m,
    )


def follow(vehicle: VehicleModel, strip: Strip, profile: Vehicle, settings: DriveSettings) -> Drive:
    """Drive a vehicle, placed at the start of a strip, along it and integrate its gyroscope readings."""
    period = 1 / settings.sample_hz
    quiet = settings.settle_s + settings.ramp_s + settings.cruise_s
    first, last = (round(seconds / period) for seconds in (quiet, quiet + settings.measure_s))
    pitched = path = progress = 0.0
    outcome: Outcome = "completed"
    pose = vehicle.pose()
    for sample in range(last):
        since = sample * period - settings.settle_s  # at rest before, then a ramp to full speed
        share = min(max(since / settings.ramp_s, 0.0), 1.0) if settings.ramp_s else float(since >= 0.0)
        _steer(vehicle, pose, strip, profile, profile.speed_mps * share)
        vehicle.advance(settings.steps_per_sample)
        before, pose = pose, vehicle.pose()
        if sample >= first:
            east, north = pose.easting - before.easting, pose.northing - before.northing
            path += math.hypot(east, north)
            progress += east * math.cos(strip.heading) + north * math.sin(strip.heading)
            pitched += (abs(before.pitch_rate) + abs(pose.pitch_rate)) / 2 * period
        if pose.tilt > math.radians(settings.rolled_deg):
            outcome = "rolled"
            break
        if abs(_lateral_offset(pose, strip)) > settings.margin_m:
            outcome = "stuck"
            break
    if outcome == "completed" and progress < settings.stuck_share * profile.speed_mps * settings.measure_s:
        outcome = "stuck"
    return Drive(outcome, pitched / path if outcome == "completed" else math.nan, path)


def _steer(vehicle: VehicleModel, pose: Pose, strip: Strip, profile: Vehicle, speed: float) -> None:
    """Steer towards the line by setting different speeds for the wheels of the two sides."""
    aim = strip.heading - math.atan(_SIDE_GAIN * _lateral_offset(pose, strip))
    heading_error = math.remainder(aim - pose.heading, 2 * math.pi)
    difference = _YAW_GAIN * heading_error * profile.track_m / 2
    most = _MAX_STEERING * speed
    difference = min(max(difference, -most), most)
    vehicle.command(speed - difference, speed + difference)


def _lateral_offset(pose: Pose, strip: Strip) -> float:
    """Return the distance of the vehicle to the left of its line, m."""
    east, north = pose.easting - strip.easting, pose.northing - strip.northing
    return north * math.cos(strip.heading) - east * math.sin(strip.heading)


@dataclass(frozen=True, slots=True)
class Effort:
    """Bounds on the number of drives per patch."""

    least: int = 16
    most: int = 64
    target_error: float = 0.05
    """Drives stop once the standard error of the mean C_r is below this share of it."""


@dataclass(frozen=True, slots=True)
class PatchDrives:
    """Results of the drives over one patch, in the order of the starts."""

    outcome: tuple[Outcome, ...]
    c_r: tuple[float | None, ...]
    """rad/m; None unless completed."""

    @classmethod
    def read(cls, own: dict[str, Any]) -> "PatchDrives":
        """Read the fields of a journal."""
        return cls(tuple(own["outcome"]), tuple(own["c_r"]))

    @property
    def completed(self) -> list[float]:
        """C_r of the completed drives, rad/m."""
        return [value for value in self.c_r if value is not None]

    @property
    def mean_c_r(self) -> float | None:
        """Mean C_r of the completed drives, rad/m; None if there are none."""
        completed = self.completed
        return math.fsum(completed) / len(completed) if completed else None

    @property
    def standard_error(self) -> float | None:
        """Standard error of the mean, rad/m; None with fewer than two completed drives."""
        completed = self.completed
        if len(completed) < 2:
            return None
        return float(np.std(completed, ddof=1)) / math.sqrt(len(completed))

    @property
    def failed(self) -> int:
        """Number of drives that rolled over or got stuck."""
        return sum(outcome != "completed" for outcome in self.outcome)


def drive_patch(
    profile: Vehicle,
    heights: NDArray[np.floating],
    tile_size: float,
    seed: int,
    effort: Effort,
    settings: DriveSettings,
    *,
    stream: tuple[int, ...] = (),
) -> PatchDrives:
    """Drive over one patch (pixels, pixels) [m], north row first, without NaN, from random starts at random headings.

    Every start has its own random stream, so more drives never change earlier ones; ``stream`` distinguishes patches
    that share a seed. The result depends on the arguments only and is the same in any process. If none of the first
    ``least`` drives is completed, no further drives are made: there is no C_r to refine.
    """
    ground = PatchGround.from_heights(heights.astype(np.float64), tile_size)
    drives = PatchDrives((), ())
    while len(drives.outcome) < effort.most:
        mean, error = drives.mean_c_r, drives.standard_error
        known = mean is None or (error is not None and error <= effort.target_error * mean)
        if len(drives.outcome) >= effort.least and known:
            break
        own = np.random.SeedSequence(seed, spawn_key=(*stream, len(drives.outcome)))
        made = drive(profile, ground, int(own.generate_state(1, np.uint64)[0]), settings)
        c_r = made.c_r if made.outcome == "completed" else None
        drives = PatchDrives((*drives.outcome, made.outcome), (*drives.c_r, c_r))
    return drives
