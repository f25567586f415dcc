"""Train the texture network on made patches, score it on unseen ones, and write it as ONNX with its model card.

All patches come from one seed, with the effects of a survey. Each effect takes patches scaled to [0, 1] and one
strength per patch, and works on all patches at once. ``augment`` applies them in the order in which a survey does:
rotate the ground, change brightness, blur, add noise, empty pixels and fill them, remove the plane and scale.

The ONNX graph has no operator whose result for a patch depends on its position in the batch (the last two layers are
1 x 1 convolutions, not matrix products over the batch).
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from string import ascii_lowercase

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from bumpymap.core import TEXTURES
from bumpymap.lab.evaluate.agreement import Accuracy, accuracy_of
from bumpymap.lab.settings import NetworkSettings, TrainSettings
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
from bumpymap.rating import FEATURE_VERSION, make_short_waves, make_textures, normalise, remove_plane

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Augmentation:
    """Maximum strengths; each patch draws its own strengths between 0 and these. Zero switches an effect off."""

    brightness: float = 0.3
    """Heights h become ``gain * h**exp(b) + offset``, with abs(b) up to this. The final scaling removes gain and
    offset, so only b affects the network."""
    rotation: float = 1.0
    """Rotation as a share of a full turn; corners are filled by mirroring. Half of the patches are also flipped."""
    blur: float = 0.7
    """Standard deviation of a Gaussian, px."""
    noise: float = 0.05
    """Standard deviation of white noise, share of the z range."""
    holes: float = 0.4
    """Share of the pixels that are emptied independently; a round hole of up to 2.5 px radius is added."""
    chance: float = 1.0
    """Probability of each effect on a patch, drawn independently."""

    def only(self, name: str) -> "Augmentation":
        """Return a copy with all effects but one switched off."""
        return replace(NONE, **{name: getattr(self, name)})


KINDS = ("brightness", "rotation", "blur", "noise", "holes")
ALL = Augmentation()
"""All effects on every patch, as in the evaluation of networks."""
LIGHT = Augmentation(chance=0.5)
"""Each effect on half of the patches; training uses a few such patches."""
NONE = Augmentation(0.0, 0.0, 0.0, 0.0, 0.0)


def augment(patches: NDArray[np.float32], settings: Augmentation, rng: np.random.Generator) -> NDArray[np.float32]:
    """Augment each patch with its own strengths, then prepare it like a patch of a survey.

    Parameters
    ----------
    patches : array (n, pixels, pixels) float32
        Scaled to [0, 1].
    settings : Augmentation
        Maximum strengths.
    rng : numpy Generator
        The same state gives the same bits. Every effect draws its random numbers even if it is off, so switching one
        off does not change the others.

    Returns
    -------
    array (n, pixels, pixels) float32
        Plane-removed, scaled to [0, 1].
    """
    count = len(patches)
    drawn, happens = rng.uniform(size=(2, len(KINDS), count))
    strength = {
        kind: getattr(settings, kind) * drawn[k] * (happens[k] < settings.chance) for k, kind in enumerate(KINDS)
    }
    heights = patches.astype(np.float64)
    flip = (rng.uniform(size=count) < 0.5) & (settings.rotation > 0)
    heights = rotate(np.where(flip[:, None, None], heights[:, :, ::-1], heights), 2 * np.pi * strength["rotation"])
    heights = brighten(heights, strength["brightness"], rng)
    heights = blur(heights, strength["blur"])
    heights = add_noise(heights, strength["noise"], rng)
    heights = fill_holes(punch_holes(heights, strength["holes"], 2.5 * (strength["holes"] > 0), rng))
    return normalise(remove_plane(heights))


def rotate(patches: _Floats, angle: _Floats) -> _Floats:
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
    turned: _Floats = upper * (1 - down) + lower * down
    return turned


def _mirror(position: _Floats, pixels: int) -> _Floats:
    """Mirror positions [px] into 0 .. pixels - 1 at the outer edges of the first and the last pixel."""
    folded = np.mod(position + 0.5, 2 * pixels)
    return np.clip(np.minimum(folded, 2 * pixels - folded) - 0.5, 0, pixels - 1)


def brighten(patches: _Floats, strength: _Floats, rng: np.random.Generator) -> _Floats:
    """Change gain and offset, and raise heights to a power between ``exp(-strength)`` and ``exp(strength)``."""
    sign = rng.choice([-1.0, 1.0], len(patches))
    gain, offset = rng.uniform(0.5, 2.0, (2, len(patches), 1, 1))
    power = np.exp(sign * strength)[:, None, None]
    changed: _Floats = gain * np.clip(patches, 0.0, 1.0) ** power + offset
    return normalise(changed).astype(np.float64)


def blur(patches: _Floats, sigma: _Floats) -> _Floats:
    """Blur each patch by its own Gaussian of ``sigma`` (n,) px; the weights are renormalised at the border."""
    axis = np.arange(patches.shape[-1])
    distance = axis[None, :] - axis[:, None]
    kernel = np.exp(-0.5 * (distance / np.maximum(sigma, 1e-3)[:, None, None]) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    blurred: _Floats = kernel @ patches @ kernel.transpose(0, 2, 1)
    return blurred


def add_noise(patches: _Floats, deviation: _Floats, rng: np.random.Generator) -> _Floats:
    """Add white noise; ``deviation`` (n,) is a share of the patch's own range."""
    noisy: _Floats = patches + (deviation * np.ptp(patches, axis=(1, 2)))[:, None, None] * rng.standard_normal(
        patches.shape
    )
    return noisy


def punch_holes(patches: _Floats, share: _Floats, radius: _Floats, rng: np.random.Generator) -> _Floats:
    """Set to NaN a random ``share`` (n,) of the pixels, and a round hole of up to ``radius`` (n,) px."""
    count, pixels, _ = patches.shape
    empty = rng.uniform(size=patches.shape) < share[:, None, None]
    centre = rng.uniform(0, pixels - 1, (2, count, 1, 1))
    size = rng.uniform(0, 1, (count, 1, 1)) * radius[:, None, None]
    axis = np.arange(pixels)
    empty |= (axis[:, None] - centre[0]) ** 2 + (axis[None, :] - centre[1]) ** 2 < size**2
    holed: _Floats = np.where(empty, np.nan, patches)
    return holed


def fill_holes(patches: _Floats) -> _Floats:
    """Fill NaN with the mean of the known pixels among 8 neighbours, ring by ring, as for patches of a survey.

    A patch must contain at least one known pixel.
    """
    filled: _Floats = patches.copy()
    pixels = patches.shape[-1]
    for _ in range(pixels):
        empty = np.isnan(filled)
        if not empty.any():
            break
        rows = np.flatnonzero(empty.any(axis=(1, 2)))
        part, hole = filled[rows], empty[rows]
        known = np.pad(~hole, ((0, 0), (1, 1), (1, 1))).astype(np.float64)
        value = np.pad(np.where(hole, 0.0, part), ((0, 0), (1, 1), (1, 1)))
        total, number = np.zeros_like(part), np.zeros_like(part)
        for down in range(3):
            for right in range(3):
                window = (slice(None), slice(down, down + pixels), slice(right, right + pixels))
                total += value[window]
                number += known[window]
        reach = hole & (number > 0)
        part[reach] = total[reach] / number[reach]
        filled[rows] = part
    return filled


# Second word of every generator's seed, so that no two uses share random numbers.
_TRAINING, _EPOCH, _UNSEEN, _UNSEEN_ALTERED, _COPIES, _ORDER, _WAVES, _UNSEEN_WAVES = range(8)

SHORT_WAVES = 0.2
"""Short regular waves that each epoch adds to the ``high_noise`` patches, as a share of these. They are added rather
than substituted, because otherwise rubble would be rarer than the forms it is confused with."""
LIGHT_EVERY = 7
"""One in this many patches of an epoch is augmented lightly: a network trained only on fully augmented patches mistakes
the grain of an unaltered one for rubble. The others are augmented as in the evaluation: with less strong blur in
training, the network would see too few examples of smooth rubble."""
_HIGH_NOISE = TEXTURES.index("high_noise")


@dataclass(frozen=True, slots=True)
class LabelledPatches:
    """Patches and their labels."""

    patches: NDArray[np.float32]
    """(n, pixels, pixels) plane-removed, scaled to [0, 1]."""
    labels: NDArray[np.int64]
    """(n,) index into ``TEXTURES``."""


def training_patches(seed: int, patches_per_texture: int, pixels: int) -> LabelledPatches:
    """Make the training patches, texture by texture."""
    return _textures(seed, _TRAINING, patches_per_texture, pixels)


def epoch_samples(training: LabelledPatches, seed: int, epoch: int) -> LabelledPatches:
    """Augment and shuffle the training patches for one epoch; a resumed training gets the same patches.

    Short regular waves, which no texture contains, are added as ``high_noise``.
    """
    added = math.ceil(SHORT_WAVES * np.count_nonzero(training.labels == _HIGH_NOISE))
    waves = make_short_waves(added, np.random.default_rng([seed, _WAVES, epoch]), training.patches.shape[-1])
    patches = np.concatenate((training.patches, waves))
    labels = np.concatenate((training.labels, np.full(added, _HIGH_NOISE)))
    order = np.random.default_rng([seed, _ORDER, epoch]).permutation(len(labels))
    patches, labels = patches[order], labels[order]
    lightly = np.arange(len(labels)) % LIGHT_EVERY == 0  # evenly spread, so that every batch holds some
    rng = np.random.default_rng([seed, _EPOCH, epoch])
    patches[lightly] = augment(patches[lightly], LIGHT, rng)
    patches[~lightly] = augment(patches[~lightly], ALL, rng)
    return LabelledPatches(patches, labels)


def unseen_short_waves(seed: int, count: int, pixels: int) -> LabelledPatches:
    """Make short regular waves from seeds that training never uses, fully augmented."""
    rng = np.random.default_rng([seed, _UNSEEN_WAVES])
    return LabelledPatches(augment(make_short_waves(count, rng, pixels), ALL, rng), np.full(count, _HIGH_NOISE))


def unseen_patches(
    seed: int, patches_per_texture: int, pixels: int, alterations: Augmentation = ALL
) -> LabelledPatches:
    """Make patches from seeds that training never uses, then augment them."""
    fresh = _textures(seed, _UNSEEN, patches_per_texture, pixels)
    if alterations == NONE:
        return fresh
    rng = np.random.default_rng([seed, _UNSEEN_ALTERED])
    return LabelledPatches(augment(fresh.patches, alterations, rng), fresh.labels)


def augmented_copies(training: LabelledPatches, seed: int) -> LabelledPatches:
    """Augment the training patches with other random numbers than in training, as in the paper's validation."""
    return LabelledPatches(augment(training.patches, ALL, np.random.default_rng([seed, _COPIES])), training.labels)


def _textures(seed: int, purpose: int, patches_per_texture: int, pixels: int) -> LabelledPatches:
    made = [
        make_textures(texture, patches_per_texture, np.random.default_rng([seed, purpose, index]), pixels)
        for index, texture in enumerate(TEXTURES)
    ]
    return LabelledPatches(np.concatenate(made), np.repeat(np.arange(len(TEXTURES)), patches_per_texture))


class TextureNet(nn.Module):
    """Four 3 x 3 convolutions, the last two at half resolution, an average over the patch, and two dense layers.

    There is no padding before the pooling, because the network would read a border of zeros as low ground. The last
    convolution pads only if a patch has fewer than 11 pixels.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        a, b, c, d = settings.channels
        self.conv1, self.norm1 = nn.Conv2d(1, a, 3, bias=False), nn.BatchNorm2d(a)
        self.conv2, self.norm2 = nn.Conv2d(a, b, 3, bias=False), nn.BatchNorm2d(b)
        self.pool = nn.MaxPool2d(3, stride=2)
        self.conv3, self.norm3 = nn.Conv2d(b, c, 3, padding=1, bias=False), nn.BatchNorm2d(c)
        border = int(settings.pixels < 11)
        self.conv4, self.norm4 = nn.Conv2d(c, d, 3, padding=border, bias=False), nn.BatchNorm2d(d)
        self.conv5, self.norm5 = nn.Conv2d(d, settings.hidden, 1, bias=False), nn.BatchNorm2d(settings.hidden)
        self.head = nn.Conv2d(settings.hidden, len(settings.classes), 1)

    def forward(self, patches: torch.Tensor) -> torch.Tensor:
        """Return logits (n, classes) of patches (n, 1, pixels, pixels) scaled to [0, 1]."""
        x = torch.relu(self.norm1(self.conv1(patches)))  # (n, 16, 13, 13)
        x = torch.relu(self.norm2(self.conv2(x)))  # (n, 32, 11, 11)
        x = torch.relu(self.norm3(self.conv3(self.pool(x))))  # (n, 64, 5, 5)
        x = torch.relu(self.norm4(self.conv4(x)))  # (n, 96, 3, 3)
        x = x.mean(dim=(2, 3), keepdim=True)  # (n, 96, 1, 1)
        x = torch.relu(self.norm5(self.conv5(x)))  # (n, 128, 1, 1)
        return self.head(x).flatten(1)  # (n, 4)


def train(
    settings: TrainSettings, checkpoint: Path | None = None, progress: Callable[[EpochReport], None] | None = None
) -> TextureNet:
    """Train a network; see `Training.run`. The same settings give the same bits on the same machine and libraries."""

    def network() -> TextureNet:
        net = TextureNet(settings.network)
        net.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # a quarter faster
        return net

    loop = Training(
        settings,
        network,
        lambda numbers: _epochs(settings, numbers),
        lambda share: _learning_rate(share, settings.learning_rate),
        record={"feature_version": FEATURE_VERSION},
    )
    return loop.run(checkpoint, progress)


def _epochs(settings: TrainSettings, numbers: range) -> Iterator[EpochData]:
    training = training_patches(settings.seed, settings.patches_per_texture, settings.network.pixels)
    for epoch in numbers:
        samples = epoch_samples(training, settings.seed, epoch)
        patches = torch.from_numpy(samples.patches)[:, None].contiguous(memory_format=torch.channels_last)
        count = len(samples.labels)
        batches = max(1, count // settings.batch)  # of equal size: a batch of one patch has no variance to normalise
        bounds = [number * count // batches for number in range(batches + 1)]
        yield EpochData((patches,), torch.from_numpy(samples.labels), bounds)


def _learning_rate(share: float, peak: float) -> float:
    """Rise linearly over the first tenth, then fall along half a cosine to zero; ``share``: of the training, 0..1."""
    if share < 0.1:
        return peak * (share + 0.01) / 0.11
    return peak * 0.5 * (1 + math.cos(math.pi * (share - 0.1) / 0.9))


_BATCH = 1024


@dataclass(frozen=True, slots=True)
class Evaluation:
    """All scores of the model card."""

    unseen: Accuracy
    """Patches from other seeds, fully augmented."""
    augmented_copies: Accuracy
    """Augmented copies of the training patches, the paper's validation."""
    single: dict[str, Accuracy]
    """Patches from other seeds, without augmentation (``none``) and with one effect each."""
    short_waves: Accuracy
    """Short regular waves from other seeds, fully augmented; ``high_noise`` is the right answer."""


def evaluate(net: TextureNet, seed: int, training_per_texture: int, unseen_per_texture: int) -> Evaluation:
    """Score a network in evaluation mode.

    Unseen patches come from other random streams of the ``seed`` of its training; copies of all training patches are
    scored too.
    """
    pixels = net.settings.pixels
    single = {"none": score(net, unseen_patches(seed, unseen_per_texture, pixels, NONE))}
    for name in KINDS:
        single[name] = score(net, unseen_patches(seed, unseen_per_texture, pixels, ALL.only(name)))
    return Evaluation(
        unseen=score(net, unseen_patches(seed, unseen_per_texture, pixels)),
        augmented_copies=score(net, augmented_copies(training_patches(seed, training_per_texture, pixels), seed)),
        single=single,
        short_waves=score(net, unseen_short_waves(seed, unseen_per_texture, pixels)),
    )


def predict(net: nn.Module, *inputs: torch.Tensor) -> NDArray[np.float32]:
    """Return the probabilities (n, classes) that a network computes for inputs (n, ...)."""
    with torch.no_grad():
        batches = zip(*(torch.split(values, _BATCH) for values in inputs), strict=True)
        parts = [net(*batch).softmax(1) for batch in batches]
    probability: NDArray[np.float32] = torch.cat(parts).numpy()
    return probability


def score(net: TextureNet, samples: LabelledPatches) -> Accuracy:
    """Count right and wrong answers."""
    answer = predict(net, torch.from_numpy(samples.patches)[:, None]).argmax(axis=1)
    return accuracy_of(samples.labels, answer, len(TEXTURES))


_EFFECTS = {
    "none": "none",
    "brightness": f"brightness: gain, offset, power exp(-{ALL.brightness:g}) to exp({ALL.brightness:g})",
    "rotation": "rotation by any angle, flips",
    "blur": f"blur, up to {ALL.blur:g} px",
    "noise": f"white noise, up to {ALL.noise:.0%} of the z range",
    "holes": f"holes: up to {ALL.holes:.0%} of the pixels and a disc, filled from neighbours",
}


def model_card(settings: TrainSettings, evaluation: Evaluation, parameters: int, size: int) -> str:
    """Return the text of the card; ``size`` is that of the ONNX file, bytes."""
    network, copies = settings.network, evaluation.augmented_copies
    side = f"{network.pixels} x {network.pixels}"
    numbers = f"{parameters:,} trained parameters; {size:,} bytes of ONNX, opset 17"
    names = ", ".join(f"`{texture}`" for texture in TEXTURES)
    single = "\n".join(f"| {text} | {percent(evaluation.single[key].right)} |" for key, text in _EFFECTS.items())
    return f"""# Texture network

Classifies the heightmap of one tile as one of the four terrain forms of the BumpyPatch paper: {names}.

- **Use**: `bumpymap map`. The texture and the z range determine the ride cost of a tile.
- **Input**: `patches` (batch, 1, {network.pixels}, {network.pixels}) float32. The heights of a tile of
  {settings.tile_size:g} m, its least-squares plane removed, holes filled from their neighbours, min-max scaled to
  [0, 1] (feature version {FEATURE_VERSION}).
- **Output**: `probability` (batch, {len(network.classes)}) float32, in the order above.
- **Network**: four 3 x 3 convolutions with {", ".join(map(str, network.channels))} filters on {side} pixels,
  averaged over the patch, and a hidden layer of {network.hidden} units; {numbers}.

## Data

{4 * settings.patches_per_texture:,} patches, {settings.patches_per_texture:,} per texture, made from Perlin noise, sine
waves and Gaussian blur by `bumpymap.rating.textures`. No survey was used. Every epoch augments the patches with new
random brightness, rotation, blur, noise and holes; one patch in {LIGHT_EVERY} gets each effect only with probability
{LIGHT.chance:g}. Unseen patches come from other seeds and were not trained on, augmented or not. Every epoch adds
{SHORT_WAVES:.0%} of short regular waves (0.4 to 0.75 m on a tile of 3 m, in one direction or crossing) to the
`high_noise` patches: no form contains them, and a network trained without them calls the shortest ones `flat`.

## Accuracy

On {evaluation.unseen.count:,} **patches from unseen seeds, fully augmented: {percent(evaluation.unseen.right)}**

{score_table(evaluation.unseen, TEXTURES)}

On {copies.count:,} **augmented copies of the training patches: {percent(copies.right)}**
(the paper's validation method; it reports 92.42 % for its own patches and augmentation, which are not these)

{score_table(copies, TEXTURES)}

On unseen seeds with one effect at a time:

| augmentation | accuracy |
|---|---|
{single}

Of {evaluation.short_waves.count:,} short regular waves from unseen seeds, fully augmented,
{percent(evaluation.short_waves.right)} are classified as `high_noise`, the right answer.

## Reproduce

    pip install '.[learn]'
    {settings.command} --out textures.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

## Limits

- The accuracy is measured on *synthetic* ground. Real ground does not exactly match any form: the network
  returns the form that a tile resembles most, and its probabilities show how clearly.
- The network does not see absolute height: a patch with 1 cm of relief and one with 1 m look the same after scaling.
  The z range distinguishes them. Tiles with at most 1 mm of relief are classed as flat without the network.
- Many filled holes smooth a patch; if coverage is low, rough ground may be classified as `low_noise`.
- A single isolated step (a kerb, a ledge) is none of the four forms.
- It works only for tiles of {settings.tile_size:g} m with {side} pixels; `bumpymap map` rejects it for others.
"""


INPUT_NAME = "patches"
OUTPUT_NAME = "probability"


def to_onnx(net: TextureNet, metadata: Mapping[str, object]) -> bytes:
    """Write a network as an ONNX file.

    Parameters
    ----------
    net : TextureNet
        In evaluation mode.
    metadata : mapping
        Written as ``metadata_props``: text as it is, everything else as JSON.

    Returns
    -------
    bytes
        Input ``patches`` (batch, 1, pixels, pixels) float32, output ``probability`` (batch, classes) float32.
    """
    graph = OnnxGraph("texture", ascii_lowercase.__getitem__)

    def layer(number: int, source: str) -> str:
        conv, norm = getattr(net, f"conv{number}"), getattr(net, f"norm{number}")
        return graph.add("Relu", [graph.conv(conv, norm, source, f"conv{number}")])

    x = layer(2, layer(1, INPUT_NAME))
    x = graph.add("MaxPool", [x], kernel_shape=[3, 3], strides=[2, 2])
    x = layer(4, layer(3, x))
    x = layer(5, graph.add("GlobalAveragePool", [x]))
    x = graph.add("Flatten", [graph.conv(net.head, None, x, "head")], axis=1)
    graph.add("Softmax", [x], OUTPUT_NAME, axis=1)
    pixels, classes = net.settings.pixels, len(net.settings.classes)
    return graph.to_bytes({INPUT_NAME: (1, pixels, pixels)}, (OUTPUT_NAME, classes), metadata)


UNSEEN_PER_TEXTURE = 2500
"""Number of patches per texture in the scores on unseen seeds."""


def make_model(
    settings: TrainSettings, out: Path, progress: Callable[[EpochReport], None] | None = None
) -> TrainedModel[Evaluation]:
    """Train a texture network and write it.

    Parameters
    ----------
    settings : TrainSettings
        They determine every byte of the file on one machine.
    out : Path
        The ONNX file. The model card is written next to it (``.md``), and during training a checkpoint
        (``.checkpoint``), from which the same call resumes after an interruption.
    progress : callable, optional
        Called with a report after every epoch.

    Raises
    ------
    OutputError
        A file cannot be written.
    UsageError
        A checkpoint with other settings exists.
    """
    with model_files(out) as files:
        net = train(settings, files.checkpoint, progress)
        evaluation = evaluate(net, settings.seed, settings.patches_per_texture, UNSEEN_PER_TEXTURE)
        scores = {
            "accuracy_unseen": evaluation.unseen.right,
            "confusion_unseen": evaluation.unseen.confusion,
            "accuracy_altered_copies": evaluation.augmented_copies.right,
            "confusion_altered_copies": evaluation.augmented_copies.confusion,
            "accuracy_short_waves": evaluation.short_waves.right,
        }
        network = {
            "classes": list(settings.network.classes),
            "pixels": settings.network.pixels,
            "tile_size": settings.tile_size,
            "feature_version": FEATURE_VERSION,
            "channels": list(settings.network.channels),
            "hidden": settings.network.hidden,
        }
        training = {"parameters": parameter_count(net), "seed": settings.seed, "command": settings.command}
        content = to_onnx(net, {**versions("bumpymap-textures"), **network, **training, **scores})
        files.write(content, model_card(settings, evaluation, parameter_count(net), len(content)))
    return TrainedModel(files.model, files.card, evaluation, parameter_count(net))
