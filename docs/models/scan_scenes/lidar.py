"""Simulate a LiDAR: cast beams into a scene and add the errors of real returns.

open3d casts the rays. The returns follow four rules: grass is a layer in which a beam is stopped after a random
distance; the signal falls with the square of the distance and with the angle of incidence, and a weak signal gives no
return; smooth wet surfaces reflect pulses away, and some of these return from what they meet then, so that a mirror
image appears below the ground; a few pulses return from anywhere.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import open3d
from numpy.typing import NDArray

from bumpymap.core import Scan
from bumpymap.lab.terrains import log_uniform
from scan_scenes.objects import REFLECTIONS, Floats, Label, ground_mesh
from scan_scenes.scene import Scene, make_scene

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
    is_rosette: bool = False
    """Loops through the middle of the view, as two rotating prisms make them, and not horizontal lines."""
    view_deg: float = 360.0
    """Horizontal field of view, its middle ahead."""
    dense_deg: tuple[float, float] = (-90.0, 90.0)
    """Band of elevations in which lines are closer."""
    dense: float = 1.0
    """Lines per degree in this band, divided by those outside."""
    stray: float = 0.0
    """Share of the pulses that return from dust, rain or nothing, at any range."""

    def directions(self) -> NDArray[np.float64]:
        """Return unit vectors in the sensor's frame, (lines * columns, 3): lines from the lowest, loops in time."""
        if self.is_rosette:
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
        return np.interp(np.linspace(0.0, below[-1], self.lines), below, edges)

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
        return about_y @ about_x


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
        lines=60, columns=500, lowest_deg=-35.0, highest_deg=35.0, is_rosette=True, view_deg=80.0, reach_m=90.0
    ),
    "rosette_360": Sensor(
        lines=40, columns=500, lowest_deg=-7.0, highest_deg=52.0, is_rosette=True, height_m=0.6, reach_m=30.0
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


_tensor: Any = open3d.core.Tensor
_MARGIN_M = 5.0
"""The ground extends this far beyond the maximum range."""
_FOOTPRINT_M = 0.4
"""Half the length and width of the robot, on which it stands."""
_CLEAR_M = 0.02
"""A reflected beam starts this far from the surface."""
_GET_WET = (Label.ASPHALT, Label.CONCRETE, Label.DIRT)
_LEAST_COSINE = 0.05
"""Lower bound of the cosine of the angle of incidence, because real ground is never perfectly smooth."""


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


def simulate_scan(scene: Scene, sensor: Sensor, seed: int) -> Scan:
    """Simulate one rotation of the sensor, ``height_m`` above the origin; the robot leans with the ground below it.

    Intensities are the apparent reflectivity (0 to 1), labels are ids of RELLIS-3D: 0 for mirror images and stray
    returns. ``seed``: of noise and lost returns. The same arguments give the same bits on the same machine.
    """
    rng = np.random.default_rng([*scene.seed, seed, 1])
    rays = sensor.directions()
    level = rays @ (posture(scene) @ sensor.to_level()).T
    eye = np.array([0.0, 0.0, float(scene.ground.height(np.zeros(1), np.zeros(1))[0]) + sensor.height_m])
    world = _World(scene, sensor, rng)
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
    points = (distance[:, None] * rays).astype(np.float32)
    there = points.any(axis=1)
    return Scan(points[there], intensity[there].astype(np.float32), label[there].astype(np.uint16))


def posture(scene: Scene) -> Floats:
    """Return the rotation (3, 3) from a robot that stands on the ground at the origin to a level frame."""
    around = _FOOTPRINT_M * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
    z = scene.ground.height(around[:, 0], around[:, 1])
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
    return hits.distance[rows] + world.first_hit(start, on)["t_hit"].numpy().astype(np.float64)


class _World:
    """The triangles of a scene, ready for casting."""

    def __init__(self, scene: Scene, sensor: Sensor, rng: np.random.Generator) -> None:
        self._rays: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
        corners, triangles = ground_mesh(scene.ground, rng, sensor.end_m + _MARGIN_M)
        self._rays.add_triangles(_tensor(corners), _tensor(triangles))
        kinds = sorted({kind for kind, _ in scene.objects})
        for kind in kinds:
            soup = np.concatenate([part for name, part in scene.objects if name == kind]).reshape(-1, 3)
            self._rays.add_triangles(_tensor(soup), _tensor(np.arange(len(soup), dtype=np.uint32).reshape(-1, 3)))
        self._labels = np.array([Label.VOID, *kinds], np.uint32)
        """Label of each body; VOID for the ground, whose labels depend on the place."""

    def first_hit(self, start: Floats, way: Floats) -> dict[str, Any]:
        """Return what open3d says of rays from ``start`` (n, 3) along unit vectors (n, 3)."""
        rays = np.concatenate([start, way], axis=1).astype(np.float32)
        return self._rays.cast_rays(_tensor(rays))

    def cast(self, scene: Scene, eye: Floats, level: Floats) -> _Hits:
        """Cast beams along unit vectors ``level`` (n, 3) from ``eye`` (3,)."""
        found = self.first_hit(np.broadcast_to(eye, level.shape), level)
        distance = found["t_hit"].numpy().astype(np.float64)
        which = found["geometry_ids"].numpy()
        hit = np.isfinite(distance)
        label = np.zeros(len(level), np.uint32)
        label[hit] = self._labels[which[hit]]
        on_ground = hit & (which == 0)
        place = eye + np.where(hit, distance, 0.0)[:, None] * level
        label[on_ground] = scene.ground.sample(place[on_ground, 0], place[on_ground, 1])[1]
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
    return replace(hits, distance=distance, cosine=cosine)


def _returns(
    hits: _Hits, scene: Scene, sensor: Sensor, rng: np.random.Generator
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], Floats]:
    """Return which beams have a return, which are reflected away, and the intensity."""
    reflectivity = np.zeros(256)
    lost = np.zeros(256)
    for label, (returned, reflected) in REFLECTIONS.items():
        reflectivity[label] = rng.uniform(*returned)
        lost[label] = rng.uniform(*reflected)
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


def scene_scan(seed: int, index: int) -> Scan:
    """Simulate the scan of one synthetic scene; every scene has another sensor."""
    sensor = draw_sensor(np.random.default_rng([seed, index, 2]))
    return replace(simulate_scan(make_scene(seed, index), sensor, index), name=f"{index:06d}")


_START_M = 4.0
_TABLE = 128
"""Number of blocks in a row after which heights repeat."""


def overhead_scan(scene: Scene, seed: int) -> Scan:
    """Sample the ground of a scene, without objects, evenly over distance and azimuth.

    As from a mast or a slope, without shadows. Seen from a low sensor, blocks hide one another, so its scans do not
    contain rough ground in which every pixel is filled. Beyond a straight line, adjacent blocks of one width of 0.2 to
    0.8 m are added. Water has no label, because its lost returns are not simulated here. The same arguments give the
    same bits.
    """
    rng = np.random.default_rng([*scene.seed, seed, 5])
    count = int(log_uniform(rng, 2e4, 1.2e5))
    away, turn = rng.uniform(_START_M, rng.uniform(25.0, 60.0), count), rng.uniform(-np.pi, np.pi, count)
    x, y = away * np.cos(turn), away * np.sin(turn)
    soil, found = scene.ground.sample(x, y)
    above = scene.ground.grass_height(x, y) - rng.exponential(scene.ground.grass_path_m, count)
    z = soil + np.where(found == Label.GRASS, np.maximum(above, 0.0), 0.0)
    wide, high, bearing = log_uniform(rng, 0.2, 0.8), log_uniform(rng, 0.25, 0.9), rng.uniform(0, 2 * np.pi)
    across = x * np.cos(bearing) + y * np.sin(bearing)
    along = y * np.cos(bearing) - x * np.sin(bearing)
    column, row = (np.floor(way / wide).astype(np.int64) % _TABLE for way in (across, along))
    wet = np.isin(found, (Label.WATER, Label.PUDDLE))
    heap = across > rng.uniform(-10.0, 10.0)
    z += np.where(heap, rng.uniform(0.0, high, (_TABLE, _TABLE))[row, column], 0.0)
    z += rng.uniform(0.005, 0.03) * rng.standard_normal(count)
    here = scene.ground.height(np.zeros(1), np.zeros(1))[0] + rng.uniform(0.6, 4.0)
    label = np.where(heap, Label.RUBBLE, np.where(wet, Label.VOID, found)).astype(np.uint16)
    return Scan(np.column_stack([x, y, z - here]).astype(np.float32), np.full(count, 0.3, np.float32), label)
