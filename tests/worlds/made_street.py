"""A street to drive along: lanes, kerbs, pavements, walls, crowns over the road, parked cars, and cars that move."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.scans.ground import GroundSample, SceneGround
from bumpymap.lab.worlds.scans.lidar import Sensor, SimulatedScan, posture, simulate_scan
from bumpymap.lab.worlds.scans.scene import Scene
from bumpymap.lab.worlds.scans.things import Floats, Label, Triangles, boxes, make_field, tree, vehicle

LANES_M = 3.5
"""The two lanes reach so far to both sides of the street's axis; the cars park beyond."""
_KERB_M, _WALL_M = 5.7, 9.8
"""Distance of the kerbs and of the walls from the axis."""
_PARKED_M, _TREE_M = 4.65, 7.2
_STEP_M = 3.0
"""The robot moves so far from one frame to the next."""


@dataclass(frozen=True, slots=True)
class _StreetGround(SceneGround):
    """The ground of a street along the x axis, seen from a place on it."""

    place: tuple[float, float] = (0.0, 0.0)
    """Where the origin of the positions lies on the street, m."""
    turn: float = 0.0
    """Azimuth of their x axis, rad."""

    def sample(self, x: Floats, y: Floats) -> GroundSample:
        """Return heights and labels at positions around ``place``."""
        east = self.place[0] + np.cos(self.turn) * x - np.sin(self.turn) * y
        north = self.place[1] + np.sin(self.turn) * x + np.cos(self.turn) * y
        away = np.abs(north)
        road = away < _KERB_M
        z = np.where(road, 0.08 * (1.0 - (away / _KERB_M) ** 2), 0.12) + 0.03 * np.sin(east / 15.0) + 0.01 * east
        z += np.where(away < LANES_M, 0.002, 0.003) * self.fine.at(east, north)
        return GroundSample(z, np.where(road, Label.ASPHALT, Label.CONCRETE).astype(np.uint8))

    def height(self, x: float, y: float) -> float:
        """Return the height at one position, m."""
        return float(self.sample(np.array([x]), np.array([y])).z[0])


@dataclass(frozen=True, slots=True)
class Street:
    """A street along the x axis, from 0 to its length."""

    length_m: float
    ground: _StreetGround
    fixed: tuple[tuple[Label, Triangles], ...]
    """What stands: walls, trees, parked cars."""
    moving: tuple[tuple[Triangles, float, float, float], ...]
    """Cars at the origin, heading along x; where each is at the first frame, x and y, and its way per frame, m."""
    solids: Floats
    """(n, 4) what bars the way and stays: middle x, y and half of its extent along x and y, m."""

    def scene(self, frame: int, place: tuple[float, float], turn: float) -> Scene:
        """Return what is around a place when the frame is taken."""
        cars = [(Label.VEHICLE, _stand(soup, self.ground, x + step * frame, y)) for soup, x, y, step in self.moving]
        cos, sin = np.cos(turn), np.sin(turn)
        back = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        corner = np.array([*place, 0.0])
        things = tuple((label, ((soup - corner) @ back).astype(np.float32)) for label, soup in (*self.fixed, *cars))
        return Scene("street", replace(self.ground, place=place, turn=turn), things, (frame,))

    def blocked(self, low: float, high: float, step: float) -> NDArray[np.bool_]:
        """Return where something stands that stays, in cells of ``step`` [m] of a square around the street.

        Whatever stands reaches from below ``low`` to above ``high`` for any vehicle. The square goes from 0 along x and
        is centred in y, north row first.
        """
        count = round(self.length_m / step)
        at = (np.arange(count) + 0.5) * step
        x, y = np.meshgrid(at, at[::-1] - 0.5 * self.length_m)
        mask = np.zeros((count, count), np.bool_)
        for east, north, long, wide in self.solids:
            mask |= (np.abs(x - east) <= long) & (np.abs(y - north) <= wide)
        return mask


def make_street(seed: int, length_m: float = 84.0) -> Street:
    """Draw a street.

    Parameters
    ----------
    seed : int
        The same seed gives the same bits.
    length_m : float
        Walls on both sides are so long; the ground goes on.
    """
    rng = np.random.default_rng([seed, 7])
    ground = _street_ground(rng)
    fixed: list[tuple[Label, Triangles]] = []
    solids: list[tuple[float, float, float, float]] = []
    for side in (-1.0, 1.0):
        solids.append((length_m / 2, side * (_WALL_M + 0.25), length_m / 2, 0.25))
        wall = boxes(np.array([[length_m, 0.5, 6.0]]), np.array([[*solids[-1][:2], -0.5]]), np.zeros(1))
        fixed.append((Label.BARRIER, wall))
        for x in np.arange(6.0 + 4 * (side > 0), length_m, 17.0):
            soup = tree(rng, np.zeros(3), float(rng.uniform(8.0, 10.5)))
            fixed.append((Label.TREE, _stand(soup, ground, float(x), side * _TREE_M)))
            solids.append((float(x), side * _TREE_M, 0.2, 0.2))
        for x in np.arange(9.0 + 3 * (side > 0), length_m - 3.0, 7.5):
            if rng.uniform() < 0.75:
                soup, half = _car(rng)
                place = (float(x + rng.uniform(-0.5, 0.5)), side * _PARKED_M)
                fixed.append((Label.VEHICLE, _stand(soup, ground, *place)))
                solids.append((*place, *half))
    moving = tuple(
        (_car(rng)[0], x, y, step)
        for x, y, step in ((18.0, -1.75, 3.5), (-8.0, -1.75, 3.0), (45.0, 1.75, -4.0), (100.0, 1.75, -4.5))
    )
    return Street(length_m, ground, tuple(fixed), moving, np.array(solids))


def drive_street(street: Street, sensor: Sensor, frames: int) -> tuple[list[SimulatedScan], NDArray[np.float64]]:
    """Drive along the right lane, one frame every 3 m.

    Parameters
    ----------
    street : Street
    sensor : Sensor
        Its tilt is replaced by that of the moving robot.
    frames : int

    Returns
    -------
    list of SimulatedScan
    poses : (frames, 4, 4) float64
        True transforms from the sensor's frame to that of the street, m.
    """
    scans, poses = [], np.tile(np.eye(4), (frames, 1, 1))
    for number in range(frames):
        x, y, turn = 4.0 + _STEP_M * number, -1.75 + 0.3 * np.sin(number / 4.0), 0.03 * np.cos(number / 4.0)
        tilted = replace(sensor, tilt_deg=(0.8 * np.sin(1.3 * number), 0.8 * np.cos(1.7 * number)))
        scene = street.scene(number, (x, y), turn)
        scans.append(simulate_scan(scene, tilted, number))
        cos, sin = np.cos(turn), np.sin(turn)
        poses[number, :3, :3] = (
            np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1]]) @ posture(scene) @ tilted.to_level()
        )
        poses[number, :3, 3] = x, y, street.ground.height(x, y) + sensor.height_m
    return scans, poses


def noisy_poses(poses: NDArray[np.float64], seed: int, metres: float, degrees: float) -> NDArray[np.float64]:
    """Return poses with independent errors of these standard deviations in every coordinate and about every axis."""
    rng = np.random.default_rng([seed, 8])
    noisy = poses.copy()
    noisy[:, :3, 3] += metres * rng.standard_normal((len(poses), 3))
    for pose, angles in zip(noisy, np.radians(degrees) * rng.standard_normal((len(poses), 3)), strict=True):
        pose[:3, :3] = _turned(angles) @ pose[:3, :3]
    return noisy


def _stand(soup: Triangles, ground: _StreetGround, x: float, y: float) -> Triangles:
    """Move a thing from the origin to a place on the ground."""
    moved: Triangles = (soup + np.array([x, y, ground.height(x, y)])).astype(np.float32)
    return moved


def _turned(angles: Floats) -> Floats:
    """Rotation (3, 3) by small angles about x, y and z, made exactly orthonormal."""
    x, y, z = angles
    left, _, right = np.linalg.svd(np.eye(3) + np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]))
    turned: Floats = left @ right
    return turned


def _street_ground(rng: np.random.Generator) -> _StreetGround:
    """Make the ground; its height comes from ``sample``, so most fields of a scene's ground are not used."""
    none = make_field(rng, 16, 1.0, 1.0, (4.0, 16.0))
    fine = make_field(rng, 1024, 0.04, 0.5, (0.1, 2.0))
    return _StreetGround(none, 0.0, none, 0.0, fine, Label.ASPHALT, 0.0, (), 0.0, none, 1.0)


def _car(rng: np.random.Generator) -> tuple[Triangles, tuple[float, float]]:
    """Make a car at the origin, heading along x, and half of its extent along x and y, m."""
    soup = vehicle(rng, np.zeros(3)).astype(np.float64)
    corners = soup.reshape(-1, 3)[:, :2]
    _, axes = np.linalg.eigh(np.cov(corners.T))
    along, across = axes[:, 1], np.array([-axes[1, 1], axes[0, 1]])
    soup = np.stack([soup[..., :2] @ along, soup[..., :2] @ across, soup[..., 2]], axis=-1)
    half = np.abs(soup.reshape(-1, 3)[:, :2]).max(axis=0)
    return soup.astype(np.float32), (float(half[0]), float(half[1]))
