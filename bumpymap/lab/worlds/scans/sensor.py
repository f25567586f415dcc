"""Spinning LiDARs: beam directions and accuracy."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.worlds.scans._fields import log_uniform

__all__ = ["SENSORS", "Sensor", "draw_sensor"]


@dataclass(frozen=True, slots=True)
class Sensor:
    """One spinning LiDAR on a robot."""

    lines: int = 64
    columns: int = 2048
    lowest_deg: float = -22.5
    """Elevation of the lowest line."""
    highest_deg: float = 22.5
    """Elevation of the highest line."""
    height_m: float = 1.4
    """Height above the ground at the robot's position."""
    noise_m: float = 0.015
    """Standard deviation of a range."""
    end_m: float = 110.0
    """Maximum range."""
    reach_m: float = 60.0
    """Range at which a surface of reflectivity 0.1 at normal incidence returns every other pulse."""
    lost: float = 0.005
    """Share of the pulses that are lost independently of the scene."""
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    """Roll about the x axis, then pitch about the y axis, of the robot on its ground."""

    def __post_init__(self) -> None:
        if self.lines < 2 or self.columns < 8:
            raise UsageError(f"a sensor has {self.lines} lines and {self.columns} columns; it needs at least 2 and 8")
        if not -90.0 < self.lowest_deg < self.highest_deg < 90.0:
            raise UsageError(f"lines from {self.lowest_deg} to {self.highest_deg} deg; they must rise within -90 to 90")
        if not (min(self.height_m, self.reach_m) > 0 and self.noise_m >= 0 and self.end_m > 1 and 0 <= self.lost < 1):
            raise UsageError(
                f"height_m is {self.height_m}, noise_m {self.noise_m}, reach_m {self.reach_m}, end_m {self.end_m}, "
                f"lost {self.lost}; height and reach must be above 0, end above 1, noise 0 or more, lost 0 to 1"
            )

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors in the sensor's frame, (lines * columns, 3), line by line from the lowest."""
        elevation = np.radians(np.linspace(self.lowest_deg, self.highest_deg, self.lines))[:, None]
        azimuth = np.linspace(-np.pi, np.pi, self.columns, endpoint=False)[None, :]
        parts = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth))
        rays = np.stack([*parts, np.broadcast_to(np.sin(elevation), parts[0].shape)], axis=-1)
        return rays.reshape(-1, 3)

    def to_level(self) -> NDArray[np.float64]:
        """Return the rotation (3, 3) from the sensor's frame to a frame with vertical z axis."""
        roll, pitch = np.radians(self.tilt_deg)
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        turned: NDArray[np.float64] = about_y @ about_x
        return turned


SENSORS = {
    "64_narrow": Sensor(),
    "64_dense": Sensor(lowest_deg=-16.6, highest_deg=16.6, height_m=1.5),
    "64_down": Sensor(lowest_deg=-24.8, highest_deg=2.0, height_m=1.75, reach_m=70.0),
    "64_wide": Sensor(lowest_deg=-45.0, highest_deg=45.0, height_m=0.9, reach_m=30.0, noise_m=0.02),
    "64_coarse": Sensor(columns=1024, height_m=1.1),
    "128_narrow": Sensor(lines=128, columns=1024, height_m=1.6),
    "128_wide": Sensor(lines=128, columns=1024, lowest_deg=-45.0, highest_deg=45.0, height_m=0.8, reach_m=25.0),
    "32_sparse": Sensor(lines=32, lowest_deg=-25.0, highest_deg=15.0, height_m=1.2),
}
"""Typical sensors on the market, named by number of lines and vertical field of view."""
_COMMON = {"64_narrow": 3.0, "64_dense": 3.0, "32_sparse": 0.5, "64_wide": 2.5, "128_wide": 4.0}
"""Weights of sensors that are drawn more or less often than the others."""


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw one of ``SENSORS`` with small variations; two fifths are the wide ones of low robots."""
    names = list(SENSORS)
    weight = np.array([_COMMON.get(name, 1.5) for name in names])
    sensor = SENSORS[names[rng.choice(len(names), p=weight / weight.sum())]]
    return replace(
        sensor,
        height_m=float(np.clip(sensor.height_m * rng.uniform(0.7, 1.35), 0.5, 2.1)),
        noise_m=float(rng.uniform(0.008, 0.03)),
        reach_m=sensor.reach_m * float(rng.uniform(0.7, 1.3)),
        lost=log_uniform(rng, 0.001, 0.05),
        tilt_deg=(float(rng.normal(0, 1.5)), float(rng.normal(0, 1.5))),
    )
