"""The ground of a scene: heights and labels at any position, and a mesh for ray casting."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.worlds.scans._fields import Field, Floats, smoothstep
from bumpymap.lab.worlds.scans.labels import Label
from bumpymap.lab.worlds.scans.regions import Bank, Region, Road

__all__ = ["GroundSample", "SceneGround", "ground_mesh"]

_HILLSIDE_M = 40.0
"""Distance from the origin at which the hillside ends and its height stays the same."""
_START_M = 0.4
"""Inner radius of the mesh."""
STEP = 0.01
"""Vertex spacing of the mesh, as a share of the distance."""


@dataclass(frozen=True, slots=True)
class GroundSample:
    """Height and label of the ground at some positions."""

    z: Floats
    """(n,) m; height of the soil, without grass."""
    label: NDArray[np.uint8]
    """(n,) RELLIS-3D id."""


@dataclass(frozen=True, slots=True)
class SceneGround:
    """Hills, bumps and fine relief, overlaid by regions of other ground in order."""

    hills: Field
    hills_m: float
    """Standard deviation of hills, waves of 25 m and more."""
    bumps: Field
    bumps_m: float
    """Standard deviation of bumps, waves of 2 to 20 m; roads are graded and have none."""
    fine: Field
    """Waves under 2 m."""
    cover: Label
    """Label outside all regions: grass or dirt."""
    cover_rough_m: float
    regions: tuple[Region, ...]
    grass_m: float
    """Mean height of the grass."""
    grass_tufts: Field
    grass_path_m: float
    """Mean path of a beam through grass before a blade stops it."""
    slope: tuple[float, float] = (0.0, 0.0)
    """Rise per metre eastwards and northwards of the hillside around the origin."""
    banks: tuple[Bank, ...] = ()

    def sample(self, x: Floats, y: Floats) -> GroundSample:
        """Return heights and labels at positions in metres from the origin."""
        bumps = self.bumps_m * self.bumps.at(x, y)
        z = self.hills_m * self.hills.at(x, y) + bumps
        away = np.hypot(x, y)
        z += (self.slope[0] * x + self.slope[1] * y) * np.minimum(1.0, _HILLSIDE_M / np.maximum(away, _HILLSIDE_M))
        for bank in self.banks:
            z += bank.rise(x, y)
        label = np.full(x.shape, self.cover, np.uint8)
        rough = np.full(x.shape, self.cover_rough_m)
        relief, floor = np.zeros_like(x), np.full(x.shape, -np.inf)
        for region in self.regions:
            reach = region.reach(x, y)
            inside = reach < 1.0
            if isinstance(region, Road):
                z -= bumps * smoothstep(2.0 - reach)
                relief[inside], floor[inside] = 0.0, -np.inf
                relief += region.relief(x, y)
            elif region.level_m is None:
                relief += region.relief(x, y)
                floor[inside] = -region.pool_m
            else:
                share = smoothstep((1.35 - reach) / 0.35)
                z += share * (region.level_m - z)
                relief *= 1 - share
            label[inside] = region.label
            rough[inside] = region.rough_m
            if isinstance(region, Road) and region.kerb_m > 0:
                kerb = region.on_kerb(region.across(x, y)) > 0
                label[kerb], rough[kerb] = Label.CONCRETE, 0.002
        return GroundSample(z + np.maximum(relief + rough * self.fine.at(x, y), floor), label)

    def grass_height(self, x: Floats, y: Floats) -> Floats:
        """Return the height of grass at each position, m."""
        tall: Floats = self.grass_m * np.clip(1.0 + 0.4 * self.grass_tufts.at(x, y), 0.15, 1.8)
        return tall


def ground_mesh(
    ground: SceneGround, rng: np.random.Generator, end_m: float
) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Mesh the ground around the origin: (n, 3) vertices and (m, 3) triangles.

    The spacing grows with the distance, like that of the beams: 5 cm near 5 m, 50 cm near 50 m. Vertices are jittered
    within their cells, so that no line of the mesh coincides with a scan line.
    """
    around = round(2 * np.pi / STEP)
    rings = int(np.log(end_m / _START_M) / STEP)
    radius = _START_M * np.exp(STEP * (np.arange(rings)[:, None] + rng.uniform(-0.2, 0.2, (rings, around))))
    angle = 2 * np.pi / around * (np.arange(around)[None, :] + rng.uniform(-0.2, 0.2, (rings, around)))
    x, y = (radius * np.cos(angle)).ravel(), (radius * np.sin(angle)).ravel()
    corners = np.stack([x, y, ground.sample(x, y).z], axis=1).astype(np.float32)
    here = np.arange(rings * around).reshape(rings, around)
    right = np.roll(here, -1, axis=1)
    quads = (here[:-1], right[:-1], here[1:], right[1:])
    triangles = np.concatenate(
        [
            np.stack([quads[0], quads[2], quads[1]], axis=-1).reshape(-1, 3),
            np.stack([quads[1], quads[2], quads[3]], axis=-1).reshape(-1, 3),
        ]
    )
    return corners, triangles.astype(np.uint32)
