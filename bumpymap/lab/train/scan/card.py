"""Write the model card of a scan network in Markdown: purpose, data, accuracy, limits."""

from dataclasses import dataclass

from bumpymap.core import CLASSES, PolarSettings
from bumpymap.lab.train.scan.evaluate import ScanEvaluation
from bumpymap.lab.train.scan.train import ScanTrainSettings
from bumpymap.lab.train.score import percent, score_table
from bumpymap.readers import LABEL_SETS
from bumpymap.scan import MEASURES, SECTOR_VERSION

__all__ = ["CardFacts", "model_card"]

_CLASS_NAMES = tuple(map(str, range(CLASSES)))
_LABELS = LABEL_SETS["rellis"]
"""What the labels of the scenes, and of data sets to train on, mean."""


_LIMITS_OF_SIMULATION = """\
- The accuracy is measured on *synthetic* scenes. The network has not seen anything that the simulator lacks (snow,
  crops, rain, moving objects, reflections in water).
- Mud and water are distinguished from dirt by ruts, churned ground and missing returns: mud as flat as dry dirt is
  classified as dirt, and so is a puddle of which only the margin returns light.
- Natural ground is simulated with roots, clods and tussocks of 3 to 40 mm (standard deviation) and herbs up to 40 cm.
  Rougher ground is classified as class 1, whatever grows there.
"""


@dataclass(frozen=True, slots=True)
class CardFacts:
    """Facts of a training on its card, in addition to settings and scores."""

    learned: tuple[int, ...]
    """Number of training sectors of each class."""
    parameters: int
    """Number of trained parameters."""
    size: int
    """Size of the ONNX file, bytes."""
    command: str
    """The command line of this training, without ``--out``."""
    simulated: bool
    """Whether the scans were simulated."""


def model_card(settings: ScanTrainSettings, evaluation: ScanEvaluation, made: CardFacts) -> str:
    """Return the text of the card of a training."""
    limits = _LIMITS_OF_SIMULATION if made.simulated else ""
    widths = ", ".join(map(str, settings.network.widths))
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
  {made.parameters:,} trained parameters; {made.size:,} bytes of ONNX, opset 17.
- **Grid**: any polar grid with heightmaps of {PolarSettings().pixels} x {PolarSettings().pixels} pixels.
- **Classes**: {_classes()} (most frequent label of a sector's points, RELLIS-3D names).

## Data

{_data(settings, made.simulated)}
Training sectors: {", ".join(f"{n:,} of class {k}" for k, n in enumerate(made.learned))}. An epoch draws
{settings.sectors_per_class:,} of each class, half of them mirrored in azimuth; each scan was cut into sectors
{settings.turns} more times after a random rotation, half of these times on another polar grid.

{_accuracy(evaluation)}
## Reproduce

    pip install 'bumpymap[learn,o3d]'
    {made.command} --out scan.onnx

Seed {settings.seed}, {settings.epochs} epochs. The same command gives the same bits on the same machine and libraries.

## Limits

{limits}- A sector has one class. If a kerb, a trunk or the margin of a puddle runs through it, the most
  frequent label counts as true; many of the errors are such sectors.
- Ground that few beams reach is uncertain: beyond 20 m a sector often contains one or two scan lines.
"""


def _accuracy(evaluation: ScanEvaluation) -> str:
    return f"""## Accuracy

On {evaluation.every.count:,} sectors with ground of {evaluation.scans} **unseen scans:
{percent(evaluation.every.balanced_accuracy)} balanced accuracy** (training is balanced in the same way),
{percent(evaluation.every.accuracy)} of all sectors. The paper reports 83.24 % on its own patches, which are not these.

{score_table(evaluation.every, _CLASS_NAMES)}

By label, number of sectors classified as 0, 1, 2:

| label | class | 0 | 1 | 2 |
|---|---|---|---|---|
{_labels(evaluation)}
"""


def _data(settings: ScanTrainSettings, simulated: bool) -> str:
    if not simulated:
        return "Labelled frames in the layout of RELLIS-3D; the last fifth of every sequence is unseen.\n"
    return f"""{settings.scenes} synthetic scenes with labels (`bumpymap.lab.worlds.scans`), each scanned once by a
different sensor: 16 to 128 lines, evenly spaced or closer near the horizon, or a solid-state pattern of 60 to 360
degrees; 0.4 to 2.1 m above the ground, upright or leaning by up to 15 degrees, with range noise of 0.8 to 3 cm, 0.1 to
5 % of lost returns, stray returns and mirror images below wet ground. No real scan was used. The ground of every tenth
scene is sampled once more from above, without shadows and with blocks piled on half of it.
Unseen scenes have other numbers of the same seed.
"""


def _classes() -> str:
    return "; ".join(
        f"{k}: " + ", ".join(_LABELS.names[label] for label, class_id in _LABELS.class_of.items() if class_id == k)
        for k in range(CLASSES)
    )


def _labels(evaluation: ScanEvaluation) -> str:
    return "\n".join(
        f"| {_LABELS.names[label]} | {_LABELS.class_of[label]} | " + " | ".join(map(str, counts)) + " |"
        for label, counts in sorted(evaluation.labels.items(), key=lambda item: (_LABELS.class_of[item[0]], item[0]))
    )
