"""Classify the texture of tiles with a small neural network.

The result for a tile must not depend on the other tiles of a stack. Patches therefore pass through the network in
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
    PatchStack,
    Reason,
    TextureMap,
    UsageError,
    check_network,
    metadata_of,
    parse_json,
    read_network,
    session,
    shipped_network,
)
from bumpymap.rating.textures import FEATURE_VERSION, normalise

__all__ = ["FLAT_RELIEF", "TextureModel", "classify"]

FLAT_RELIEF = 1e-3
"""A patch with at most this relief, m, is ``flat`` with probability 1: scaled up, it would show the rounding of the
survey's coordinates instead of ground."""

_BATCH = 16
"""Larger batches save 3 % per patch but lose more to padding: a block has about two hundred tiles."""
_FORMAT = "bumpymap-textures"
_INPUT = "patches"
_KIND = "texture network"
_REMEDY = "Train one with: bumpymap train --out MODEL.onnx"


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
                f"or train one: bumpymap train --tile-size {tile_size:g} --pixels {pixels} --out MODEL.onnx"
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
        check_network(content, {_INPUT: (_BATCH, 1, pixels, pixels)}, len(TEXTURES), origin, _REMEDY)
        return cls(content, metadata, tile_size, pixels)


def classify(patches: PatchStack, model: TextureModel) -> TextureMap:
    """Classify the texture of each tile.

    Parameters
    ----------
    patches : PatchStack
        n tiles; ``relief_map``, ``reason`` and ``grid`` are used.
    model : TextureModel
        Network for tiles of that grid.

    Returns
    -------
    TextureMap
        (n, 4) probabilities; NaN where ``reason`` is not 0. Patches of at most ``FLAT_RELIEF`` are flat with
        probability 1.

    Raises
    ------
    UsageError
        The network was trained for tiles of another size or another number of pixels.
    """
    model.require_grid(patches.grid.tile_size, patches.grid.pixels)
    known = np.flatnonzero(patches.reason == Reason.OK)
    relief = patches.relief_map[known]
    if not np.isfinite(relief).all():
        raise ValueError("a tile with reason 0 has NaN in its relief_map")
    probability = np.full((len(patches.reason), len(TEXTURES)), np.nan, np.float32)
    flat = np.ptp(relief, axis=(1, 2)) <= FLAT_RELIEF
    probability[known[flat]] = np.eye(len(TEXTURES), dtype=np.float32)[TEXTURES.index("flat")]
    rough = relief[~flat]
    scaled = normalise(rough.reshape(len(rough), 1, model.pixels**2))  # min and max over one axis are 4 times faster
    probability[known[~flat]] = infer(model, scaled.reshape(rough.shape))
    return TextureMap(probability)


def infer(model: TextureModel, scaled: NDArray[np.float32]) -> NDArray[np.float32]:
    """Run the network on patches (n, pixels, pixels) scaled to [0, 1]; return probabilities (n, 4)."""
    network = session(model.content)
    probability = np.empty((len(scaled), len(TEXTURES)), np.float32)
    for start in range(0, len(scaled), _BATCH):
        part = scaled[start : start + _BATCH, None]  # (batch, 1, pixels, pixels)
        if len(part) < _BATCH:
            part = np.concatenate((part, np.zeros((_BATCH - len(part), *part.shape[1:]), np.float32)))
        probability[start : start + _BATCH] = network.run(None, {_INPUT: part})[0][: len(scaled) - start]
    return probability
