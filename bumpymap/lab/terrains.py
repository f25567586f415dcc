"""Terrains: random ground of one kind on a slope, as a fine surface and heightmap, and simulated surveys of it.

Each shape is a surface over the square of a tile, sampled finer than a pixel. Horizontal sizes are realistic; heights
cover a wide range, from imperceptible to impassable, because a calibration needs both. Lengths follow publications on
unpaved roads, fields and quarries: washboard of 0.4 to 1.6 m, wheel ruts 1.2 to 1.8 m apart, furrows of 0.4 to 1 m.

Four of the shapes are the paper's forms, or textures, made from Perlin noise, sine waves and Gaussian blur; at equal z
range they get rougher from ``flat`` to ``high_noise``. Their lengths are fractions of the patch's side; metres in the
docstrings are those of the default patch, 3 m and 15 px. Many patches are made in one call. Each has its own noise
lattice, rotated by a random angle and shifted by a random offset, so that lattice lines do not align with rows of
pixels. Blurred forms are made with a margin that is cropped after the blur, because a blur that mirrors at the border
would flatten the border.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from bumpymap.core import TEXTURES, Floats, Texture, UsageError
from bumpymap.rating import normalise, remove_plane

Shape = Callable[[np.random.Generator, Floats, Floats, int], Floats]
"""(random generator, eastings and northings from the middle of the tile [m], samples along a pixel) -> heights, m."""

_BATCH = 1024
"""Patches made in one call: another number changes the random patches."""
_LONGEST_WAVE = 6.0
"""Longest wave of fractal ground, m; longer ones would be removed with the tile's plane."""


def make_textures(texture: Texture, count: int, rng: np.random.Generator, pixels: int = 15) -> NDArray[np.float32]:
    """Generate patches of one terrain form: plane-removed relief, each scaled to [0, 1], (count, pixels, pixels).

    Equal states of ``rng`` generate equal patches; 4 pixels along a side at least.
    """
    if texture not in _FORMS:
        raise UsageError(f"texture is '{texture}'; it must be one of {', '.join(TEXTURES)}")
    if count < 0 or pixels < 4:
        raise UsageError(f"{count} patches of {pixels} pixels; count must be 0 or more, pixels 4 or more")
    batches = [np.empty((0, pixels, pixels), np.float32)]
    for start in range(0, count, _BATCH):
        raw = _FORMS[texture](min(_BATCH, count - start), rng, pixels)
        batches.append(normalise(remove_plane(raw)))
    return np.concatenate(batches)


def make_short_waves(count: int, rng: np.random.Generator, pixels: int = 15) -> NDArray[np.float32]:
    """Generate, as `make_textures`, regular waves shorter than those of ``noise_sin``: washboard, tracks, ripples.

    The paper has no such form, and a network that was not trained on it may take it for flat. It is as rough as
    ``high_noise``, so it is labelled ``high_noise`` in training. Wavelengths are 0.4 to 0.75 m.
    """
    along, across = _rotated_axes(count, rng, pixels, 0)
    wavelength = rng.uniform(0.4 / 3, 0.75 / 3, (2, count, 1, 1))
    phase = rng.uniform(0, 2 * np.pi, (2, count, 1, 1))
    first = np.sin(2 * np.pi * along / wavelength[0] + phase[0])
    second = np.sin(2 * np.pi * across / wavelength[1] + phase[1])
    pattern = rng.integers(0, 3, (count, 1, 1))
    waves = np.select([pattern == 0, pattern == 1], [first, first * second], first + second)
    ground = _octaves(count, rng, pixels, rng.uniform(0.2, 0.8, count), rng.uniform(0.3, 0.7, count), 3)
    return normalise(remove_plane(waves + rng.uniform(0.0, 0.3, (count, 1, 1)) * ground))


def _perlin(count: int, rng: np.random.Generator, pixels: int, cell: Floats, margin: int = 0) -> Floats:
    """Generate gradient noise after Perlin (2002), with one lattice per patch and unit variance on infinite ground.

    With lattice corners ``i, j`` around the point ``(u, v)``, unit gradients ``g`` at the corners and the fade
    ``s(t) = 6 t^5 - 15 t^4 + 10 t^3``::

        n(u, v) = sum over a, b in {0, 1} of  w_a(u - i) w_b(v - j)  g[i + a, j + b] . (u - i - a, v - j - b)
        w_1(t) = s(t),  w_0(t) = 1 - s(t)

    ``cell`` (count,): side of a lattice cell, as a fraction of the patch's side; ``margin``: pixels that are added on
    each of the four sides.
    """
    x, y = _rotated_axes(count, rng, pixels, margin)
    reach = np.sqrt(0.5) * (1 + 2 * margin / pixels)
    offset = rng.uniform(0, 1, (2, count, 1, 1)) + reach / cell[:, None, None]
    nodes = int(np.ceil(2 * reach / cell.min())) + 3
    angle = rng.uniform(0, 2 * np.pi, (count, nodes * nodes))
    u, v = x / cell[:, None, None] + offset[0], y / cell[:, None, None] + offset[1]
    i, j = np.floor(u).astype(np.int64), np.floor(v).astype(np.int64)
    u, v = u - i, v - j
    weight_u, weight_v = _fade(u), _fade(v)
    noise: Floats = np.zeros_like(u)
    for a in (0, 1):
        for b in (0, 1):
            corner = ((i + a) * nodes + j + b).reshape(count, -1)
            gradient = np.take_along_axis(angle, corner, axis=1).reshape(u.shape)
            weight = (weight_u if a else 1 - weight_u) * (weight_v if b else 1 - weight_v)
            noise += weight * (np.cos(gradient) * (u - a) + np.sin(gradient) * (v - b))
    return noise / _PERLIN_SD


def _fade(t: Floats) -> Floats:
    return t * t * t * (t * (6 * t - 15) + 10)


def _perlin_sd() -> float:
    """Return the standard deviation of ``n(u, v)``: gradients are independent, each component has variance 1/2."""
    t = (np.arange(400) + 0.5) / 400
    near, near_t2 = np.mean((1 - _fade(t)) ** 2), np.mean((1 - _fade(t)) ** 2 * t**2)
    # The four corners contribute equally; E[(g . d)^2] = |d|^2 / 2, and |d|^2 is a sum of two equal terms.
    return float(np.sqrt(4 * near * near_t2))


_PERLIN_SD = _perlin_sd()


def _rotated_axes(count: int, rng: np.random.Generator, pixels: int, margin: int) -> tuple[Floats, Floats]:
    """Return x and y of pixel centres, (count, side, side) each, rotated about the patch's centre by a random angle."""
    axis = (np.arange(-margin, pixels + margin) + 0.5) / pixels - 0.5
    turn = rng.uniform(0, 2 * np.pi, (count, 1, 1))
    east, south = axis[None, None, :], axis[None, :, None]
    return np.cos(turn) * east - np.sin(turn) * south, np.sin(turn) * east + np.cos(turn) * south


def _octaves(
    count: int, rng: np.random.Generator, pixels: int, cell: Floats, persistence: Floats, octaves: int, margin: int = 0
) -> Floats:
    """Sum octaves of Perlin noise, each with half the cell and ``persistence`` times the amplitude; unit variance."""
    amplitude, power = np.ones(count), np.zeros(count)
    total: Floats = np.zeros((count, pixels + 2 * margin, pixels + 2 * margin))
    for octave in range(octaves):
        total += amplitude[:, None, None] * _perlin(count, rng, pixels, cell / 2**octave, margin)
        power += amplitude**2
        amplitude = amplitude * persistence
    return total / np.sqrt(power)[:, None, None]


def _blurred_noise(
    count: int, rng: np.random.Generator, pixels: int, cell: Floats, persistence: Floats, octaves: int, sigma: Floats
) -> Floats:
    """Return ``_octaves`` after a Gaussian blur by ``sigma`` (count,), a fraction of a side, correct up to the border.

    The blur of a patch is ``K P K^T`` with its own matrix ``K[i, j] ~ exp(-(i - j)^2 / (2 sigma^2))``, rows sum to 1,
    which also crops the margin.
    """
    margin = int(np.ceil(3 * sigma.max() * pixels)) + 1
    noise = _octaves(count, rng, pixels, cell, persistence, octaves, margin)
    distance = np.arange(-margin, pixels + margin)[None, :] - np.arange(pixels)[:, None]
    kernel = np.exp(-0.5 * (distance / (sigma[:, None, None] * pixels)) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    return kernel @ noise @ kernel.transpose(0, 2, 1)


def _flat(count: int, rng: np.random.Generator, pixels: int) -> Floats:
    """Generate long gentle undulation: a bowl, saddle or swell (cells of 2.4 to 7 m, blur 0.3 to 0.5 m)."""
    cell, persistence = rng.uniform(0.8, 2.3, count), rng.uniform(0.0, 0.15, count)
    return _blurred_noise(count, rng, pixels, cell, persistence, 2, rng.uniform(0.1, 0.16, count))


def _low_noise(count: int, rng: np.random.Generator, pixels: int) -> Floats:
    """Generate soft bumps and hollows (cells of 1.1 to 2.2 m, three octaves, blur 0.08 to 0.2 m)."""
    cell, persistence = rng.uniform(0.37, 0.73, count), rng.uniform(0.35, 0.55, count)
    return _blurred_noise(count, rng, pixels, cell, persistence, 3, rng.uniform(0.025, 0.06, count))


def _noise_sin(count: int, rng: np.random.Generator, pixels: int) -> Floats:
    """Generate waves over noise (wavelength 0.8 to 2.4 m; noise of three octaves from cells of 0.6 to 1.2 m)."""
    ground = _octaves(count, rng, pixels, rng.uniform(0.2, 0.4, count), rng.uniform(0.4, 0.7, count), 3)
    wavelength = np.exp(rng.uniform(np.log(0.8 / 3), np.log(2.4 / 3), (count, 1, 1)))
    phase = rng.uniform(0, 2 * np.pi, (count, 1, 1))
    along, _ = _rotated_axes(count, rng, pixels, 0)
    wave: Floats = np.sqrt(2) * np.sin(2 * np.pi * along / wavelength + phase)
    return wave + rng.uniform(0.2, 0.5, (count, 1, 1)) * ground


def _high_noise(count: int, rng: np.random.Generator, pixels: int) -> Floats:
    """Generate rubble, heights varying from pixel to pixel (cells 0.4 to 1.2 m, persistence near 1, white noise)."""
    ground = _octaves(count, rng, pixels, rng.uniform(0.13, 0.4, count), rng.uniform(0.7, 1.0, count), 3)
    return ground + rng.uniform(0.1, 0.6, (count, 1, 1)) * rng.standard_normal((count, pixels, pixels))


_FORMS: dict[str, Callable[[int, np.random.Generator, int], Floats]] = {
    "flat": _flat,
    "low_noise": _low_noise,
    "noise_sin": _noise_sin,
    "high_noise": _high_noise,
}


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number with a uniform logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def fractal(rng: np.random.Generator, x: Floats, hurst: float, rms: float) -> Floats:
    """Make self-affine ground: power spectral density k^-(2 H + 2), standard deviation ``rms`` [m] about its plane.

    It is a corner of a square four times as wide, so that opposite edges are independent.
    """
    n = x.shape[0]
    wide, step = 4 * n, float(x[0, 1] - x[0, 0])
    waves = np.fft.fftfreq(wide, step)
    k = np.hypot(*np.meshgrid(waves, waves))
    gain = np.where(k > 1 / _LONGEST_WAVE, np.maximum(k, 1e-9) ** -(hurst + 1), 0.0)
    white = np.fft.fft2(rng.standard_normal((wide, wide)))
    surface = np.fft.ifft2(white * gain).real[:n, :n]
    axis = np.arange(n) - (n - 1) / 2
    norm = n * float(axis @ axis)
    surface = surface - surface.mean()
    surface -= np.outer(np.ones(n), axis) * (surface.sum(axis=0) @ axis / norm)
    surface -= np.outer(axis, np.ones(n)) * (surface.sum(axis=1) @ axis / norm)
    return np.asarray(surface * (rms / surface.std()))


def _across(rng: np.random.Generator, x: Floats, y: Floats) -> Floats:
    """Return the distance from a line through the centre at a random bearing, m."""
    turn = rng.uniform(0, 2 * np.pi)
    return np.asarray(np.cos(turn) * x + np.sin(turn) * y)


def _spots(rng: np.random.Generator, count: int, x: Floats) -> Floats:
    """Draw random positions in and just outside the tile, (count, 2), m."""
    half = 1.1 * float(np.abs(x).max())
    return rng.uniform(-half, half, (count, 2))


def _texture(name: Texture) -> Shape:
    """One of the paper's four forms, bilinear between its pixels; relief 0.02 to 3 m."""

    def shape(rng: np.random.Generator, x: Floats, _y: Floats, fine: int) -> Floats:
        pixels = x.shape[0] // fine
        patch = make_textures(name, 1, rng, pixels)[0].astype(np.float64)
        place = (np.arange(x.shape[0]) + 0.5) / fine - 0.5
        low = np.clip(np.floor(place).astype(np.int64), 0, pixels - 2)
        part = np.clip(place - low, 0.0, 1.0)
        rows = patch[low] * (1 - part)[:, None] + patch[low + 1] * part[:, None]
        surface: Floats = rows[:, low] * (1 - part) + rows[:, low + 1] * part
        return surface * log_uniform(rng, 0.02, 3.0)

    return shape


def _fractal(hurst: float) -> Shape:
    """Natural ground of one roughness exponent; standard deviation 3 mm to 0.5 m."""
    return lambda rng, x, _y, _fine: fractal(rng, x, hurst, log_uniform(rng, 0.003, 0.5))


def _washboard(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Transverse waves with an amplitude of 4 to 60 mm, no steeper than traffic makes them."""
    length = log_uniform(rng, 0.4, 1.6)
    height = log_uniform(rng, 0.004, min(0.06, 0.08 * length))
    phase = 2 * np.pi * _across(rng, x, y) / length + rng.uniform(0, 2 * np.pi)
    waves: Floats = np.sin(phase) + rng.uniform(0, 0.3) * np.sin(2 * phase + rng.uniform(0, 2 * np.pi))
    return height * waves


def _ruts(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Two grooves with low banks, 3 cm to 0.6 m deep."""
    away = _across(rng, x, y)
    gap, width, depth = rng.uniform(1.2, 1.8), rng.uniform(0.1, 0.2), log_uniform(rng, 0.03, 0.6)
    middle = rng.uniform(-0.6, 0.6)
    surface = np.zeros_like(x)
    for side in (middle - gap / 2, middle + gap / 2):
        for place, height in ((side, -1.0), (side - 2 * width, 0.3), (side + 2 * width, 0.3)):
            surface += depth * height * np.exp(-(((away - place) / width) ** 2))
    return surface


def _potholes(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """One to five holes with steep sides, 0.15 to 0.6 m in radius, 3 cm to 0.7 m deep."""
    surface = np.zeros_like(x)
    for east, north in _spots(rng, int(rng.integers(1, 6)), x):
        radius, depth = log_uniform(rng, 0.15, 0.6), log_uniform(rng, 0.03, 0.7)
        surface -= depth * np.exp(-((np.hypot(x - east, y - north) / radius) ** 4))
    return surface


def _stones(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Half ellipsoids on flat ground, the largest 6 cm to 0.8 m in radius."""
    surface = np.zeros_like(x)
    largest = log_uniform(rng, 0.06, 0.8)
    for east, north in _spots(rng, 1 + int(rng.poisson(rng.uniform(3, 30))), x):
        radius = largest * rng.uniform(0.3, 1.0)
        height, wide = radius * rng.uniform(0.4, 0.9), radius * rng.uniform(0.7, 1.3)
        inside = 1 - ((x - east) / radius) ** 2 - ((y - north) / wide) ** 2
        surface = np.maximum(surface, height * np.sqrt(np.maximum(inside, 0.0)))
    return surface


def _rise(away: Floats, height: float, place: float) -> Floats:
    """One step up, some centimetres wide."""
    return height / (1 + np.exp(-np.clip((away - place) / 0.015, -50, 50)))


def _kerb(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """One step of 3 cm to 0.8 m."""
    return _rise(_across(rng, x, y), log_uniform(rng, 0.03, 0.8), rng.uniform(-1, 1))


def _steps(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Two to four parallel steps of one height, up or down."""
    away, height = _across(rng, x, y), log_uniform(rng, 0.03, 0.5)
    surface = np.zeros_like(x)
    for place in rng.uniform(-1.5, 1.5, int(rng.integers(2, 5))):
        surface += _rise(away, height * float(rng.choice([-1, 1])), place)
    return surface


def _furrows(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Ploughed ground: parallel ridges of 2 cm to 0.4 m with clods on them."""
    away = _across(rng, x, y)
    length, height = rng.uniform(0.4, 1.0), log_uniform(rng, 0.02, 0.4)
    ridge = np.abs(np.mod(away / length + rng.uniform(), 1) - 0.5) * 4 - 1
    return height / 2 * np.sin(np.pi / 2 * ridge) + fractal(rng, x, 0.4, 0.15 * height)


def _tufts(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Tussocks of grass, 8 to 25 cm wide, the tallest 4 cm to 0.7 m."""
    surface = np.zeros_like(x)
    tallest = log_uniform(rng, 0.04, 0.7)
    for east, north in _spots(rng, 1 + int(rng.poisson(rng.uniform(5, 45))), x):
        width, height = rng.uniform(0.08, 0.25), tallest * rng.uniform(0.3, 1.0)
        tuft = height * np.exp(-((x - east) ** 2 + (y - north) ** 2) / width**2)
        surface = np.maximum(surface, tuft)
    return surface


def _margin(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Border between smooth and rough ground inside one tile."""
    away = _across(rng, x, y)
    rough = 1 / (1 + np.exp(-np.clip((away - rng.uniform(-0.8, 0.8)) / rng.uniform(0.05, 0.4), -50, 50)))
    wild = fractal(rng, x, rng.uniform(0.2, 0.8), log_uniform(rng, 0.02, 0.5))
    smooth = fractal(rng, x, 0.5, log_uniform(rng, 0.002, 0.02))
    return rough * wild + (1 - rough) * smooth


def _ditch(rng: np.random.Generator, x: Floats, y: Floats, _fine: int) -> Floats:
    """Two slopes that meet in a bottom or on a crest, more or less rounded."""
    away = _across(rng, x, y)
    bend = float(np.subtract(*rng.uniform(-0.5, 0.5, 2))) * log_uniform(rng, 0.1, 2.5)
    return bend / 2 * np.hypot(away - rng.uniform(-1, 1), rng.uniform(0.05, 0.5))


SHAPES: dict[str, Shape] = {
    **{name: _texture(name) for name in TEXTURES},
    "fractal_2": _fractal(0.2),
    "fractal_5": _fractal(0.5),
    "fractal_8": _fractal(0.8),
    "washboard": _washboard,
    "ruts": _ruts,
    "potholes": _potholes,
    "stones": _stones,
    "kerb": _kerb,
    "steps": _steps,
    "furrows": _furrows,
    "tufts": _tufts,
    "margin": _margin,
    "ditch": _ditch,
}
"""Name -> shape function."""

ON_ROUGH_GROUND = frozenset({"washboard", "ruts", "potholes", "stones", "kerb", "steps", "tufts", "ditch"})
"""Kinds that describe a feature only; fractal ground of 1 to 12 mm is added to them."""


KINDS = tuple(SHAPES)
"""All kinds of ground, starting with the paper's four textures."""
FINE = 4
"""Number of samples of the surface along the side of a pixel."""
_GENTLE_DEG, _STEEP = 8.0, 1.2
"""Half of the terrains lie on slopes up to 8 degrees, the others up to 1.2 times ``slope_limit_deg``."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """The ground of one tile."""

    kind: str
    surface: Floats
    """(pixels * FINE, pixels * FINE) heights, m; north row first."""
    tile_size: float
    """m."""

    @property
    def pixels(self) -> int:
        """Pixels along a side."""
        return len(self.surface) // FINE

    @property
    def heights(self) -> Floats:
        """(pixels, pixels) mean height of each pixel, m; north row first; as from a perfect, noise-free survey."""
        return np.asarray(self.surface.reshape(self.pixels, FINE, self.pixels, FINE).mean(axis=(1, 3)))


def make_terrain(
    kind: str,
    seed: int,
    index: int,
    *,
    height_scale: float = 1.0,
    slope_limit_deg: float = 30.0,
    tile_size: float = 3.0,
    pixels: int = 15,
) -> Terrain:
    """Make one terrain of a kind of ``KINDS``; the same arguments give the same bits.

    ``seed``, ``index``: of the library, and number of the terrain in its kind; ``height_scale``: factor on all heights,
    as a small vehicle is calibrated on lower ground; ``slope_limit_deg``: of the vehicle: slopes of half of the
    terrains range to slightly beyond it; ``tile_size``: m; ``pixels``: along a side, at least 4. Raises UsageError if
    the kind is unknown, or there are too few pixels.
    """
    if kind not in SHAPES:
        raise UsageError(f"terrain kind is '{kind}'; it must be one of {', '.join(KINDS)}")
    if pixels < 4:
        raise UsageError(f"a terrain of {pixels} pixels; it must have 4 at least")
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(KINDS.index(kind), index)))
    samples = pixels * FINE
    axis = (np.arange(samples) + 0.5) * tile_size / samples - tile_size / 2
    x, y = np.meshgrid(axis, axis[::-1])
    surface = SHAPES[kind](rng, x, y, FINE)
    if kind in ON_ROUGH_GROUND:
        surface = surface + fractal(rng, x, rng.uniform(0.3, 0.8), log_uniform(rng, 0.001, 0.012))
    slope = rng.uniform(0.0, _GENTLE_DEG if rng.random() < 0.5 else _STEEP * slope_limit_deg)
    bearing = rng.uniform(0, 2 * np.pi)
    plane = np.tan(np.radians(slope)) * (np.cos(bearing) * x + np.sin(bearing) * y)
    return Terrain(kind, surface * height_scale + plane, tile_size)


def survey_terrain(
    terrain: Terrain, density: float, noise_m: float, rng: np.random.Generator
) -> tuple[Floats, Floats, Floats]:
    """Draw easting, northing and upward (n,) [m] of the points of a survey; the tile's south-west corner is the origin.

    ``density``: points per m2; ``noise_m``: standard deviation of the heights, of which each is independent. The same
    generator state gives the same bits.
    """
    side = terrain.tile_size
    step = side / len(terrain.surface)
    easting, northing = rng.uniform(0.0, side, (2, int(rng.poisson(density * side**2))))
    where = np.array([(side - northing) / step - 0.5, easting / step - 0.5])
    upward: Floats = map_coordinates(terrain.surface, where, order=1, mode="nearest")
    return easting, northing, upward + noise_m * rng.standard_normal(len(upward))
