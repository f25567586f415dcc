"""What an evaluation found: the record that the report, its pictures and the JSON file are made of."""

import math
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from bumpymap.lab.evaluate.classes import ClassTable
from bumpymap.lab.evaluate.compare import Comparison, KindRow, Order
from bumpymap.lab.evaluate.density import DensityRow
from bumpymap.lab.evaluate.drives import Driven
from bumpymap.lab.evaluate.invariance import MoveRow
from bumpymap.lab.evaluate.noise import NoiseRow
from bumpymap.lab.evaluate.subject import Verdict
from bumpymap.lab.evaluate.timing import StepCost
from bumpymap.lab.simulate import Key

__all__ = ["DrivenPatches", "Findings", "plain_record"]

FORMAT = "bumpymap-evaluation"


@dataclass(frozen=True, slots=True)
class DrivenPatches:
    """The patches behind a comparison."""

    names: list[Key]
    """Tile ``(col, row)``, or kind and index of a terrain."""
    driven: Driven
    verdicts: dict[str, Verdict]


@dataclass(slots=True)
class Findings:
    """Everything that was measured; parts that were left out are empty."""

    title: str
    facts: dict[str, Any]
    """What was evaluated."""
    vehicles: list[dict[str, Any]]
    """Name, calibration and class limits of each; the first one is that of the tables."""
    settings: dict[str, Any]
    classes: dict[str, ClassTable] = field(default_factory=dict)
    """Rating -> Table I."""
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    """Vehicle -> predictions beside drives."""
    kinds: list[KindRow] = field(default_factory=list)
    patches: dict[str, DrivenPatches] = field(default_factory=dict)
    """Vehicle -> what the comparison is made of."""
    orders: list[Order] = field(default_factory=list)
    densities: list[DensityRow] = field(default_factory=list)
    noise: list[NoiseRow] = field(default_factory=list)
    moves: list[MoveRow] = field(default_factory=list)
    timing: list[StepCost] = field(default_factory=list)

    def to_record(self) -> dict[str, Any]:
        """Return every number as JSON has it; None stands for what cannot be known."""
        record: dict[str, Any] = {"format": FORMAT, "version": 1}
        return record | {name: plain_record(value) for name, value in asdict(self).items()}


def plain_record(value: Any) -> Any:
    """Turn nested records into what JSON has: six digits, None for what is not finite, lists in a fixed order."""
    if isinstance(value, dict):
        return {str(key): plain_record(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple | frozenset):
        return [plain_record(item) for item in (sorted(value) if isinstance(value, frozenset) else value)]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return float(f"{value:.6g}") if math.isfinite(value) else None
    return value
