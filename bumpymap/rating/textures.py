"""The paper's four terrain forms: made from Perlin noise, sine waves and Gaussian blur; told apart by a small network.

A texture is a patch as ``PatchStack.relief_map`` shows it to the network and to the simulated vehicle: with its
least-squares plane removed, then min-max scaled. Scaled, level ground is the noise of its survey, which looks like
rubble: so the network also gets the relief and the noise in metres. Lengths are fractions of the patch's side;
metres in the docstrings are those of the default patch, 3 m and 15 px. Every parameter is random for each patch. At
equal z range the forms get rougher from ``flat`` to ``high_noise``.

Many patches are made in one call. Each has its own noise lattice, rotated by a random angle and shifted by a random
offset, so that lattice lines do not align with rows of pixels. Blurred forms are made with a margin that is cropped
after the blur, because a blur that mirrors at the border would flatten the border.

The texture of a tile must not depend on the other tiles of a stack. Patches therefore pass through the network in
batches of a fixed size, the last one padded, on one thread, and the graph has no operation across patches.

Annotations name `numpy.random` in quotes: it is imported when it is looked up, and a map makes no textures.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    TEXTURES,
    BadInputError,
    PatchStack,
    Reason,
    Texture,
    TextureMap,
    UsageError,
    check_network,
    metadata_of,
    parse_json,
    read_network,
    session,
    shipped_network,
)

FEATURE_VERSION = 2
"""Version of the network's input (plane-removed, hole-filled, min-max scaled relief, and `measures_of`). If it changes,
train again."""
MEASURES = 3
"""Length of a row of `measures_of`."""

_BATCH = 1024
"""Patches made in one call: another number changes the random patches."""
_Floats = NDArray[np.float64]


def make_textures(texture: Texture, count: int, rng: "np.random.Generator", pixels: int = 15) -> NDArray[np.float32]:
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


def make_short_waves(count: int, rng: "np.random.Generator", pixels: int = 15) -> NDArray[np.float32]:
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


def normalise(patches: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale each patch (n, pixels, pixels) without NaN to [0, 1] by its own extremes, as the texture network takes it.

    Training and inference both use this function. A patch of constant height becomes zeros.
    """
    low = patches.min(axis=(1, 2), keepdims=True).astype(np.float64)  # extremes need no double precision
    span = patches.max(axis=(1, 2), keepdims=True) - low
    scaled: _Floats = patches - low
    scaled /= np.where(span > 0, span, 1.0)
    return scaled.astype(np.float32)


def remove_plane(patches: NDArray[np.floating]) -> _Floats:
    """Subtract the least-squares plane from each patch (n, pixels, pixels) without NaN.

    On a full square of pixels the regressors 1, x, y (centred) are orthogonal, so each coefficient is one dot product.
    """
    pixels = patches.shape[-1]
    axis = np.arange(pixels) - (pixels - 1) / 2
    heights = patches - patches.mean(axis=(1, 2), keepdims=True, dtype=np.float64)
    weight = 1.0 / (pixels * np.sum(axis**2))
    slope_row = np.einsum("nij,i->n", heights, axis) * weight
    slope_col = np.einsum("nij,j->n", heights, axis) * weight
    plane = slope_row[:, None, None] * axis[:, None] + slope_col[:, None, None] * axis[None, :]
    residual: _Floats = heights - plane
    return residual


def measures_of(
    relief_map: NDArray[np.floating], count: NDArray[np.integer], variance: NDArray[np.floating], rise: _Floats
) -> NDArray[np.float32]:
    """Return what the network is given of a tile's metres beside its scaled patch, (n, 3).

    Logarithms of the relief over 0.1 m and of the standard error of the pixels' means over 0.01 m, and 1; the last two
    are 0 where too few pixels hold two points. ``relief_map``, ``count``, ``variance`` (n, pixels, pixels): as
    ``relief_map``, ``spread_count`` and ``spread_variance`` of a `PatchStack`; ``rise`` (n,): of the tile's plane over
    a pixel, m: points beside the middle of their pixel err by it. NaN counts as 0.
    """
    count = count.reshape(len(count), count.shape[-1] ** 2)
    variance = np.where(count > 0, variance.reshape(count.shape).astype(np.float64), 0.0)
    freedom = np.maximum(count - 1, 0).sum(axis=1)
    square = (count * variance * (count > 1)).sum(axis=1) / np.maximum(freedom, 1)
    share = (1.0 / np.maximum(count, 1) * (count > 0)).sum(axis=1) / np.maximum((count > 0).sum(axis=1), 1)
    known = freedom >= _LEAST_FREEDOM
    error = np.where(
        known, np.log(np.clip(np.sqrt((square + np.nan_to_num(rise) ** 2 / 12) * share), *_ERRORS) / 0.01), 0.0
    )
    relief = np.log(np.clip(np.ptp(relief_map, axis=(1, 2)), *_RELIEFS) / 0.1)
    return np.stack((relief, error, known), axis=1).astype(np.float32)


_LEAST_FREEDOM = 4
"""Points beyond one a pixel, that many at least, or the noise of a tile is not known."""
_RELIEFS, _ERRORS = (0.005, 10.0), (2e-4, 0.5)
"""Reliefs and standard errors, m, that the network has learned from; others count as the nearest."""


def _perlin(count: int, rng: "np.random.Generator", pixels: int, cell: _Floats, margin: int = 0) -> _Floats:
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
    noise: _Floats = np.zeros_like(u)
    for a in (0, 1):
        for b in (0, 1):
            corner = ((i + a) * nodes + j + b).reshape(count, -1)
            gradient = np.take_along_axis(angle, corner, axis=1).reshape(u.shape)
            weight = (weight_u if a else 1 - weight_u) * (weight_v if b else 1 - weight_v)
            noise += weight * (np.cos(gradient) * (u - a) + np.sin(gradient) * (v - b))
    return noise / _PERLIN_SD


def _fade(t: _Floats) -> _Floats:
    return t * t * t * (t * (6 * t - 15) + 10)


def _perlin_sd() -> float:
    """Return the standard deviation of ``n(u, v)``: gradients are independent, each component has variance 1/2."""
    t = (np.arange(400) + 0.5) / 400
    near, near_t2 = np.mean((1 - _fade(t)) ** 2), np.mean((1 - _fade(t)) ** 2 * t**2)
    # The four corners contribute equally; E[(g . d)^2] = |d|^2 / 2, and |d|^2 is a sum of two equal terms.
    return float(np.sqrt(4 * near * near_t2))


_PERLIN_SD = _perlin_sd()


def _rotated_axes(count: int, rng: "np.random.Generator", pixels: int, margin: int) -> tuple[_Floats, _Floats]:
    """Return x and y of pixel centres, (count, side, side) each, rotated about the patch's centre by a random angle."""
    axis = (np.arange(-margin, pixels + margin) + 0.5) / pixels - 0.5
    turn = rng.uniform(0, 2 * np.pi, (count, 1, 1))
    east, south = axis[None, None, :], axis[None, :, None]
    return np.cos(turn) * east - np.sin(turn) * south, np.sin(turn) * east + np.cos(turn) * south


def _octaves(
    count: int,
    rng: "np.random.Generator",
    pixels: int,
    cell: _Floats,
    persistence: _Floats,
    octaves: int,
    margin: int = 0,
) -> _Floats:
    """Sum octaves of Perlin noise, each with half the cell and ``persistence`` times the amplitude; unit variance."""
    amplitude, power = np.ones(count), np.zeros(count)
    total: _Floats = np.zeros((count, pixels + 2 * margin, pixels + 2 * margin))
    for octave in range(octaves):
        total += amplitude[:, None, None] * _perlin(count, rng, pixels, cell / 2**octave, margin)
        power += amplitude**2
        amplitude = amplitude * persistence
    return total / np.sqrt(power)[:, None, None]


def _blurred_noise(
    count: int,
    rng: "np.random.Generator",
    pixels: int,
    cell: _Floats,
    persistence: _Floats,
    octaves: int,
    sigma: _Floats,
) -> _Floats:
    """Return ``_octaves`` after a Gaussian blur by ``sigma`` (count,), a fraction of a side, correct up to the border.

    The blur of a patch is ``K P K^T`` with its own matrix ``K[i, j] ~ exp(-(i - j)^2 / (2 sigma^2))``, rows sum to 1,
    which also crops the margin.
    """
    margin = int(np.ceil(3 * sigma.max() * pixels)) + 1
    noise = _octaves(count, rng, pixels, cell, persistence, octaves, margin)
    distance = np.arange(-margin, pixels + margin)[None, :] - np.arange(pixels)[:, None]
    kernel = np.exp(-0.5 * (distance / (sigma[:, None, None] * pixels)) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    blurred: _Floats = kernel @ noise @ kernel.transpose(0, 2, 1)
    return blurred


def _flat(count: int, rng: "np.random.Generator", pixels: int) -> _Floats:
    """Generate long gentle undulation: a bowl, saddle or swell (cells of 2.4 to 7 m, blur 0.3 to 0.5 m)."""
    cell, persistence = rng.uniform(0.8, 2.3, count), rng.uniform(0.0, 0.15, count)
    return _blurred_noise(count, rng, pixels, cell, persistence, 2, rng.uniform(0.1, 0.16, count))


def _low_noise(count: int, rng: "np.random.Generator", pixels: int) -> _Floats:
    """Generate soft bumps and hollows (cells of 1.1 to 2.2 m, three octaves, blur 0.08 to 0.2 m)."""
    cell, persistence = rng.uniform(0.37, 0.73, count), rng.uniform(0.35, 0.55, count)
    return _blurred_noise(count, rng, pixels, cell, persistence, 3, rng.uniform(0.025, 0.06, count))


def _noise_sin(count: int, rng: "np.random.Generator", pixels: int) -> _Floats:
    """Generate waves over noise (wavelength 0.8 to 2.4 m; noise of three octaves from cells of 0.6 to 1.2 m)."""
    ground = _octaves(count, rng, pixels, rng.uniform(0.2, 0.4, count), rng.uniform(0.4, 0.7, count), 3)
    wavelength = np.exp(rng.uniform(np.log(0.8 / 3), np.log(2.4 / 3), (count, 1, 1)))
    phase = rng.uniform(0, 2 * np.pi, (count, 1, 1))
    along, _ = _rotated_axes(count, rng, pixels, 0)
    wave: _Floats = np.sqrt(2) * np.sin(2 * np.pi * along / wavelength + phase)
    return wave + rng.uniform(0.2, 0.5, (count, 1, 1)) * ground


def _high_noise(count: int, rng: "np.random.Generator", pixels: int) -> _Floats:
    """Generate rubble, heights varying from pixel to pixel (cells 0.4 to 1.2 m, persistence near 1, white noise)."""
    ground = _octaves(count, rng, pixels, rng.uniform(0.13, 0.4, count), rng.uniform(0.7, 1.0, count), 3)
    return ground + rng.uniform(0.1, 0.6, (count, 1, 1)) * rng.standard_normal((count, pixels, pixels))


_FORMS: "dict[str, Callable[[int, np.random.Generator, int], _Floats]]" = {
    "flat": _flat,
    "low_noise": _low_noise,
    "noise_sin": _noise_sin,
    "high_noise": _high_noise,
}
_NETWORK_BATCH = 16
"""Larger batches save 3 % per patch but lose more to padding: a block has about two hundred tiles."""
_FORMAT = "bumpymap-textures"
_INPUT, _MEASURES = "patches", "measures"
_KIND = "texture network"
_REMEDY = "Train one with: bumpymap train textures --out MODEL.onnx"


@dataclass(frozen=True, slots=True)
class TextureModel:
    """A texture network as plain data that can be sent to other processes."""

    content: bytes
    """Content of the ONNX file."""
    metadata: dict[str, str]
    """``metadata_props`` of the file: seed, command, accuracies."""
    tile_size: float
    """Side of the tiles it was trained for, m."""
    pixels: int
    """Pixels along a side."""

    @property
    def id(self) -> str:
        """Twelve hex digits of the SHA-256 of the file."""
        return hashlib.sha256(self.content).hexdigest()[:12]

    def require_grid(self, tile_size: float, pixels: int) -> None:
        """Raise UsageError if tiles to classify differ in size [m] or number of pixels from the network's."""
        if (tile_size, pixels) != (self.tile_size, self.pixels):
            raise UsageError(
                f"tiles are {tile_size:g} m with {pixels} pixels; the texture network {self.id} was trained for "
                f"{self.tile_size:g} m with {self.pixels}. Use `tile_size={self.tile_size:g}`, `pixels={self.pixels}`, "
                f"or train one: bumpymap train textures --set tile_size={tile_size:g} --set network.pixels={pixels} "
                "--out MODEL.onnx"
            )

    @classmethod
    def shipped(cls) -> "TextureModel":
        """Read the network that is included in bumpymap."""
        return cls._from_bytes(shipped_network("rating", "textures.onnx"), "the texture network in the package")

    @classmethod
    def load(cls, path: Path) -> "TextureModel":
        """Read a network written by ``bumpymap train``. Raises BadInputError if it is not one."""
        return cls._from_bytes(read_network(path, _KIND, _REMEDY), str(path))

    @classmethod
    def _from_bytes(cls, content: bytes, origin: str) -> "TextureModel":
        metadata = metadata_of(content, _FORMAT, origin, _KIND, _REMEDY)
        try:
            classes, version = tuple(parse_json(metadata["classes"])), int(metadata["feature_version"])
            tile_size, pixels = float(metadata["tile_size"]), int(metadata["pixels"])
        except (KeyError, ValueError, TypeError) as error:
            raise BadInputError(f"{origin} is a damaged texture network: {error!r}. {_REMEDY}") from error
        if (classes, version) != (TEXTURES, FEATURE_VERSION):
            raise BadInputError(
                f"{origin} has the classes {', '.join(map(str, classes))} and takes patches of version {version}; this "
                f"bumpymap needs {', '.join(TEXTURES)} and version {FEATURE_VERSION}. {_REMEDY}"
            )
        if pixels < 1:
            raise BadInputError(f"{origin} is a damaged texture network: its pixels are {pixels}. {_REMEDY}")
        inputs = {_INPUT: (_NETWORK_BATCH, 1, pixels, pixels), _MEASURES: (_NETWORK_BATCH, MEASURES, 1, 1)}
        check_network(content, inputs, len(TEXTURES), origin, _REMEDY)
        return cls(content, metadata, tile_size, pixels)


def classify(patches: PatchStack, model: TextureModel) -> TextureMap:
    """Classify the texture of n tiles: (n, 4) probabilities; NaN where ``reason`` is not 0.

    Raises UsageError if the network was trained for tiles of another size or another number of pixels.
    """
    model.require_grid(patches.grid.tile_size, patches.grid.pixels)
    known = np.flatnonzero(patches.reason == Reason.OK)
    relief = patches.relief_map[known]
    if not np.isfinite(relief).all():
        raise ValueError("a tile with reason 0 has NaN in its relief_map")
    probability = np.full((len(patches.reason), len(TEXTURES)), np.nan, np.float32)
    scaled = normalise(relief.reshape(len(relief), 1, model.pixels**2))  # min and max over one axis are 4 times faster
    rise = np.tan(np.radians(patches.slope[known])) * patches.grid.pixel_size
    measures = measures_of(relief, patches.spread_count[known], patches.spread_variance[known], rise)
    probability[known] = infer(model, scaled.reshape(relief.shape), measures)
    return TextureMap(probability)


def infer(model: TextureModel, scaled: NDArray[np.float32], measures: NDArray[np.float32]) -> NDArray[np.float32]:
    """Run the network on scaled patches (n, pixels, pixels) and `measures_of` (n, 3); return probabilities (n, 4)."""
    network, count = session(model.content), len(scaled)
    more = (0, -count % _NETWORK_BATCH)
    inputs = {
        _INPUT: np.pad(scaled[:, None], (more, *[(0, 0)] * 3)),
        _MEASURES: np.pad(measures[:, :, None, None], (more, *[(0, 0)] * 3)),
    }
    batches = range(0, count, _NETWORK_BATCH)
    parts = [network.run(None, {name: v[at : at + _NETWORK_BATCH] for name, v in inputs.items()})[0] for at in batches]
    return np.concatenate((np.empty((0, len(TEXTURES)), np.float32), *parts))[:count]
