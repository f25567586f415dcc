"""Statistics of the sectors of each class (the paper's Tables IV and V)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, Scan, SectorStack
from bumpymap.readers import LabelSet

__all__ = ["ClassedSectorTable", "ScanClassRow", "class_rows", "join_sectors", "z_deviation"]

Floats = NDArray[np.float64]
_MEASURES = ("stripes", "variance", "residual")


@dataclass(frozen=True, slots=True)
class ClassedSectorTable:
    """The sectors of many scans, one row each."""

    class_id: dict[str, NDArray[np.uint8]]
    """Method -> (n,) class."""
    truth: NDArray[np.int16]
    """(n,) class of the most frequent label; -1 without a label."""
    traversable: NDArray[np.bool_]
    """(n,) whether the sector has ground, and so a class."""
    stripes: Floats
    """(n,)"""
    variance: Floats
    """(n,) m^2"""
    residual: Floats
    """(n,) m"""
    deviation: Floats
    """(n,) standard deviation of z over all points of the sector, ground or not, m"""


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


def z_deviation(scan: Scan, stack: SectorStack) -> Floats:
    """Return the standard deviation of z over all points of each sector (n,), m."""
    inside = stack.point_sector >= 0
    place, z = stack.point_sector[inside], scan.points[inside, 2].astype(np.float64)
    count = np.maximum(np.bincount(place, minlength=len(stack.zone)), 1)
    off = z - (np.bincount(place, z, len(stack.zone)) / count)[place]
    deviation: Floats = np.sqrt(np.bincount(place, off**2, len(stack.zone)) / count)
    return deviation


def join_sectors(
    classed: Sequence[dict[str, ClassedSectors]], deviations: Sequence[Floats], labels: LabelSet | None
) -> ClassedSectorTable:
    """Collect the sectors of one or more scans, classified by the same methods, one of them the filter.

    Parameters
    ----------
    classed : sequence of dict
        Method -> sectors, for each scan.
    deviations : sequence of arrays
        ``z_deviation`` of each scan.
    labels : LabelSet or None
        The meaning of the labels of the scans; None if they have none.
    """
    stacks = [next(iter(methods.values())).sectors for methods in classed]
    label = np.concatenate([stack.label for stack in stacks])

    def gathered(values: Sequence[NDArray[np.generic]]) -> NDArray[np.float64]:
        return np.concatenate(values).astype(np.float64)

    return ClassedSectorTable(
        class_id={method: np.concatenate([methods[method].class_id for methods in classed]) for method in classed[0]},
        truth=np.full(len(label), -1, np.int16) if labels is None else labels.classes_of(label),
        traversable=np.concatenate([stack.traversable for stack in stacks]),
        stripes=gathered([_stripes(methods) for methods in classed]),
        variance=gathered([stack.variance for stack in stacks]),
        residual=gathered([stack.residual for stack in stacks]),
        deviation=gathered(deviations),
    )


def _stripes(methods: dict[str, ClassedSectors]) -> NDArray[np.float32]:
    """Return the stripe counts of the method that counts them."""
    return next(found.stripes for found in methods.values() if found.stripes is not None)


def class_rows(table: ClassedSectorTable, method: str) -> list[ScanClassRow]:
    """Summarise the traversable sectors of each class."""
    class_id = table.class_id[method]
    total = int(table.traversable.sum())
    rows = []
    for number in range(CLASSES):
        own = table.traversable & (class_id == number)
        values = [_middle(getattr(table, name)[own]) for name in _MEASURES]
        rows.append(ScanClassRow(number, int(own.sum()), float(own.sum() / total) if total else float("nan"), *values))
    return rows


def _middle(values: Floats) -> tuple[float, float]:
    return (float(np.median(values)), float(values.mean())) if len(values) else (float("nan"), float("nan"))
