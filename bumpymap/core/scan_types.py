"""Records of the scan job: a scan, its polar grid, the measures of its sectors, and their classes.

A scan is in the sensor frame: x forward, y to the left, z up, metres. Azimuth is counted from x towards y, in radians.
One row of a ``SectorStack`` is one sector with enough points; all its arrays have the same length.
"""

import math
from array import array
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpymap.core.config import PolarSettings, ScanMethod
from bumpymap.core.settings import brief_repr
from bumpymap.core.types import NO_CLASS

NEAREST_S = 0.2
"""A time has a pose if one of the track is as near as this ..."""
LONGEST_GAP_S = 1.5
"""... or if it lies between two that are no farther apart than this: poses at 1 Hz are interpolated."""
_SPEED_S = 0.05
"""Beyond the ends, the motion is that over at least this long: two poses a moment apart tell no speed."""
SCAN_S = 2.0
"""Poses this long before and after a frame are kept for deskewing: no scan takes longer."""


@dataclass(frozen=True, slots=True)
class PoseTrack:
    """Poses of a sensor in the order of time."""

    times: NDArray[np.float64]
    """(n,) s, increasing."""
    poses: NDArray[np.float64]
    """(n, 4, 4) transforms from the sensor frame to the world frame, m."""

    def at(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the poses at given times, (m, 4, 4).

        The place is interpolated along a line, the rotation at constant speed (slerp). Before the first and after the
        last pose, the motion continues as between the nearest ones, see ``_SPEED_S``.
        """
        if len(self.times) == 1 or not len(times):
            return np.repeat(self.poses[:1], len(times), axis=0)
        from scipy.spatial.transform import Rotation

        end = len(self.times) - 1
        before = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, end - 1)
        after = before + 1
        after[times < self.times[0]] = min(int(np.searchsorted(self.times, self.times[0] + _SPEED_S)), end)
        late = int(np.searchsorted(self.times, self.times[-1] - _SPEED_S, side="right")) - 1
        before[times > self.times[-1]] = max(late, 0)
        share = (times - self.times[before]) / (self.times[after] - self.times[before])
        first, second = self.poses[before], self.poses[after]
        poses = np.tile(np.eye(4), (len(times), 1, 1))
        poses[:, :3, 3] = first[:, :3, 3] + share[:, None] * (second[:, :3, 3] - first[:, :3, 3])
        between = first[:, :3, :3].transpose(0, 2, 1) @ second[:, :3, :3]
        turn = Rotation.from_rotvec(Rotation.from_matrix(between).as_rotvec() * share[:, None])
        poses[:, :3, :3] = first[:, :3, :3] @ turn.as_matrix()
        return poses

    def covers(self, times: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which times have a pose, see ``NEAREST_S`` and ``LONGEST_GAP_S``."""
        after = np.searchsorted(self.times, times)
        left, right = np.clip(after - 1, 0, len(self.times) - 1), np.clip(after, 0, len(self.times) - 1)
        nearest = np.minimum(np.abs(times - self.times[left]), np.abs(times - self.times[right]))
        inside = (times >= self.times[0]) & (times <= self.times[-1])
        is_short = self.times[right] - self.times[left] <= LONGEST_GAP_S
        return np.asarray((nearest <= NEAREST_S) | (inside & is_short))

    def around(self, time: float, seconds: float) -> "PoseTrack":
        """Return the poses within some seconds of a time, and one more on each side; times are relative to it."""
        first = max(int(np.searchsorted(self.times, time - seconds)) - 1, 0)
        last = int(np.searchsorted(self.times, time + seconds, side="right")) + 1
        return PoseTrack(self.times[first:last] - time, self.poses[first:last])


@dataclass(frozen=True, slots=True)
class BagMessage:
    """The place of a scan in a bag."""

    topic: str
    number: int
    """Position among the messages of the topic, from 0."""
    time_ns: int
    """Time under which the bag stores the message."""
    place: int
    """Position among those messages of the topic that have the same ``time_ns``, from 0."""
    stamp_ns: int
    """Time of the measurement, from the header of the message; ``time_ns`` if the header has none."""
    frame_id: str
    """Coordinate frame of the points."""
    bytes: int
    """Size of the message."""


@dataclass(frozen=True, slots=True)
class Frame:
    """A scan that was found, before it is read."""

    path: Path
    """File of the scan; or the bag, a file or a folder."""
    message: BagMessage | None = None
    """None if ``path`` is a file of its own."""
    pose: NDArray[np.float64] | None = None
    """(4, 4) transform from the sensor frame to the world frame, m; None if unknown."""
    motion: PoseTrack | None = None
    """Poses around the frame, at times relative to it; None if unknown."""
    pose_frame: str = "map"
    """Coordinate frame that the pose leads to."""
    name: str = ""
    """Stem of its output files, unique in a run; empty before the run has named its frames."""

    @property
    def origin(self) -> str:
        """The file; or the bag, topic and number of the message."""
        where = "" if self.message is None else f", message {self.message.number} of {self.message.topic}"
        return f"{self.path}{where}"


CLASSES = 3
"""Class 0 (smooth) to 2 (rough) of a scan's sectors."""
NOT_TRAVERSABLE = 255
"""Class of a sector whose points are not ground, and of points outside of all classified sectors."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """Number of returns of a file that were dropped, by reason."""

    no_return: int = 0
    """At (0, 0, 0), or all three coordinates are NaN: the beam hit nothing."""
    not_finite: int = 0
    """A coordinate is infinite, or one or two are NaN."""
    on_robot: int = 0
    """On the robot that carries the sensor."""


@dataclass(frozen=True, slots=True)
class Scan:
    """One revolution of a LiDAR, in the sensor frame."""

    __repr__ = brief_repr

    points: NDArray[np.float32]
    """(n, 3) x forward, y left, z up, m; finite."""
    intensity: NDArray[np.float32] | None = None
    """(n,) as stored in the file; None if the file has none."""
    label: NDArray[np.uint16] | None = None
    """(n,) semantic ids; None if the scan has no labels."""
    name: str = ""
    """Name of the frame: the stem of its file."""
    dropped: Dropped = Dropped()
    """Returns of the file that were left out."""
    time: NDArray[np.float32] | None = None
    """(n,) s after the time of the frame: as in the file, or after its first return if the file has times of day; None
    if the file has none."""
    heading_rad: float = 0.0
    """Of the x axis, counter-clockwise, in a frame that does not turn with the robot: sectors keep their directions."""

    def __post_init__(self) -> None:
        count = len(self.points)
        if self.points.shape != (count, 3):
            raise ValueError(f"points are {self.points.shape}; a scan has (n, 3)")
        for name in ("intensity", "label", "time"):
            values = getattr(self, name)
            if values is not None and values.shape != (count,):
                raise ValueError(f"{name} is {values.shape}; the scan has {count} points")


@dataclass(frozen=True, slots=True)
class SectorStack:
    """Measured sectors of one scan: one row each, only sectors with more than ``least_points`` points."""

    __repr__ = brief_repr

    settings: PolarSettings
    azimuth_start_rad: float
    """Azimuth at which sector 0 of every zone starts, counter-clockwise from the x axis."""
    origin_height: float
    """Height of the origin of the frame above the ground near it, m; NaN without level ground."""
    zone: NDArray[np.int16]
    """(n,) 0 is the innermost; rows are sorted by zone, ring, sector."""
    ring: NDArray[np.int16]
    """(n,) inside the zone, 0 is the innermost."""
    sector: NDArray[np.int16]
    """(n,) around the zone, counter-clockwise from ``azimuth_start_rad``."""
    count: NDArray[np.int32]
    """(n,) points."""
    normal: NDArray[np.float32]
    """(n, 3) normal of the plane through the ground points, sensor frame, n_z >= 0; zeros without ground."""
    traversable: NDArray[np.bool_]
    """(n,) True if there is ground, its normal is close enough to vertical, and it is not seen from below."""
    heights: NDArray[np.float32]
    """(n, pixels, pixels) mean z of ground points above their plane, m; zeros without ground. Rows go outwards with
    distance, columns counter-clockwise with azimuth, both in equal steps; empty pixels are filled."""
    coverage: NDArray[np.float32]
    """(n,) share of the pixels that hold a ground point, 0..1."""
    variance: NDArray[np.float32]
    """(n,) population variance of z over the ground points, m^2; NaN without ground."""
    residual: NDArray[np.float32]
    """(n,) mean perpendicular distance of the ground points to that plane, m; NaN without ground."""
    label: NDArray[np.int16]
    """(n,) most frequent label of the points (the smallest if tied); -1 if the scan has no labels."""
    ground_count: NDArray[np.int32]
    """(n,) points that are ground."""
    obstacle_count: NDArray[np.int32]
    """(n,) points between ``belly_m`` and ``height_m`` above the ground, without those that are airborne."""
    overhead_count: NDArray[np.int32]
    """(n,) points from ``height_m`` above the ground on."""
    obstacle: NDArray[np.bool_]
    """(n,) whether something stands on the sector's ground between ``belly_m`` and ``height_m`` above it, or the ground
    drops by more than ``belly_m``: at a ditch, an edge, a step down."""
    drop: NDArray[np.bool_]
    """(n,) whether the ground drops so."""
    obstacle_height: NDArray[np.float32]
    """(n,) top of the obstacle, above the ground, m; NaN without one."""
    clearance: NDArray[np.float32]
    """(n,) height above the ground of the lowest object that is higher than ``height_m``, m; NaN without one."""
    objects: NDArray[np.float32]
    """(n, 2, pixels, pixels) of the points that are not ground and not higher above it than twice ``height_m``: the
    highest in each pixel, m, and their number; zeros where there are none."""
    measures: NDArray[np.float64]
    """(n, 7) means over the points of what ``places`` say where they are."""
    places: NDArray[np.float32]
    """(bins, 8) measures of small bins around the sensor, and of those about them, wherever sectors lie, and the number
    of ground points there: see ``scan/sectors.cpp``."""
    point_place: NDArray[np.uint16]
    """(m, 2) place of each point of the scan in those bins, outwards and around, in 256ths of a bin; outwards 65535
    beyond the grid."""
    point_sector: NDArray[np.int32]
    """(m,) row of the sector that holds each point of the scan; -1 if none does."""
    point_ground: NDArray[np.bool_]
    """(m,) whether the point is ground."""
    point_airborne: NDArray[np.bool_]
    """(m,) whether it lies alone, up to twice ``height_m`` above the ground: rain, dust, insects; no obstacle."""
    point_height: NDArray[np.float32]
    """(m,) height above the ground, m; NaN where no ground is known."""


@dataclass(frozen=True, slots=True)
class SectorRide:
    """The ride of a vehicle on the ground of sectors, as in a survey's map; unknown where points are too few."""

    c_r: NDArray[np.float32]
    """(n,) mean absolute change of the vehicle's pitch per metre driven, rad/m; NaN if unknown."""
    c_r_low: NDArray[np.float32]
    """(n,) lower end of its 80 % interval, rad/m."""
    c_r_high: NDArray[np.float32]
    """(n,) upper end, rad/m."""
    class_id: NDArray[np.uint8]
    """(n,) class of a survey's map, 0 (flattest) to 3 (roughest, or the vehicle fails); ``NO_CLASS`` if unknown."""
    p_fail: NDArray[np.float32]
    """(n,) share of drives that fail, 0..1; NaN if unknown."""
    limits: NDArray[np.float32]
    """(3,) of C_r between the classes, rad/m."""

    @classmethod
    def unknown(cls, sectors: int) -> "SectorRide":
        """Return the ride on sectors of which none could be rated."""
        nothing = np.full(sectors, np.nan, np.float32)
        no_class, no_limits = np.full(sectors, NO_CLASS, np.uint8), np.full(3, np.nan, np.float32)
        return cls(nothing, nothing, nothing, no_class, nothing, no_limits)


@dataclass(frozen=True, slots=True)
class ClassedSectors:
    """Measured sectors with their classes."""

    __repr__ = brief_repr

    sectors: SectorStack
    class_id: NDArray[np.uint8]
    """(n,) 0 smooth .. 2 rough; ``NOT_TRAVERSABLE`` if the sector is not traversable."""
    stripes: NDArray[np.float32] | None
    """(n,) stripe count of the filter method; None from the learned one."""
    method: ScanMethod
    """Method that classified the sectors."""
    field: NDArray[np.float32]
    """(bins, CLASSES + 1) the class of the ground in the bins of ``sectors.places``: see ``scan/sectors.py``."""
    point_class: NDArray[np.uint8]
    """(m,) class of the ground at each point of the scan; ``NOT_TRAVERSABLE`` where none is known."""
    confidence: NDArray[np.float32] | None = None
    """(n,) class probability from the learned method, NaN if not traversable; None from the filter method."""
    ride: SectorRide | None = None
    """The ride of a vehicle on them; None if none was named."""


Message = TypeVar("Message")


@dataclass(frozen=True, slots=True)
class GroundGrid:
    """The ground around the sensor in square cells: x forward, y to the left, the sensor in the middle.

    Arrays are (side, side), from the lowest y upwards, and in each row from the lowest x. Unknown values are NaN.
    """

    __repr__ = brief_repr

    resolution_m: float
    """Side of a cell."""
    occupancy: NDArray[np.int8]
    """0, 33, 66 on known ground of class 0, 1, 2; with a vehicle 0 to 98, in proportion to C_r up to the limit of its
    class 3, and where C_r is unknown, to the limits of its classes 1, 2, 3 for class 0, 1, 2. 100 where an obstacle
    stands, the ground drops, has a step higher than the belly or is not traversable, or the vehicle fails; -1 where
    nothing is known: neither ground nor an obstacle was seen, and more than the belly's height of what may stand there
    is hidden from the sensor."""
    class_id: NDArray[np.uint8]
    """Class of the ground; ``NOT_TRAVERSABLE`` also where none is known."""
    elevation: NDArray[np.float32]
    """Mean z of the ground points in the cell, m, in the frame of the cells."""
    step: NDArray[np.float32]
    """Largest difference in elevation from the cells beside it, m."""
    obstacle_height: NDArray[np.float32]
    """Top of the obstacle in the cell between belly and height of the vehicle, above the ground, m."""
    clearance: NDArray[np.float32]
    """Height above the ground of the lowest point in the cell that is higher than the vehicle, m."""
    c_r: NDArray[np.float32] | None = None
    """Ride of the vehicle on the cell's sector, rad/m; None without a vehicle."""
    corner_m: tuple[float, float] | None = None
    """x and y of the lowest corner, m, if the cells are those of a frame that does not move with the robot (``odom``),
    or, with several sensors, of the robot: its axes and heights count, and the sensor, or the robot, is within half a
    cell of the middle. None: of the sensor's frame."""

    @property
    def side(self) -> int:
        """Cells along each side."""
        return len(self.occupancy)

    @property
    def reach_m(self) -> float:
        """Distance from the sensor to each side."""
        return 0.5 * self.side * self.resolution_m

    def fill(self, message: Message, header: Any) -> Message:
        """Fill a message ``nav_msgs/OccupancyGrid`` and return it.

        Parameters
        ----------
        message : nav_msgs/OccupancyGrid
            Of any library with the same names of attributes. Its data become an ``array.array``, which rclpy takes
            without looking at every cell.
        header : std_msgs/Header
            Of the point cloud: the grid lies in the sensor's frame at its time; or in that of the poses, which
            ``frame_id`` then names.
        """
        grid: Any = message
        grid.header = header
        grid.info.map_load_time = header.stamp
        grid.info.resolution = self.resolution_m
        grid.info.width = grid.info.height = self.side
        corner = self.corner_m or (-self.reach_m, -self.reach_m)
        grid.info.origin.position.x, grid.info.origin.position.y = corner
        grid.info.origin.orientation.w = 1.0
        grid.data = array("b", self.occupancy.tobytes())
        return message


@dataclass(frozen=True, slots=True)
class SectorBounds:
    """Distance and azimuth ranges of sectors."""

    near: NDArray[np.float64]
    """(n,) inner horizontal distance from the sensor, m."""
    far: NDArray[np.float64]
    """(n,) outer distance, m."""
    right: NDArray[np.float64]
    """(n,) azimuth at which the sector starts, counter-clockwise from the x axis, 0 to 2 pi, rad."""
    left: NDArray[np.float64]
    """(n,) azimuth at which it ends, greater than ``right``, rad."""


def sector_bounds(stack: SectorStack) -> SectorBounds:
    """Return the bounds of the sectors of a stack."""
    settings = stack.settings
    edges = np.array([*settings.zone_starts_m, settings.end_m])
    depth = np.diff(edges) / settings.rings
    width = 2.0 * math.pi / np.array(settings.sectors)
    near = edges[stack.zone] + stack.ring * depth[stack.zone]
    right = (stack.azimuth_start_rad + stack.sector * width[stack.zone]) % (2.0 * math.pi)
    return SectorBounds(near, near + depth[stack.zone], right, right + width[stack.zone])


def first_cells(settings: PolarSettings) -> NDArray[np.int64]:
    """Return the number of the first cell of each zone, counted in zone, ring, sector order."""
    cells = np.array(settings.sectors) * settings.rings
    return np.asarray(np.cumsum(cells) - cells)


def cell_numbers(stack: SectorStack) -> NDArray[np.int64]:
    """Return the numbers of sectors among all cells of their grid, (n,), counted in zone, ring, sector order."""
    sectors, first = np.array(stack.settings.sectors), first_cells(stack.settings)
    return np.asarray(first[stack.zone] + stack.ring * sectors[stack.zone] + stack.sector)


@dataclass(frozen=True, slots=True)
class PolarCells:
    """Places around the sensor, such as pixels, in a polar grid; arrays have any one shape."""

    settings: PolarSettings
    first: NDArray[np.int32]
    """Number of the first cell in the ring of each place, counted as by `cell_numbers`; outside, that of all cells."""
    sectors: NDArray[np.floating]
    """Sectors around its zone; 0 outside."""
    turn: NDArray[np.floating]
    """Its azimuth as a fraction of a turn."""

    @classmethod
    def of(cls, settings: PolarSettings, distance: NDArray[np.floating], turn: NDArray[np.floating]) -> "PolarCells":
        """Find the rings of places at some distances from the sensor, m."""
        edges = np.array([*settings.zone_starts_m, settings.end_m], distance.dtype)
        sectors, rings = np.array(settings.sectors), np.array(settings.rings)
        zone = np.searchsorted(edges, distance, side="right") - 1
        inside = (zone >= 0) & (zone < len(sectors))
        zone = np.where(inside, zone, 0)
        ring = ((distance - edges[zone]) / np.diff(edges)[zone] * rings[zone]).astype(np.int64)
        first = first_cells(settings)[zone] + np.clip(ring, 0, rings[zone] - 1) * sectors[zone]
        around = np.where(inside, sectors[zone], 0).astype(distance.dtype)
        return cls(settings, np.where(inside, first, int(sectors @ rings)).astype(np.int32), around, turn)

    def cells(self, azimuth_start_rad: float) -> NDArray[np.int32]:
        """Return the number of the cell of each place; outside of the grid, the number of all cells."""
        share = self.turn - self.turn.dtype.type(azimuth_start_rad / (2.0 * math.pi))
        sector = np.minimum((share - np.floor(share)) * self.sectors, np.maximum(self.sectors - 1, 0))
        return np.asarray(self.first + sector.astype(np.int32))
