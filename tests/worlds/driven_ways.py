"""Drive along ways over the relief of a survey in DART.

C_r is measured as in the drives of a calibration, after settling and acceleration: the integral of abs(omega_y) dt over
the horizontal length of the path. The vehicle steers to a point ahead on the line. The more it has to turn, the slower
it drives; at 90 degrees and more it turns on the spot. What it pitches while it turns counts, for so a gyroscope on
board would measure it.

Coordinates are metres east and north of a window's south-west corner: easting and northing themselves do not fit the
single precision of a mesh.
"""

import math
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve, distance_transform_edt, uniform_filter1d

from bumpymap.core import OBSTACLE
from bumpymap.lab.simulate.drive import DriveSettings, Outcome
from bumpymap.lab.simulate.model import DartVehicle, Physics, Pose
from bumpymap.lab.simulate.terrain import Strip, cell_triangles, fit_plane
from bumpymap.rating import Vehicle

_Floats = NDArray[np.float64]
_STEP_M = 0.05
_SEARCH_M = 3.0
"""How far ahead of its last place along the line a vehicle is looked for."""
_SMOOTH_M = 1.0
"""Length over which the normal of a line that is moved sideways is averaged."""


@dataclass(frozen=True, slots=True)
class GuideLine:
    """A line as points 5 cm apart."""

    points: _Floats
    """(n, 2) easting and northing, m."""
    step: float
    """Distance between points along the line, m."""

    @classmethod
    def along(cls, corners: _Floats, offset: float = 0.0) -> "GuideLine":
        """Make the line through corners (m, 2), in m, moved to the left by ``offset`` m."""
        distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))])
        count = max(math.ceil(float(distance[-1]) / _STEP_M), 2)
        at = np.linspace(0.0, distance[-1], count + 1)
        points = np.stack([np.interp(at, distance, corners[:, axis]) for axis in (0, 1)], axis=1)
        step = float(distance[-1]) / count
        return cls(points + offset * _normals(points, step) if offset else points, step)

    def progress(self, easting: float, northing: float, before: int) -> tuple[int, float]:
        """Return the number of the nearest point from ``before`` onwards, up to 3 m ahead, and its distance, m."""
        ahead = self.points[before : before + round(_SEARCH_M / self.step)]
        squared = (ahead[:, 0] - easting) ** 2 + (ahead[:, 1] - northing) ** 2
        nearest = int(squared.argmin())
        return before + nearest, math.sqrt(float(squared[nearest]))

    def ahead(self, number: int, distance: float) -> tuple[float, float]:
        """Return the place ``distance`` m after a point; the line goes on straight beyond its end."""
        wanted = number + round(distance / self.step)
        last = len(self.points) - 1
        x, y = self.points[min(wanted, last)].tolist()
        if wanted > last:
            x_0, y_0 = self.points[last - 1].tolist()
            x, y = x + (wanted - last) * (x - x_0), y + (wanted - last) * (y - y_0)
        return x, y


def _normals(points: _Floats, step: float) -> _Floats:
    """Return the unit normals (n, 2) to the left, averaged along the line: at a corner they turn gradually."""
    forward = np.gradient(points, axis=0)
    forward = uniform_filter1d(forward, max(round(_SMOOTH_M / step), 1), axis=0, mode="nearest")
    forward /= np.maximum(np.hypot(forward[:, 0], forward[:, 1]), 1e-12)[:, None]
    return np.stack([-forward[:, 1], forward[:, 0]], axis=1)


_OBSTACLE_M = 1.0
_ON_BORDER = 1e-6
"""Points this near to the border of a pixel lie on it, pixels."""
_RINGS = 15
"""Pixels from the rim of a hole inwards."""
_SLOPE_PIXELS = 15
"""Side of the square whose plane gives the slope at a place."""


def fill_gaps(heights: NDArray[np.floating]) -> _Floats:
    """Fill NaN pixels as the map does: with the mean of their known 8 neighbours, from the rim of a hole inwards.

    What lies more than 15 pixels inside, such as all that is beyond the survey, gets the nearest height. Heights
    (rows, cols) are in m, and some are known.
    """
    filled = heights.astype(np.float64)
    missing = np.isnan(filled)
    ring = np.ones((3, 3))
    for _ in range(_RINGS):
        if not missing.any():
            return filled
        total = convolve(np.where(missing, 0.0, filled), ring, mode="constant")
        known = convolve((~missing).astype(np.float64), ring, mode="constant")
        rim = missing & (known > 0.5)
        filled[rim] = total[rim] / known[rim]
        missing = missing & ~rim
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(filled[tuple(nearest)], np.float64)


@dataclass(frozen=True, slots=True)
class ReliefGround:
    """Heights of a window of the map, bilinear between pixel centres and constant beyond the outermost ones.

    Pixels with an obstacle are higher by more than any vehicle climbs, over exactly their area: in bilinear ground the
    foot of such a wall would stand half a pixel outside of it.
    """

    heights: _Floats
    """(rows, cols) m, south row first, without NaN."""
    pixel_size: float
    """m."""
    gradient: tuple[float, float] = (0.0, 0.0)
    """Slope to the east and to the north where the vehicle starts, m/m."""
    walls: NDArray[np.bool_] | None = None
    """(rows, cols) pixels with an obstacle, south row first."""

    @classmethod
    def from_heightmap(
        cls, heights: NDArray[np.floating], pixel_size: float, objects: NDArray[np.uint8] | None = None
    ) -> "ReliefGround":
        """Make the ground of heights (rows, cols) in m, north row first; NaN are filled by `fill_gaps`.

        ``objects`` (rows, cols) are states of the pixels, as `MapReader.objects` gives them.
        """
        walls = None if objects is None else np.ascontiguousarray(objects[::-1] == OBSTACLE)
        return cls(np.ascontiguousarray(fill_gaps(heights)[::-1]), pixel_size, walls=walls)

    @property
    def extent(self) -> float:
        """Shorter side of the window, m."""
        return float(self.pixel_size * min(self.heights.shape))

    @property
    def spacing(self) -> float:
        """Half a pixel, m: pixel centres become vertices, as in the drives of a calibration."""
        return self.pixel_size / 2

    def sloped_at(self, easting: float, northing: float) -> "ReliefGround":
        """Return the same ground with the slope of the plane through the pixels around a place."""
        rows, cols = self.heights.shape
        side = min(_SLOPE_PIXELS, rows, cols)
        row, col = (
            int(min(max(place / self.pixel_size - side / 2, 0), size - side))
            for place, size in ((northing, rows), (easting, cols))
        )
        _, (east, north) = fit_plane(self.heights[row : row + side, col : col + side][::-1])
        return replace(self, gradient=(east / self.pixel_size, north / self.pixel_size))

    def height(self, easting: _Floats, northing: _Floats) -> _Floats:
        """Return the heights of points, m."""
        rows, cols = self.heights.shape
        col = np.clip(easting / self.pixel_size - 0.5, 0, cols - 1)
        row = np.clip(northing / self.pixel_size - 0.5, 0, rows - 1)
        west, south = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
        east, north = np.minimum(west + 1, cols - 1), np.minimum(south + 1, rows - 1)
        right, up = col - west, row - south
        below = self.heights[south, west] * (1 - right) + self.heights[south, east] * right
        above = self.heights[north, west] * (1 - right) + self.heights[north, east] * right
        bilinear: _Floats = below * (1 - up) + above * up
        return bilinear if self.walls is None else bilinear + _OBSTACLE_M * self._in_walls(easting, northing)

    def _in_walls(self, easting: _Floats, northing: _Floats) -> NDArray[np.bool_]:
        """Return which points lie in pixels with an obstacle; on a border, both sides must have one."""
        assert self.walls is not None
        rows, cols = self.walls.shape
        inside = np.ones(np.broadcast(easting, northing).shape, np.bool_)
        for side in (-_ON_BORDER, _ON_BORDER):
            col = np.floor(easting / self.pixel_size + side).astype(np.int64).clip(0, cols - 1)
            for other in (-_ON_BORDER, _ON_BORDER):
                row = np.floor(northing / self.pixel_size + other).astype(np.int64).clip(0, rows - 1)
                inside &= self.walls[row, col]
        return inside


def corridor_triangles(ground: ReliefGround, points: _Floats, half_width: float) -> NDArray[np.float32]:
    """Triangulate the ground within ``half_width`` of a line.

    Parameters
    ----------
    ground : ReliefGround
    points : array (n, 2)
        Points close together along the line, m.
    half_width : float
        m.

    Returns
    -------
    array (m, 3, 3) float32
        As from `strip_triangles`; cells have half the size of a pixel.
    """
    step = ground.spacing
    first = np.floor((points.min(axis=0) - half_width) / step).astype(np.int64) - 1
    last = np.ceil((points.max(axis=0) + half_width) / step).astype(np.int64) + 1
    easting, northing = np.meshgrid(*(np.arange(a, b + 1) * step for a, b in zip(first, last, strict=True)))
    vertices = np.stack([easting, northing, ground.height(easting, northing)], axis=-1).astype(np.float32)
    cells = (easting.shape[0] - 1, easting.shape[1] - 1)
    apart = np.ones(cells, np.bool_)
    col, row = (np.floor(points / step).astype(np.int64) - first).T
    apart[row, col] = False
    return cell_triangles(vertices, distance_transform_edt(apart) * step <= half_width + step)


_LOOK_AHEAD = 1.0
"""Distance to the point that is steered to, in wheelbases."""
_YAW_GAIN = 2.0
"""Yaw rate per angle between heading and that point, 1/s."""
_MAX_STEERING = 0.5
"""Largest speed difference that steering may command, as a share of the profile's speed."""
_STUCK_WINDOW_S = 10.0
"""A vehicle is stuck if it covers too little of the line in this time."""


@dataclass(slots=True)
class WayDrive:
    """Result of one drive along a way."""

    outcome: Outcome
    path_m: float = 0.0
    """Horizontal length of the chassis' path during the measurement."""
    pitched_rad: float = 0.0
    """Integral of abs(omega_y) dt during the measurement."""

    @property
    def c_r(self) -> float:
        """Ride cost of the way, rad/m; NaN unless completed."""
        return self.pitched_rad / self.path_m if self.outcome == "completed" and self.path_m > 0 else math.nan


def drive_way(profile: Vehicle, ground: ReliefGround, corners: _Floats, offset: float = 0.0) -> WayDrive:
    """Drive along a line in DART; the same arguments give the same bits in any process.

    Parameters
    ----------
    profile : Vehicle
    ground : ReliefGround
    corners : array (n, 2)
        The line, m east and north of the ground's south-west corner.
    offset : float
        The vehicle drives this far to the left of the line, m.
    """
    settings, guide = DriveSettings(), GuideLine.along(corners, offset)
    return follow_guide(DartVehicle(profile, *_start(profile, ground, guide, settings)), guide, profile, settings)


def _start(
    profile: Vehicle, ground: ReliefGround, guide: GuideLine, settings: DriveSettings
) -> tuple[ReliefGround, Strip, Physics, NDArray[np.float32]]:
    """Return what a `DartVehicle` takes to stand at the start of a line, with the ground along the line as a mesh."""
    half_width = profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m
    (easting, northing), (x, y) = guide.points[:2].tolist()
    strip = Strip(easting, northing, math.atan2(y - northing, x - easting), 0.0, half_width)
    # Beyond the end of the line there is ground too: the chassis' front reaches farther than its middle.
    beyond = np.array([guide.ahead(len(guide.points) - 1, metres) for metres in np.arange(0.1, 1.0, 0.1)])
    triangles = corridor_triangles(ground, np.concatenate([guide.points, beyond]), half_width)
    return ground.sloped_at(easting, northing), strip, settings.physics, triangles


def follow_guide(vehicle: DartVehicle, guide: GuideLine, profile: Vehicle, settings: DriveSettings) -> WayDrive:
    """Drive a vehicle along a line and integrate its gyroscope readings; it stands at the start of the line.

    The drive ends with the line, or when the vehicle is stuck.
    """
    period = 1 / settings.sample_hz
    quiet = round((settings.settle_s + settings.ramp_s + settings.cruise_s) / period)
    made = WayDrive("completed")
    recent: deque[int] = deque(maxlen=round(_STUCK_WINDOW_S / period))
    least = settings.stuck_share * profile.speed_mps * _STUCK_WINDOW_S
    pose, speed, sample, at = vehicle.pose(), 0.0, 0, 0
    while at < len(guide.points) - 1:
        angle = _angle_to(guide.ahead(at, _LOOK_AHEAD * profile.wheelbase_m), pose)
        held = sample * period < settings.settle_s
        speed = _next_speed(speed, 0.0 if held else max(math.cos(angle), 0.0) ** 2, profile, settings)
        _command(vehicle, angle, speed, profile)
        vehicle.advance(settings.steps_per_sample)
        before, pose = pose, vehicle.pose()
        sample += 1
        at, aside = guide.progress(pose.easting, pose.northing, at)
        if sample > quiet:
            made.path_m += math.hypot(pose.easting - before.easting, pose.northing - before.northing)
            made.pitched_rad += (abs(before.pitch_rate) + abs(pose.pitch_rate)) / 2 * period
            recent.append(at)
        if held:
            recent.clear()
        crawls = len(recent) == recent.maxlen and (at - recent[0]) * guide.step < least
        if pose.tilt > math.radians(settings.rolled_deg):
            made.outcome = "rolled"
            break
        if crawls or aside > settings.margin_m:
            made.outcome = "stuck"
            break
    return made


def _angle_to(place: tuple[float, float], pose: Pose) -> float:
    """Return the angle from the heading to the direction of a place, radians."""
    aim = math.atan2(place[1] - pose.northing, place[0] - pose.easting)
    return math.remainder(aim - pose.heading, 2 * math.pi)


def _next_speed(speed: float, share: float, profile: Vehicle, settings: DriveSettings) -> float:
    """Return the commanded speed, m/s: towards a share of the profile's speed, changed as gently as on the ramp."""
    wanted = profile.speed_mps * share
    most = profile.speed_mps / (settings.ramp_s * settings.sample_hz) if settings.ramp_s > 0 else profile.speed_mps
    return min(max(wanted, speed - most), speed + most)


def _command(vehicle: DartVehicle, angle: float, speed: float, profile: Vehicle) -> None:
    """Set the speeds of both sides; a vehicle at rest before its start does not turn either."""
    most = _MAX_STEERING * profile.speed_mps if speed > 0 or abs(angle) >= math.pi / 2 else 0.0
    difference = min(max(_YAW_GAIN * angle * profile.track_m / 2, -most), most)
    vehicle.command(speed - difference, speed + difference)
