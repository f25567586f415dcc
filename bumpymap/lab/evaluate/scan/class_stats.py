"""Statistics of the sectors of each class (the paper's Tables IV and V), and agreement with labels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors
from bumpymap.lab.evaluate.agreement import confusion
from bumpymap.scan import classes_of_labels

__all__ = ["Accuracy", "ClassedSectorTable", "ScanClassRow", "accuracy_of", "class_rows", "join_sectors"]

Floats = NDArray[np.float64]
_MEASURES = ("stripes", "variance", "residual")


@dataclass(frozen=True, slots=True)
class ClassedSectorTable:
    """The traversable sectors of many scans, one row each."""

    class_id: dict[str, NDArray[np.uint8]]
    """Method -> (n,) class."""
    truth: NDArray[np.int16]
    """(n,) class of the most frequent label; -1 without a label."""
    stripes: Floats
    """(n,)"""
    variance: Floats
    """(n,) m^2"""
    residual: Floats
    """(n,) m"""


@dataclass(frozen=True, slots=True)
class ScanClassRow:
    """Statistics of the sectors that one method assigns to a class."""

    class_id: int
    sectors: int
    share: float
    """Share of the traversable sectors, 0..1."""
    stripes: tuple[float, float]
    """Median and mean; NaN without sectors."""
    variance: tuple[float, float]
    """m^2"""
    residual: tuple[float, float]
    """m"""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Agreement of classes with labels."""

    confusion: list[list[int]]
    """``[class of the label][predicted class]``, number of sectors."""
    right: float
    """Accuracy; NaN without labels."""
    even: float
    """Balanced accuracy over the classes that occur; NaN without labels."""


def join_sectors(classed: Sequence[dict[str, ClassedSectors]]) -> ClassedSectorTable:
    """Collect the traversable sectors of one or more scans, classified by the same methods, one of them the filter."""
    stacks = [next(iter(methods.values())).sectors for methods in classed]
    open_to = [stack.traversable for stack in stacks]

    def gathered(values: Sequence[NDArray[np.generic]]) -> NDArray[np.float64]:
        return np.concatenate([value[gate] for value, gate in zip(values, open_to, strict=True)]).astype(np.float64)

    return ClassedSectorTable(
        class_id={
            method: np.concatenate(
                [methods[method].class_id[gate] for methods, gate in zip(classed, open_to, strict=True)]
            )
            for method in classed[0]
        },
        truth=np.concatenate(
            [classes_of_labels(stack.label[gate]) for stack, gate in zip(stacks, open_to, strict=True)]
        ),
        stripes=gathered([_stripes(methods) for methods in classed]),
        variance=gathered([stack.variance for stack in stacks]),
        residual=gathered([stack.residual for stack in stacks]),
    )


def _stripes(methods: dict[str, ClassedSectors]) -> NDArray[np.float32]:
    """Return the stripe counts of the method that counts them."""
    return next(found.stripes for found in methods.values() if found.stripes is not None)


def class_rows(table: ClassedSectorTable, method: str) -> list[ScanClassRow]:
    """Summarise the sectors of each class."""
    class_id = table.class_id[method]
    rows = []
    for number in range(CLASSES):
        own = class_id == number
        values = [_middle(getattr(table, name)[own]) for name in _MEASURES]
        rows.append(ScanClassRow(number, int(own.sum()), float(own.mean()) if len(own) else float("nan"), *values))
    return rows


def _middle(values: Floats) -> tuple[float, float]:
    return (float(np.median(values)), float(values.mean())) if len(values) else (float("nan"), float("nan"))


def accuracy_of(table: ClassedSectorTable, method: str) -> Accuracy:
    """Compare classes with labels over the sectors that have one."""
    known = table.truth >= 0
    truth, found = table.truth[known].astype(np.int64), table.class_id[method][known].astype(np.int64)
    counts = confusion(truth, found, CLASSES)
    totals = counts.sum(axis=1)
    there = totals > 0
    right = float(np.trace(counts) / totals.sum()) if there.any() else float("nan")
    even = float((np.diag(counts)[there] / totals[there]).mean()) if there.any() else float("nan")
    return Accuracy(counts.tolist(), right, even)
