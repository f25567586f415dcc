"""Train the scan network on sectors of labelled frames, score it on unseen ones, and write it as ONNX."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from bumpymap.core import CLASSES, BadInputError, PolarSettings, Progress, Scan, SilentProgress, counted
from bumpymap.lab.label_sets import LABEL_SETS, Accuracy, accuracy_of
from bumpymap.lab.settings import ScanNetSettings, ScanTrainSettings
from bumpymap.lab.train.model_files import (
    Epoch,
    EpochReport,
    OnnxGraph,
    convolution,
    predict,
    train_network,
    training_files,
    versions,
    write_model,
)
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import CHANNELS, MEASURES, SECTOR_VERSION, network_input, polar_sectors

_LABELS = LABEL_SETS["rellis"]
"""Meaning of the labels of data sets to train on."""
GRIDS = (
    PolarSettings(zone_starts_m=(4.0, 12.0, 28.0, 60.0), end_m=100.0, sectors=(24, 32, 48, 32), rings=(4, 4, 4, 2)),
    PolarSettings(zone_starts_m=(1.0, 5.0, 15.0, 30.0), end_m=60.0, sectors=(12, 24, 36, 48), rings=(2, 4, 4, 4)),
    PolarSettings(zone_starts_m=(2.0, 6.0, 18.0, 45.0), end_m=90.0, sectors=(16, 40, 48, 40), rings=(2, 4, 6, 4)),
)
"""Polar grids that training uses beside the default one, so that a network fits any grid."""
_OTHER_GRID = 0.5
"""Share of the additional cuts that use one of them."""
SWAPPED_MEASURES = ("coverage",)
"""Measures that training swaps between some sectors."""
_SWAPPED_SHARE = 0.15
"""Share of the sectors of an epoch that take them. Chosen."""
_TREE, _BUSH = 4, 19
"""Ids of RELLIS-3D."""


class Sectors(NamedTuple):
    """Sectors with known classes."""

    patches: NDArray[np.float32]
    """(n, CHANNELS, pixels, pixels)"""
    measures: NDArray[np.float32]
    """(n, len(MEASURES))"""
    class_id: NDArray[np.int64]
    """(n,) 0..2"""


def join(parts: Sequence[Sectors]) -> Sectors:
    """Concatenate one or more sets of sectors, in order."""
    return Sectors(*map(np.concatenate, zip(*parts, strict=True)))


def draw_cuts(rng: np.random.Generator, count: int) -> list[tuple[float, PolarSettings]]:
    """Draw angles [rad] and polar grids of additional cuts of a scan."""
    angles = rng.uniform(0, 2 * np.pi, count)
    other, which = rng.uniform(size=count) < _OTHER_GRID, rng.integers(len(GRIDS), size=count)
    return [
        (float(angle), GRIDS[k] if draws else PolarSettings())
        for angle, draws, k in zip(angles, other, which, strict=True)
    ]


def labelled_sectors(scan: Scan, cuts: Iterable[tuple[float, PolarSettings]] = ()) -> Sectors:
    """Cut a labelled scan into sectors and keep those with a class that have ground: others are never classified.

    The scan is cut once more for each of ``cuts``, after rotating it about z by the angle [rad], on the grid: that puts
    the same ground into other sectors.
    """
    scan = crowns_as_bushes(scan)
    stacks = [polar_sectors(scan)]
    for turn, grid in cuts:
        cos, sin = np.cos(turn), np.sin(turn)
        about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], np.float32)
        stacks.append(polar_sectors(Scan(scan.points @ about_z.T, None, scan.label), grid))
    parts = []
    for stack in stacks:
        class_id = _LABELS.classes_of(stack.label)
        known = (class_id >= 0) & stack.traversable
        patches, measures = network_input(stack)
        chosen = known[stack.traversable]
        parts.append(Sectors(patches[chosen], measures[chosen], class_id[known].astype(np.int64)))
    return join(parts)


def crowns_as_bushes(scan: Scan) -> Scan:
    """Return a labelled scan whose tree points higher than the vehicle are labelled as bush.

    A crown over a road is no reason to avoid it, a trunk on it is.
    """
    stack = polar_sectors(scan)
    label = np.asarray(scan.label).copy()
    label[(label == _TREE) & (stack.point_height >= stack.settings.height_m)] = _BUSH
    return replace(scan, label=label)


def folder_frames(folder: Path) -> tuple[list[Path], list[Path]]:
    """List frames of a data set in the layout of RELLIS-3D: training frames, and the last fifth of every sequence.

    ``folder`` contains sequences (``00000``, ..), is a sequence, or contains ``Rellis-3D``. Only every tenth frame is
    used, because neighbouring frames show nearly the same ground; this also separates the two parts of a sequence.
    """
    inner = folder / "Rellis-3D"
    root = inner if inner.is_dir() else folder
    inside = root.iterdir() if root.is_dir() else []
    sequences = sorted(path for path in inside if path.is_dir() and path.name.isdigit())
    learn: list[Path] = []
    unseen: list[Path] = []
    for sequence in sequences or [root]:
        frames = find_frames([sequence])
        border = len(frames) - max(1, len(frames) // 5)
        learn += frames[:border]
        unseen += frames[border:]
    if not learn:
        raise BadInputError(f"{folder} contains {len(unseen)} frame(s); training needs 2 or more in a sequence")
    return learn, unseen


def folder_sectors(frames: Sequence[Path], turns: int = 0, seed: int = 1, progress: Progress | None = None) -> Sectors:
    """Return the sectors of labelled frames on disk, in order.

    Raises BadInputError if a frame has no labels, or none of them has a class.
    """
    parts, progress = [], progress or SilentProgress()
    progress.start("cutting scans into sectors", len(frames))
    for number, frame in enumerate(counted(frames, progress), start=1):
        scan = read_scan(frame)
        if scan.label is None:
            raise BadInputError(
                f"{frame} has no label file; training needs os1_cloud_node_semantickitti_label_id/{frame.stem}.label "
                "next to its folder"
            )
        parts.append(labelled_sectors(scan, draw_cuts(np.random.default_rng([seed, number, 3]), turns)))
    joined = join(parts)
    if not len(joined.class_id):
        raise BadInputError(
            f"no sector of {len(frames)} frames has a label with a class; the labels must be ids of RELLIS-3D"
        )
    return joined


def draw_epoch(
    sectors: Sectors, per_class: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Draw the same number of sectors of every class that occurs, half of them mirrored in azimuth; shuffled.

    If a class has fewer sectors, each is drawn equally often, up to a difference of one. Some sectors take their
    ``SWAPPED_MEASURES`` from others, so that the network does not rely on these measures alone: the share of filled
    pixels depends more on the sensor than relief does.
    """
    rows = []
    for class_id in np.unique(sectors.class_id):
        there = np.flatnonzero(sectors.class_id == class_id)
        rounds = [rng.permutation(there) for _ in range(-(-per_class // len(there)))]
        rows.append(np.concatenate(rounds)[:per_class])
    order = rng.permutation(np.concatenate(rows))
    patches = sectors.patches[order]
    mirrored = rng.uniform(size=len(order)) < 0.5
    patches[mirrored] = patches[mirrored][..., ::-1]
    measures = sectors.measures[order]
    for name in SWAPPED_MEASURES:
        column = MEASURES.index(name)
        takes = np.flatnonzero(rng.uniform(size=len(order)) < _SWAPPED_SHARE)
        measures[takes, column] = measures[rng.permutation(takes), column]
    return patches, measures, sectors.class_id[order]


class InvertedResidual(nn.Module):
    """Widen by 1 x 1, filter each channel by 3 x 3, narrow by 1 x 1; add the input if the shapes match."""

    def __init__(self, source: int, target: int, stride: int, expansion: int) -> None:
        super().__init__()
        inner = expansion * source
        self.widen = convolution(source, inner, 1)
        self.filter = convolution(inner, inner, 3, padding=1, stride=stride, groups=inner)
        self.narrow = convolution(inner, target, 1)
        self.adds = stride == 1 and source == target

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Map shape (n, source, h, w) to (n, target, h / stride, w / stride)."""
        inner = nn.functional.relu6(self.widen(x))
        inner = nn.functional.relu6(self.filter(inner))
        narrow: torch.Tensor = self.narrow(inner)
        return x + narrow if self.adds else narrow


class ScanNet(nn.Module):
    """Inverted residuals over the images of a sector; its measures join before the output layer."""

    def __init__(self, settings: ScanNetSettings) -> None:
        super().__init__()
        self.settings = settings
        widths = (settings.stem, *settings.widths)
        self.stem = convolution(CHANNELS, settings.stem, 3, padding=1, stride=2)
        self.blocks = nn.ModuleList(
            InvertedResidual(a, b, 2 if b > a else 1, settings.expansion) for a, b in pairwise(widths)
        )
        self.measures = convolution(len(MEASURES), settings.measure_channels, 1)
        self.hidden = convolution(widths[-1] + settings.measure_channels, settings.hidden, 1)
        self.head = nn.Conv2d(settings.hidden, CLASSES, 1)

    def forward(self, patches: torch.Tensor, measures: torch.Tensor) -> torch.Tensor:
        """Return logits (n, CLASSES) of images (n, CHANNELS, pixels, pixels) and measures (n, len(MEASURES))."""
        x = nn.functional.relu6(self.stem(patches))  # (n, 16, 8, 8)
        for block in self.blocks:
            x = block(x)  # (n, 16, 8, 8), then (n, 24, 4, 4) three times
        x = x.mean(dim=(2, 3), keepdim=True)  # (n, 24, 1, 1)
        joined = nn.functional.relu6(self.measures(measures[:, :, None, None]))  # (n, 16, 1, 1)
        x = nn.functional.relu6(self.hidden(torch.cat((x, joined), dim=1)))  # (n, 48, 1, 1)
        return self.head(x).flatten(1)  # (n, 3)


def train(
    settings: ScanTrainSettings,
    sectors: Sectors,
    checkpoint: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
) -> ScanNet:
    """Train a network; see `train_network`. The same settings and sectors give the same bits on the same machine."""
    counts = np.bincount(sectors.class_id, minlength=3).tolist()
    return train_network(
        settings,
        lambda: ScanNet(settings.network),
        lambda numbers: _epochs(settings, sectors, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        {"sectors": counts, "sector_version": SECTOR_VERSION},
        checkpoint,
        progress,
        smoothing=settings.smoothing,
    )


def _epochs(settings: ScanTrainSettings, sectors: Sectors, numbers: range) -> Iterator[Epoch]:
    for epoch in numbers:
        rng = np.random.default_rng([settings.seed, 4, epoch])
        drawn = draw_epoch(sectors, settings.sectors_per_class, rng)
        patches, measures, class_id = (torch.from_numpy(values) for values in drawn)
        yield (patches, measures), class_id, [*range(0, len(class_id), settings.batch), len(class_id)]


def _learning_rate(share: float, peak: float) -> float:
    """Rise over the first twentieth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    rise = min(1.0, (share + 0.005) / 0.055)
    return peak * rise * 0.5 * (1 + math.cos(math.pi * share))


@dataclass(frozen=True, slots=True)
class ScanEvaluation:
    """All scores of a training, on unseen scans."""

    every: Accuracy
    """All sectors with a class and ground, which are the ones classified in use."""
    scans: int
    """Number of scans."""
    parameters: int
    """Number of trained parameters."""


def evaluate(net: ScanNet, unseen: Sectors, scans: int) -> ScanEvaluation:
    """Score a trained network on the sectors of ``scans`` unseen scans."""
    probability = predict(net, torch.from_numpy(unseen.patches), torch.from_numpy(unseen.measures))
    predicted = probability.argmax(axis=1)
    parameters = sum(p.numel() for p in net.parameters())
    return ScanEvaluation(accuracy_of(unseen.class_id, predicted, CLASSES), scans, parameters)


def to_onnx(net: ScanNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network in evaluation mode as an ONNX file, with ``metadata``.

    Inputs ``patches`` (batch, CHANNELS, pixels, pixels) and ``measures`` (batch, len(MEASURES)), output ``probability``
    (batch, CLASSES), all float32.
    """
    graph = OnnxGraph("scan")
    ends = graph.constant("zero", np.float32(0.0)), graph.constant("six", np.float32(6.0))

    def relu6(pair: Any, source: str) -> str:
        return graph.add("Clip", graph.conv(pair, source), *ends)

    x = relu6(net.stem, "patches")
    for block in net.blocks:
        narrow = graph.conv(block.narrow, relu6(block.filter, relu6(block.widen, x)))
        x = graph.add("Add", x, narrow) if block.adds else narrow
    plane = graph.constant("plane", np.array([2, 3], np.int64))
    joined = relu6(net.measures, graph.add("Unsqueeze", "measures", plane))
    x = relu6(net.hidden, graph.add("Concat", graph.add("GlobalAveragePool", x), joined, axis=1))
    pixels = PolarSettings().pixels
    inputs = {"patches": (CHANNELS, pixels, pixels), "measures": (len(MEASURES),)}
    return graph.to_bytes(net.head, x, inputs, metadata)


def make_scan_model(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path,
    progress: Callable[[EpochReport], None] | None = None,
    scan_progress: Progress | None = None,
) -> ScanEvaluation:
    """Train a network for the sectors of scans, write it, and return its scores.

    Settings and scans determine every byte of the file on one machine. ``out``: the ONNX file. While the job runs
    a checkpoint (``.checkpoint``) lies next to it, from which the same call resumes after an interruption. ``scans``: a
    folder in the layout of RELLIS-3D. ``progress`` is called with a report after every epoch, ``scan_progress`` counts
    the scans that were cut into sectors.

    Raises OutputError if a file cannot be written, BadInputError if the folder contains no scans with labels,
    UsageError if a checkpoint of another training exists.
    """
    with training_files(out) as checkpoint:
        learn, unseen = folder_frames(scans)
        sectors = folder_sectors(learn, settings.turns, settings.seed, scan_progress)
        others = folder_sectors(unseen, progress=scan_progress)
        net = train(settings, sectors, checkpoint, progress)
        evaluation = evaluate(net, others, len(unseen))
        options = settings.as_options("seed", "epochs", "sectors_per_class", "threads")
        command = f"bumpymap train scans RELLIS_FOLDER {options}"
        write_model(out, to_onnx(net, metadata_of(settings, evaluation, command)), checkpoint)
    return evaluation


def metadata_of(settings: ScanTrainSettings, evaluation: ScanEvaluation, command: str) -> dict[str, object]:
    """Return the metadata of the ONNX file of a training."""
    return {
        **versions("bumpymap-scan"),
        "sector_version": SECTOR_VERSION,
        "pixels": PolarSettings().pixels,
        "parameters": evaluation.parameters,
        "seed": settings.seed,
        "command": command,
        "accuracy_even": evaluation.every.even,
        "accuracy_unseen": evaluation.every.right,
        "confusion_unseen": evaluation.every.confusion,
    }
