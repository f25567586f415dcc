"""The model card: what a scan network is for, how it was made and how good it is, in Markdown."""

from dataclasses import dataclass

from bumpymap.core import CLASSES, PolarSettings
from bumpymap.lab.train.scan.evaluate import ScanEvaluation
from bumpymap.lab.train.scan.train import ScanTrainSettings
from bumpymap.lab.train.score import percent, score_table
from bumpymap.scan import CLASS_OF_LABEL, MEASURES, SECTOR_VERSION, grid_record

__all__ = ["LABEL_NAMES", "CardFacts", "model_card"]

_CLASS_NAMES = tuple(map(str, range(CLASSES)))
LABEL_NAMES = {
    1: "dirt", 3: "grass", 4: "tree", 6: "water", 8: "vehicle", 10: "asphalt", 17: "person", 18: "fence", 19: "bush",
    23: "concrete", 27: "barrier", 31: "puddle", 33: "mud", 34: "rubble",
}  # fmt: skip
"""RELLIS-3D id -> name, those with a class."""


_LIMITS_OF_SIMULATION = """\
- The accuracy is that of telling *made* scenes apart. What the simulator does not know (snow, crops,
  rain, moving things, reflections in water) the network does not know.
- Mud and water are told from dirt by ruts, by churned ground and by returns that stay away: mud as flat as dry dirt
  reads as dirt, and so does a puddle of which nothing comes back but its margin.
- Natural ground is made with roots, clods and tussocks of 3 to 40 mm (standard deviation) and herbs up to 40 cm. Ground
  rougher than that reads as class 1, whatever grows there.
"""


@dataclass(frozen=True, slots=True)
class CardFacts:
    """What the card says of a training beside its settings and scores."""

    learned: tuple[int, ...]
    """Sectors of each class that it learned from."""
    parameters: int
    """Trained numbers."""
    size: int
    """Bytes of the ONNX file."""
    command: str
    """The command line of this training, all but where to write."""
    simulated: bool
    """Whether the scans were made up."""


def model_card(settings: ScanTrainSettings, evaluation: ScanEvaluation, made: CardFacts) -> str:
    """Write the card of a training with such settings and scores."""
    limits = _LIMITS_OF_SIMULATION if made.simulated else ""
    widths = ", ".join(map(str, settings.network.widths))
    return f"""# Scan network

Tells how rough the sectors of one LiDAR scan are: class 0 (smooth) to 2 (rough).

- **Use**: `bumpymap scan --method learned`.
- **Input**: `patches` (batch, 2, 15, 15) float32, the heights of a sector over its plane, in the sector's own polar
  coordinates: once scaled by their own range, once by asinh(h / 5 cm); and `measures` (batch, {len(MEASURES)}):
  {", ".join(MEASURES)} (sector version {SECTOR_VERSION}). `beside` is the number of points against that of
  the ground in the same ring.
- **Output**: `probability` (batch, {CLASSES}) float32.
- **Network**: after MobileNetV2: a 3 x 3 convolution with {settings.network.stem} filters, inverted residuals with
  {widths} channels, {settings.network.expansion} times wider inside; the measures join before the answer.
  {made.parameters:,} trained numbers; {made.size:,} bytes of ONNX, opset 17.
- **Grid**: {grid_record(PolarSettings())}; other grids are refused.
- **Classes**: {_classes()} (most frequent label of a sector's points, RELLIS-3D names).

## Data

{_data(settings, made.simulated)}
Sectors to learn from: {", ".join(f"{n:,} of class {k}" for k, n in enumerate(made.learned))}. An epoch draws
{settings.sectors_per_class:,} of each class, half of them mirrored in azimuth; each scan was cut {settings.turns} more
times after a random turn.

## Accuracy

On {evaluation.every.count:,} sectors of {evaluation.scans} **unseen scans: {percent(evaluation.every.even_accuracy)}
with the classes weighted evenly** (training is balanced so), {percent(evaluation.every.accuracy)} of all sectors as
they come. The paper reports 83.24 % on its own patches, which are not these.

{score_table(evaluation.every, _CLASS_NAMES)}

Of those, the {evaluation.gated.count:,} that the gate lets through (what the network is asked in use):
{percent(evaluation.gated.even_accuracy)} evenly, {percent(evaluation.gated.accuracy)} as they come.

{score_table(evaluation.gated, _CLASS_NAMES)}

By label, sectors said to be of class 0, 1, 2:

| label | class | 0 | 1 | 2 |
|---|---|---|---|---|
{_labels(evaluation)}

## Make it again

    pip install 'bumpymap[learn,o3d]'
    {made.command} --out scan.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

## Limits

{limits}- A sector has one class. Where a kerb, a trunk or the margin of a puddle runs through it, the most
  frequent label decides what is right; many of the errors are such sectors.
- A scan says little about ground that few beams reach: beyond 20 m a sector often holds one or two lines.
"""


def _data(settings: ScanTrainSettings, simulated: bool) -> str:
    if not simulated:
        return "Labelled frames in the layout of RELLIS-3D; the last fifth of every sequence is unseen.\n"
    return f"""{settings.scenes} made-up scenes with labels (`bumpymap.lab.worlds.scans`), each seen once by another
sensor of 32, 64 or 128 lines with range noise of 0.8 to 3 cm, 0.1 to 5 % of lost returns and a tilt of some degrees. No
real scan was used. The ground of every tenth scene is seen once more from above, without shadows and with blocks heaped
on half of it. Unseen scenes come from other numbers of the same seed.
"""


def _classes() -> str:
    return "; ".join(
        f"{k}: " + ", ".join(LABEL_NAMES[label] for label, class_id in CLASS_OF_LABEL.items() if class_id == k)
        for k in range(CLASSES)
    )


def _labels(evaluation: ScanEvaluation) -> str:
    return "\n".join(
        f"| {LABEL_NAMES[label]} | {CLASS_OF_LABEL[label]} | " + " | ".join(map(str, said)) + " |"
        for label, said in sorted(evaluation.labels.items(), key=lambda item: (CLASS_OF_LABEL[item[0]], item[0]))
    )
