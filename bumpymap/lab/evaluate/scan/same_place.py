"""Classes of one place that is seen by two sensors."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, ClassedSectors, Scan, point_classes

__all__ = ["SensorAgreement", "agreement", "cell_classes", "scene_pairs", "sum_agreements"]

CELL_M = 0.5
END_M = 30.0
_AROUND = round(2 * END_M / CELL_M)
_MOUNTS_M = (1.7, 1.0)
"""Height of the sensor of 64 lines, and of that of 32."""


@dataclass(frozen=True, slots=True)
class SensorAgreement:
    """Cells of 0.5 m within 30 m that both sensors give a class."""

    cells: int
    same: int
    """Those with the same class."""


def scene_pairs(seed: int, scenes: range) -> Iterator[tuple[Scan, Scan]]:
    """Simulate scenes with a sensor of 64 lines and with a lower one of 32 at the same place."""
    from bumpymap.lab.worlds import SENSORS, make_scene, simulate_scan

    sensors = [
        replace(SENSORS[name], height_m=height)
        for name, height in zip(("64_blocks", "32_sparse"), _MOUNTS_M, strict=True)
    ]
    for index in scenes:
        scene = make_scene(seed, index)
        seen = [simulate_scan(scene, sensor, index) for sensor in sensors]
        first, second = (Scan(scan.points[scan.points.any(axis=1)], name=f"{index}") for scan in seen)
        yield first, second


def cell_classes(scan: Scan, classed: ClassedSectors) -> NDArray[np.int16]:
    """Return the most frequent class of the points of each cell around the sensor (the smaller if tied).

    Returns
    -------
    (n * n,) array
        Row by row; -1 without a point in a classified sector.
    """
    class_id = point_classes(scan, classed)
    place = np.floor((scan.points[:, :2].astype(np.float64) + END_M) / CELL_M).astype(np.int64)
    near = np.hypot(scan.points[:, 0], scan.points[:, 1]) < END_M
    there = near & (class_id < CLASSES) & ((place >= 0) & (place < _AROUND)).all(axis=1)
    cell = place[there, 0] * _AROUND + place[there, 1]
    counts = np.bincount(cell * CLASSES + class_id[there], minlength=_AROUND**2 * CLASSES).reshape(-1, CLASSES)
    return np.where(counts.any(axis=1), counts.argmax(axis=1), -1).astype(np.int16)


def agreement(pair: tuple[Scan, Scan], classify: Callable[[Scan], ClassedSectors]) -> SensorAgreement:
    """Compare the classes of two scans of one place, in one frame of x and y."""
    first, second = (cell_classes(scan, classify(scan)) for scan in pair)
    both = (first >= 0) & (second >= 0)
    return SensorAgreement(int(both.sum()), int((both & (first == second)).sum()))


def sum_agreements(each: Sequence[SensorAgreement]) -> SensorAgreement:
    """Add the counts of many places."""
    return SensorAgreement(sum(one.cells for one in each), sum(one.same for one in each))
