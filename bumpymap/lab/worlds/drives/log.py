"""A drive log as a vehicle's own sensors record it, with the true values of what `check` has to find."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from bumpymap.core import DriveLog, PlaceTrack
from bumpymap.lab.worlds.drives.grades import DriveSensors
from bumpymap.lab.worlds.drives.imu import SensedImu, sense_imu
from bumpymap.lab.worlds.drives.motion import TrueDrive
from bumpymap.lab.worlds.drives.places import sense_places, sense_wheels

__all__ = ["SensedDrive", "SensorTruth", "sense_drive"]

Floats = NDArray[np.float64]
_BAND_HZ = 10.0
_START_S = 1_760_000_000.0
"""Time of the first sample: loggers write seconds since 1970."""


@dataclass(frozen=True, slots=True)
class SensorTruth:
    """The true values of what can be found out about the sensors of a drive."""

    clock_offset_s: float
    """Time to add to the times of the positions for those of the IMU, in the middle of the drive: clock, latency of
    the receiver and delay of the IMU's filter."""
    clock_drift_ppm: float
    mount_deg: tuple[float, float, float]
    floor_radps: float
    """Mean absolute pitch rate of sensor and idle motors below 10 Hz, rad/s."""
    position_error_m: float
    """Standard deviation, east and north each; NaN without positions."""


@dataclass(frozen=True, slots=True)
class SensedDrive:
    """A drive log and its truth."""

    log: DriveLog
    truth: SensorTruth
    start_s: float
    """Time of the log at which the true motion begins."""


def sense_drive(
    drive: TrueDrive, sensors: DriveSensors, seed: int, name: str = "simulated", crs: str | None = None
) -> SensedDrive:
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
    places = (
        None
        if sensors.gnss is None
        else sense_places(drive, sensors, sensors.gnss, np.random.default_rng(place_stream))
    )
    wheels = None if sensors.wheels_hz is None else sense_wheels(drive, sensors, sensors.wheels_hz)
    latency = sensors.gnss.latency_s if sensors.gnss else 0.0
    truth = SensorTruth(
        clock_offset_s=sensors.clock.offset_s - latency + imu.delay_s,
        clock_drift_ppm=sensors.clock.drift_ppm,
        mount_deg=sensors.mount_deg,
        floor_radps=_floor(imu, sensors.imu.sample_hz),
        position_error_m=sensors.gnss.error_m if sensors.gnss else float("nan"),
    )
    log = DriveLog(
        name=name,
        paths=(),
        imu=replace(imu.track, time=imu.track.time + _START_S),
        places=None if places is None else _geographic(replace(places, time=places.time + _START_S), crs),
        wheels=None if wheels is None else replace(wheels, time=wheels.time + _START_S),
    )
    return SensedDrive(log, truth, _START_S)


def _floor(imu: SensedImu, rate_hz: float) -> float:
    """Return the mean absolute reading below 10 Hz without its mean."""
    sos = butter(4, _BAND_HZ, fs=rate_hz, output="sos")
    return float(np.abs(sosfiltfilt(sos, imu.floor - imu.floor.mean())).mean())


def _geographic(places: PlaceTrack, crs: str | None) -> PlaceTrack:
    """Turn easting and northing into longitude and latitude."""
    if crs is None:
        return places
    from pyproj import Transformer

    longitude, latitude = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(places.x, places.y)
    return replace(places, x=longitude, y=latitude, kind="lonlat")
