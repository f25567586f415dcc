"""LiDARs, spinning and solid-state: beam directions and accuracy."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.worlds.scans._fields import log_uniform

__all__ = ["SENSORS", "Pattern", "Sensor", "draw_sensor"]

Pattern = Literal["lines", "rosette"]
"""Horizontal lines, or loops through the middle of the view, as two rotating prisms make them."""
_LOOP_TURN = 0.2199
"""Turns of a rosette for one oscillation between its margins."""
_LOOP_POINTS = 500
"""Points of one loop."""


@dataclass(frozen=True, slots=True)
class Sensor:
    """One LiDAR on a robot."""

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
    """Roll about the x axis, then pitch about the y axis (nose down above 0), of the sensor on its robot."""
    pattern: Pattern = "lines"
    view_deg: float = 360.0
    """Horizontal field of view, its middle ahead."""
    dense_deg: tuple[float, float] = (-90.0, 90.0)
    """Band of elevations in which lines are closer."""
    dense: float = 1.0
    """Lines per degree in this band, divided by those outside."""
    stray: float = 0.0
    """Share of the pulses that return from dust, rain or nothing, at any range."""

    def __post_init__(self) -> None:
        if self.lines < 2 or self.columns < 8:
            raise UsageError(f"a sensor has {self.lines} lines and {self.columns} columns; it needs at least 2 and 8")
        if not -90.0 < self.lowest_deg < self.highest_deg < 90.0:
            raise UsageError(f"lines from {self.lowest_deg} to {self.highest_deg} deg; they must rise within -90 to 90")
        if not (0.0 < self.view_deg <= 360.0 and self.dense_deg[0] < self.dense_deg[1] and self.dense > 0):
            raise UsageError(
                f"view_deg is {self.view_deg}, dense_deg {self.dense_deg}, dense {self.dense}; the view must be above "
                "0 and at most 360 degrees, the band must rise, its density be above 0"
            )
        if not 0 <= self.stray < 1:
            raise UsageError(f"stray is {self.stray}; it must be 0 or more, and below 1")
        if not (min(self.height_m, self.reach_m) > 0 and self.noise_m >= 0 and self.end_m > 1 and 0 <= self.lost < 1):
            raise UsageError(
                f"height_m is {self.height_m}, noise_m {self.noise_m}, reach_m {self.reach_m}, end_m {self.end_m}, "
                f"lost {self.lost}; height and reach must be above 0, end above 1, noise 0 or more, lost 0 to 1"
            )

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors in the sensor's frame, (lines * columns, 3): lines from the lowest, loops in time."""
        if self.pattern == "rosette":
            elevation, azimuth = self._loops()
        else:
            elevation = np.radians(self._elevations_deg())[:, None]
            half = np.radians(self.view_deg) / 2
            azimuth = np.linspace(-half, half, self.columns, endpoint=False)[None, :]
        parts = (np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth))
        rays = np.stack([*parts, np.broadcast_to(np.sin(elevation), parts[0].shape)], axis=-1)
        return rays.reshape(-1, 3)

    def _elevations_deg(self) -> NDArray[np.float64]:
        """Return the elevation of each line (lines,), in equal steps of the number of lines below an elevation."""
        if self.dense == 1.0:
            return np.linspace(self.lowest_deg, self.highest_deg, self.lines)
        band = np.clip(self.dense_deg, self.lowest_deg, self.highest_deg)
        edges = np.array([self.lowest_deg, *band, self.highest_deg])
        below = np.concatenate([[0.0], np.cumsum(np.diff(edges) * [1.0, self.dense, 1.0])])
        spaced: NDArray[np.float64] = np.interp(np.linspace(0.0, below[-1], self.lines), below, edges)
        return spaced

    def _loops(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return elevations and azimuths (n, 1) of a rosette; with a full view it winds around the vertical axis."""
        time = np.arange(self.lines * self.columns)[:, None] / (2 * _LOOP_POINTS)
        middle, half = np.radians([(self.highest_deg + self.lowest_deg) / 2, (self.highest_deg - self.lowest_deg) / 2])
        swing, turn = np.sin(2 * np.pi * time), 2 * np.pi * _LOOP_TURN * time
        if self.view_deg == 360.0:
            return middle + half * swing, np.mod(turn, 2 * np.pi) - np.pi
        return middle + half * swing * np.sin(turn), np.radians(self.view_deg) / 2 * swing * np.cos(turn)

    def to_level(self) -> NDArray[np.float64]:
        """Return the rotation (3, 3) from the sensor's frame to a frame with vertical z axis."""
        roll, pitch = np.radians(self.tilt_deg)
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        turned: NDArray[np.float64] = about_y @ about_x
        return turned


SENSORS = {
    "16_narrow": Sensor(lines=16, columns=1800, lowest_deg=-15.0, highest_deg=15.0, height_m=0.8, reach_m=50.0),
    "32_sparse": Sensor(lines=32, lowest_deg=-25.0, highest_deg=15.0, height_m=1.2),
    "32_horizon": Sensor(
        lines=32, columns=1800, lowest_deg=-25.0, highest_deg=15.0, dense_deg=(-4.0, 1.5), dense=4.0, height_m=1.2
    ),
    "40_horizon": Sensor(
        lines=40, columns=1800, lowest_deg=-25.0, highest_deg=15.0, dense_deg=(-6.0, 2.0), dense=3.0, height_m=1.7
    ),
    "64_narrow": Sensor(),
    "64_dense": Sensor(lowest_deg=-16.6, highest_deg=16.6, height_m=1.5),
    "64_down": Sensor(lowest_deg=-24.8, highest_deg=2.0, height_m=1.75, reach_m=70.0),
    "64_blocks": Sensor(
        columns=1800, lowest_deg=-24.9, highest_deg=2.0, dense_deg=(-8.5, 2.0), dense=1.5, height_m=1.73, reach_m=90.0
    ),
    "64_wide": Sensor(lowest_deg=-45.0, highest_deg=45.0, height_m=0.9, reach_m=30.0, noise_m=0.02),
    "64_coarse": Sensor(columns=1024, height_m=1.1),
    "128_narrow": Sensor(lines=128, columns=1024, height_m=1.6),
    "128_wide": Sensor(lines=128, columns=1024, lowest_deg=-45.0, highest_deg=45.0, height_m=0.8, reach_m=25.0),
    "128_horizon": Sensor(
        lines=128, columns=1800, lowest_deg=-25.0, highest_deg=15.0, dense_deg=(-6.0, 2.0), dense=4.0, height_m=1.8
    ),
    "rosette_80": Sensor(
        lines=60, columns=500, lowest_deg=-35.0, highest_deg=35.0, pattern="rosette", view_deg=80.0, reach_m=90.0
    ),
    "rosette_360": Sensor(
        lines=40, columns=500, lowest_deg=-7.0, highest_deg=52.0, pattern="rosette", height_m=0.6, reach_m=30.0
    ),
    "raster_120": Sensor(lines=125, columns=600, lowest_deg=-12.5, highest_deg=12.5, view_deg=120.0, reach_m=80.0),
}
"""Typical sensors on the market, named by number of lines and vertical field of view, or by the pattern of a
solid-state sensor and its horizontal field of view in degrees."""
_WEIGHTS = {
    "16_narrow": 2.0, "32_sparse": 1.0, "40_horizon": 1.5, "64_narrow": 2.0, "64_dense": 2.0, "64_blocks": 2.5,
    "64_wide": 2.0, "128_wide": 3.0, "rosette_80": 3.0, "raster_120": 1.5,
}  # fmt: skip
"""Weights of sensors that are drawn more often than others (1)."""
_LEANING = 0.3
"""Share of the sensors that lean forward, or back, by more than a careless mounting."""


def draw_sensor(rng: np.random.Generator) -> Sensor:
    """Draw one of ``SENSORS`` with small variations, mounted 0.4 to 2.1 m above the ground; some lean forward."""
    names = list(SENSORS)
    weight = np.array([_WEIGHTS.get(name, 1.0) for name in names])
    sensor = SENSORS[names[rng.choice(len(names), p=weight / weight.sum())]]
    height = sensor.height_m * rng.uniform(0.7, 1.35) if rng.uniform() < 0.6 else log_uniform(rng, 0.4, 2.0)
    lean = rng.uniform(-5.0, 15.0) if rng.uniform() < _LEANING else rng.normal(0, 1.5)
    return replace(
        sensor,
        height_m=float(np.clip(height, 0.4, 2.1)),
        noise_m=float(rng.uniform(0.008, 0.03)),
        reach_m=sensor.reach_m * float(rng.uniform(0.7, 1.3)),
        lost=log_uniform(rng, 0.001, 0.05),
        tilt_deg=(float(rng.normal(0, 1.5)), float(lean)),
        view_deg=sensor.view_deg * (1.0 if sensor.view_deg == 360.0 else float(rng.uniform(0.75, 1.0))),
        stray=log_uniform(rng, 1e-5, 2e-3) if rng.uniform() < 0.5 else 0.0,
    )
