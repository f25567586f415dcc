"""The results of an evaluation, from which report, plots and JSON file are made."""

from dataclasses import dataclass, field
from typing import Any

from bumpymap.lab.evaluate.classes import ClassTable
from bumpymap.lab.evaluate.compare import Comparison, KindRow, VehicleOrder
from bumpymap.lab.evaluate.density import DensityRow
from bumpymap.lab.evaluate.drives import DriveStats
from bumpymap.lab.evaluate.invariance import MoveRow
from bumpymap.lab.evaluate.noise import NoiseRow
from bumpymap.lab.evaluate.subject import Verdict
from bumpymap.lab.evaluate.timing import StepCost
from bumpymap.lab.simulate import Key

__all__ = ["ComparedPatches", "Findings"]


@dataclass(frozen=True, slots=True)
class ComparedPatches:
    """The patches behind a comparison."""

    names: list[Key]
    """Tiles ``(col, row)``, or kind and index of terrains."""
    driven: DriveStats
    verdicts: dict[str, Verdict]


@dataclass(slots=True)
class Findings:
    """All results of an evaluation; skipped parts are empty."""

    title: str
    facts: dict[str, Any]
    """Description of the survey or library."""
    vehicles: list[dict[str, Any]]
    """Name, calibration and class limits of each vehicle; the tables are about the first one."""
    settings: dict[str, Any]
    classes: dict[str, ClassTable] = field(default_factory=dict)
    """Rating -> Table I."""
    comparisons: dict[str, Comparison] = field(default_factory=dict)
    """Vehicle -> comparison of predictions with drives."""
    kinds: list[KindRow] = field(default_factory=list)
    patches: dict[str, ComparedPatches] = field(default_factory=dict)
    """Vehicle -> patches of the comparison."""
    orders: list[VehicleOrder] = field(default_factory=list)
    densities: list[DensityRow] = field(default_factory=list)
    noise: list[NoiseRow] = field(default_factory=list)
    moves: list[MoveRow] = field(default_factory=list)
    timing: list[StepCost] = field(default_factory=list)
