"""Drive along a way: a line with corners over the relief of a survey, at the profile's speed.

C_r is measured as in the drives of a calibration, after settling and acceleration: the integral of abs(omega_y) dt over
the horizontal length of the path. The vehicle steers to a point ahead on the line. The more it has to turn, the slower
it drives; at 90 degrees and more it turns on the spot. What it pitches while it turns counts, for so a gyroscope on
board would measure it; how much that is, is recorded beside it. Length and pitch are recorded by tile too.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.simulate.drive import DriveSettings, Outcome
from bumpymap.lab.simulate.guide import GuideLine
from bumpymap.lab.simulate.model import DartVehicle, Pose, VehicleModel
from bumpymap.lab.simulate.relief import ReliefGround, corridor_triangles
from bumpymap.lab.simulate.terrain import Strip
from bumpymap.rating import Vehicle

__all__ = ["Stop", "WayDrive", "drive_way", "follow_guide", "vehicle_on_way"]

_LOOK_AHEAD = 1.0
"""Distance to the point that is steered to, in wheelbases."""
_YAW_GAIN = 2.0
"""Yaw rate per angle between heading and that point, 1/s."""
_MAX_STEERING = 0.5
"""Largest speed difference that steering may command, as a share of the profile's speed."""
_TURNING_RAD = math.radians(15)
"""At a larger angle to the point ahead, the vehicle counts as turning."""
_STUCK_WINDOW_S = 10.0
"""A vehicle is stuck if it covers too little of the line in this time."""


@dataclass(frozen=True, slots=True)
class Stop:
    """A stop on the way."""

    at_m: float
    """Distance along the line at which the vehicle begins to brake, m."""
    seconds: float
    """How long it stands, s."""


@dataclass(slots=True)
class WayDrive:
    """Result of one drive along a way."""

    outcome: Outcome
    path_m: float = 0.0
    """Horizontal length of the chassis' path during the measurement."""
    pitched_rad: float = 0.0
    """Integral of abs(omega_y) dt during the measurement."""
    reached_m: float = 0.0
    """Distance along the line at the end."""
    aside_m: float = 0.0
    """Largest distance from the line."""
    turning_m: float = 0.0
    """Part of ``path_m`` on which the vehicle was turning."""
    turning_rad: float = 0.0
    """Part of ``pitched_rad`` in which it was turning."""
    seconds: float = 0.0
    tiles: list[tuple[int, int, float, float]] = field(default_factory=list)
    """Column and row in the window, from the south-west, with the path [m] and the pitch motion [rad] in each tile."""

    @property
    def c_r(self) -> float:
        """Ride cost of the way, rad/m; NaN unless completed."""
        return self.pitched_rad / self.path_m if self.outcome == "completed" and self.path_m > 0 else math.nan

    @classmethod
    def from_record(cls, fields: dict[str, Any]) -> "WayDrive":
        """Make it of the fields that a journal holds."""
        tiles = [(int(col), int(row), float(path), float(pitch)) for col, row, path, pitch in fields["tiles"]]
        return cls(**(fields | {"tiles": tiles}))


def drive_way(
    profile: Vehicle,
    ground: ReliefGround,
    corners: NDArray[np.float64],
    tile_size: float,
    offset: float = 0.0,
    settings: DriveSettings | None = None,
) -> WayDrive:
    """Drive along a line in DART; the same arguments give the same bits in any process.

    Parameters
    ----------
    profile : Vehicle
    ground : ReliefGround
    corners : array (n, 2)
        The line, m east and north of the ground's south-west corner.
    tile_size : float
        Side of the tiles by which the pitch is recorded, m.
    offset : float
        The vehicle drives this far to the left of the line, m.
    settings : DriveSettings, optional
        ``measure_s`` has no effect: a drive ends with the line, or when the vehicle is stuck.
    """
    settings = settings or DriveSettings()
    guide = GuideLine.along(corners, offset)
    return follow_guide(vehicle_on_way(profile, ground, guide, settings), guide, profile, tile_size, settings)


def vehicle_on_way(profile: Vehicle, ground: ReliefGround, guide: GuideLine, settings: DriveSettings) -> DartVehicle:
    """Return a vehicle in DART at the start of a line, with the ground along the line as a mesh."""
    half_width = profile.wheelbase_m / 2 + profile.track_m / 2 + profile.wheel.radius_m + settings.margin_m
    easting, northing = guide.points[0].tolist()
    strip = Strip(easting, northing, guide.heading, guide.length, half_width)
    # Beyond the end of the line there is ground too: the chassis' front reaches farther than its middle.
    beyond = np.array([guide.ahead(len(guide.points) - 1, metres) for metres in np.arange(0.1, 1.0, 0.1)])
    triangles = corridor_triangles(ground, np.concatenate([guide.points, beyond]), half_width)
    return DartVehicle(profile, ground.sloped_at(easting, northing), strip, settings.physics, triangles)


def follow_guide(
    vehicle: VehicleModel,
    guide: GuideLine,
    profile: Vehicle,
    tile_size: float,
    settings: DriveSettings,
    stops: Sequence[Stop] = (),
) -> WayDrive:
    """Drive a vehicle along a line and integrate its gyroscope readings; it stands at the start of the line.

    ``stops`` are in the order of their distances.
    """
    period = 1 / settings.sample_hz
    quiet = round((settings.settle_s + settings.ramp_s + settings.cruise_s) / period)
    made = WayDrive("completed")
    tiles: dict[tuple[int, int], list[float]] = {}
    recent: deque[int] = deque(maxlen=round(_STUCK_WINDOW_S / period))
    least = settings.stuck_share * profile.speed_mps * _STUCK_WINDOW_S
    pose, speed, sample, at = vehicle.pose(), 0.0, 0, 0
    halts = _Halts(stops)
    while at < len(guide.points) - 1:
        angle = _angle_to(guide.ahead(at, _LOOK_AHEAD * profile.wheelbase_m), pose)
        held = sample * period < settings.settle_s or halts.hold(at * guide.step, speed, period)
        speed = _next_speed(speed, 0.0 if held else max(math.cos(angle), 0.0) ** 2, profile, settings)
        _command(vehicle, angle, speed, profile)
        vehicle.advance(settings.steps_per_sample)
        before, pose = pose, vehicle.pose()
        sample += 1
        at, aside = guide.progress(pose.easting, pose.northing, at)
        made.aside_m = max(made.aside_m, aside)
        if sample > quiet:
            _record(made, tiles, before, pose, period, tile_size, turning=abs(angle) > _TURNING_RAD)
            recent.append(at)
        if held:
            recent.clear()
        if pose.tilt > math.radians(settings.rolled_deg):
            made.outcome = "rolled"
            break
        crawls = len(recent) == recent.maxlen and (at - recent[0]) * guide.step < least
        if crawls or aside > settings.margin_m:
            made.outcome = "stuck"
            break
    made.reached_m, made.seconds = at * guide.step, sample * period
    made.tiles = [(col, row, path, pitch) for (col, row), (path, pitch) in tiles.items()]
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


class _Halts:
    """The stops that are still ahead, and how long the vehicle has stood at the present one."""

    def __init__(self, stops: Sequence[Stop]) -> None:
        self._ahead = deque(stops)
        self._stood = 0.0

    def hold(self, along: float, speed: float, period: float) -> bool:
        """Return whether the vehicle brakes or stands now, ``along`` m after the start of the line."""
        if not self._ahead or along < self._ahead[0].at_m:
            return False
        self._stood += period if speed == 0 else 0.0
        if self._stood < self._ahead[0].seconds:
            return True
        self._ahead.popleft()
        self._stood = 0.0
        return False


def _command(vehicle: VehicleModel, angle: float, speed: float, profile: Vehicle) -> None:
    """Set the speeds of both sides; a vehicle at rest before its start does not turn either."""
    most = _MAX_STEERING * profile.speed_mps if speed > 0 or abs(angle) >= math.pi / 2 else 0.0
    difference = min(max(_YAW_GAIN * angle * profile.track_m / 2, -most), most)
    vehicle.command(speed - difference, speed + difference)


def _record(
    made: WayDrive,
    tiles: dict[tuple[int, int], list[float]],
    before: Pose,
    pose: Pose,
    period: float,
    tile_size: float,
    *,
    turning: bool,
) -> None:
    """Add one sample to the sums."""
    path = math.hypot(pose.easting - before.easting, pose.northing - before.northing)
    pitched = (abs(before.pitch_rate) + abs(pose.pitch_rate)) / 2 * period
    made.path_m += path
    made.pitched_rad += pitched
    if turning:
        made.turning_m += path
        made.turning_rad += pitched
    sums = tiles.setdefault((int(pose.easting // tile_size), int(pose.northing // tile_size)), [0.0, 0.0])
    sums[0] += path
    sums[1] += pitched
