"""One drive: settle, accelerate, drive straight ahead at the profile's speed; record the pitch rate.

C_r is the integral of abs(omega_y) dt over the drive, divided by the horizontal length of the path (rad/m): the ride
cost of the BumpyPatch paper, here with omega_y in the body frame.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from bumpymap.core import UsageError
from bumpymap.lab.simulate.model import DartVehicle, Physics, Pose, VehicleModel
from bumpymap.lab.simulate.terrain import DrivenGround, Strip
from bumpymap.rating import Vehicle

__all__ = ["Drive", "DriveSettings", "Outcome", "Start", "drive", "drive_from", "follow"]

Outcome = Literal["completed", "stuck", "rolled"]

_YAW_GAIN = 1.0
"""1/s: how fast a wrong heading is steered back."""
_SIDE_GAIN = 0.5
"""1/m: heading that is aimed at per metre beside the line, as a tangent."""
_MOST_STEERING = 0.5
"""Largest speed difference that steering may make, share of the speed."""


@dataclass(frozen=True, slots=True)
class DriveSettings:
    """What all drives of a calibration have in common."""

    physics: Physics = field(default_factory=Physics)
    settle_s: float = 1.0
    """Wheels locked."""
    ramp_s: float = 1.0
    """From rest to full speed, linearly."""
    cruise_s: float = 0.5
    """At full speed before the measurement: the pitch of speeding up dies away."""
    measure_s: float = 10.0
    sample_hz: float = 100.0
    """Rate of the gyroscope and of the steering."""
    stuck_share: float = 0.2
    """A drive that makes less of its way is stuck."""
    rolled_deg: float = 60.0
    """A chassis that leans further has rolled over."""
    margin_m: float = 1.5
    """Ground beside the wheels. A vehicle that has been pushed off its line by more has failed: stuck."""

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
    """Where a drive begins."""

    easting: float
    """m."""
    northing: float
    """m."""
    heading: float
    """Radians from east to north."""


@dataclass(frozen=True, slots=True)
class Drive:
    """What one drive gave."""

    outcome: Outcome
    c_r: float
    """rad/m; NaN unless completed."""
    path_m: float
    """Horizontal length of the path of the chassis while measured."""
    progress_m: float
    """How far it came along its line while measured."""
    seed: int
    """Start and heading were drawn from it."""


def drive(profile: Vehicle, ground: DrivenGround, seed: int, settings: DriveSettings | None = None) -> Drive:
    """Drive over endless ground from a random start at a random heading.

    The same seed gives the same bits in any process.

    Parameters
    ----------
    profile : Vehicle
    ground : DrivenGround
    seed : int
        Start and heading are drawn from it.
    settings : DriveSettings, optional

    Returns
    -------
    Drive
    """
    easting, northing, turn = np.random.default_rng(seed).random(3).tolist()
    start = Start(easting * ground.extent, northing * ground.extent, turn * 2 * math.pi)
    return drive_from(profile, ground, start, seed, settings)


def drive_from(
    profile: Vehicle, ground: DrivenGround, start: Start, seed: int = 0, settings: DriveSettings | None = None
) -> Drive:
    """Drive over endless ground from a chosen start; ``seed`` is only noted in the result."""
    settings = settings or DriveSettings()
    seconds = settings.ramp_s / 2 + settings.cruise_s + settings.measure_s
    strip = Strip(
        easting=start.easting,
        northing=start.northing,
        heading=start.heading,
        length=profile.speed_mps * seconds,
        half_width=profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m,
    )
    return follow(DartVehicle(profile, ground, strip, settings.physics), strip, profile, seed, settings)


def follow(vehicle: VehicleModel, strip: Strip, profile: Vehicle, seed: int, settings: DriveSettings) -> Drive:
    """Drive a vehicle along a strip and sum what its gyroscope reads.

    Parameters
    ----------
    vehicle : VehicleModel
        Stands at the start of the strip.
    strip : Strip
    profile : Vehicle
    seed : int
        Noted in the result.
    settings : DriveSettings
    """
    period = 1 / settings.sample_hz
    quiet = settings.settle_s + settings.ramp_s + settings.cruise_s
    first, last = (round(seconds / period) for seconds in (quiet, quiet + settings.measure_s))
    turned = path = progress = 0.0
    outcome: Outcome = "completed"
    pose = vehicle.pose()
    for sample in range(last):
        _steer(vehicle, pose, strip, profile, _speed_at(sample * period, profile, settings))
        vehicle.advance(settings.steps_per_sample)
        before, pose = pose, vehicle.pose()
        if sample >= first:
            east, north = pose.easting - before.easting, pose.northing - before.northing
            path += math.hypot(east, north)
            progress += east * math.cos(strip.heading) + north * math.sin(strip.heading)
            turned += (abs(before.pitch_rate) + abs(pose.pitch_rate)) / 2 * period
        if pose.tilt > math.radians(settings.rolled_deg):
            outcome = "rolled"
            break
        if abs(_beside(pose, strip)) > settings.margin_m:
            outcome = "stuck"
            break
    if outcome == "completed" and progress < settings.stuck_share * profile.speed_mps * settings.measure_s:
        outcome = "stuck"
    return Drive(outcome, turned / path if outcome == "completed" else math.nan, path, progress, seed)


def _speed_at(seconds: float, profile: Vehicle, settings: DriveSettings) -> float:
    """Speed that is commanded, m/s: rest, a ramp, full speed."""
    if settings.ramp_s == 0:
        return profile.speed_mps if seconds >= settings.settle_s else 0.0
    return profile.speed_mps * min(max((seconds - settings.settle_s) / settings.ramp_s, 0.0), 1.0)


def _steer(vehicle: VehicleModel, pose: Pose, strip: Strip, profile: Vehicle, speed: float) -> None:
    """Hold the line: aim back at it, and turn the wheels of the two sides at different speeds."""
    aim = strip.heading - math.atan(_SIDE_GAIN * _beside(pose, strip))
    wrong = math.remainder(aim - pose.heading, 2 * math.pi)
    difference = _YAW_GAIN * wrong * profile.track_m / 2
    most = _MOST_STEERING * speed
    difference = min(max(difference, -most), most)
    vehicle.command(speed - difference, speed + difference)


def _beside(pose: Pose, strip: Strip) -> float:
    """How far the vehicle is to the left of its line, m."""
    east, north = pose.easting - strip.easting, pose.northing - strip.northing
    return north * math.cos(strip.heading) - east * math.sin(strip.heading)
