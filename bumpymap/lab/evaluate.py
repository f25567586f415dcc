"""Compare the classes, ground and obstacles of scans with labels, and write the report of it: Markdown and JSON.

A method is of use only if it beats the constant answers, and a limit on the plain spread of the heights.
"""

import json
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    CLASSES,
    NOT_TRAVERSABLE,
    BadInputError,
    ClassedSectors,
    Floats,
    Progress,
    Scan,
    SectorStack,
    atomic,
    plain_json,
)
from bumpymap.lab.label_sets import Accuracy, LabelSet, accuracy_of, identify_label_set, label_set, require_label_set
from bumpymap.lab.settings import ScanEvaluateSettings
from bumpymap.readers import read_scan
from bumpymap.scan import ScanModel, StripeModel, classify_filter, classify_learned, polar_sectors

Ints = NDArray[np.int64]
DEVIATION = "deviation of z"
"""Name of the answers from two limits on the standard deviation of z of all points of a sector."""
RANGE_M = (4.0, 80.0)
"""Horizontal distances of the points that are judged."""
_ROUGHEST = CLASSES - 1
"""A sector of a class below this without an obstacle is called free."""
_LIMITS = 40
"""Number of limits that are tried."""
_LOOKED_AT = 20
"""Number of frames whose labels decide of which set they are."""


@dataclass(frozen=True, slots=True)
class ClassedSectorTable:
    """The sectors of many scans, one row each."""

    class_id: dict[str, NDArray[np.uint8]]
    """Method -> (n,) class."""
    truth: NDArray[np.int16]
    """(n,) class of the most frequent label; -1 without a label."""
    traversable: NDArray[np.bool_]
    """(n,) whether the sector has ground, and so a class."""
    deviation: Floats
    """(n,) standard deviation of z over all points of the sector, ground or not, m"""


def z_deviation(scan: Scan, stack: SectorStack) -> Floats:
    """Return the standard deviation of z over all points of each sector (n,), m."""
    inside = stack.point_sector >= 0
    place, z = stack.point_sector[inside], scan.points[inside, 2].astype(np.float64)
    count = np.maximum(np.bincount(place, minlength=len(stack.zone)), 1)
    off = z - (np.bincount(place, z, len(stack.zone)) / count)[place]
    return np.sqrt(np.bincount(place, off**2, len(stack.zone)) / count)


def all_answers(table: ClassedSectorTable) -> dict[str, Ints]:
    """Return the class (n,) of every sector by each method, and by rules that need none.

    A sector without ground is answered by the roughest class, except by the constant answers.
    """
    answers = {
        method: np.where(class_id == NOT_TRAVERSABLE, _ROUGHEST, class_id).astype(np.int64)
        for method, class_id in table.class_id.items()
    }
    for number in range(CLASSES):
        answers[f"always {number}"] = np.full(len(table.truth), number, np.int64)
    known = table.traversable & (table.truth >= 0)
    limits = best_limits(table.deviation[known], table.truth[known])
    below = np.searchsorted(limits, table.deviation, side="right")
    answers[DEVIATION] = np.where(table.traversable, below, _ROUGHEST)
    return answers


def best_limits(values: NDArray[np.float64], truth: NDArray[np.int16]) -> NDArray[np.float64]:
    """Return the two limits on values (n,) whose three classes agree best with the truth (n,), in balanced accuracy.

    They are fitted to the sectors that are judged, which no method in use can do.
    """
    if not len(values):
        return np.full(2, np.inf)
    limits = np.unique(np.quantile(values, np.linspace(0, 1, _LIMITS)))
    below = np.stack([np.searchsorted(np.sort(values[truth == k]), limits) for k in range(CLASSES)])
    share = below / np.maximum(np.bincount(truth, minlength=CLASSES), 1)[:, None]
    low, high = np.triu_indices(len(limits))
    even = share[0, low] + share[1, high] - share[1, low] - share[2, high]
    best = int(np.argmax(even))
    return limits[[low[best], high[best]]]


def _judged(scan: Scan, labels: LabelSet) -> tuple[NDArray[np.bool_], NDArray[np.uint16]]:
    """Return which points (n,) have a known label and are within the range, and all labels (n,)."""
    label = np.zeros(len(scan.points), np.uint16) if scan.label is None else scan.label
    away = np.hypot(scan.points[:, 0], scan.points[:, 1])
    return (label > 0) & labels.is_known(label) & (away >= RANGE_M[0]) & (away < RANGE_M[1]), label


def ground_score(scan: Scan, ground: NDArray[np.bool_], labels: LabelSet) -> dict[str, Any]:
    """Compare points (n,) found as ground with the labels of a scan; points without a label are left out.

    Returns ``frame``, number of ``points`` within the range, ``precision`` (NaN if none is found), ``recall`` (NaN if
    there is no ground) and ``f1``.
    """
    judged, label = _judged(scan, labels)
    truth, found = labels.is_ground(label[judged]), ground[judged]
    both, all_found, all_true = (float(part.sum()) for part in (truth & found, found, truth))
    parts = {"precision": (both, all_found), "recall": (both, all_true), "f1": (2 * both, all_found + all_true)}
    shares = {name: part / whole if whole else math.nan for name, (part, whole) in parts.items()}
    return {"frame": scan.name, "points": int(judged.sum())} | shares


def mean_ground(scores: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the mean of `ground_score` over the frames that have ground, of each figure."""
    known = [score for score in scores if score["points"] and not math.isnan(score["recall"])]
    mean: dict[str, Any] = {"frame": "mean", "points": sum(score["points"] for score in known)}
    for name in ("precision", "recall", "f1"):
        mean[name] = float(np.nanmean([score[name] for score in known])) if known else math.nan
    return mean


def obstacle_score(scan: Scan, classed: ClassedSectors, labels: LabelSet) -> dict[str, int]:
    """Count the points of obstacles that lie in sectors called free: of class 0 or 1, without an obstacle.

    Returns ``points`` of obstacles within the range, those ``in_free`` sectors, those of them that are not known to be
    higher than the vehicle (``in_free_low``), and those in sectors of class 0 or 1 at any height (``in_free_class``).
    """
    stack = classed.sectors
    judged, label = _judged(scan, labels)
    rows = np.flatnonzero(judged & labels.is_obstacle(label))
    smooth = classed.class_id < _ROUGHEST
    place, high = stack.point_sector[rows], stack.point_height[rows] > stack.settings.height_m
    in_free = np.append(smooth & ~stack.obstacle, False)[place]
    parts = {"in_free": in_free, "in_free_low": in_free & ~high, "in_free_class": np.append(smooth, False)[place]}
    return {"points": len(rows)} | {name: int(np.count_nonzero(part)) for name, part in parts.items()}


@dataclass(slots=True)
class ScanFindings:
    """All results of an evaluation of scans."""

    facts: dict[str, Any]
    settings: dict[str, Any]
    accuracy: dict[str, Accuracy]
    """Method or rule -> agreement with the labels of the sectors with ground."""
    accuracy_all: dict[str, Accuracy]
    """The same over all sectors; without ground the answer of a method is the roughest class."""
    ground: list[dict[str, Any]]
    """Frame by frame, and then their mean."""
    obstacles: dict[str, dict[str, int]]
    """Method -> points of obstacles in sectors called free."""


def labels_of(frames: Sequence[Path], name: str | None) -> LabelSet:
    """Return the label set of frames: the one that is named, or else the one that fits their ids.

    ``name``: a built-in set, or a file. Raises as `label_set`, `require_label_set` and `identify_label_set` do, and
    BadInputError if no frame has labels.
    """
    found = [read_scan(frame).label for frame in frames[:: -(-len(frames) // _LOOKED_AT)]]
    there = [label for label in found if label is not None]
    if not there:
        raise BadInputError(
            f"{frames[0]} has no labels to compare with. They are in NAME.label beside NAME.bin, in a folder labels "
            "next to its folder, or in a field named label of a PLY or PCD file"
        )
    if name is None:
        return identify_label_set(np.concatenate(there), str(frames[0]))
    known = label_set(name)
    require_label_set(np.concatenate(there), known, str(frames[0]))
    return known


def evaluate_scans(
    scans: Iterator[Scan],
    count: int,
    settings: ScanEvaluateSettings,
    stripes: StripeModel,
    network: ScanModel | None,
    progress: Progress,
    labels: LabelSet,
) -> ScanFindings:
    """Evaluate methods on ``count`` scans: the filter by ``stripes``, the learned one by ``network``, if there is one.

    ``settings.method`` alone is judged, if it is given. ``labels``: the meaning of the labels of the scans. Raises
    BadInputError if no scan has a sector that can be classified.
    """
    parts = []
    ground: list[dict[str, Any]] = []
    obstacles: dict[str, Counter[str]] = {}
    progress.start("classing scans", count)
    for scan in scans:
        stack = polar_sectors(scan)
        found = {} if settings.method == "learned" else {"filter": classify_filter(stack, stripes)}
        if network is not None:
            found["learned"] = classify_learned(stack, network)
        if scan.label is not None:
            ground.append(ground_score(scan, stack.point_ground, labels))
            for name, own in found.items():
                obstacles.setdefault(name, Counter()).update(obstacle_score(scan, own, labels))
        class_id = {name: own.class_id for name, own in found.items()}
        truth, deviation = labels.classes_of(stack.label), z_deviation(scan, stack)
        parts.append(ClassedSectorTable(class_id, truth, stack.traversable, deviation))
        progress.advance(1)
    if not any(part.traversable.any() for part in parts):
        raise BadInputError("no scan has a sector that can be classified, so there is nothing to evaluate")
    table = ClassedSectorTable(
        {name: np.concatenate([part.class_id[name] for part in parts]) for name in parts[0].class_id},
        *(np.concatenate([getattr(part, name) for part in parts]) for name in ("truth", "traversable", "deviation")),
    )
    drivable, labelled, answers = table.traversable, table.truth >= 0, all_answers(table)
    facts = {
        "scans": count,
        "sectors": int(drivable.sum()),
        "labelled": int((labelled & drivable).sum()),
        "all_sectors": len(drivable),
        "all_labelled": int(labelled.sum()),
        "labels": labels.name,
        "filter": asdict(stripes),
        "network": None if network is None else network.id,
    }
    return ScanFindings(
        facts=facts,
        settings=asdict(settings),
        accuracy={
            name: accuracy_of(table.truth[drivable], answer[drivable], CLASSES) for name, answer in answers.items()
        },
        accuracy_all={name: accuracy_of(table.truth, answer, CLASSES) for name, answer in answers.items()},
        ground=[*ground, mean_ground(ground)],
        obstacles={name: dict(scores) for name, scores in obstacles.items()},
    )


REPORT = "report.md"
"""Name of the page of an evaluation."""


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(header)} |", f"|{'---|' * len(header)}"]
    return [*lines, *(f"| {' | '.join(row)} |" for row in rows), ""]


def percent(share: float) -> str:
    """Format a share of 0..1 as per cent; a dash if it is not finite."""
    return f"{100 * share:.1f} %" if math.isfinite(share) else "-"


_PAPER_ACCURACY = 0.8324
"""Of the learned method, on its patches of RELLIS-3D."""
_ANSWERS = (
    "A method is of use if it beats the constant answers in accuracy *and* in balanced accuracy (the mean of the "
    f"recalls). *{DEVIATION}* sets two limits on the standard deviation of z of all points of a sector, chosen to suit "
    "these very scans, which no method in use can do. The class of a sector's most frequent label counts as true."
)
_GROUND = (
    f"Points {RANGE_M[0]:g} to {RANGE_M[1]:g} m away, against the ground ids of the label set; points without a label "
    "are left out."
)
_OBSTACLES = (
    f"Points {RANGE_M[0]:g} to {RANGE_M[1]:g} m away with an obstacle's label. A sector is called free if its class is "
    "0 or 1 and no obstacle stands on it. *Low*: points not known to be higher than the vehicle, such as a crown."
)


def write_scan_report(findings: ScanFindings, out: Path) -> list[Path]:
    """Write ``report.json`` and ``report.md`` of scans, in this order."""
    facts = findings.facts
    opening = (
        f"{facts['scans']} scans, {facts['sectors']:,} sectors with ground, {facts['labelled']:,} of them labelled "
        f"(label set `{facts['labels']}`). Filter method: centres at "
        f"{', '.join(f'{centre:.2f}' for centre in facts['filter']['centres'])} stripes."
        + (f" Learned method: network {facts['network']}." if facts["network"] else "")
    )
    ground = [
        [score["frame"], f"{score['points']:,}", *(percent(score[name]) for name in ("precision", "recall", "f1"))]
        for score in findings.ground
    ]
    obstacles = [
        [method, f"{score['points']:,}"]
        + [
            percent(score[name] / score["points"] if score["points"] else math.nan)
            for name in ("in_free", "in_free_low", "in_free_class")
        ]
        for method, score in findings.obstacles.items()
    ]
    free = ("method", "points", "in free sectors", "low", "in sectors of class 0 or 1")
    sections = [
        ("Compared with labels", _ANSWERS, _accuracy_lines(findings)),
        ("Ground", _GROUND, table(("frame", "points", "precision", "recall", "F1"), ground)),
        ("Obstacles in sectors called free", _OBSTACLES, table(free, obstacles)),
    ]
    lines = ["# Can the classes of scans be trusted?", "", opening, ""]
    for title, intro, own in sections:
        lines += [f"## {title}", "", intro, "", *own]
    record = {"format": "bumpymap-scan-evaluation", "version": 1, **asdict(findings)}
    files = {
        out / "report.json": json.dumps(plain_json(record, 6), indent=1, allow_nan=False) + "\n",
        out / REPORT: "\n".join(lines).rstrip() + "\n",
    }
    for path, text in files.items():
        with atomic(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return list(files)


def _accuracy_lines(findings: ScanFindings) -> list[str]:
    facts = findings.facts
    lines = [f"{facts['labelled']:,} sectors with ground:", "", *_answer_table(findings.accuracy)]
    lines += [f"All {facts['all_labelled']:,} sectors; to a method, one without ground is of class 2:", ""]
    lines += _answer_table(findings.accuracy_all)
    for method in findings.obstacles:
        rows = [[f"labelled {k}", *map(str, line)] for k, line in enumerate(findings.accuracy[method].confusion)]
        lines += table((f"`{method}`", *(f"found {k}" for k in range(len(rows)))), rows)
    return [*lines, f"The paper reports {percent(_PAPER_ACCURACY)} on its own patches of RELLIS-3D.", ""]


def _answer_table(answers: dict[str, Accuracy]) -> list[str]:
    rows = [[name, *map(percent, (found.right, found.even, *found.recall))] for name, found in answers.items()]
    return table(("answer", "accuracy", "balanced accuracy", "recall of 0", "of 1", "of 2"), rows)
