"""Sensors with the faults of real ones: figures of data sheets, and vibration measured on a real vehicle.

*Cheap* is the InvenSense MPU-6050 (product specification 3.4): low-frequency noise of the rates 0.033 deg/s from 1 to
10 Hz, 131 LSB per deg/s; acceleration 400 ug/sqrt(Hz), 16384 LSB per g, zero offset 50 mg; sensitivity within 3 %, of
which a third is taken as the standard deviation. *Good* is the Analog Devices ADIS16470 (data sheet, revision C): rates
0.008 deg/s/sqrt(Hz), 8 deg/h in-run stability; acceleration 13 ug in-run stability. Biases at switch-on are those that
remain after a user's calibration of the cheap sensor, and the factory's of the good one.

Vibration is that of a Husky A200 on firm ground in BorealTC (LaRocque et al. 2024, CC0): 15 to 50 Hz while it drives. With
its motors on at standstill it reads a mean absolute pitch rate of 0.004 to 0.02 rad/s below 10 Hz; here it is 0.006.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from bumpymap.lab.worlds.drives.motion import GRAVITY

__all__ = ["GNSS", "IMUS", "ClockFault", "DriveSensors", "GnssGrade", "ImuGrade", "SensorGrade", "Vibration"]

_DEG = float(np.radians(1.0))
_Axes = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class SensorGrade:
    """Faults of a sensor with three axes; its unit u is rad/s or m/s2."""

    noise: float
    """Density of the white noise, u/sqrt(Hz)."""
    bias: float
    """Standard deviation of the constant bias, u."""
    wander: float
    """Standard deviation of the slow change of the bias, u."""
    step: float
    """Step of the digital output, u."""
    scale: float
    """Standard deviation of the error of the sensitivity, a share."""
    cross: float
    """Standard deviation of the share of each other axis that is read."""


@dataclass(frozen=True, slots=True)
class ImuGrade:
    """An inertial sensor."""

    rate: SensorGrade
    acceleration: SensorGrade
    sample_hz: float
    """Samples in a second."""
    cutoff_hz: float | None
    """Of the low-pass filter before sampling; None: there is none, and vibration folds down."""
    jitter_s: float
    """Standard deviation of the time stamps."""


@dataclass(frozen=True, slots=True)
class GnssGrade:
    """A satellite receiver."""

    white_m: float
    """Standard deviation of the error that differs from fix to fix, east and north each."""
    slow_m: float
    """Standard deviation of the error that changes slowly."""
    slow_s: float = 60.0
    """Time in which it is forgotten (Gauss-Markov process)."""
    sample_hz: float = 10.0
    latency_s: float = 0.0
    """From the fix to its time stamp."""
    gaps: int = 0
    """Number of dropouts."""
    gap_s: tuple[float, float] = (5.0, 20.0)
    """Shortest and longest dropout."""
    stated: bool = True
    """Whether the receiver states its error."""

    @property
    def error_m(self) -> float:
        """Standard deviation of a position, east and north each, m."""
        return float(np.hypot(self.white_m, self.slow_m))


@dataclass(frozen=True, slots=True)
class Vibration:
    """What motors and tyres add to all axes: roll, pitch, yaw [rad/s]; forward, left, up [m/s2]; root mean square."""

    moving_rate: _Axes = (0.011, 0.008, 0.003)
    """15 to 60 Hz, at the speed ``full_mps`` and above; in proportion to the speed below."""
    moving_acceleration: _Axes = (0.8, 1.0, 0.45)
    idle_rate: _Axes = (0.010, 0.014, 0.008)
    """3 to 25 Hz, always."""
    idle_acceleration: _Axes = (0.25, 0.25, 0.1)
    full_mps: float = 1.0
    moving_hz: tuple[float, float] = (15.0, 60.0)
    idle_hz: tuple[float, float] = (3.0, 25.0)
    tone_per_m: float = 30.0
    """Half of the power while moving is one tone with so many periods per metre."""


@dataclass(frozen=True, slots=True)
class ClockFault:
    """How the clock of the positions runs against that of the IMU."""

    offset_s: float = 0.0
    """To add to the positions' times for the IMU's, in the middle of the drive."""
    drift_ppm: float = 0.0
    """Change of it, microseconds per second."""


@dataclass(frozen=True, slots=True)
class DriveSensors:
    """All sensors of a vehicle and how they are fitted."""

    imu: ImuGrade
    gnss: GnssGrade | None
    mount_deg: _Axes = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the IMU in the vehicle: turned by yaw about up, then by pitch about left, then by roll."""
    imu_arm_m: _Axes = (0.0, 0.0, 0.0)
    """Place of the IMU forward, left and up of the centre of mass."""
    antenna_arm_m: _Axes = (0.0, 0.0, 0.0)
    clock: ClockFault = field(default_factory=ClockFault)
    vibration: Vibration | None = field(default_factory=Vibration)
    wheels_hz: float | None = None
    """Rate at which wheel speeds are recorded; None: they are not."""


IMUS: Mapping[str, ImuGrade] = MappingProxyType(
    {
        "perfect": ImuGrade(SensorGrade(0, 0, 0, 0, 0, 0), SensorGrade(0, 0, 0, 0, 0, 0), 100.0, None, 0.0),
        "good": ImuGrade(
            SensorGrade(0.008 * _DEG, 0.1 * _DEG, 8 / 3600 * _DEG, 0.00625 * _DEG, 0.001, 0.0005),
            SensorGrade(100e-6 * GRAVITY, 2e-3 * GRAVITY, 13e-6 * GRAVITY, 1e-4 * GRAVITY, 0.001, 0.0005),
            sample_hz=200.0,
            cutoff_hz=80.0,
            jitter_s=0.0002,
        ),
        "cheap": ImuGrade(
            SensorGrade(0.011 * _DEG, 1.0 * _DEG, 0.05 * _DEG, _DEG / 131, 0.01, 0.007),
            SensorGrade(400e-6 * GRAVITY, 15e-3 * GRAVITY, 2e-3 * GRAVITY, GRAVITY / 16384, 0.01, 0.007),
            sample_hz=100.0,
            cutoff_hz=42.0,
            jitter_s=0.002,
        ),
        "cheap_unfiltered": ImuGrade(
            SensorGrade(0.011 * _DEG, 1.0 * _DEG, 0.05 * _DEG, _DEG / 131, 0.01, 0.007),
            SensorGrade(400e-6 * GRAVITY, 15e-3 * GRAVITY, 2e-3 * GRAVITY, GRAVITY / 16384, 0.01, 0.007),
            sample_hz=100.0,
            cutoff_hz=None,
            jitter_s=0.002,
        ),
    }
)
"""Grades by name."""
GNSS: Mapping[str, GnssGrade] = MappingProxyType(
    {
        "perfect": GnssGrade(0.0, 0.0),
        "rtk": GnssGrade(white_m=0.015, slow_m=0.013, latency_s=0.05),
        "sbas": GnssGrade(white_m=0.1, slow_m=0.8, latency_s=0.1),
        "single": GnssGrade(white_m=0.25, slow_m=1.48, latency_s=0.15, gaps=1),
        "worst": GnssGrade(white_m=0.5, slow_m=2.96, latency_s=0.2, gaps=2, stated=False),
    }
)
"""Receivers by name: errors of 2 cm, 0.8 m, 1.5 m and 3 m."""
