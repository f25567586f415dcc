"""The true motion of a vehicle on a drive: what its sensors would record if they had no faults."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, atomic

__all__ = ["GRAVITY", "TrueDrive", "read_motion", "save_motion"]

Floats = NDArray[np.float64]

GRAVITY = 9.80665
"""m/s2."""
_SAMPLED_HZ = 100.0
"""Rate at which pitch motion is summed, as in the drives of a calibration."""


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
    wheels: Floats
    """(n, 2) speed of the left and of the right wheels, m/s."""

    @property
    def time(self) -> Floats:
        """(n,) s."""
        return np.arange(len(self.place)) / self.rate_hz

    @property
    def sampled(self) -> tuple[Floats, Floats, Floats]:
        """Time [s], way [m] and pitch motion [rad] since the start, at 100 Hz, as in the drives of a calibration."""
        every = round(self.rate_hz / _SAMPLED_HZ)
        steps = np.hypot(*np.diff(self.place[::every, :2], axis=0).T)
        speed = np.abs(self.rates[::every, 1])
        pitched = (speed[1:] + speed[:-1]) / 2 * every / self.rate_hz
        way, turned = (np.concatenate([[0.0], np.cumsum(values)]) for values in (steps, pitched))
        return self.time[::every], way, turned

    def ride(self, start_s: Floats, end_s: Floats) -> tuple[Floats, Floats]:
        """Return the true way [m] and C_r [rad/m] between times, each (m,); C_r is NaN without a way."""
        time, way, pitched = self.sampled
        metres, turned = (np.interp(end_s, time, total) - np.interp(start_s, time, total) for total in (way, pitched))
        return metres, np.divide(turned, metres, out=np.full_like(metres, np.nan), where=metres > 0)

    def place_of(self, arm_m: tuple[float, float, float]) -> Floats:
        """Return the places (n, 3) of a sensor ``arm_m`` forward, left and up of the centre of mass, m."""
        places: Floats = self.place + self.rotation @ np.array(arm_m)
        return places

    def specific_force(self, arm_m: tuple[float, float, float]) -> Floats:
        """Return what an accelerometer there feels, (n, 3) in the chassis' axes, m/s2: the mean over a sample."""
        velocity = self.velocity + np.cross(self.rates, np.array(arm_m))
        in_space = np.einsum("nij,nj->ni", self.rotation, velocity)
        felt = np.gradient(in_space, 1 / self.rate_hz, axis=0)
        felt[:, 2] += GRAVITY
        return np.asarray(np.einsum("nji,nj->ni", self.rotation, felt))


def save_motion(drive: TrueDrive, path: Path) -> None:
    """Write a drive as a compressed NumPy archive, in single precision but for its places."""
    small = {name: getattr(drive, name).astype(np.float32) for name in ("rotation", "rates", "velocity", "wheels")}
    with atomic(path) as part, part.open("wb") as file:
        np.savez_compressed(file, rate_hz=drive.rate_hz, place=drive.place, **small)


def read_motion(path: Path) -> TrueDrive:
    """Read what `save_motion` wrote.

    Raises
    ------
    BadInputError
        The file is missing or another one.
    """
    try:
        with np.load(path) as held:
            rate_hz = float(held["rate_hz"])
            arrays = {name: held[name].astype(np.float64) for name in TrueDrive.__slots__ if name != "rate_hz"}
    except (OSError, KeyError, ValueError) as error:
        raise BadInputError(f"{path} is not a recorded motion: {error}; record the drive again") from error
    return TrueDrive(rate_hz, **arrays)
