"""The learned method: a small network classifies each sector by the heightmap of its ground and by the objects on it.

The only input that depends on the rest of the scan is ``beside``: the number of ground points against that of other
sectors in the ring. The network's answer for a sector does not depend on others in the batch: inference runs on one
thread, and the graph treats each sector separately. Of open ground a sector shows few points, and much the same ground
as the sectors around it: there, what the neighbours say counts between smooth and fair.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASSES,
    NOT_TRAVERSABLE,
    BadInputError,
    ClassedSectors,
    PolarSettings,
    SectorStack,
    UsageError,
    cell_numbers,
    check_network,
    metadata_of,
    read_network,
    sector_bounds,
    session,
    shipped_network,
)
from bumpymap.scan.sectors import OPEN_SHARE, with_places

SECTOR_VERSION = 3
"""Version of ``network_input``. After a change networks must be trained again."""
CHANNELS = 4
"""Image channels of a sector: ground heights scaled by their own range, and on a fixed scale; the top of what is not
ground, and the number of its points."""
MEASURES = (
    "count",
    "beside",
    "coverage",
    "z_deviation",
    "residual",
    "upright",
    "distance",
    "width",
    "depth",
    "ground",
    "obstacles",
    "overhead",
    "obstacle_height",
    "clearance",
)
"""Scalar inputs of the network, which the filled and scaled images do not show. ``ground``, ``obstacles`` and
``overhead`` are shares of the sector's points."""
_NEIGHBOURS = 8
"""Most neighbours of a cell."""
_NEIGHBOURS_WEIGHT, _LEAST_PROBABILITY = 1.5, 1e-3
"""Weight of the mean log-odds of the neighbours against the sector's own, and least probability that they are taken of
(chosen)."""
_BATCH = 32
"""Sectors that are classified at once: more would not stay in the cache of a processor."""
_FORMAT = "bumpymap-scan"
_KIND = "scan network"
_REMEDY = "Train one with: bumpymap train scans DIR --out MODEL.onnx"


@dataclass(frozen=True, slots=True)
class ScanModel:
    """A network for the sectors of a scan, as plain picklable data."""

    content: bytes
    """The ONNX file."""
    metadata: dict[str, str]
    """Its ``metadata_props``: seed, command, accuracies."""
    pixels: int
    """Rows and columns of the heightmaps that it was trained on; the rest of the polar grid is free."""

    @property
    def id(self) -> str:
        """Twelve hex digits that change with any byte of the file."""
        return hashlib.sha256(self.content).hexdigest()[:12]

    def require_pixels(self, settings: PolarSettings) -> None:
        """Raise UsageError if the network was trained on heightmaps of another size."""
        if settings.pixels != self.pixels:
            raise UsageError(
                f"pixels is {settings.pixels}; the scan network {self.id} was trained on heightmaps of {self.pixels}. "
                "Use that number, or the filter method"
            )

    @classmethod
    def shipped(cls) -> "ScanModel":
        """Read the network that is included in bumpymap."""
        return cls.from_bytes(shipped_network("scan", "scan.onnx"), "the scan network in the package")

    @classmethod
    def load(cls, path: Path) -> "ScanModel":
        """Read a network from a file. Raises BadInputError if it is not a scan network."""
        return cls.from_bytes(read_network(path, _KIND, _REMEDY), str(path))

    @classmethod
    def from_bytes(cls, content: bytes, origin: str) -> "ScanModel":
        """Check an ONNX file from ``origin``. Raises BadInputError if it is not a scan network."""
        metadata = metadata_of(content, _FORMAT, origin, _KIND, _REMEDY)
        if metadata.get("sector_version") != str(SECTOR_VERSION) or not metadata.get("pixels", "").isdigit():
            raise BadInputError(
                f"{origin} uses sectors of version {metadata.get('sector_version', 'none')}; this bumpymap uses "
                f"version {SECTOR_VERSION}. {_REMEDY}"
            )
        pixels = int(metadata["pixels"])
        # Of another size than `_BATCH`: a graph for batches of one size alone is refused.
        inputs = {"patches": (2, CHANNELS, pixels, pixels), "measures": (2, len(MEASURES))}
        check_network(content, inputs, CLASSES, origin, _REMEDY)
        return cls(content, metadata, pixels)


def network_input(stack: SectorStack) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the network's inputs for the traversable sectors; training and inference both use this function.

    Returns
    -------
    patches : array (n, CHANNELS, pixels, pixels) float32
        Heights of the ground above the sector's plane: scaled to [-1, 1] by their own range (0 if it is zero), and as
        asinh(h / 5 cm) / 3, which resolves both centimetres and metres. Of what is not ground: the top of each pixel in
        heights of the vehicle, and ln(1 + points) / 3.
    measures : array (n, len(MEASURES)) float32
        Each about -1 to 1.
    """
    asked = np.flatnonzero(stack.traversable)
    heights = stack.heights[asked]
    low = heights.min(axis=(1, 2), keepdims=True)
    span = heights.max(axis=(1, 2), keepdims=True) - low
    scaled = np.divide(heights - low, span, out=np.full_like(heights, 0.5), where=span > 0)
    patches = np.empty((len(asked), CHANNELS, *heights.shape[1:]), np.float32)
    np.subtract(2.0 * scaled, 1.0, out=patches[:, 0])
    np.divide(np.arcsinh(heights / np.float32(0.05)), np.float32(3.0), out=patches[:, 1])
    top, number = stack.objects[asked].swapaxes(0, 1)
    np.divide(top, np.float32(stack.settings.height_m), out=patches[:, 2])
    np.divide(np.log1p(number), np.float32(3.0), out=patches[:, 3])
    ground, points = stack.ground_count[asked], stack.count[asked]
    bounds = sector_bounds(stack)
    near, far = bounds.near[asked], bounds.far[asked]
    distance = 0.5 * (near + far)  # of the centre from the sensor
    width = distance * (bounds.left - bounds.right)[asked]
    measures = np.column_stack(
        [
            np.log10(ground / 200.0),
            np.log10(ground / _usual_count(stack, asked)),
            2.0 * stack.coverage[asked] - 1.0,
            0.5 * np.log10(stack.variance[asked] + 1e-6) + 1.0,
            np.log10(stack.residual[asked] + 1e-3) + 1.5,
            2.0 * np.abs(stack.normal[asked, 2]) - 1.0,
            np.log10(distance / 20.0),
            np.log10(width / 4.0),
            np.log10((far - near) / 4.0),
            2.0 * ground / points - 1.0,
            2.0 * np.sqrt(stack.obstacle_count[asked] / points) - 1.0,
            2.0 * np.sqrt(stack.overhead_count[asked] / points) - 1.0,
            2.0 * np.nan_to_num(stack.obstacle_height[asked]) / stack.settings.height_m - 1.0,
            2.0 * np.nan_to_num(stack.settings.height_m / stack.clearance[asked]) - 1.0,
        ]
    )
    return patches, measures.astype(np.float32)


def _usual_count(stack: SectorStack, asked: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the median number of ground points of traversable sectors in the same ring.

    Relative to it, water and wet mud have few points, whatever the sensor.
    """
    ring = stack.zone[asked].astype(np.int64) * max(stack.settings.rings) + stack.ring[asked]
    count = stack.ground_count[asked]
    ordered = count[np.lexsort((count, ring))]
    first = np.flatnonzero(np.diff(ring, prepend=-1))  # sectors are sorted by ring
    number = np.diff(first, append=len(ring))
    usual = 0.5 * (ordered[first + (number - 1) // 2] + ordered[first + number // 2])
    return np.repeat(usual, number)


def classify_learned(stack: SectorStack, model: ScanModel | None = None) -> ClassedSectors:
    """Classify the sectors of a scan, labelled or not, with a network; None: the one included in bumpymap.

    Each gets the most probable class; ``NOT_TRAVERSABLE`` if it is not traversable. Raises UsageError: the network was
    trained on heightmaps of another size.
    """
    probability = _with_neighbours(stack, probabilities(stack, model or ScanModel.shipped()))
    class_id = np.full(len(stack.zone), NOT_TRAVERSABLE, np.uint8)
    class_id[stack.traversable] = probability[stack.traversable].argmax(axis=1)
    return with_places(stack, class_id, None, "learned", probability, probability.max(axis=1))


def _with_neighbours(stack: SectorStack, probability: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return probabilities (n, CLASSES) in which open sectors share the odds of class 1 against 0 with neighbours.

    The odds of class 2 stay: a single obstacle must not be outvoted.
    """
    is_open = stack.traversable & (stack.ground_count >= OPEN_SHARE * stack.count)
    around, cell = neighbours(stack.settings), cell_numbers(stack)
    row = np.full(len(around) + 1, len(cell), np.int32)  # the last one is for neighbours that do not exist
    row[cell[is_open]] = np.flatnonzero(is_open)
    near = row[around[cell]]
    smooth, fair = np.maximum(probability[is_open, :2], _LEAST_PROBABILITY).T
    own, odds = np.log(fair / smooth), np.zeros(len(is_open) + 1, np.float32)
    odds[:-1][is_open], near = own, near[is_open]
    mean = odds[near].sum(axis=1) / np.maximum((near < len(is_open)).sum(axis=1), 1)
    shared = probability.copy()
    either = probability[is_open, 0] + probability[is_open, 1]
    shared[is_open, 0] = either / (1.0 + np.exp(own + _NEIGHBOURS_WEIGHT * mean))
    shared[is_open, 1] = either - shared[is_open, 0]
    return shared


@cache
def neighbours(settings: PolarSettings) -> NDArray[np.int64]:
    """Return the cells around each cell (cells, _NEIGHBOURS): three inwards, two beside, three outwards; -1: none."""
    counts = np.repeat(settings.sectors, settings.rings)  # cells of each ring
    starts = np.cumsum(counts) - counts
    line = np.repeat(np.arange(len(counts)), counts)
    turn = (np.arange(len(line)) - starts[line] + 0.5) / counts[line]
    near = np.full((len(line), _NEIGHBOURS), -1)
    for column, step, beside in ((0, -1, (-1, 0, 1)), (3, 0, (-1, 1)), (5, 1, (-1, 0, 1))):
        there = (line + step >= 0) & (line + step < len(counts))
        to = (line + step)[there]
        opposite = (turn[there] * counts[to]).astype(int)
        for k, side in enumerate(beside):
            near[there, column + k] = starts[to] + (opposite + side) % counts[to]
    return near


def probabilities(stack: SectorStack, model: ScanModel) -> NDArray[np.float32]:
    """Return the probability of each class (n, CLASSES); NaN for sectors that are not traversable."""
    model.require_pixels(stack.settings)
    found = np.full((len(stack.zone), CLASSES), np.nan, np.float32)
    if stack.traversable.any():
        patches, measures = network_input(stack)
        found[stack.traversable] = infer(model.content, {"patches": patches, "measures": measures})
    return found


def infer(content: bytes, inputs: Mapping[str, NDArray[np.float32]]) -> NDArray[np.float32]:
    """Run a network on sectors; return probabilities (n, CLASSES)."""
    network = session(content)
    parts = [
        network.run(None, {name: values[start : start + _BATCH] for name, values in inputs.items()})[0]
        for start in range(0, len(inputs["measures"]), _BATCH)
    ]
    return np.concatenate(parts)
