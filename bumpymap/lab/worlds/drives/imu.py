"""An inertial sensor on a driven vehicle: vibration, mounting, filter, sampling, noise, bias, digital steps."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfilt, sosfilt_zi
from scipy.spatial.transform import Rotation

from bumpymap.core import ImuTrack
from bumpymap.lab.worlds.drives.grades import DriveSensors, ImuGrade, SensorGrade, Vibration
from bumpymap.lab.worlds.drives.motion import TrueDrive
from bumpymap.lab.worlds.drives.random_series import band_noise, slow_noise

__all__ = ["SensedImu", "mount_rotation", "sense_imu"]

Floats = NDArray[np.float64]
_WANDER_S = 100.0
"""Time in which a bias forgets."""
_FILTER_ORDER = 2
_MOST_JITTER = 0.4
"""Largest error of a time stamp, in sample periods: stamps stay in order."""


@dataclass(frozen=True, slots=True)
class SensedImu:
    """What an inertial sensor reads, and how much of it is not motion."""

    track: ImuTrack
    floor: Floats
    """(n,) part of the rates about the vehicle's left axis that sensor and idle motors make, bias included, rad/s."""
    delay_s: float
    """By which the sensor's filter delays slow motion."""


def mount_rotation(mount_deg: tuple[float, float, float]) -> Floats:
    """Return the rotation (3, 3) from the axes of a sensor, mounted at roll, pitch and yaw, to those of the vehicle."""
    roll, pitch, yaw = mount_deg
    return np.asarray(Rotation.from_euler("ZYX", [yaw, pitch, roll], degrees=True).as_matrix(), np.float64)


def sense_imu(drive: TrueDrive, sensors: DriveSensors, rng: np.random.Generator) -> SensedImu:
    """Simulate the readings of the inertial sensor; the same generator state gives the same bits."""
    grade, mount = sensors.imu, mount_rotation(sensors.mount_deg)
    idle, moving = _vibration(drive, sensors.vibration, rng)
    force = drive.specific_force(sensors.imu_arm_m)
    stamp, at = _sample_times(drive, grade, rng)
    # Rows of vectors: v @ mount turns from the vehicle's axes to the sensor's.
    rates = (drive.rates + idle[0] + moving[0]) @ mount
    felt = (force + idle[1] + moving[1]) @ mount
    read, added = _read(_sampled(rates, grade, drive, at), grade.rate, grade, rng)
    felt, _ = _read(_sampled(felt, grade, drive, at), grade.acceleration, grade, rng)
    floor = (added @ mount.T)[:, 1] + _sampled(idle[0], grade, drive, at)[:, 1]
    delay = np.sqrt(2) / (2 * np.pi * grade.cutoff_hz) if grade.cutoff_hz else 0.0
    return SensedImu(ImuTrack(stamp, read, felt), floor, float(delay))


def _vibration(
    drive: TrueDrive, vibration: Vibration | None, rng: np.random.Generator
) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Return the vibration of idle motors and of the drive, each of rates and accelerations (n, 3)."""
    shape = (len(drive.place), 3)
    if vibration is None:
        none = np.zeros(shape)
        return (none, none), (none, none)
    speed = np.abs(drive.velocity[:, 0])
    loud = np.minimum(speed / vibration.full_mps, 1.0)[:, None]
    idle, moving = [], []
    phase = 2 * np.pi * vibration.tone_per_m * np.cumsum(speed) / drive.rate_hz
    for standing, driving in (
        (vibration.idle_rate, vibration.moving_rate),
        (vibration.idle_acceleration, vibration.moving_acceleration),
    ):
        idle.append(np.array(standing) * band_noise(rng, shape, vibration.idle_hz, drive.rate_hz))
        tone = np.sin(phase[:, None] + rng.uniform(0, 2 * np.pi, 3))
        noise = np.sqrt(0.5) * band_noise(rng, shape, vibration.moving_hz, drive.rate_hz)
        moving.append(np.array(driving) * loud * (noise + tone))
    return (idle[0], idle[1]), (moving[0], moving[1])


def _sample_times(drive: TrueDrive, grade: ImuGrade, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return time stamps and true times of the samples, s."""
    period = 1 / grade.sample_hz
    at = np.arange(rng.uniform(0, period), drive.time[-1], period)
    jitter = np.clip(grade.jitter_s * rng.standard_normal(len(at)), -_MOST_JITTER * period, _MOST_JITTER * period)
    return at + jitter, at


def _sampled(signal: Floats, grade: ImuGrade, drive: TrueDrive, at: Floats) -> Floats:
    """Filter a signal (n, 3) as the sensor does and sample it."""
    if grade.cutoff_hz is not None:
        sos = butter(_FILTER_ORDER, grade.cutoff_hz, fs=drive.rate_hz, output="sos")
        start = sosfilt_zi(sos)[:, :, None] * signal[0]
        signal, _ = sosfilt(sos, signal, axis=0, zi=start)
    return np.stack([np.interp(at, drive.time, column) for column in signal.T], axis=1)


def _read(signal: Floats, grade: SensorGrade, imu: ImuGrade, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Return the digital readings of a signal (n, 3), and the part of them that does not depend on the signal."""
    scale = np.eye(3) * (1 + grade.scale * rng.standard_normal(3))
    scale += grade.cross * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    added = grade.bias * rng.standard_normal(3)
    added = added + grade.wander * slow_noise(rng, signal.shape, _WANDER_S, imu.sample_hz)
    added = added + grade.noise * np.sqrt(imu.sample_hz / 2) * rng.standard_normal(signal.shape)
    read = signal @ scale + added
    if grade.step > 0:
        read = grade.step * np.round(read / grade.step)
    return read, added
