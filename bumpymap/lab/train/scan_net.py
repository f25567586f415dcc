"""Train the scan network, score it on unseen scans, and write it as ONNX with its model card."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from bumpymap.core import CLASSES, PolarSettings
from bumpymap.lab.label_sets import LABEL_SETS, Accuracy, accuracy_of
from bumpymap.lab.settings import ScanNetSettings, ScanTrainSettings
from bumpymap.lab.train.model_files import (
    EpochData,
    EpochReport,
    OnnxGraph,
    TrainedModel,
    Training,
    model_files,
    parameter_count,
    percent,
    score_table,
    versions,
)
from bumpymap.lab.train.scan_sectors import ScanProgress, Sectors, draw_epoch, folder_frames, folder_sectors
from bumpymap.lab.train.textures import predict
from bumpymap.scan import CHANNELS, MEASURES, SECTOR_VERSION


def convolution(source: int, target: int, size: int, stride: int = 1, groups: int = 1) -> nn.Sequential:
    """Make a convolution without bias, followed by batch normalisation."""
    return nn.Sequential(
        nn.Conv2d(source, target, size, stride, size // 2, groups=groups, bias=False), nn.BatchNorm2d(target)
    )


class InvertedResidual(nn.Module):
    """Widen by 1 x 1, filter each channel by 3 x 3, narrow by 1 x 1; add the input if the shapes match."""

    def __init__(self, source: int, target: int, stride: int, expansion: int) -> None:
        super().__init__()
        inner = expansion * source
        self.widen = convolution(source, inner, 1)
        self.filter = convolution(inner, inner, 3, stride, groups=inner)
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
        self.stem = convolution(CHANNELS, settings.stem, 3, 2)
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
        logits: torch.Tensor = self.head(x).flatten(1)  # (n, 3)
        return logits


def train(
    settings: ScanTrainSettings,
    sectors: Sectors,
    checkpoint: Path | None = None,
    progress: Callable[[EpochReport], None] | None = None,
) -> ScanNet:
    """Train a network; see `Training.run`. The same settings and sectors give the same bits on the same machine."""
    counts = np.bincount(sectors.class_id, minlength=3).tolist()
    loop = Training(
        settings,
        lambda: ScanNet(settings.network),
        lambda numbers: _epochs(settings, sectors, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        smoothing=settings.smoothing,
        record={"sectors": counts, "sector_version": SECTOR_VERSION},
    )
    return loop.run(checkpoint, progress)


def _epochs(settings: ScanTrainSettings, sectors: Sectors, numbers: range) -> Iterator[EpochData]:
    for epoch in numbers:
        rng = np.random.default_rng([settings.seed, 4, epoch])
        drawn = draw_epoch(sectors, settings.sectors_per_class, rng)
        patches, measures, class_id = (torch.from_numpy(values) for values in drawn)
        yield EpochData((patches, measures), class_id, [*range(0, len(class_id), settings.batch), len(class_id)])


def _learning_rate(share: float, peak: float) -> float:
    """Rise over the first twentieth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    rise = min(1.0, (share + 0.005) / 0.055)
    return peak * rise * 0.5 * (1 + math.cos(math.pi * share))


@dataclass(frozen=True, slots=True)
class ScanEvaluation:
    """All scores of the model card, on unseen scans."""

    every: Accuracy
    """All sectors with a class and ground, which are the ones classified in use."""
    labels: dict[int, tuple[int, ...]]
    """RELLIS-3D id -> number of sectors classified as 0, 1, 2."""
    scans: int
    """Number of scans."""


def evaluate(net: ScanNet, unseen: Sectors, scans: int) -> ScanEvaluation:
    """Score a trained network on the sectors of ``scans`` unseen scans."""
    probability = predict(net, torch.from_numpy(unseen.patches), torch.from_numpy(unseen.measures))
    predicted = probability.argmax(axis=1)
    labels = {
        int(label): tuple(np.bincount(predicted[unseen.label == label], minlength=CLASSES).tolist())
        for label in np.unique(unseen.label)
    }
    return ScanEvaluation(accuracy_of(unseen.class_id, predicted, CLASSES), labels, scans)


_CLASS_NAMES = tuple(map(str, range(CLASSES)))
_LABELS = LABEL_SETS["rellis"]
"""Meaning of the labels of data sets to train on."""


def model_card(
    settings: ScanTrainSettings, evaluation: ScanEvaluation, sectors: Sectors, command: str, made: tuple[int, int]
) -> str:
    """Return the text of the card of a training.

    ``sectors``: those of the training; ``command``: its command line, without ``--out``; ``made``: number of trained
    parameters, and size of the ONNX file, bytes.
    """
    learned = np.bincount(sectors.class_id, minlength=CLASSES).tolist()
    every, widths = evaluation.every, ", ".join(map(str, settings.network.widths))
    classes = "; ".join(
        f"{k}: " + ", ".join(_LABELS.names[label] for label, class_id in _LABELS.class_of.items() if class_id == k)
        for k in range(CLASSES)
    )
    labels = "\n".join(
        f"| {_LABELS.names[label]} | {_LABELS.class_of[label]} | " + " | ".join(map(str, counts)) + " |"
        for label, counts in sorted(evaluation.labels.items(), key=lambda item: (_LABELS.class_of[item[0]], item[0]))
    )
    return f"""# Scan network

Classifies the sectors of one LiDAR scan by roughness: class 0 (smooth) to 2 (rough).

- **Use**: `bumpymap scan --method learned`.
- **Input**: `patches` (batch, 2, 15, 15) float32, the heights of a sector above its plane, in the sector's own polar
  coordinates: once scaled by their own range, once by asinh(h / 5 cm); and `measures` (batch, {len(MEASURES)}):
  {", ".join(MEASURES)} (sector version {SECTOR_VERSION}). `beside` is the ratio of the number of points to that
  of the ground in the same ring.
- **Output**: `probability` (batch, {CLASSES}) float32.
- **Network**: after MobileNetV2: a 3 x 3 convolution with {settings.network.stem} filters, inverted residuals with
  {widths} channels and expansion factor {settings.network.expansion}; the measures join before the output layer.
  {made[0]:,} trained parameters; {made[1]:,} bytes of ONNX, opset 17.
- **Grid**: any polar grid with heightmaps of {PolarSettings().pixels} x {PolarSettings().pixels} pixels.
- **Classes**: {classes} (most frequent label of a sector's points, RELLIS-3D names).

## Data

Labelled frames in the layout of RELLIS-3D; the last fifth of every sequence is unseen.

Training sectors: {", ".join(f"{n:,} of class {k}" for k, n in enumerate(learned))}. An epoch draws
{settings.sectors_per_class:,} of each class, half of them mirrored in azimuth; each scan was cut into sectors
{settings.turns} more times after a random rotation, half of these times on another polar grid.

## Accuracy

On {every.count:,} sectors with ground of {evaluation.scans} **unseen scans:
{percent(every.even)} balanced accuracy** (training is balanced in the same way),
{percent(every.right)} of all sectors. The paper reports 83.24 % on its own patches, which are not these.

{score_table(every, _CLASS_NAMES)}

By label, number of sectors classified as 0, 1, 2:

| label | class | 0 | 1 | 2 |
|---|---|---|---|---|
{labels}

## Reproduce

    pip install '.[learn]'
    {command} --out scan.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

## Limits

- A sector has one class. If a kerb, a trunk or the margin of a puddle runs through it, the most
  frequent label counts as true; many of the errors are such sectors.
- Ground that few beams reach is uncertain: beyond 20 m a sector often contains one or two scan lines.
"""


def to_onnx(net: ScanNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network in evaluation mode as an ONNX file, with ``metadata``.

    Inputs ``patches`` (batch, CHANNELS, pixels, pixels) and ``measures`` (batch, len(MEASURES)), output ``probability``
    (batch, CLASSES), all float32.
    """
    graph = OnnxGraph("scan", "x{}".format)
    ends = [graph.constant("zero", np.float32(0.0)), graph.constant("six", np.float32(6.0))]
    plane = graph.constant("plane", np.array([2, 3], np.int64))

    def relu6(pair: Any, source: str) -> str:
        return graph.add("Clip", [_convolution(graph, pair, source), *ends])

    x = relu6(net.stem, "patches")
    for block in net.blocks:
        narrow = _convolution(graph, block.narrow, relu6(block.filter, relu6(block.widen, x)))
        x = graph.add("Add", [x, narrow]) if block.adds else narrow
    x = graph.add("GlobalAveragePool", [x])
    joined = relu6(net.measures, graph.add("Unsqueeze", ["measures", plane]))
    x = relu6(net.hidden, graph.add("Concat", [x, joined], axis=1))
    x = graph.add("Flatten", [graph.conv(net.head, None, x, **_strides(net.head))], axis=1)
    graph.add("Softmax", [x], "probability", axis=1)
    pixels = PolarSettings().pixels
    inputs = {"patches": (CHANNELS, pixels, pixels), "measures": (len(MEASURES),)}
    return graph.to_bytes(inputs, ("probability", CLASSES), metadata)


def _convolution(graph: OnnxGraph, pair: Any, source: str) -> str:
    """Add a convolution with its normalisation."""
    layer, norm = pair.children()
    if not isinstance(layer, nn.Conv2d) or not isinstance(norm, nn.BatchNorm2d):
        raise TypeError(f"expected a convolution and its normalisation, not {pair}")
    return graph.conv(layer, norm, source, **_strides(layer))


def _strides(layer: nn.Conv2d) -> dict[str, Any]:
    return {"strides": [layer.stride[0]] * 2, "group": layer.groups}


def make_scan_model(
    settings: ScanTrainSettings,
    out: Path,
    scans: Path,
    progress: Callable[[EpochReport], None] | None = None,
    scan_progress: ScanProgress | None = None,
) -> TrainedModel[ScanEvaluation]:
    """Train a network for the sectors of scans and write it.

    Settings and scans determine every byte of the file on one machine. ``out``: the ONNX file. The model card is
    written next to it (``.md``), and while the job runs a checkpoint (``.checkpoint``), from which the same call
    resumes after an interruption. ``scans``: a folder in the layout of RELLIS-3D. ``progress`` is called with a report
    after every epoch, ``scan_progress`` with (finished scans, all scans) after every scan that was cut into sectors.

    Raises OutputError if a file cannot be written, BadInputError if the folder contains no scans with labels,
    UsageError if a checkpoint of another training exists.
    """
    with model_files(out) as files:
        learn, unseen = folder_frames(scans)
        sectors = folder_sectors(learn, settings.turns, settings.seed, scan_progress)
        others = folder_sectors(unseen, progress=scan_progress)
        command = f"bumpymap train scans RELLIS_FOLDER {settings.options}"
        net = train(settings, sectors, files.checkpoint, progress)
        evaluation, parameters = evaluate(net, others, len(unseen)), parameter_count(net)
        metadata = {
            **versions("bumpymap-scan"),
            "sector_version": SECTOR_VERSION,
            "pixels": PolarSettings().pixels,
            "parameters": parameters,
            "seed": settings.seed,
            "command": command,
            "accuracy_even": evaluation.every.even,
            "accuracy_unseen": evaluation.every.right,
            "confusion_unseen": evaluation.every.confusion,
        }
        content = to_onnx(net, metadata)
        files.write(content, model_card(settings, evaluation, sectors, command, (parameters, len(content))))
    return TrainedModel(files.model, files.card, evaluation, parameters)
