"""The paper's four terrain forms, distinguished by a small network.

A texture is a patch as ``PatchStack.relief_map`` shows it to the network and to the simulated vehicle: with its
least-squares plane removed, then min-max scaled. Scaled, level ground is the noise of its survey, which looks like
rubble: so the network also gets the relief and the noise in metres.

The texture of a tile must not depend on the other tiles of a stack. Patches therefore pass through the network in
batches of a fixed size, the last one padded, on one thread, and the graph has no operation across patches.
"""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    TEXTURES,
    BadInputError,
    Floats,
    PatchStack,
    Reason,
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


def normalise(patches: NDArray[np.floating]) -> NDArray[np.float32]:
    """Scale each patch (n, pixels, pixels) without NaN to [0, 1] by its own extremes, as the texture network takes it.

    Training and inference both use this function. A patch of constant height becomes zeros.
    """
    low = patches.min(axis=(1, 2), keepdims=True).astype(np.float64)  # extremes need no double precision
    span = patches.max(axis=(1, 2), keepdims=True) - low
    scaled: Floats = patches - low
    scaled /= np.where(span > 0, span, 1.0)
    return scaled.astype(np.float32)


def remove_plane(patches: NDArray[np.floating]) -> Floats:
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
    residual: Floats = heights - plane
    return residual


def measures_of(
    relief_map: NDArray[np.floating], count: NDArray[np.integer], variance: NDArray[np.floating], rise: Floats
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


def classify(patches: PatchStack, model: TextureModel) -> NDArray[np.float32]:
    """Classify the texture of n tiles: (n, 4) probabilities, see `CostMap`; NaN where ``reason`` is not 0.

    Raises UsageError if the network was trained for tiles of another size or another number of pixels.
    """
    model.require_grid(patches.grid.tile_size, patches.grid.pixels)
    known = np.flatnonzero(patches.reason == Reason.OK)
    relief = patches.relief_map[known]
    probability = np.full((len(patches.reason), len(TEXTURES)), np.nan, np.float32)
    scaled = normalise(relief.reshape(len(relief), 1, model.pixels**2))  # min and max over one axis are 4 times faster
    rise = np.tan(np.radians(patches.slope[known])) * patches.grid.pixel_size
    measures = measures_of(relief, patches.spread_count[known], patches.spread_variance[known], rise)
    probability[known] = infer(model, scaled.reshape(relief.shape), measures)
    return probability


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
