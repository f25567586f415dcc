"""Simulate a LiDAR: cast beams into a scene and add the errors of real returns.

open3d casts the rays. The returns follow four rules: grass is a layer in which a beam is stopped after a random
distance; the signal falls with the square of the distance and with the angle of incidence, and a weak signal gives no
return; smooth wet surfaces reflect pulses away, and some of these return from what they meet then, so that a mirror
image appears below the ground; a few pulses return from anywhere.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import UsageError
from bumpymap.lab.worlds.scans._fields import Floats
from bumpymap.lab.worlds.scans.ground import ground_mesh
from bumpymap.lab.worlds.scans.labels import REFLECTIONS, Label
from bumpymap.lab.worlds.scans.scene import Scene
from bumpymap.lab.worlds.scans.sensor import Sensor

__all__ = ["SimulatedScan", "load_open3d", "posture", "simulate_scan"]

_MARGIN_M = 5.0
"""The ground extends this far beyond the maximum range."""
_FOOTPRINT_M = 0.4
"""Half the length and width of the robot, on which it stands."""
_CLEAR_M = 0.02
"""A reflected beam starts this far from the surface."""
_GET_WET = (Label.ASPHALT, Label.CONCRETE, Label.DIRT)
_LEAST_COSINE = 0.05
"""Lower bound of the cosine of the angle of incidence, because real ground is never perfectly smooth."""


def load_open3d(what: str) -> Any:
    """Import open3d, which casts the rays. Even if it is installed, system libraries that it needs may be missing.

    Parameters
    ----------
    what : str
        What needs it, for the error message.

    Raises
    ------
    UsageError
        It cannot be loaded; the message says what to install.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        if isinstance(error, ModuleNotFoundError) and error.name == "open3d":
            raise UsageError(f"{what} needs open3d. Install it with: pip install 'bumpymap[o3d]'") from error
        raise UsageError(
            f"{what} needs open3d, which is installed but cannot be loaded: {error}. It needs system libraries. "
            "On Debian and Ubuntu: sudo apt-get install libusb-1.0-0 libegl1 libgl1 libx11-6"
        ) from error
    return open3d


@dataclass(frozen=True, slots=True)
class SimulatedScan:
    """One frame of the sensor; a beam without return is at (0, 0, 0), as sensor drivers write it."""

    points: NDArray[np.float32]
    """(lines * columns, 3) sensor frame, m."""
    intensity: NDArray[np.float32]
    """(lines * columns,) apparent reflectivity, 0..1."""
    label: NDArray[np.uint32]
    """(lines * columns,) RELLIS-3D id; 0 without return, and for mirror images and stray returns."""


@dataclass(frozen=True, slots=True)
class _Hits:
    """Surfaces that the beams hit."""

    distance: Floats
    """(n,) m; inf without a hit."""
    cosine: Floats
    """(n,) cosine of the angle between beam and normal, 0..1."""
    normal: Floats
    """(n, 3) of the surface."""
    label: NDArray[np.uint32]
    """(n,)"""
    on_grass: NDArray[np.bool_]
    """(n,) True on grass-covered ground."""


def simulate_scan(scene: Scene, sensor: Sensor, seed: int) -> SimulatedScan:
    """Simulate one rotation of the sensor in a scene.

    The robot leans with the ground below it.

    Parameters
    ----------
    scene : Scene
        The sensor is ``height_m`` above its origin.
    sensor : Sensor
        Beams, noise, tilt.
    seed : int
        Seed of noise and lost returns. The same arguments give the same bits on the same machine.

    Returns
    -------
    SimulatedScan
        One row per beam.
    """
    rng = np.random.default_rng([*scene.seed, seed, 1])
    rays = sensor.directions()
    level = rays @ (posture(scene) @ sensor.to_level()).T
    eye = np.array([0.0, 0.0, float(scene.ground.sample(np.zeros(1), np.zeros(1)).z[0]) + sensor.height_m])
    world = _World.of(scene, sensor, rng)
    hits = _in_grass(scene, world.cast(scene, eye, level), eye, level, rng)
    seen, away, intensity = _returns(hits, scene, sensor, rng)
    distance = np.where(seen, hits.distance, 0.0)
    label = np.where(seen, hits.label, 0)
    mirrored = np.flatnonzero(away & (rng.uniform(size=len(rays)) < scene.mirror))
    beyond = _mirrored(world, hits, eye, level, mirrored)
    kept = beyond < sensor.end_m
    distance[mirrored[kept]] = beyond[kept]
    distance = np.where(distance > 0, distance + sensor.noise_m * rng.standard_normal(len(rays)), 0.0)
    stray = np.flatnonzero(rng.uniform(size=len(rays)) < sensor.stray)
    distance[stray], label[stray] = rng.uniform(1.0, sensor.reach_m, len(stray)), 0
    return SimulatedScan(
        (distance[:, None] * rays).astype(np.float32),
        np.where(distance > 0, intensity, 0.0).astype(np.float32),
        label.astype(np.uint32),
    )


def posture(scene: Scene) -> Floats:
    """Return the rotation (3, 3) from a robot that stands on the ground at the origin to a level frame."""
    around = _FOOTPRINT_M * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    z = scene.ground.sample(around[:, 0], around[:, 1]).z
    rise = np.clip([(z[0] - z[1]), (z[2] - z[3])], -1.0, 1.0) / (2 * _FOOTPRINT_M)
    up = np.array([-rise[0], -rise[1], 1.0]) / np.hypot(1.0, np.hypot(*rise))
    ahead = np.array([1.0, 0.0, rise[0]]) / np.hypot(1.0, rise[0])
    return np.stack([ahead, np.cross(up, ahead), up], axis=1)


def _mirrored(world: "_World", hits: _Hits, eye: Floats, level: Floats, rows: NDArray[np.intp]) -> Floats:
    """Return the whole path of beams ``rows`` that a surface reflects; inf if they then meet nothing."""
    normal, way = hits.normal[rows], level[rows]
    facing = (normal * way).sum(axis=1, keepdims=True)
    on = way - 2 * facing * normal
    start = eye + hits.distance[rows, None] * way + _CLEAR_M * on
    whole: Floats = hits.distance[rows] + world.first_hit(start, on)["t_hit"].numpy().astype(np.float64)
    return whole


@dataclass(frozen=True, slots=True)
class _World:
    """The triangles of a scene, ready for casting."""

    rays: Any
    """The scene of open3d."""
    tensor: Any
    """Its type of arrays."""
    labels: NDArray[np.uint32]
    """Label of each body; 0 for the ground, whose labels depend on the place."""

    @classmethod
    def of(cls, scene: Scene, sensor: Sensor, rng: np.random.Generator) -> "_World":
        """Mesh a scene."""
        open3d = load_open3d("a simulated scan")
        tensor: Any = open3d.core.Tensor
        world = open3d.t.geometry.RaycastingScene(nthreads=1)
        corners, triangles = ground_mesh(scene.ground, rng, sensor.end_m + _MARGIN_M)
        labels = [int(Label.VOID)]
        world.add_triangles(tensor(corners), tensor(triangles))
        for kind in sorted({kind for kind, _ in scene.things}):
            soup = np.concatenate([part for name, part in scene.things if name == kind]).reshape(-1, 3)
            world.add_triangles(tensor(soup), tensor(np.arange(len(soup), dtype=np.uint32).reshape(-1, 3)))
            labels.append(int(kind))
        return cls(world, tensor, np.array(labels, np.uint32))

    def first_hit(self, start: Floats, way: Floats) -> dict[str, Any]:
        """Return what open3d says of rays from ``start`` (n, 3) along unit vectors (n, 3)."""
        rays = np.concatenate([start, way], axis=1).astype(np.float32)
        found: dict[str, Any] = self.rays.cast_rays(self.tensor(rays))
        return found

    def cast(self, scene: Scene, eye: Floats, level: Floats) -> _Hits:
        """Cast beams along unit vectors ``level`` (n, 3) from ``eye`` (3,)."""
        found = self.first_hit(np.broadcast_to(eye, level.shape), level)
        distance = found["t_hit"].numpy().astype(np.float64)
        which = found["geometry_ids"].numpy()
        hit = np.isfinite(distance)
        label = np.zeros(len(level), np.uint32)
        label[hit] = self.labels[which[hit]]
        on_ground = hit & (which == 0)
        place = eye + np.where(hit, distance, 0.0)[:, None] * level
        label[on_ground] = scene.ground.sample(place[on_ground, 0], place[on_ground, 1]).label
        normal = found["primitive_normals"].numpy().astype(np.float64)
        cosine = np.clip(np.abs((normal * level).sum(axis=1)), 0.0, 1.0)
        return _Hits(distance, cosine, normal, label, on_ground & (label == Label.GRASS))


def _in_grass(scene: Scene, hits: _Hits, eye: Floats, level: Floats, rng: np.random.Generator) -> _Hits:
    """Stop beams inside the grass after an exponentially distributed path with mean ``grass_path_m``."""
    ground = scene.ground
    path = rng.exponential(ground.grass_path_m, len(level))
    rows = np.flatnonzero(hits.on_grass)
    foot = eye + hits.distance[rows, None] * level[rows]
    inside = ground.grass_height(foot[:, 0], foot[:, 1]) / np.maximum(hits.cosine[rows], _LEAST_COSINE)
    inside = np.minimum(inside, 0.9 * hits.distance[rows])
    distance, cosine = hits.distance.copy(), hits.cosine.copy()
    stopped = path[rows] < inside
    distance[rows] -= np.where(stopped, inside - path[rows], 0.0)
    cosine[rows] = np.where(stopped, 0.5, cosine[rows])  # mean over random orientations of blades
    return _Hits(distance, cosine, hits.normal, hits.label, hits.on_grass)


def _returns(
    hits: _Hits, scene: Scene, sensor: Sensor, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Floats]:
    """Return which beams have a return, which are reflected away, and the intensity."""
    reflectivity = np.zeros(256)
    lost = np.zeros(256)
    for label, reflection in REFLECTIONS.items():
        reflectivity[label] = rng.uniform(*reflection.reflectivity)
        lost[label] = rng.uniform(*reflection.specular_loss)
    lost[list(_GET_WET)] = np.maximum(lost[list(_GET_WET)], scene.wet)
    count = len(hits.distance)
    bright = reflectivity[hits.label] * np.maximum(hits.cosine, _LEAST_COSINE) ** 0.6 * rng.uniform(0.7, 1.3, count)
    near = np.where(np.isfinite(hits.distance), np.maximum(hits.distance, 0.1), np.inf)
    strength = bright / 0.1 * (sensor.reach_m / near) ** 2
    # Specular loss increases at grazing incidence.
    kept = 1.0 - lost[hits.label] * (1.0 - 0.5 * hits.cosine)
    seen = strength > np.exp(rng.normal(0.0, 0.35, count))
    seen &= (near <= sensor.end_m) & (near > 0.3)
    stays = rng.uniform(size=count) < kept
    return seen & stays & (rng.uniform(size=count) >= sensor.lost), seen & ~stays, bright
