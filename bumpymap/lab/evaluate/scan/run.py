"""Evaluate both methods of classification on scans."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, ClassedSectors, Progress, Scan, SectorStack, counted
from bumpymap.lab.evaluate.scan.class_stats import Accuracy, ScanClassRow, accuracy_of, class_rows, join_sectors
from bumpymap.lab.evaluate.scan.settings import ScanEvaluateSettings
from bumpymap.lab.evaluate.scan.timing import MethodCost, PlainCost, method_costs, plain_cost
from bumpymap.lab.evaluate.scan.turning import kept_share
from bumpymap.lab.train import UNSEEN, scene_scan
from bumpymap.readers import read_scan
from bumpymap.scan import ScanModel, StripeModel, classify_filter, classify_learned, polar_sectors

__all__ = ["ScanFindings", "evaluate_scans", "read_frames", "simulated_scans"]

_FULL_TURN = 131_072
"""Beams of the sensor for which times are measured: 64 lines, 2,048 columns."""


@dataclass(slots=True)
class ScanFindings:
    """All results of an evaluation of scans."""

    facts: dict[str, Any]
    settings: dict[str, Any]
    classes: dict[str, list[ScanClassRow]] = field(default_factory=dict)
    """Method -> the paper's Tables IV and V."""
    accuracy: dict[str, Accuracy] = field(default_factory=dict)
    """Method -> agreement with labels; empty without labels."""
    kept: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Method -> share of the points that keep their class in a rotated scan: mean and minimum over the scans."""
    costs: list[MethodCost] = field(default_factory=list)
    plain: PlainCost | None = None


def simulated_scans(settings: ScanEvaluateSettings) -> Iterator[Scan]:
    """Simulate scans of scenes that are never used in training."""
    for index in range(settings.scenes):
        yield scene_scan(settings.seed, UNSEEN + index)


def read_frames(frames: Sequence[Path]) -> Iterator[Scan]:
    """Read scans one after another."""
    return (read_scan(frame) for frame in frames)


def evaluate_scans(
    scans: Iterator[Scan],
    count: int,
    settings: ScanEvaluateSettings,
    stripes: StripeModel,
    network: ScanModel,
    progress: Progress,
) -> ScanFindings:
    """Evaluate both methods on scans.

    Parameters
    ----------
    scans : iterator of Scan, length ``count``
    count : int
    settings : ScanEvaluateSettings
    stripes : StripeModel
        Model of the filter method.
    network : ScanModel
        Model of the learned method.
    progress : Progress

    Raises
    ------
    BadInputError
        No scan has a sector that can be classified.
    """
    classifiers: dict[str, Callable[[SectorStack], ClassedSectors]] = {
        "filter": lambda stack: classify_filter(stack, stripes),
        "learned": lambda stack: classify_learned(stack, network),
    }
    methods = {name: _from_points(classifier) for name, classifier in classifiers.items()}
    angles = np.random.default_rng(settings.seed).uniform(0.0, 2 * math.pi, settings.turns).tolist()
    classed, kept, fullest = [], dict[str, list[float]]({name: [] for name in methods}), None
    progress.start("classing scans", count)
    for scan in scans:
        stack = polar_sectors(scan)
        classed.append({name: _without_points(classifier(stack)) for name, classifier in classifiers.items()})
        for name, classify in methods.items():
            kept[name].append(kept_share(scan, classify, angles))
        if fullest is None or abs(len(scan.points) - _FULL_TURN) < abs(len(fullest.points) - _FULL_TURN):
            fullest = scan
        progress.advance(1)
    table = join_sectors(classed)
    if fullest is None or not len(table.truth):
        raise BadInputError("no scan has a sector that can be classified, so there is nothing to evaluate")
    progress.start("timing rounds of both methods", settings.repeats)
    facts = {"scans": count, "sectors": len(table.truth), "labelled": int((table.truth >= 0).sum())}
    return ScanFindings(
        facts=facts | {"filter": asdict(stripes), "network": network.id},
        settings=asdict(settings),
        classes={name: class_rows(table, name) for name in methods},
        accuracy={name: accuracy_of(table, name) for name in methods} if facts["labelled"] else {},
        kept={name: (float(np.nanmean(shares)), float(np.nanmin(shares))) for name, shares in kept.items()},
        costs=method_costs(_full_turn(fullest, settings.seed), methods, counted(range(settings.repeats), progress)),
        plain=plain_cost(fullest, stripes),
    )


def _from_points(classifier: Callable[[SectorStack], ClassedSectors]) -> Callable[[Scan], ClassedSectors]:
    return lambda scan: classifier(polar_sectors(scan))


def _without_points(classed: ClassedSectors) -> ClassedSectors:
    """Drop the sector number of each point to save memory."""
    return replace(classed, sectors=replace(classed.sectors, point_sector=np.empty(0, np.int32)))


def _full_turn(scan: Scan, seed: int) -> Scan:
    """Resample a scan to one point per beam of the sensor, by repeating or omitting points at random."""
    if not len(scan.points):
        return scan
    rows = np.random.default_rng(seed).permutation(np.resize(np.arange(len(scan.points)), _FULL_TURN))
    return Scan(scan.points[np.sort(rows)], name=scan.name)
