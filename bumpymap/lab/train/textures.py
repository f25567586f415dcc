"""Train the texture network on made patches, score it on unseen ones, and write it as ONNX.

All patches come from one seed. `surveyed` makes of scaled patches what a survey shows of ground of some relief: turned,
bent, blurred, on a slope, through points with noise, waves and strips of photogrammetry, and empty pixels that are
filled. All patches are worked on at once.

The ONNX graph has no operator whose result for a patch depends on its position in the batch (the last two layers are
1 x 1 convolutions, not matrix products over the batch).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.ndimage import correlate
from torch import nn

from bumpymap.core import TEXTURES, Floats
from bumpymap.lab.label_sets import Accuracy, accuracy_of
from bumpymap.lab.settings import NetworkSettings, TrainSettings
from bumpymap.lab.terrains import make_short_waves, make_textures
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
from bumpymap.rating import FEATURE_VERSION, MEASURES, measures_of, normalise, remove_plane

FORM_RELIEF = {"flat": (0.0, 0.3), "low_noise": (0.1, 1.5), "noise_sin": (0.3, 3.0), "high_noise": (0.6, math.inf)}
"""Least and greatest true relief of each form in a tile, m, which decide the label. Below 0.1 m even the roughest form
leaves a Warthog in class 0 (C_r 0.1 rad/m in its table), so all lower ground is flat."""


@dataclass(frozen=True, slots=True)
class SurveyEffects:
    """Ground and surveys that are drawn, each patch its own: logarithms alike, or alike from 0."""

    relief: tuple[float, float] = (0.03, 8.0)
    """True relief, m."""
    level: float = 0.35
    """Share of the patches without any relief."""
    noise: tuple[float, float] = (0.001, 0.05)
    """Standard deviation of a point, m."""
    points: tuple[float, float] = (0.28, 16.0)
    """Points of a pixel; 7 to 400 points/m2 at 0.2 m."""
    waves: tuple[float, float] = (0.001, 0.015)
    """Standard deviation of the waves of photogrammetry, m, on half of the patches; smooth over 1 to 2.5 px."""
    strip: float = 0.02
    """Greatest step between two strips, m, on a quarter of the patches."""
    power: tuple[float, float] = (0.74, 1.35)
    """Exponent of the ground's scaled heights."""
    blur: float = 0.7
    """Greatest standard deviation of a blur, px."""
    hole: float = 2.5
    """Greatest radius of a hole, px, on half of the patches."""
    slope: float = 0.1
    """Greatest rise of the whole tile over one pixel, m: points beside the middle of their pixel err by it."""
    no_noise: float = 0.15
    """Share of the patches of which the noise is not known."""


def labels_of(shape: NDArray[np.int64], relief: Floats) -> NDArray[np.int64]:
    """Return the label of ground of a ``shape`` and true ``relief`` [m], (n,): the shape if it is so low or high.

    Elsewhere it is the nearest form whose `FORM_RELIEF` holds the relief.
    """
    least, most = np.array(list(FORM_RELIEF.values())).T
    return np.clip(shape, np.searchsorted(most, relief), np.searchsorted(least, relief, side="right") - 1)


SurveyedPatches = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]
"""Inputs of the network, (n, pixels, pixels) plane-removed and scaled to [0, 1], and (n, 3) of `measures_of`; and
labels, (n,) index into ``TEXTURES``."""


def surveyed(
    patches: NDArray[np.float32], shape: NDArray[np.int64], rng: np.random.Generator, of: SurveyEffects | None = None
) -> SurveyedPatches:
    """Draw ground of scaled patches (n, pixels, pixels) of a shape (n,), and a survey of it; same state, same bits."""
    of, count, pixels = of or SurveyEffects(), len(patches), patches.shape[-1]
    grid, one = np.arange(pixels), (count, 1, 1)

    def spread(low: float, high: float) -> Floats:
        return np.exp(rng.uniform(math.log(low), math.log(high), one))

    def some(share: float) -> NDArray[np.bool_]:
        return rng.uniform(size=one) < share

    heights = np.where(some(0.5), patches[:, :, ::-1], patches).astype(np.float64)
    heights = np.clip(rotate(heights, rng.uniform(0, 2 * np.pi, count)), 0, 1) ** spread(*of.power)
    heights = remove_plane(blur(heights, rng.uniform(0, of.blur, count)))
    relief = spread(*of.relief) * ~some(of.level)
    heights *= relief / np.ptp(heights, axis=(1, 2), keepdims=True)

    held = rng.poisson(spread(*of.points), patches.shape)
    row, col = rng.uniform(0, pixels - 1, (2, *one))
    held *= np.hypot(grid[:, None] - row, grid - col) >= rng.uniform(0, of.hole, one) * some(0.5)
    held[:, 0, 0] += ~held.any(axis=(1, 2))
    sides = (np.diff(heights, axis=side, append=np.take(heights, [-1], side)) for side in (1, 2))
    steep = sum(rise**2 for rise in sides) / 12  # a pixel's points lie evenly over it
    inside = spread(*of.noise) ** 2 + steep
    rise = rng.uniform(0, of.slope, one)
    few = np.maximum(held, 1)
    noise = rng.standard_normal(patches.shape) * np.sqrt((inside + rise**2 / 12) / few)
    variance = inside * rng.chisquare(np.maximum(held - 1, 1e-9)) / few
    waves = blur(rng.standard_normal(patches.shape), rng.uniform(1.0, 2.5, count))
    waves *= spread(*of.waves) * some(0.5) / waves.std(axis=(1, 2), keepdims=True)
    axis, turn = grid / (pixels - 1) - 0.5, rng.uniform(0, 2 * np.pi, one)
    across = np.cos(turn) * axis + np.sin(turn) * axis[:, None] > rng.uniform(-0.5, 0.5, one)
    strip = rng.uniform(0, of.strip, one) * some(0.25) * across

    seen = remove_plane(fill_holes(np.where(held > 0, heights + noise + waves + strip, np.nan)))
    measures = measures_of(seen, held, variance, rise[:, 0, 0])
    measures[some(of.no_noise)[:, 0, 0], 1:] = 0
    return normalise(seen), measures, labels_of(shape, relief[:, 0, 0])


def rotate(patches: Floats, angle: Floats) -> Floats:
    """Rotate each patch about its centre by ``angle`` (n,) rad: bilinear, half-sample mirroring beyond the border."""
    count, pixels, _ = patches.shape
    axis = np.arange(pixels) - (pixels - 1) / 2
    cos, sin = np.cos(angle)[:, None, None], np.sin(angle)[:, None, None]
    row = _mirror(cos * axis[:, None] + sin * axis[None, :] + (pixels - 1) / 2, pixels)
    col = _mirror(cos * axis[None, :] - sin * axis[:, None] + (pixels - 1) / 2, pixels)
    r, c = np.minimum(row.astype(np.int64), pixels - 2), np.minimum(col.astype(np.int64), pixels - 2)
    down, right = row - r, col - c
    which = np.arange(count)[:, None, None]
    upper = patches[which, r, c] * (1 - right) + patches[which, r, c + 1] * right
    lower = patches[which, r + 1, c] * (1 - right) + patches[which, r + 1, c + 1] * right
    return upper * (1 - down) + lower * down


def _mirror(position: Floats, pixels: int) -> Floats:
    """Mirror positions [px] into 0 .. pixels - 1 at the outer edges of the first and the last pixel."""
    folded = np.mod(position + 0.5, 2 * pixels)
    return np.clip(np.minimum(folded, 2 * pixels - folded) - 0.5, 0, pixels - 1)


def blur(patches: Floats, sigma: Floats) -> Floats:
    """Blur each patch by its own Gaussian of ``sigma`` (n,) px; the weights are renormalised at the border."""
    axis = np.arange(patches.shape[-1])
    distance = axis[None, :] - axis[:, None]
    kernel = np.exp(-0.5 * (distance / np.maximum(sigma, 1e-3)[:, None, None]) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    return kernel @ patches @ kernel.transpose(0, 2, 1)


def fill_holes(patches: Floats) -> Floats:
    """Fill NaN with the mean of the known pixels among 8 neighbours, ring by ring, as for patches of a survey.

    A patch must contain at least one known pixel.
    """
    filled: Floats = patches.copy()
    for _ in range(patches.shape[-1]):
        empty = np.isnan(filled)
        if not empty.any():
            break
        rows = np.flatnonzero(empty.any(axis=(1, 2)))
        part, hole = filled[rows], empty[rows]
        values = np.where(hole, 0.0, part), (~hole).astype(np.float64)
        total, number = (correlate(each, np.ones((1, 3, 3)), mode="constant") for each in values)
        reach = hole & (number > 0)
        part[reach] = total[reach] / number[reach]
        filled[rows] = part
    return filled


# Second word of every generator's seed, so that no two uses share random numbers.
_TRAINING, _EPOCH, _UNSEEN, _UNSEEN_SURVEY, _COPIES, _ORDER, _WAVES, _UNSEEN_WAVES = range(8)

SHORT_WAVES = 0.4
"""Short regular waves that each epoch adds to the ``high_noise`` patches, as a share of these. They are added rather
than substituted, because otherwise rubble would be rarer than the forms it is confused with."""
_HIGH_NOISE = TEXTURES.index("high_noise")


def shapes(seed: int, purpose: int, patches_per_texture: int, pixels: int) -> NDArray[np.float32]:
    """Make scaled patches, texture by texture; ``purpose`` is the second word of the seed."""
    rngs = (np.random.default_rng([seed, purpose, index]) for index in range(len(TEXTURES)))
    made = [make_textures(name, patches_per_texture, rng, pixels) for name, rng in zip(TEXTURES, rngs, strict=True)]
    return np.concatenate(made)


def epoch_samples(patches: NDArray[np.float32], seed: int, epoch: int) -> SurveyedPatches:
    """Survey and shuffle the training patches for one epoch; a resumed training gets the same samples.

    Short regular waves, which no texture contains, are added as ``high_noise``.
    """
    added = math.ceil(SHORT_WAVES * len(patches) / len(TEXTURES))
    waves = make_short_waves(added, np.random.default_rng([seed, _WAVES, epoch]), patches.shape[-1])
    shape = np.append(_in_turn(patches), np.full(added, _HIGH_NOISE))
    order = np.random.default_rng([seed, _ORDER, epoch]).permutation(len(shape))
    rng = np.random.default_rng([seed, _EPOCH, epoch])
    return surveyed(np.concatenate((patches, waves))[order], shape[order], rng)


def unseen_samples(
    seed: int, patches_per_texture: int, pixels: int, of: SurveyEffects | None = None
) -> SurveyedPatches:
    """Make and survey patches from seeds that training never uses."""
    fresh = shapes(seed, _UNSEEN, patches_per_texture, pixels)
    return surveyed(fresh, _in_turn(fresh), np.random.default_rng([seed, _UNSEEN_SURVEY]), of)


def _in_turn(patches: NDArray[np.float32]) -> NDArray[np.int64]:
    return np.repeat(np.arange(len(TEXTURES)), len(patches) // len(TEXTURES))


class TextureNet(nn.Module):
    """Four 3 x 3 convolutions, the last two at half resolution, an average over the patch, and two dense layers.

    The first dense layer takes the measures too.

    There is no padding before the pooling, because the network would read a border of zeros as low ground. The last
    convolution pads only if a patch has fewer than 11 pixels.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        a, b, c, d = settings.channels
        self.conv1, self.conv2 = convolution(1, a, 3), convolution(a, b, 3)
        self.pool = nn.MaxPool2d(3, stride=2)
        self.conv3 = convolution(b, c, 3, padding=1)
        self.conv4 = convolution(c, d, 3, padding=int(settings.pixels < 11))
        self.conv5 = convolution(d + MEASURES, settings.hidden, 1)
        self.head = nn.Conv2d(settings.hidden, len(TEXTURES), 1)
        self.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # a quarter faster

    def forward(self, patches: torch.Tensor, measures: torch.Tensor) -> torch.Tensor:
        """Return logits (n, classes) of patches (n, 1, pixels, pixels) scaled to [0, 1] and `measures_of`, (n, 3)."""
        x = torch.relu(self.conv1(patches))  # (n, 16, 13, 13)
        x = torch.relu(self.conv2(x))  # (n, 32, 11, 11)
        x = torch.relu(self.conv3(self.pool(x)))  # (n, 64, 5, 5)
        x = torch.relu(self.conv4(x))  # (n, 96, 3, 3)
        x = torch.cat((x.mean(dim=(2, 3), keepdim=True), measures[:, :, None, None]), dim=1)  # (n, 99, 1, 1)
        x = torch.relu(self.conv5(x))  # (n, 128, 1, 1)
        return self.head(x).flatten(1)  # (n, 4)


def train(
    settings: TrainSettings, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None
) -> TextureNet:
    """Train a network; see `train_network`. The same settings give the same bits on the same machine and libraries."""
    return train_network(
        settings,
        lambda: TextureNet(settings.network),
        lambda numbers: _epochs(settings, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        {"feature_version": FEATURE_VERSION},
        checkpoint,
        progress,
    )


def _epochs(settings: TrainSettings, numbers: range) -> Iterator[Epoch]:
    training = shapes(settings.seed, _TRAINING, settings.patches_per_texture, settings.network.pixels)
    for epoch in numbers:
        patches, measures, labels = map(torch.from_numpy, epoch_samples(training, settings.seed, epoch))
        patches = patches[:, None].contiguous(memory_format=torch.channels_last)
        count = len(labels)
        batches = max(1, count // settings.batch)  # of equal size: a batch of one patch has no variance to normalise
        bounds = [number * count // batches for number in range(batches + 1)]
        yield (patches, measures), labels, bounds


def _learning_rate(share: float, peak: float) -> float:
    """Rise linearly over the first tenth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    if share < 0.1:
        return peak * (share + 0.01) / 0.11
    return peak * 0.5 * (1 + math.cos(math.pi * (share - 0.1) / 0.9))


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scores of a training."""

    unseen: Accuracy
    """Patches from other seeds, surveyed anew."""
    level: Accuracy
    """Noise of level ground."""
    augmented_copies: Accuracy
    """The training patches, surveyed anew: the paper's validation."""
    short_waves: Accuracy
    """Short regular waves from other seeds."""
    parameters: int
    """Number of trained parameters."""


def evaluate(net: TextureNet, seed: int, training_per_texture: int, unseen_per_texture: int) -> Evaluation:
    """Score a network in evaluation mode.

    Unseen patches come from other random streams of the ``seed`` of its training; copies of all training patches are
    scored too.
    """
    pixels = net.settings.pixels
    copies = shapes(seed, _TRAINING, training_per_texture, pixels)
    rng = np.random.default_rng([seed, _UNSEEN_WAVES])
    waves, high = make_short_waves(unseen_per_texture, rng, pixels), np.full(unseen_per_texture, _HIGH_NOISE)
    return Evaluation(
        unseen=score(net, unseen_samples(seed, unseen_per_texture, pixels)),
        level=score(net, unseen_samples(seed, unseen_per_texture, pixels, SurveyEffects(level=1.0))),
        augmented_copies=score(net, surveyed(copies, _in_turn(copies), np.random.default_rng([seed, _COPIES]))),
        short_waves=score(net, surveyed(waves, high, rng)),
        parameters=sum(p.numel() for p in net.parameters()),
    )


def score(net: TextureNet, samples: SurveyedPatches) -> Accuracy:
    """Count right and wrong answers."""
    patches, measures, labels = samples
    answer = predict(net, torch.from_numpy(patches)[:, None], torch.from_numpy(measures)).argmax(axis=1)
    return accuracy_of(labels, answer, len(TEXTURES))


def to_onnx(net: TextureNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network in evaluation mode as an ONNX file, with ``metadata``.

    Inputs ``patches`` (batch, 1, pixels, pixels) and ``measures`` (batch, 3, 1, 1), output ``probability`` (batch,
    classes), all float32.
    """
    graph = OnnxGraph("texture")

    def layer(pair: nn.Sequential, source: str) -> str:
        return graph.add("Relu", graph.conv(pair, source))

    x = layer(net.conv2, layer(net.conv1, "patches"))
    x = graph.add("MaxPool", x, kernel_shape=[3, 3], strides=[2, 2])
    x = graph.add("GlobalAveragePool", layer(net.conv4, layer(net.conv3, x)))
    x = layer(net.conv5, graph.add("Concat", x, "measures", axis=1))
    pixels = net.settings.pixels
    return graph.to_bytes(net.head, x, {"patches": (1, pixels, pixels), "measures": (MEASURES, 1, 1)}, metadata)


UNSEEN_PER_TEXTURE = 2500
"""Number of patches per texture in the scores on unseen seeds."""


def make_model(settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None = None) -> Evaluation:
    """Train a texture network, write it, and return its scores.

    The settings determine every byte of the file on one machine. ``out``: the ONNX file. During training a checkpoint
    (``.checkpoint``) lies next to it, from which the same call resumes after an interruption. ``progress`` is called
    with a report after every epoch. Raises OutputError if a file cannot be written, UsageError if a checkpoint with
    other settings exists.
    """
    with training_files(out) as checkpoint:
        net = train(settings, checkpoint, progress)
        evaluation = evaluate(net, settings.seed, settings.patches_per_texture, UNSEEN_PER_TEXTURE)
        network = settings.network
        names = ("seed", "epochs", "patches_per_texture", "network.pixels", "tile_size", "threads")
        metadata = {
            **versions("bumpymap-textures"),
            "classes": list(TEXTURES),
            "pixels": network.pixels,
            "tile_size": settings.tile_size,
            "feature_version": FEATURE_VERSION,
            "channels": list(network.channels),
            "hidden": network.hidden,
            "parameters": evaluation.parameters,
            "seed": settings.seed,
            "command": f"bumpymap train textures {settings.as_options(*names)}",
            "accuracy_unseen": evaluation.unseen.right,
            "confusion_unseen": evaluation.unseen.confusion,
            "accuracy_level": evaluation.level.right,
            "accuracy_altered_copies": evaluation.augmented_copies.right,
            "confusion_altered_copies": evaluation.augmented_copies.confusion,
            "accuracy_short_waves": evaluation.short_waves.right,
        }
        write_model(out, to_onnx(net, metadata), checkpoint)
    return evaluation
