"""The ground of a scene: regions with their relief, heights and labels at any position, a mesh for ray casting.

The ``reach`` of a region is a normalised distance: below 1 inside, 1 on its margin, increasing outwards.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.lab.terrains import log_uniform
from scan_scenes.things import Field, Floats, Label, smoothstep


@dataclass(frozen=True, slots=True)
class Blob:
    """A patch of ground with a wavy margin: water, puddle, mud, rubble, bare dirt, a field of grass."""

    label: Label
    centre: tuple[float, float]
    """m."""
    radius_m: float
    waves: tuple[tuple[float, float], ...]
    """Amplitude (share of the radius) and phase of 2, 3, .. waves around the margin."""
    rough_m: float
    """Standard deviation of waves shorter than 2 m."""
    level_m: float | None = None
    """Height of a level surface such as water; None for ground."""
    pool_m: float = math.inf
    """Depth below the surrounding ground from which hollows contain water."""
    tracks: tuple[tuple[float, float, float, float], ...] = ()
    """Wheel tracks through it: bearing, distance from the centre [m], depth [m], width of a rut [m]."""

    def reach(self, x: Floats, y: Floats) -> Floats:
        """Distance from the centre divided by the radius in that direction."""
        east, north = x - self.centre[0], y - self.centre[1]
        bearing = np.arctan2(north, east)
        size = np.ones_like(bearing)
        for number, (amplitude, phase) in enumerate(self.waves, start=2):
            size += amplitude * np.cos(number * bearing + phase)
        return np.hypot(east, north) / self.radius_m / size

    def relief(self, x: Floats, y: Floats) -> Floats:
        """Return the relief of the wheel tracks, m; they fade out at the margin."""
        surface = np.zeros_like(x)
        for bearing, offset, depth, width in self.tracks:
            across = (x - self.centre[0]) * np.cos(bearing) + (y - self.centre[1]) * np.sin(bearing) - offset
            along = (y - self.centre[1]) * np.cos(bearing) - (x - self.centre[0]) * np.sin(bearing)
            surface += ruts(across + 0.8 * np.sin(along / 6.0 + offset), depth, width)
        return surface * np.clip((1.15 - self.reach(x, y)) / 0.25, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Road:
    """A road or a track that winds across the scene."""

    label: Label
    bearing: tuple[float, float]
    """Cosine and sine of its direction."""
    offset_m: float
    """Distance of its centreline from the origin."""
    bends: tuple[tuple[float, float, float], ...]
    """Amplitude [m], wave number [rad/m] and phase of its bends."""
    half_width_m: float
    rough_m: float
    crown_m: float = 0.0
    """Height of the centreline above the sides."""
    rut_m: float = 0.0
    """Depth of the two wheel ruts."""
    kerb_m: float = 0.0
    """Height of concrete kerbs on both sides; 0 without kerbs."""
    pavement_m: float = 0.0
    """Width of the pavements behind the kerbs; the ground beyond is as high as they are."""
    ditch_m: float = 0.0
    """Depth of the ditches on both sides."""
    verge_m: float = 3.0
    """Distance of the middle of the ditches, and of the foot of the banks, from the margin."""
    banks_m: tuple[float, float] = (0.0, 0.0)
    """Height of the ground beyond the verge, to the right and to the left, above that of the road."""
    bank_width_m: float = 6.0

    def across(self, x: Floats, y: Floats) -> Floats:
        """Signed distance from the centreline, m."""
        along, side = beside(x, y, self.bearing, self.offset_m)
        slope = np.zeros_like(x)
        for amplitude, number, phase in self.bends:
            side = side - amplitude * np.sin(number * along + phase)
            slope += amplitude * number * np.cos(number * along + phase)
        return side / np.hypot(1.0, slope)

    def reach(self, x: Floats, y: Floats) -> Floats:
        """Distance from the centreline divided by half the width."""
        return np.abs(self.across(x, y)) / self.half_width_m

    def relief(self, x: Floats, y: Floats) -> Floats:
        """Return the relief of crown, ruts and kerbs, m."""
        across = self.across(x, y)
        surface = self.crown_m * np.clip(1 - (across / self.half_width_m) ** 2, 0.0, 1.0)
        if self.rut_m > 0:
            surface += ruts(across, self.rut_m, 0.22)
        beyond = np.abs(across) - self.half_width_m
        if self.pavement_m > 0:
            surface += self.kerb_m * (beyond >= 0)
        elif self.kerb_m > 0:
            surface += self.kerb_m * self.on_kerb(across)
        if self.ditch_m > 0:
            surface -= self.ditch_m * smoothstep(1.0 - np.abs(beyond / self.verge_m - 1.0))
        for side, height in zip((-1.0, 1.0), self.banks_m, strict=True):
            past = (beyond - self.verge_m) / self.bank_width_m
            surface += np.where(across * side > 0, height * smoothstep(past), 0.0)
        return surface

    def places(self, along: Floats, across: Floats) -> Floats:
        """Return x and y [m] and heading [rad], (n, 3), at distances along the road and left of its centreline."""
        side, slope = np.full_like(along, self.offset_m), np.zeros_like(along)
        for amplitude, number, phase in self.bends:
            side += amplitude * np.sin(number * along + phase)
            slope += amplitude * number * np.cos(number * along + phase)
        side = side + across * np.hypot(1.0, slope)
        cos, sin = self.bearing
        heading = np.arctan2(sin, cos) + np.arctan(slope)
        return np.stack([along * cos - side * sin, along * sin + side * cos, heading], axis=-1)

    def on_kerb(self, across: Floats) -> Floats:
        """Return 1 on a kerb or pavement, 0 elsewhere."""
        beyond = np.abs(across) - self.half_width_m
        on: Floats = ((beyond >= 0) & (beyond < max(0.25, self.pavement_m))).astype(np.float64)
        return on if self.kerb_m > 0 else np.zeros_like(across)


@dataclass(frozen=True, slots=True)
class Bank:
    """A change of height along a wavy line: a terrace, an embankment, the foot of a hill."""

    bearing: tuple[float, float]
    """Cosine and sine of the direction of its line."""
    offset_m: float
    """Distance of its foot from the origin, to the left of the line's direction."""
    height_m: float
    width_m: float
    wave: tuple[float, float, float]
    """Amplitude [m], wave number [rad/m] and phase of the line's waves."""

    def rise(self, x: Floats, y: Floats) -> Floats:
        """Return what the bank adds to the height of the ground, m."""
        along, side = beside(x, y, self.bearing, self.offset_m)
        amplitude, number, phase = self.wave
        side = side - amplitude * np.sin(number * along + phase)
        return self.height_m * smoothstep(side / self.width_m)


Region = Blob | Road


def beside(x: Floats, y: Floats, bearing: tuple[float, float], offset_m: float) -> tuple[Floats, Floats]:
    """Return the distances along a straight line and to the left of it, m."""
    return x * bearing[0] + y * bearing[1], y * bearing[0] - x * bearing[1] - offset_m


def ruts(across: Floats, depth_m: float, width_m: float) -> Floats:
    """Return the relief of two grooves 1.5 m apart with low banks, m."""
    surface = np.zeros_like(across)
    for middle in (-0.75, 0.75):
        away = (across - middle) / width_m
        surface += depth_m * (0.35 * np.exp(-((np.abs(away) - 2.0) ** 2)) - np.exp(-(away**2)))
    return surface


def make_blob(
    rng: np.random.Generator,
    label: Label,
    centre: tuple[float, float],
    radius_m: float,
    rough_m: float,
    level_m: float | None = None,
) -> Blob:
    """Draw a random blob; mud gets wheel tracks all over, with water in the deepest ones."""
    waves = tuple((float(rng.uniform(0, 0.3 / n)), float(rng.uniform(0, 2 * np.pi))) for n in (2, 3, 4, 5))
    pool = math.inf
    tracks: tuple[tuple[float, float, float, float], ...] = ()
    if label == Label.MUD:
        deepest, pool = log_uniform(rng, 0.15, 0.4), float(rng.uniform(0.08, 0.25))
        count = int(np.clip(radius_m * rng.uniform(0.8, 1.4), 2, 20))
        main = rng.uniform(0, np.pi)
        tracks = tuple(
            (
                main + float(rng.normal(0, 0.3)),
                float(rng.uniform(-0.9, 0.9)) * radius_m,
                deepest * float(rng.uniform(0.4, 1.0)),
                float(rng.uniform(0.15, 0.3)),
            )
            for _ in range(count)
        )
    return Blob(label, centre, radius_m, waves, rough_m, level_m, pool, tracks)


def make_road(rng: np.random.Generator, label: Label, offset_m: float) -> Road:
    """Draw a random road of asphalt or concrete, or a dirt track."""
    bearing = rng.uniform(0, 2 * np.pi)
    bends = tuple(
        (float(rng.uniform(0, 5)), 2 * np.pi / float(rng.uniform(60, 150)), float(rng.uniform(0, 2 * np.pi)))
        for _ in range(2)
    )
    line = (float(np.cos(bearing)), float(np.sin(bearing)))
    if label == Label.DIRT:
        width, rough = float(rng.uniform(1.3, 2.5)), log_uniform(rng, 0.004, 0.025)
        return Road(label, line, offset_m, bends, width, rough, 0.0, log_uniform(rng, 0.01, 0.07))
    kerb = float(rng.uniform(0.08, 0.16)) if rng.uniform() < 0.4 else 0.0
    width, rough = float(rng.uniform(2.5, 5.5)), log_uniform(rng, 0.001, 0.005)
    return Road(label, line, offset_m, bends, width, rough, float(rng.uniform(0.02, 0.1)), 0.0, kerb)


_HILLSIDE_M = 40.0
"""Distance from the origin at which the hillside ends and its height stays the same."""
_START_M = 0.4
"""Inner radius of the mesh."""
STEP = 0.01
"""Vertex spacing of the mesh, as a share of the distance."""


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

    def height(self, x: Floats, y: Floats) -> Floats:
        """Return the heights of the soil, without grass, at positions (n,) in metres from the origin."""
        return self.sample(x, y)[0]

    def sample(self, x: Floats, y: Floats) -> tuple[Floats, NDArray[np.uint8]]:
        """Return heights of the soil [m] and RELLIS-3D ids at positions in metres from the origin, (n,) each."""
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
        return z + np.maximum(relief + rough * self.fine.at(x, y), floor), label

    def grass_height(self, x: Floats, y: Floats) -> Floats:
        """Return the height of grass at each position, m."""
        return self.grass_m * np.clip(1.0 + 0.4 * self.grass_tufts.at(x, y), 0.15, 1.8)


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
    corners = np.stack([x, y, ground.height(x, y)], axis=1).astype(np.float32)
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
