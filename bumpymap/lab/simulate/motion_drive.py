"""Drive with a recorder of pitch, roll and vertical motion: what a ride feels like, at any speed.

The rates of pitch and roll are those of an on-board gyroscope, sampled as for C_r. The vertical velocity of the
chassis' centre of mass is recorded at every time step; its weighted acceleration is computed in the frequency domain
from the start of the vehicle on, so that the filter has settled before the measurement begins.
"""

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings, Outcome, Start, follow
from bumpymap.lab.simulate.model import DartVehicle, Pose
from bumpymap.lab.simulate.terrain import DrivenGround, Strip
from bumpymap.rating import Vehicle, felt_response

__all__ = ["MotionDrive", "drive_motion"]

_SETTLE_S = 0.02
"""End of the record that the cut-off of the velocity changes."""


@dataclass(frozen=True, slots=True)
class MotionDrive:
    """What one drive felt; NaN unless completed."""

    outcome: Outcome
    c_r: float
    """Integral of the absolute pitch rate over the way, rad/m."""
    c_roll: float
    """The same of the roll rate, rad/m."""
    a_w: float
    """Root mean square of the weighted vertical acceleration, m/s2."""


@dataclass(slots=True)
class _Recorder:
    """A vehicle that notes its motion while it is driven."""

    vehicle: DartVehicle
    roll_rate: list[float] = field(default_factory=list)
    """rad/s, one for each call of `advance`."""
    upward: list[float] = field(default_factory=list)
    """Vertical velocity, m/s, one for each time step."""

    def command(self, left_mps: float, right_mps: float) -> None:
        """Set the speed of the tyres on either side."""
        self.vehicle.command(left_mps, right_mps)

    def advance(self, steps: int) -> None:
        """Simulate and record time steps."""
        for _ in range(steps):
            self.vehicle.advance(1)
            self.upward.append(float(self.vehicle.chassis.getCOMLinearVelocity()[2]))
        self.roll_rate.append(float(self.vehicle.chassis.getSpatialVelocity()[0]))

    def pose(self) -> Pose:
        """Return the present state of the chassis."""
        return self.vehicle.pose()


def drive_motion(
    profile: Vehicle, ground: DrivenGround, start: Start, speed: float, settings: DriveSettings | None = None
) -> MotionDrive:
    """Drive from a given start at a given speed and measure pitch, roll and weighted vertical acceleration.

    Parameters
    ----------
    profile : Vehicle
    ground : DrivenGround
    start : Start
    speed : float
        m/s, in the place of the profile's. The measured way is as long as at the profile's speed.
    settings : DriveSettings, optional
        ``measure_s`` is the time of the measured way at the profile's speed.
    """
    settings = settings or DriveSettings()
    settings = replace(settings, measure_s=settings.measure_s * profile.speed_mps / speed)
    own = replace(profile, speed_mps=speed)
    strip = Strip(
        easting=start.easting,
        northing=start.northing,
        heading=start.heading,
        length=speed * (settings.ramp_s / 2 + settings.cruise_s + settings.measure_s),
        half_width=own.wheelbase_m / 2 + own.track_m / 2 + own.wheel.radius_m + settings.margin_m,
    )
    recorder = _Recorder(DartVehicle(own, ground, strip, settings.physics))
    made = follow(recorder, strip, own, 0, settings)
    if made.outcome != "completed":
        return MotionDrive(made.outcome, math.nan, math.nan, math.nan)
    return MotionDrive("completed", made.c_r, _rolled(recorder, settings) / made.path_m, _weighted(recorder, settings))


def _rolled(recorder: _Recorder, settings: DriveSettings) -> float:
    """Return the integral of the absolute roll rate over the measured time, rad."""
    rates = np.abs(recorder.roll_rate[_samples(settings) - 1 :])
    return float((rates[1:] + rates[:-1]).sum() / 2 / settings.sample_hz)


def _weighted(recorder: _Recorder, settings: DriveSettings) -> float:
    """Return the root mean square of the weighted acceleration over the measured time, m/s2."""
    step = settings.physics.time_step
    quiet = round(settings.settle_s / step)
    first = _samples(settings) * settings.steps_per_sample - quiet
    felt = weighted_acceleration(np.array(recorder.upward[quiet:]), step)
    return float(np.sqrt(np.mean(felt[first : -round(_SETTLE_S / step)] ** 2)))


def weighted_acceleration(velocity: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return the weighted acceleration (n,) [m/s2] of a vertical velocity (n,) [m/s] every ``step`` s from rest on."""
    long = 2 * len(velocity)
    frequency = np.fft.rfftfreq(long, step)
    to_velocity: NDArray[Any] = 2j * np.pi * np.maximum(frequency, frequency[1] / 2)  # 0 Hz weighs nothing
    spectrum = np.fft.rfft(velocity, long) * felt_response(frequency) / to_velocity
    return np.asarray(np.fft.irfft(spectrum, long)[: len(velocity)])


def _samples(settings: DriveSettings) -> int:
    """Return the number of samples before the measurement."""
    return round((settings.settle_s + settings.ramp_s + settings.cruise_s) * settings.sample_hz)
