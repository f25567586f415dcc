"""Simulated drive logs: the true motion of a vehicle, the faults of its sensors, the files of its logger.

The good IMU is the Analog Devices ADIS16470 (data sheet, revision C): rates 0.008 deg/s/sqrt(Hz), 8 deg/h in-run
stability; acceleration 13 ug in-run stability. Its biases at switch-on are those that remain after the factory's
calibration.

Vibration is that of a Husky A200 on firm ground in BorealTC (LaRocque et al. 2024, CC0): 15 to 50 Hz while it drives.
At standstill, with its motors on, it reads a mean absolute pitch rate of 0.004 to 0.02 rad/s below 10 Hz; here 0.006.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer
from scipy.signal import butter, lfilter, sosfilt, sosfilt_zi, sosfiltfilt, sosfreqz
from scipy.spatial.transform import Rotation

from bumpymap.core import DriveLog, ImuTrack, PlaceTrack

Floats = NDArray[np.float64]

GRAVITY = 9.80665
"""m/s2."""


@dataclass(frozen=True, slots=True)
class TrueDrive:
    """The motion of a chassis, sample by sample, in the chassis' own axes: x forward, y left, z up."""

    rate_hz: float
    """Samples in a second; the first is at 0 s."""
    place: Floats
    """(n, 3) easting, northing and height of the centre of mass, m."""
    rotation: Floats
    """(n, 3, 3) from the chassis' axes to east, north and up."""
    rates: Floats
    """(n, 3) angular velocity, rad/s."""
    velocity: Floats
    """(n, 3) velocity of the centre of mass, m/s."""

    @property
    def time(self) -> Floats:
        """(n,) s."""
        return np.arange(len(self.place)) / self.rate_hz

    @property
    def specific_force(self) -> Floats:
        """What an accelerometer there feels, (n, 3) in the chassis' axes, m/s2: the mean over a sample."""
        in_space = np.einsum("nij,nj->ni", self.rotation, self.velocity)
        felt = np.gradient(in_space, 1 / self.rate_hz, axis=0)
        felt[:, 2] += GRAVITY
        return np.einsum("nji,nj->ni", self.rotation, felt)


def save_motion(drive: TrueDrive, path: Path) -> None:
    """Write a drive as a compressed NumPy archive, in single precision but for its places."""
    small = {name: getattr(drive, name).astype(np.float32) for name in ("rotation", "rates", "velocity")}
    np.savez_compressed(path, rate_hz=drive.rate_hz, place=drive.place, **small)


def read_motion(path: Path) -> TrueDrive:
    """Read what `save_motion` wrote."""
    with np.load(path) as held:
        arrays = {name: held[name].astype(np.float64) for name in ("place", "rotation", "rates", "velocity")}
        return TrueDrive(float(held["rate_hz"]), **arrays)


_SAMPLES = 4096
"""Frequencies at which the gain of a filter is averaged."""


def band_noise(
    rng: np.random.Generator, shape: tuple[int, int], band_hz: tuple[float, float], rate_hz: float
) -> Floats:
    """Draw Gaussian noise (n, k) of unit variance between two frequencies; columns are independent."""
    sos = butter(2, band_hz, "bandpass", fs=rate_hz, output="sos")
    _, gain = sosfreqz(sos, _SAMPLES)
    # Filtered forwards and backwards: the gain counts twice.
    power = float(np.mean(np.abs(gain) ** 4))
    return np.asarray(sosfiltfilt(sos, rng.standard_normal(shape), axis=0) / np.sqrt(power))


def slow_noise(rng: np.random.Generator, shape: tuple[int, int], forget_s: float, rate_hz: float) -> Floats:
    """Draw first-order Gauss-Markov noise (n, k) of unit variance, whose correlation falls to 1/e in ``forget_s``."""
    keep = float(np.exp(-1 / (forget_s * rate_hz)))
    drawn = rng.standard_normal(shape)
    drawn[1:] *= np.sqrt(1 - keep**2)
    return np.asarray(lfilter([1.0], [1.0, -keep], drawn, axis=0))


_DEG = float(np.radians(1.0))


@dataclass(frozen=True, slots=True)
class SensorGrade:
    """Faults of a sensor with three axes; its unit u is rad/s or m/s2."""

    noise: float = 0.0
    """Density of the white noise, u/sqrt(Hz)."""
    bias: float = 0.0
    """Standard deviation of the constant bias, u."""
    wander: float = 0.0
    """Standard deviation of the slow change of the bias, u."""
    step: float = 0.0
    """Step of the digital output, u."""
    scale: float = 0.0
    """Standard deviation of the error of the sensitivity, a share."""
    cross: float = 0.0
    """Standard deviation of the share of each other axis that is read."""


@dataclass(frozen=True, slots=True)
class DriveSensors:
    """The IMU and the satellite receiver of a vehicle, at its centre of mass; perfect if no faults are given."""

    rate: SensorGrade = field(default_factory=SensorGrade)
    acceleration: SensorGrade = field(default_factory=SensorGrade)
    imu_hz: float = 100.0
    """Samples of the IMU in a second."""
    cutoff_hz: float | None = None
    """Of the low-pass filter before sampling; None: there is none."""
    jitter_s: float = 0.0
    """Standard deviation of the time stamps of the IMU."""
    vibrates: bool = False
    """True if motors and tyres shake the IMU."""
    mount_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Roll, pitch and yaw of the IMU in the vehicle: turned by yaw about up, then by pitch about left, then by roll."""
    gnss_hz: float = 10.0
    """Fixes of the receiver in a second."""
    white_m: float = 0.0
    """Standard deviation of the error that differs from fix to fix, east and north each."""
    slow_m: float = 0.0
    """Standard deviation of the error that changes slowly."""
    latency_s: float = 0.0
    """From a fix to its time stamp."""
    clock_offset_s: float = 0.0
    """To add to the times of the receiver's clock for the IMU's, in the middle of the drive."""
    clock_drift_ppm: float = 0.0
    """Change of it, microseconds per second."""


GOOD = DriveSensors(
    SensorGrade(0.008 * _DEG, 0.1 * _DEG, 8 / 3600 * _DEG, 0.00625 * _DEG, 0.001, 0.0005),
    SensorGrade(100e-6 * GRAVITY, 2e-3 * GRAVITY, 13e-6 * GRAVITY, 1e-4 * GRAVITY, 0.001, 0.0005),
    imu_hz=200.0,
    cutoff_hz=80.0,
    jitter_s=0.0002,
    vibrates=True,
    white_m=0.015,
    slow_m=0.013,
    latency_s=0.05,
)
"""An ADIS16470 and an RTK receiver."""
_WANDER_S, _SLOW_S = 100.0, 60.0
"""Times in which a bias and the slow error of a fix forget."""
_FILTER_ORDER = 2
_MOST_JITTER = 0.4
"""Largest error of a time stamp, in sample periods: stamps stay in order."""
_IDLE_HZ, _MOVING_HZ = (3.0, 25.0), (15.0, 60.0)
_VIBRATION = (((0.010, 0.014, 0.008), (0.011, 0.008, 0.003)), ((0.25, 0.25, 0.1), (0.8, 1.0, 0.45)))
"""Root mean square of what idle motors always add, and tyres at 1 m/s and more: to rates about forward, left and up
[rad/s], and to accelerations along them [m/s2]."""
_TONE_PER_M = 30.0
"""Half of the power while moving is one tone with so many periods per metre."""


def mount_rotation(mount_deg: tuple[float, float, float]) -> Floats:
    """Return the rotation (3, 3) from the axes of a sensor, mounted at roll, pitch and yaw, to those of the vehicle."""
    return Rotation.from_euler("ZYX", mount_deg[::-1], degrees=True).as_matrix()


def sense_imu(drive: TrueDrive, sensors: DriveSensors, rng: np.random.Generator) -> ImuTrack:
    """Simulate the readings of the inertial sensor; the same generator state gives the same bits."""
    shaken = _vibration(drive, rng) if sensors.vibrates else ((0.0, 0.0), (0.0, 0.0))
    period = 1 / sensors.imu_hz
    at = np.arange(rng.uniform(0, period), drive.time[-1], period)
    jitter = np.clip(sensors.jitter_s * rng.standard_normal(len(at)), -_MOST_JITTER * period, _MOST_JITTER * period)
    mount, read = mount_rotation(sensors.mount_deg), []
    for signal, (idle, moving), grade in zip(
        (drive.rates, drive.specific_force), shaken, (sensors.rate, sensors.acceleration), strict=True
    ):
        # Rows of vectors: v @ mount turns from the vehicle's axes to the sensor's.
        felt = _sampled((signal + idle + moving) @ mount, sensors.cutoff_hz, drive, at)
        read.append(_read(felt, grade, sensors.imu_hz, rng))
    return ImuTrack(at + jitter, *read)


def _vibration(drive: TrueDrive, rng: np.random.Generator) -> list[tuple[Floats, Floats]]:
    """Return the vibration of idle motors and of the drive, (n, 3) each: of the rates, then of the accelerations."""
    shape = (len(drive.place), 3)
    speed = np.abs(drive.velocity[:, 0])
    loud = np.minimum(speed, 1.0)[:, None]
    phase = 2 * np.pi * _TONE_PER_M * np.cumsum(speed) / drive.rate_hz
    made = []
    for standing, driving in _VIBRATION:
        idle = np.array(standing) * band_noise(rng, shape, _IDLE_HZ, drive.rate_hz)
        tone = np.sin(phase[:, None] + rng.uniform(0, 2 * np.pi, 3))
        noise = np.sqrt(0.5) * band_noise(rng, shape, _MOVING_HZ, drive.rate_hz)
        made.append((idle, np.array(driving) * loud * (noise + tone)))
    return made


def _sampled(signal: Floats, cutoff_hz: float | None, drive: TrueDrive, at: Floats) -> Floats:
    """Filter a signal (n, 3) as the sensor does and sample it."""
    if cutoff_hz is not None:
        sos = butter(_FILTER_ORDER, cutoff_hz, fs=drive.rate_hz, output="sos")
        start = sosfilt_zi(sos)[:, :, None] * signal[0]
        signal, _ = sosfilt(sos, signal, axis=0, zi=start)
    return np.stack([np.interp(at, drive.time, column) for column in signal.T], axis=1)


def _read(signal: Floats, grade: SensorGrade, sample_hz: float, rng: np.random.Generator) -> Floats:
    """Return the digital readings of a signal (n, 3)."""
    scale = np.eye(3) * (1 + grade.scale * rng.standard_normal(3))
    scale += grade.cross * rng.standard_normal((3, 3)) * (1 - np.eye(3))
    added = grade.bias * rng.standard_normal(3)
    added = added + grade.wander * slow_noise(rng, signal.shape, _WANDER_S, sample_hz)
    added = added + grade.noise * np.sqrt(sample_hz / 2) * rng.standard_normal(signal.shape)
    read = signal @ scale + added
    return grade.step * np.round(read / grade.step) if grade.step > 0 else read


def sense_places(drive: TrueDrive, sensors: DriveSensors, rng: np.random.Generator) -> PlaceTrack:
    """Simulate the fixes of a receiver, in the coordinates of the drive; time stamps are those of its own clock."""
    at = np.arange(rng.uniform(0, 1 / sensors.gnss_hz), drive.time[-1], 1 / sensors.gnss_hz)
    shape = (len(at), 2)
    error = sensors.white_m * rng.standard_normal(shape)
    error = error + sensors.slow_m * slow_noise(rng, shape, _SLOW_S, sensors.gnss_hz)
    x, y = (np.interp(at, drive.time, drive.place[:, axis]) + error[:, axis] for axis in (0, 1))
    shown = at + sensors.latency_s
    stamp = shown - sensors.clock_offset_s - 1e-6 * sensors.clock_drift_ppm * (shown - drive.time[-1] / 2)
    return PlaceTrack(stamp, x, y, np.full(len(at), np.hypot(sensors.white_m, sensors.slow_m)), "projected")


START_S = 1_760_000_000.0
"""Time of the first sample: loggers write seconds since 1970."""


def sense_drive(
    drive: TrueDrive, sensors: DriveSensors, seed: int, name: str = "simulated", crs: str | None = None
) -> DriveLog:
    """Simulate the log of a drive; the same arguments give the same bits.

    Parameters
    ----------
    drive : TrueDrive
    sensors : DriveSensors
    seed : int
    name : str
    crs : str, optional
        CRS of the drive's easting and northing, such as ``EPSG:32614``: positions become longitude and latitude.
    """
    imu_stream, place_stream = np.random.SeedSequence(seed).spawn(2)
    imu = sense_imu(drive, sensors, np.random.default_rng(imu_stream))
    places = sense_places(drive, sensors, np.random.default_rng(place_stream))
    if crs is not None:
        longitude, latitude = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(places.x, places.y)
        places = replace(places, x=longitude, y=latitude, kind="lonlat")
    return DriveLog(
        name=name,
        paths=(),
        imu=replace(imu, time=imu.time + START_S),
        places=replace(places, time=places.time + START_S),
        wheels=None,
    )


_IMU = "time [s],gyro_x [rad/s],gyro_y [rad/s],gyro_z [rad/s],acc_x [m/s2],acc_y [m/s2],acc_z [m/s2]"
_PLACES = {
    "lonlat": ("time [s],longitude [deg],latitude [deg],horizontal_error [m]", "%.9f"),
    "projected": ("time [s],easting [m],northing [m],horizontal_error [m]", "%.4f"),
}


def write_drive_files(log: DriveLog, folder: Path) -> list[Path]:
    """Write a log as NAME_imu.csv and NAME_gnss.csv."""
    columns = np.column_stack([log.imu.time, log.imu.rate, log.imu.acceleration])
    imu, gnss = (folder / f"{log.name}_{kind}.csv" for kind in ("imu", "gnss"))
    np.savetxt(imu, columns, fmt=["%.6f"] * 7, delimiter=",", header=_IMU, comments="")
    header, form = _PLACES[log.places.kind]
    columns = np.column_stack([log.places.time, log.places.x, log.places.y, log.places.error])
    np.savetxt(gnss, columns, fmt=["%.6f", form, form, "%.3f"], delimiter=",", header=header, comments="")
    return [imu, gnss]
