"""The model card: what a texture network is for, how it was made and how good it is, in Markdown."""

from bumpymap.core import TEXTURES
from bumpymap.lab.train.alter import ALL, LIGHT
from bumpymap.lab.train.data import LIGHT_EVERY, SHORT_WAVES
from bumpymap.lab.train.evaluate import Evaluation
from bumpymap.lab.train.score import percent, score_table
from bumpymap.lab.train.train import TrainSettings
from bumpymap.rating import FEATURE_VERSION

__all__ = ["model_card"]

_ALTERATIONS = {
    "none": "none",
    "brightness": f"brightness: gain, offset, power exp(-{ALL.brightness:g}) to exp({ALL.brightness:g})",
    "rotation": "rotation by any angle, flips",
    "blur": f"blur, up to {ALL.blur:g} px",
    "noise": f"white noise, up to {ALL.noise:.0%} of the z range",
    "holes": f"holes: up to {ALL.holes:.0%} of the pixels and a disc, filled from neighbours",
}


def model_card(settings: TrainSettings, evaluation: Evaluation, parameters: int, size: int) -> str:
    """Write the card.

    Parameters
    ----------
    settings : TrainSettings
        Of the training.
    evaluation : Evaluation
        Its scores.
    parameters : int
        Trained numbers.
    size : int
        Bytes of the ONNX file.
    """
    network = settings.network
    side = f"{network.pixels} x {network.pixels}"
    numbers = f"{parameters:,} trained numbers; {size:,} bytes of ONNX, opset 17"
    single = "\n".join(f"| {text} | {percent(evaluation.single[key].accuracy)} |" for key, text in _ALTERATIONS.items())
    copies = percent(evaluation.altered_copies.accuracy)
    return f"""# Texture network

Tells the four terrain forms of the BumpyPatch paper apart in the heightmap of one tile: {_names()}.

- **Use**: `bumpymap map`. The texture, with the z range, decides what a tile costs a vehicle.
- **Input**: `patches` (batch, 1, {network.pixels}, {network.pixels}) float32. The heights of a tile of
  {settings.tile_size:g} m, its least-squares plane taken off, holes filled from their neighbours, min-max scaled to
  [0, 1] (feature version {FEATURE_VERSION}).
- **Output**: `probability` (batch, {len(network.classes)}) float32, in the order above.
- **Network**: four 3 x 3 convolutions with {", ".join(map(str, network.channels))} filters on {side} pixels,
  averaged over the patch, and {network.hidden} units that read the averages; {numbers}.

## Data

{4 * settings.patches_per_texture:,} patches, {settings.patches_per_texture:,} a texture, made from Perlin noise, sine
waves and Gaussian blur by `bumpymap.rating.textures`. No survey was used. Every epoch alters the patches anew:
brightness, rotation, blur, noise and holes, all of them, but on one patch in {LIGHT_EVERY} each only with probability
{LIGHT.chance:g}. Unseen patches come from other seeds: none of them, altered or not, was learned from. Every epoch adds
to the `high_noise` patches {SHORT_WAVES:.0%} of short regular waves (0.4 to 0.75 m on a tile of 3 m, one way or
crossing): no form holds them, and a network that never met them takes the shortest for `flat`.

## Accuracy

On {evaluation.unseen.count:,} **patches from unseen seeds with all alterations: {percent(evaluation.unseen.accuracy)}**

{score_table(evaluation.unseen, TEXTURES)}

On {evaluation.altered_copies.count:,} **altered copies of the training patches: {copies}**
(the paper's way of validating; it reports 92.42 % for its own patches and alterations, which are not these)

{score_table(evaluation.altered_copies, TEXTURES)}

On unseen seeds with one alteration at a time:

| alteration | accuracy |
|---|---|
{single}

Of {evaluation.short_waves.count:,} short regular waves from unseen seeds with all alterations,
{percent(evaluation.short_waves.accuracy)} are called `high_noise`, as they should be.

## Make it again

    pip install 'bumpymap[learn]'
    {settings.command} --out textures.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

## Limits

- The accuracy is that of telling *made* ground apart. Real ground is no exact member of any form: on it the network
  says which form a tile resembles most, and its probabilities say how clearly.
- Height is not seen: a patch with 1 cm of relief and one with 1 m look the same after scaling. The z range, rated
  beside the texture, tells them apart. Tiles with at most 1 mm of relief never reach the network; they are flat.
- Many filled holes smooth a patch; where coverage is low, rough ground can pass for `low_noise`.
- One isolated step (a kerb, a ledge) is none of the four forms.
- It fits tiles of {settings.tile_size:g} m with {side} pixels only; `bumpymap map` refuses it for others.
"""


def _names() -> str:
    return ", ".join(f"`{texture}`" for texture in TEXTURES)
