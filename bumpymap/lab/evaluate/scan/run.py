"""Evaluate both methods of classification on scans."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from bumpymap.core import BadInputError, ClassedSectors, Progress, Scan, SectorStack, counted
from bumpymap.lab.evaluate.scan.answers import Accuracy, accuracy_of, all_answers
from bumpymap.lab.evaluate.scan.class_stats import ScanClassRow, class_rows, join_sectors, z_deviation
from bumpymap.lab.evaluate.scan.points import (
    GroundScore,
    ObstacleScore,
    ground_score,
    mean_ground,
    obstacle_score,
    sum_obstacles,
)
from bumpymap.lab.evaluate.scan.same_place import SensorAgreement, agreement, scene_pairs
from bumpymap.lab.evaluate.scan.settings import ScanEvaluateSettings
from bumpymap.lab.evaluate.scan.timing import MethodCost, PlainCost, method_costs, plain_cost
from bumpymap.lab.evaluate.scan.turning import kept_share
from bumpymap.lab.train import UNSEEN, crowns_as_bushes, scene_scan
from bumpymap.readers import LABEL_SETS, LabelSet, label_set, read_scan, require_label_set, tell_label_set
from bumpymap.scan import ScanModel, StripeModel, classify_filter, classify_learned, polar_sectors

__all__ = [
    "ScanFindings",
    "ScanMethods",
    "compare_sensors",
    "evaluate_scans",
    "labels_of",
    "read_frames",
    "simulated_scans",
]

_LOOKED_AT = 20
"""Number of frames whose labels decide of which set they are."""
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
    """Method or rule -> agreement with the labels of the sectors with ground; empty without labels."""
    accuracy_all: dict[str, Accuracy] = field(default_factory=dict)
    """The same over all sectors; without ground the answer of a method is the roughest class."""
    ground: list[GroundScore] = field(default_factory=list)
    """Frame by frame, and then their mean; empty without labels."""
    obstacles: dict[str, ObstacleScore] = field(default_factory=dict)
    """Method -> points of obstacles in sectors called free; empty without labels."""
    sensors: dict[str, SensorAgreement] = field(default_factory=dict)
    """Method -> agreement of two sensors at one place; empty for scans from files."""
    kept: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Method -> share of the points that keep their class in a rotated scan: mean and minimum over the scans."""
    costs: list[MethodCost] = field(default_factory=list)
    plain: PlainCost | None = None


def simulated_scans(settings: ScanEvaluateSettings) -> Iterator[Scan]:
    """Simulate scans of scenes that are never used in training."""
    for index in range(settings.scenes):
        yield crowns_as_bushes(scene_scan(settings.seed, UNSEEN + index))


def read_frames(frames: Sequence[Path], labels: LabelSet | None = None) -> Iterator[Scan]:
    """Read scans one after another.

    Raises
    ------
    BadInputError
        The labels of a scan are not those of ``labels``.
    """
    for frame in frames:
        scan = read_scan(frame)
        if labels is not None and scan.label is not None:
            require_label_set(scan.label, labels, str(frame))
        yield scan


def labels_of(frames: Sequence[Path], name: str | None) -> LabelSet | None:
    """Return the label set of frames: the one that is named, or else the one that fits the ids of their labels.

    Parameters
    ----------
    frames : paths
        Frames; without any, scenes are simulated, whose labels are those of RELLIS-3D.
    name : str, optional
        A built-in set, or a file.

    Returns
    -------
    LabelSet or None
        None if no frame has labels.

    Raises
    ------
    BadInputError, UsageError
        As from `label_set` and `tell_label_set`; a set is named and no frame has labels.
    """
    if not frames:
        return LABEL_SETS["rellis"]
    found = [read_scan(frame).label for frame in frames[:: -(-len(frames) // _LOOKED_AT)]]
    there = [label for label in found if label is not None]
    if name is not None:
        if not there:
            raise BadInputError(
                f"`labels` is '{name}', but {frames[0]} has no labels. They are in NAME.label beside NAME.bin, in "
                "a folder labels next to its folder, or in a field named label of a PLY or PCD file"
            )
        return label_set(name)
    return tell_label_set(np.concatenate(there), str(frames[0])) if there else None


class ScanMethods:
    """Both methods of classification, by name."""

    def __init__(self, stripes: StripeModel, network: ScanModel) -> None:
        self.stripes = stripes
        self.network = network
        self.by_sectors: dict[str, Callable[[SectorStack], ClassedSectors]] = {
            "filter": lambda stack: classify_filter(stack, stripes),
            "learned": lambda stack: classify_learned(stack, network),
        }
        self.by_points = {name: _from_points(classifier) for name, classifier in self.by_sectors.items()}


def compare_sensors(
    settings: ScanEvaluateSettings, methods: ScanMethods, progress: Progress
) -> dict[str, SensorAgreement]:
    """Return, by method, how well two sensors agree on the classes of scenes that are never used in training."""
    found: dict[str, list[SensorAgreement]] = {name: [] for name in methods.by_points}
    for pair in counted(scene_pairs(settings.seed, range(UNSEEN, UNSEEN + settings.pairs)), progress):
        for name, classify in methods.by_points.items():
            found[name].append(agreement(pair, classify))
    return {
        name: SensorAgreement(sum(one.cells for one in each), sum(one.same for one in each))
        for name, each in found.items()
    }


def evaluate_scans(
    scans: Iterator[Scan],
    count: int,
    settings: ScanEvaluateSettings,
    methods: ScanMethods,
    progress: Progress,
    labels: LabelSet | None = None,
) -> ScanFindings:
    """Evaluate both methods on scans.

    Parameters
    ----------
    scans : iterator of Scan, length ``count``
    count : int
    settings : ScanEvaluateSettings
    methods : ScanMethods
    progress : Progress
    labels : LabelSet, optional
        The meaning of the labels of the scans; None if they have none.

    Raises
    ------
    BadInputError
        No scan has a sector that can be classified.
    """
    angles = np.random.default_rng(settings.seed).uniform(0.0, 2 * math.pi, settings.turns).tolist()
    classed, deviations, kept, fullest = [], [], dict[str, list[float]]({name: [] for name in methods.by_points}), None
    ground: list[GroundScore] = []
    obstacles = dict[str, list[ObstacleScore]]({name: [] for name in methods.by_points})
    progress.start("classing scans", count)
    for scan in scans:
        stack = polar_sectors(scan)
        found = {name: classifier(stack) for name, classifier in methods.by_sectors.items()}
        if labels is not None and scan.label is not None:
            ground.append(ground_score(scan, stack.point_ground, labels))
            for name, own in found.items():
                obstacles[name].append(obstacle_score(scan, own, labels))
        deviations.append(z_deviation(scan, stack))
        classed.append({name: _without_points(own) for name, own in found.items()})
        for name, classify in methods.by_points.items():
            kept[name].append(kept_share(scan, classify, angles))
        if fullest is None or abs(len(scan.points) - _FULL_TURN) < abs(len(fullest.points) - _FULL_TURN):
            fullest = scan
        progress.advance(1)
    table = join_sectors(classed, deviations, labels) if classed else None
    if fullest is None or table is None or not table.traversable.any():
        raise BadInputError("no scan has a sector that can be classified, so there is nothing to evaluate")
    progress.start("timing rounds of both methods", settings.repeats)
    drivable, labelled = table.traversable, table.truth >= 0
    answers = all_answers(table) if labelled.any() else {}
    facts: dict[str, Any] = {
        "scans": count,
        "sectors": int(drivable.sum()),
        "labelled": int((labelled & drivable).sum()),
    }
    facts |= {"all_sectors": len(drivable), "all_labelled": int(labelled.sum())}
    facts |= {"labels": labels.name if labels and labelled.any() else None}
    return ScanFindings(
        facts=facts | {"filter": asdict(methods.stripes), "network": methods.network.id},
        settings=asdict(settings),
        classes={name: class_rows(table, name) for name in methods.by_points},
        accuracy={name: accuracy_of(table.truth[drivable], answer[drivable]) for name, answer in answers.items()},
        accuracy_all={name: accuracy_of(table.truth, answer) for name, answer in answers.items()},
        ground=[*ground, mean_ground(ground)] if ground else [],
        obstacles={name: sum_obstacles(scores) for name, scores in obstacles.items() if scores},
        kept={name: (float(np.nanmean(shares)), float(np.nanmin(shares))) for name, shares in kept.items()},
        costs=method_costs(
            _full_turn(fullest, settings.seed), methods.by_points, counted(range(settings.repeats), progress)
        ),
        plain=plain_cost(fullest, methods.stripes),
    )


def _from_points(classifier: Callable[[SectorStack], ClassedSectors]) -> Callable[[Scan], ClassedSectors]:
    return lambda scan: classifier(polar_sectors(scan))


def _without_points(classed: ClassedSectors) -> ClassedSectors:
    """Drop what is known of each point to save memory."""
    none = {name: getattr(classed.sectors, name)[:0] for name in ("point_sector", "point_ground", "point_height")}
    return replace(classed, sectors=replace(classed.sectors, **none))


def _full_turn(scan: Scan, seed: int) -> Scan:
    """Resample a scan to one point per beam of the sensor, by repeating or omitting points at random."""
    if not len(scan.points):
        return scan
    rows = np.random.default_rng(seed).permutation(np.resize(np.arange(len(scan.points)), _FULL_TURN))
    return Scan(scan.points[np.sort(rows)], name=scan.name)
