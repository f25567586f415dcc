"""Write the model card of a texture network in Markdown: purpose, data, accuracy, limits."""

from bumpymap.core import TEXTURES
from bumpymap.lab.train.augment import ALL, LIGHT
from bumpymap.lab.train.data import LIGHT_EVERY, SHORT_WAVES
from bumpymap.lab.train.evaluate import Evaluation
from bumpymap.lab.train.score import percent, score_table
from bumpymap.lab.train.train import TrainSettings
from bumpymap.rating import FEATURE_VERSION

__all__ = ["model_card"]

_EFFECTS = {
    "none": "none",
    "brightness": f"brightness: gain, offset, power exp(-{ALL.brightness:g}) to exp({ALL.brightness:g})",
    "rotation": "rotation by any angle, flips",
    "blur": f"blur, up to {ALL.blur:g} px",
    "noise": f"white noise, up to {ALL.noise:.0%} of the z range",
    "holes": f"holes: up to {ALL.holes:.0%} of the pixels and a disc, filled from neighbours",
}


def model_card(settings: TrainSettings, evaluation: Evaluation, parameters: int, size: int) -> str:
    """Return the text of the card.

    Parameters
    ----------
    settings : TrainSettings
    evaluation : Evaluation
    parameters : int
        Number of trained parameters.
    size : int
        Size of the ONNX file, bytes.
    """
    network = settings.network
    side = f"{network.pixels} x {network.pixels}"
    numbers = f"{parameters:,} trained parameters; {size:,} bytes of ONNX, opset 17"
    return f"""# Texture network

Classifies the heightmap of one tile as one of the four terrain forms of the BumpyPatch paper: {_names()}.

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

{_accuracy(evaluation)}
## Reproduce

    pip install 'bumpymap[learn]'
    {settings.command} --out textures.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

{_limits(settings.tile_size, side)}"""


def _accuracy(evaluation: Evaluation) -> str:
    single = "\n".join(f"| {text} | {percent(evaluation.single[key].accuracy)} |" for key, text in _EFFECTS.items())
    copies = percent(evaluation.augmented_copies.accuracy)
    return f"""## Accuracy

On {evaluation.unseen.count:,} **patches from unseen seeds, fully augmented: {percent(evaluation.unseen.accuracy)}**

{score_table(evaluation.unseen, TEXTURES)}

On {evaluation.augmented_copies.count:,} **augmented copies of the training patches: {copies}**
(the paper's validation method; it reports 92.42 % for its own patches and augmentation, which are not these)

{score_table(evaluation.augmented_copies, TEXTURES)}

On unseen seeds with one effect at a time:

| augmentation | accuracy |
|---|---|
{single}

Of {evaluation.short_waves.count:,} short regular waves from unseen seeds, fully augmented,
{percent(evaluation.short_waves.accuracy)} are classified as `high_noise`, the right answer.
"""


def _limits(tile_size: float, side: str) -> str:
    return f"""## Limits

- The accuracy is measured on *synthetic* ground. Real ground does not exactly match any form: the network
  returns the form that a tile resembles most, and its probabilities show how clearly.
- The network does not see absolute height: a patch with 1 cm of relief and one with 1 m look the same after scaling.
  The z range distinguishes them. Tiles with at most 1 mm of relief are classed as flat without the network.
- Many filled holes smooth a patch; if coverage is low, rough ground may be classified as `low_noise`.
- A single isolated step (a kerb, a ledge) is none of the four forms.
- It works only for tiles of {tile_size:g} m with {side} pixels; `bumpymap map` rejects it for others.
"""


def _names() -> str:
    return ", ".join(f"`{texture}`" for texture in TEXTURES)
