"""The vehicle and its ground in DART. No other module uses the physics engine.

The setup uses ODE's collision detector, VELOCITY actuators and no sleeping. Wheels are cylinders of their true width:
spheres take 0.6 of the time, but sink into holes that a tyre spans. DART loads a terrain only from a file, so the mesh
is written to a temporary folder and deleted after loading.

The ground of a drive is an unbounded height function, of which a strip becomes a mesh. A patch is 3 m wide and a drive
10 m long, so the patch is continued beyond its edges: its least-squares plane is unbounded, and the residual is
mirrored at the edges (half-sample: the edge pixel comes twice). Mirroring the heights themselves would fold every slope
into a ridge. Heights are at pixel centres, with bilinear interpolation between them.
"""

import struct
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, OutputError, UsageError, install_command
from bumpymap.lab.settings import Physics
from bumpymap.rating import Vehicle


class DrivenGround(Protocol):
    """Unbounded ground, as a height function."""

    @property
    def extent(self) -> float:
        """Starts are drawn from a square of this side at the origin, m."""

    @property
    def spacing(self) -> float:
        """Vertex spacing of a mesh that resolves this ground, m."""

    @property
    def gradient(self) -> tuple[float, float]:
        """Mean slope to the east and to the north, m/m; sets the initial attitude of a vehicle."""

    def height(self, easting: Floats, northing: Floats) -> Floats:
        """Return the heights of points, m; all arrays have the same shape."""


def fit_plane(heights: Floats) -> tuple[Floats, tuple[float, float]]:
    """Fit a least-squares plane to a square heightmap (pixels, pixels) [m], north row first.

    Returns the plane at the pixel centres, m, and its slope to the east and to the north, m per pixel.
    """
    pixels = heights.shape[0]
    axis = np.arange(pixels) - (pixels - 1) / 2
    norm = pixels * float(axis @ axis) or 1.0
    east = float(heights.sum(axis=0) @ axis) / norm
    north = -float(heights.sum(axis=1) @ axis) / norm
    plane = heights.mean() + east * axis[None, :] - north * axis[:, None]
    return plane, (east, north)


def relief_and_slope(tiles: Sequence[Floats], tile_size: float) -> tuple[NDArray[np.float32], Floats]:
    """Return relief maps (n, pixels, pixels) [m] above the planes of heightmaps, and the slopes of these (n,) [deg]."""
    relief, slope = [], []
    for heights in tiles:
        plane, gradient = fit_plane(heights)
        relief.append((heights - plane).astype(np.float32))
        slope.append(np.degrees(np.arctan(np.hypot(*gradient) * len(heights) / tile_size)))
    return np.stack(relief), np.array(slope)


@dataclass(frozen=True, slots=True)
class PatchGround:
    """A patch continued without bounds: its plane plus its mirrored residual."""

    residual: Floats
    """(pixels, pixels) heights above the plane, m; south row first."""
    tile_size: float
    """Side of the patch, m."""
    mean: float
    """Height of the plane in the middle of the patch, m."""
    gradient: tuple[float, float]
    """Slope of the plane to the east and to the north, m/m."""

    @classmethod
    def from_heights(cls, heights: NDArray[np.floating], tile_size: float) -> "PatchGround":
        """Make the ground of a heightmap (pixels, pixels) [m], north row first, without NaN."""
        values = np.asarray(heights, dtype=np.float64)
        plane, (east, north) = fit_plane(values)
        per_metre = values.shape[0] / tile_size
        residual = np.ascontiguousarray((values - plane)[::-1])
        return cls(residual, tile_size, float(values.mean()), (east * per_metre, north * per_metre))

    @property
    def extent(self) -> float:
        """Period of the mirrored residual, two patches, m."""
        return 2 * self.tile_size

    @property
    def spacing(self) -> float:
        """Half a pixel, m: pixel centres become vertices, so the mesh keeps the peaks of the bilinear ground."""
        return self.tile_size / len(self.residual) / 2

    def height(self, easting: Floats, northing: Floats) -> Floats:
        """Return the heights of points, m; the patch itself lies between 0 and ``tile_size`` on both axes."""
        pixels = len(self.residual)
        scale = pixels / self.tile_size
        col, row = easting * scale - 0.5, northing * scale - 0.5
        col_0, row_0 = np.floor(col).astype(np.int64), np.floor(row).astype(np.int64)
        right, up = col - col_0, row - row_0
        west, east = _mirrored(col_0, pixels), _mirrored(col_0 + 1, pixels)
        south, north = _mirrored(row_0, pixels), _mirrored(row_0 + 1, pixels)
        below = self.residual[south, west] * (1 - right) + self.residual[south, east] * right
        above = self.residual[north, west] * (1 - right) + self.residual[north, east] * right
        middle = self.tile_size / 2
        plane = self.mean + self.gradient[0] * (easting - middle) + self.gradient[1] * (northing - middle)
        return plane + below * (1 - up) + above * up


@dataclass(frozen=True, slots=True)
class Strip:
    """The ground within ``half_width`` of a straight path, extended by ``half_width`` at both ends; m and radians."""

    easting: float
    northing: float
    heading: float
    """Direction of the path, from east to north."""
    length: float
    half_width: float


def strip_triangles(ground: DrivenGround, strip: Strip) -> NDArray[np.float32]:
    """Triangulate a strip of ground: (n, 3, 3) float32: triangle, corner, (easting, northing, upward) in m.

    The vertices lie on a grid anchored at the ground's origin, not at the path, so the pixel centres of a patch are
    vertices at any heading. Corners run counter-clockwise seen from above: ODE's meshes have one side.
    """
    forward = np.array([np.cos(strip.heading), np.sin(strip.heading)])
    start = np.array([strip.easting, strip.northing])
    ends = np.stack([start - strip.half_width * forward, start + (strip.length + strip.half_width) * forward])
    step = ground.spacing
    first = np.floor((ends.min(axis=0) - strip.half_width) / step).astype(np.int64)
    last = np.ceil((ends.max(axis=0) + strip.half_width) / step).astype(np.int64)
    easting, northing = np.meshgrid(*(np.arange(a, b + 1) * step for a, b in zip(first, last, strict=True)))
    vertices = np.stack([easting, northing, ground.height(easting, northing)], axis=-1).astype(np.float32)
    middle = np.stack([easting[:-1, :-1], northing[:-1, :-1]], axis=-1) + step / 2 - start
    along, across = middle @ forward, middle @ np.array([-forward[1], forward[0]])
    reach = strip.half_width + step
    keep = (along >= -reach) & (along <= strip.length + reach) & (np.abs(across) <= reach)
    south_west, south_east = vertices[:-1, :-1][keep], vertices[:-1, 1:][keep]
    north_west, north_east = vertices[1:, :-1][keep], vertices[1:, 1:][keep]
    lower = np.stack([south_west, south_east, north_east], axis=1)
    upper = np.stack([south_west, north_east, north_west], axis=1)
    return np.concatenate([lower, upper])


def _mirrored(index: NDArray[np.int64], pixels: int) -> NDArray[np.int64]:
    """Mirror indices by half a sample: ... 1 0 | 0 1 ... n-1 | n-1 n-2 ..."""
    wrapped = index % (2 * pixels)
    return np.minimum(wrapped, 2 * pixels - 1 - wrapped)


_GRAVITY = 9.80665
"""Standard gravity, m/s2."""
_CLEARANCE_M = 0.001
"""Height above the ground at which a vehicle starts."""
_BODY_SHARE = 0.3
"""Ratio of the body's height to its length; only relevant after a rollover."""
_URDF = (
    '<robot name="ground"><link name="ground"><collision><geometry><mesh filename="{}"/></geometry></collision></link>'
    "</robot>"
)
_OTHER_FOLDER = "set TMPDIR to a folder with free space and without special characters in its name"


@dataclass(frozen=True, slots=True)
class Pose:
    """Position, heading, tilt and pitch rate of the chassis."""

    easting: float
    northing: float
    heading: float
    """Of the forward axis, radians from east to north."""
    tilt: float
    """Angle between the chassis' upward axis and the vertical, rad."""
    pitch_rate: float
    """Angular velocity about the chassis' own left axis, rad/s, as an on-board gyroscope measures it."""


class VehicleModel(Protocol):
    """A vehicle on its ground."""

    def command(self, left_mps: float, right_mps: float) -> None:
        """Set the speed of the tyres on either side."""

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` time steps."""

    def pose(self) -> Pose:
        """Return the present state of the chassis."""


def require_dart() -> Any:
    """Import dartpy; raise UsageError if it, or what the fits to its drives need, is not installed."""
    require_scikit_learn()
    try:
        import dartpy
    except ImportError as error:
        raise UsageError(
            f"driving a vehicle needs the DART physics engine, which is not installed: {install_command('sim')}"
        ) from error
    return dartpy


def require_scikit_learn() -> None:
    """Raise UsageError if scikit-learn is not installed: before hours of driving, not after."""
    if find_spec("sklearn") is None:
        raise UsageError(f"fitting a calibration needs scikit-learn, which is not installed: {install_command('sim')}")


class DartVehicle:
    """A vehicle at the start of a strip of ground, heading along it."""

    def __init__(self, profile: Vehicle, ground: DrivenGround, strip: Strip, physics: Physics) -> None:
        self._dart = require_dart()
        self._radius = profile.wheel.radius_m
        self._world = self._make_world(physics)
        self._world.addSkeleton(self._load_ground(strip_triangles(ground, strip), physics))
        robot = self._dart.dynamics.Skeleton("vehicle")
        self._wheels: dict[str, list[Any]] = {"left": [], "right": []}
        self.chassis = self._build(robot, profile, physics)
        """DART's body of the chassis."""
        robot.disableSelfCollisionCheck()
        position = self._dart.math.Isometry3()
        rotation, translation = standing_pose(profile, ground, strip)
        position.set_rotation(rotation)
        position.set_translation(translation)
        robot.getRootJoint().setPositions(self._dart.dynamics.FreeJoint.convertToPositions(position))
        self._world.addSkeleton(robot)

    def command(self, left_mps: float, right_mps: float) -> None:
        """Set the speed of the tyres on either side."""
        for side, speed in (("left", left_mps), ("right", right_mps)):
            for joint in self._wheels[side]:
                joint.setCommand(0, speed / self._radius)

    def advance(self, steps: int) -> None:
        """Simulate ``steps`` time steps with the last commands."""
        for _ in range(steps):
            self._world.step(False)

    def pose(self) -> Pose:
        """Return the present state of the chassis."""
        matrix = self.chassis.getWorldTransform().matrix()
        return Pose(
            easting=float(matrix[0, 3]),
            northing=float(matrix[1, 3]),
            heading=float(np.arctan2(matrix[1, 0], matrix[0, 0])),
            tilt=float(np.arccos(np.clip(matrix[2, 2], -1.0, 1.0))),
            pitch_rate=float(self.chassis.getSpatialVelocity()[1]),
        )

    def _make_world(self, physics: Physics) -> Any:
        world = self._dart.simulation.World()
        world.setGravity([0.0, 0.0, -_GRAVITY])
        world.setTimeStep(physics.time_step)
        world.setCollisionDetector(self._dart.simulation.CollisionDetectorType.ODE)
        sleeping = world.getDeactivationOptions()
        sleeping.mEnabled = False
        world.setDeactivationOptions(sleeping)
        return world

    def _load_ground(self, triangles: NDArray[np.float32], physics: Physics) -> Any:
        """Load the ground into the engine as a mesh, by way of a temporary file."""
        options = self._dart.utils.DartLoaderOptions()
        options.mDefaultRootJointType = self._dart.utils.DartLoaderRootJointType.FIXED
        loader = self._dart.utils.DartLoader()
        loader.setOptions(options)
        try:
            with tempfile.TemporaryDirectory(prefix="bumpymap-") as folder:
                path = Path(folder) / "ground.stl"
                path.write_bytes(stl_bytes(triangles))
                # Not as_uri(): DART does not decode %20.
                urdf = _URDF.format(escape("file://" + path.as_posix(), {'"': "&quot;"}))
                skeleton = loader.parseSkeletonString(urdf, self._dart.common.Uri(""))
        except OSError as error:
            raise OutputError(f"cannot write the ground to a temporary file: {error}; {_OTHER_FOLDER}") from error
        if skeleton is None:
            raise OutputError(f"the physics engine cannot read {path}; {_OTHER_FOLDER}")
        self._set_surface(skeleton.getBodyNode(0).getShapeNode(0), physics)
        return skeleton

    def _build(self, robot: Any, profile: Vehicle, physics: Physics) -> Any:
        """Build chassis, two rockers and four wheels; return the chassis."""

        def inertia(mass: float, moments: tuple[float, float, float]) -> Any:
            return self._dart.dynamics.Inertia(mass, [0.0, 0.0, 0.0], np.diag(moments))

        turned = self._dart.math.Isometry3()  # a cylinder's axis is z: to the left, it is the axle
        turned.set_rotation([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
        _, chassis = robot.createFreeJointAndBodyNodePair()
        chassis.setInertia(inertia(profile.chassis.mass_kg, profile.chassis.inertia_kgm2))
        self._add_belly(chassis, profile, physics)
        for side, left in (("left", profile.track_m / 2), ("right", -profile.track_m / 2)):
            pivot, rocker = robot.createRevoluteJointAndBodyNodePair(chassis)
            rocker.setInertia(inertia(profile.rocker.mass_kg, profile.rocker.inertia_kgm2))
            self._hinge(pivot, (0.0, left, -profile.chassis.com_height_m))
            pivot.setLimitEnforcement(True)
            pivot.setPositionLowerLimit(0, -profile.rocker.limit_rad)
            pivot.setPositionUpperLimit(0, profile.rocker.limit_rad)
            pivot.setSpringStiffness(0, profile.rocker.stiffness_nm_per_rad)
            pivot.setDampingCoefficient(0, profile.rocker.damping_nms_per_rad)
            for forward in (profile.wheelbase_m / 2, -profile.wheelbase_m / 2):
                axle, wheel = robot.createRevoluteJointAndBodyNodePair(rocker)
                wheel.setInertia(inertia(profile.wheel.mass_kg, wheel_inertia(profile)))
                self._hinge(axle, (forward, 0.0, 0.0))
                axle.setActuatorType(self._dart.dynamics.ActuatorType.VELOCITY)
                tyre = self._dart.dynamics.CylinderShape(profile.wheel.radius_m, profile.wheel.width_m)
                shape = wheel.createShapeNode(tyre)
                shape.setRelativeTransform(turned)
                shape.createCollisionAspect()
                shape.createDynamicsAspect()
                self._set_surface(shape, physics)
                self._wheels[side].append(axle)
        return chassis

    def _add_belly(self, chassis: Any, profile: Vehicle, physics: Physics) -> None:
        """Add a collision box to the chassis, from the belly upwards."""
        belly = profile.belly
        size = [belly.length_m, belly.width_m, _BODY_SHARE * belly.length_m]
        node = chassis.createShapeNode(self._dart.dynamics.BoxShape(size))
        node.createCollisionAspect()
        node.createDynamicsAspect()
        place = self._dart.math.Isometry3()
        place.set_translation([0.0, 0.0, _belly_height(profile) + size[2] / 2])
        node.setRelativeTransform(place)
        self._set_surface(node, physics)

    def _hinge(self, joint: Any, place: tuple[float, float, float]) -> None:
        """Set a joint's axis to the left and its position in the parent body."""
        joint.setAxis([0.0, 1.0, 0.0])
        frame = self._dart.math.Isometry3()
        frame.set_translation(place)
        joint.setTransformFromParentBodyNode(frame)

    @staticmethod
    def _set_surface(shape: Any, physics: Physics) -> None:
        surface = shape.getDynamicsAspect()
        surface.setFrictionCoeff(physics.friction)
        surface.setRestitutionCoeff(0.0)


def wheel_inertia(profile: Vehicle) -> tuple[float, float, float]:
    """Return the moments of inertia of a solid cylinder about its forward, left (axle) and upward axis, kg m^2."""
    wheel = profile.wheel
    across = wheel.mass_kg * (3 * wheel.radius_m**2 + wheel.width_m**2) / 12
    return across, wheel.mass_kg * wheel.radius_m**2 / 2, across


def standing_pose(
    profile: Vehicle, ground: DrivenGround, strip: Strip
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the initial pose: along the strip, parallel to the ground's mean slope, just above its highest bumps.

    Neither wheels nor belly start inside the ground, even if the start is on a rock. Returns a rotation (3, 3), whose
    columns are the forward, left and upward axis, and the place (3,) of the chassis' centre of mass, m.
    """
    east, north = ground.gradient
    cos, sin = np.cos(strip.heading), np.sin(strip.heading)
    upward = np.array([-east, -north, 1.0]) / np.sqrt(1 + east**2 + north**2)
    forward = np.array([cos, sin, east * cos + north * sin])
    forward /= np.linalg.norm(forward)
    rotation = np.stack([forward, np.cross(upward, forward), upward], axis=1)
    half_base, half_track, down = profile.wheelbase_m / 2, profile.track_m / 2, -profile.chassis.com_height_m
    wheels = np.array([[x, y, down] for x in (half_base, -half_base) for y in (half_track, -half_track)]) @ rotation.T
    radius = profile.wheel.radius_m
    offset = np.linspace(-radius, radius, 25)
    dx, dy = (axis.ravel() for axis in np.meshgrid(offset, offset))
    under = dx**2 + dy**2 <= radius**2
    dx, dy = dx[under], dy[under]
    easting = strip.easting + wheels[:, :1] + dx
    northing = strip.northing + wheels[:, 1:2] + dy
    centre = ground.height(easting, northing) + np.sqrt(radius**2 - dx**2 - dy**2)
    spans = (np.linspace(-size / 2, size / 2, 41) for size in (profile.belly.length_m, profile.belly.width_m))
    along, across = (axis.ravel() for axis in np.meshgrid(*spans))
    belly = np.stack([along, across, np.full(along.size, _belly_height(profile))], axis=1) @ rotation.T
    rise = ground.height(strip.easting + belly[:, 0], strip.northing + belly[:, 1]) - belly[:, 2]
    upward_m = max(float((centre.max(axis=1) - wheels[:, 2]).max()), float(rise.max())) + _CLEARANCE_M
    return rotation, np.array([strip.easting, strip.northing, upward_m])


def _belly_height(profile: Vehicle) -> float:
    """Return the height of the underside relative to the centre of mass, m; usually negative."""
    return profile.belly.clearance_m - profile.wheel.radius_m - profile.chassis.com_height_m


def stl_bytes(triangles: NDArray[np.float32]) -> bytes:
    """Encode triangles, (n, 3, 3) float32, as binary STL."""
    record = np.dtype([("normal", "<f4", 3), ("corner", "<f4", (3, 3)), ("attribute", "<u2")])
    body = np.zeros(len(triangles), dtype=record)
    body["corner"] = triangles
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    body["normal"] = across / np.linalg.norm(across, axis=1, keepdims=True)
    return b"bumpymap".ljust(80) + struct.pack("<I", len(body)) + bytes(body.tobytes())
