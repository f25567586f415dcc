"""Label sets: what the semantic ids of labelled points mean; and how classes agree with labels.

A set gives each of its ids a name, a class (0 smooth to 2 rough; -1: none) and a kind: ground, obstacle or neither.
Three sets are built in: ``kitti`` (ids 0 to 19, as networks for SemanticKITTI are trained), ``semantic-kitti`` (the raw
ids of that data set) and ``rellis`` (RELLIS-3D). Another comes from a file: CSV with the columns ``id,class`` and, if
wanted, ``name`` and ``kind``.
"""

import csv
import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, BadInputError, UsageError, read_regular

_NO_CLASS = -1
"""Class of an id that has none."""
_LEAST_KNOWN = 0.5
"""A set is refused if fewer of the labelled points than this have ids of the set."""
_LEAST_GROUND = 0.02
"""A set explains labels if at least this share of the labelled points is ground: most scans outdoors have more, and ids
that are read with a set they are not of are rarely ground."""
_KINDS = ("ground", "obstacle", "")
_SHOWN = 8
"""Number of ids that a message names."""


@dataclass(frozen=True, slots=True)
class LabelSet:
    """The meaning of semantic ids."""

    name: str
    """``kitti``, ``semantic-kitti``, ``rellis``, or the path of a file."""
    class_of: dict[int, int]
    """Id -> class 0 (smooth) to 2 (rough), -1 if it has none; every id of the set is there."""
    ground: frozenset[int]
    """Ids of ground."""
    obstacle: frozenset[int]
    """Ids of standing objects that stop a vehicle. Trees count as a whole where a set has no id of their
    trunks: only what is lower than the vehicle is in its way."""

    def classes_of(self, labels: NDArray[np.integer[Any]]) -> NDArray[np.int16]:
        """Return the class of each label; -1 if it has none or is not of the set."""
        table = np.full(max(self.class_of, default=0) + 2, _NO_CLASS, np.int16)
        table[list(self.class_of)] = list(self.class_of.values())
        outside = len(table) - 1
        return table[np.where((labels >= 0) & (labels < outside), labels, outside).astype(np.intp)]

    def is_ground(self, labels: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return which labels are of ground."""
        return np.isin(labels, [*self.ground])

    def is_obstacle(self, labels: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return which labels are of obstacles."""
        return np.isin(labels, [*self.obstacle])

    def is_known(self, labels: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return which labels are ids of the set."""
        return np.isin(labels, [*self.class_of])

    def fits(self, labelled: NDArray[np.integer[Any]]) -> bool:
        """Return whether all of some labels are ids of the set, and enough of them its ground."""
        is_ground = not self.ground or self.is_ground(labelled).mean() >= _LEAST_GROUND
        return bool(is_ground and self.is_known(labelled).all())


def _from_groups(name: str, *groups: tuple[int, str, Collection[int]]) -> LabelSet:
    """Return a set from groups of ids: class, kind, and the ids, of built-in sets with their names."""
    class_of = {number: class_id for class_id, _, ids in groups for number in ids}
    kinds = {kind: frozenset(number for _, own, ids in groups if own == kind for number in ids) for kind in _KINDS}
    return LabelSet(name, class_of, kinds["ground"], kinds["obstacle"])


_KITTI = _from_groups(
    "kitti",
    (_NO_CLASS, "", {0: "unlabelled"}),
    (0, "ground", {9: "road", 10: "parking", 11: "sidewalk", 12: "other ground", 17: "terrain"}),
    (1, "", {15: "vegetation"}),
    (
        2,
        "obstacle",
        {
            1: "car", 2: "bicycle", 3: "motorcycle", 4: "truck", 5: "other vehicle", 6: "person", 7: "bicyclist",
            8: "motorcyclist", 13: "building", 14: "fence", 16: "trunk", 18: "pole", 19: "traffic sign",
        },
    ),
)  # fmt: skip
_SEMANTIC_KITTI = _from_groups(
    "semantic-kitti",
    (_NO_CLASS, "", {0: "unlabelled", 1: "outlier", 52: "other structure", 99: "other object"}),
    (
        0,
        "ground",
        {40: "road", 44: "parking", 48: "sidewalk", 49: "other ground", 60: "lane marking", 72: "terrain"},
    ),
    (1, "", {70: "vegetation"}),
    (
        2,
        "obstacle",
        {
            10: "car", 11: "bicycle", 13: "bus", 15: "motorcycle", 16: "on rails", 18: "truck", 20: "other vehicle",
            30: "person", 31: "bicyclist", 32: "motorcyclist", 50: "building", 51: "fence", 71: "trunk", 80: "pole",
            81: "traffic sign", 252: "moving car", 253: "moving bicyclist", 254: "moving person",
            255: "moving motorcyclist", 256: "moving on rails", 257: "moving bus", 258: "moving truck",
            259: "moving other vehicle",
        },
    ),
)  # fmt: skip
_RELLIS = _from_groups(
    "rellis",
    (_NO_CLASS, "", {0: "void", 7: "sky"}),
    (_NO_CLASS, "obstacle", {5: "pole", 9: "object", 12: "building", 15: "log"}),
    (0, "ground", {1: "dirt", 3: "grass", 10: "asphalt", 23: "concrete"}),
    (1, "ground", {6: "water", 31: "puddle", 33: "mud", 34: "rubble"}),
    (1, "", {19: "bush"}),
    (2, "obstacle", {4: "tree", 8: "vehicle", 17: "person", 18: "fence", 27: "barrier"}),
)
LABEL_SETS: dict[str, LabelSet] = {known.name: known for known in (_KITTI, _SEMANTIC_KITTI, _RELLIS)}
"""The built-in sets by their names."""


def label_set(name_or_path: str | Path) -> LabelSet:
    """Return a built-in label set, or read one from a file.

    Raises UsageError if it is neither the name of a set nor a file name that ends in ``.csv``; BadInputError if the
    file cannot be read, or is not a label set.
    """
    text = str(name_or_path)
    if text in LABEL_SETS:
        return LABEL_SETS[text]
    path = Path(text)
    if not (path.suffix.lower() == ".csv" or path.exists() or len(path.parts) > 1):
        raise UsageError(f"`labels` is '{text}'; it must be {', '.join(LABEL_SETS)}, or a file that ends in .csv")
    return _read_set(path)


def _read_set(path: Path) -> LabelSet:
    try:
        lines = read_regular(path).decode("utf-8-sig", "replace").splitlines()
    except OSError as error:
        raise BadInputError(f"cannot read the label set {path}: {error.strerror or error}") from error
    table = csv.reader((line for line in lines if line.strip() and not line.startswith("#")), skipinitialspace=True)
    try:
        head, *rows = [[word.strip() for word in row] for row in table] or [[]]
    except csv.Error as error:
        raise BadInputError(f"{path} is not a label set: {error}") from error
    if not {"id", "class"} <= {*head} <= {"id", "class", "name", "kind"} or not rows:
        raise BadInputError(
            f"{path} is not a label set: its first line is '{','.join(head)[:80]}', with {len(rows)} lines below; it "
            "must be id,class or id,class,name,kind, with one line per id below"
        )
    groups: dict[int, tuple[int, str, Collection[int]]] = {}
    for row in rows:
        found = dict(zip(head, row, strict=False))
        try:
            number, class_id, kind = int(found["id"]), int(found["class"]), found.get("kind", "")
            is_valid = 0 <= number <= 65_535 and _NO_CLASS <= class_id < CLASSES and len(row) == len(head)
        except (KeyError, ValueError):
            is_valid = False
        if not is_valid or number in groups or kind not in _KINDS:
            raise BadInputError(
                f"{path}: the line {','.join(row)[:80]} is not one of a label set. Each id (0 to 65,535) stands once, "
                "with a class from -1 to 2 and, if wanted, name and kind (ground, obstacle, or empty)"
            )
        groups[number] = class_id, kind, [number]
    return _from_groups(str(path), *groups.values())


def require_label_set(labels: NDArray[np.integer[Any]], known: LabelSet, origin: str) -> None:
    """Refuse labels that are not of a set: most ids are not, or they do not fit it while they fit a built-in one.

    ``labels``: semantic ids, best of many frames; 0 and below are unlabelled in every set. ``origin``: where they are
    from, for the message of the BadInputError.
    """
    labelled = labels[labels > 0]
    if not len(labelled) or known.fits(labelled):
        return
    if known.is_known(labelled).mean() < _LEAST_KNOWN or any(other.fits(labelled) for other in LABEL_SETS.values()):
        raise BadInputError(
            f"the labels of {origin} (ids {_listed(labels)}) are not those of the set {known.name}: "
            f"{known.is_known(labelled).mean():.0%} of the labelled points have ids of the set, "
            f"{known.is_ground(labelled).mean():.0%} are its ground. Name the set they are of, or a file with it"
        )


def identify_label_set(labels: NDArray[np.integer[Any]], origin: str) -> LabelSet:
    """Return the one built-in set of which all ``labels`` are, and enough of them ground.

    Raises BadInputError, which names the ``origin`` of the labels, if no set fits, or several do.
    """
    labelled = labels[labels > 0]
    fitting = [known for known in LABEL_SETS.values() if len(labelled) and known.fits(labelled)]
    if len(fitting) == 1:
        return fitting[0]
    what = f"fit {' and '.join(known.name for known in fitting)}" if fitting else "fit no label set that is built in"
    raise BadInputError(
        f"the labels of {origin} (ids {_listed(labels)}) {what}; say which they are: {', '.join(LABEL_SETS)}, or a "
        "file FILE.csv with the columns id,class,name,kind"
    )


def _listed(labels: NDArray[np.integer[Any]]) -> str:
    ids = np.unique(labels[labels > 0])
    return ", ".join(map(str, ids[:_SHOWN])) + (", .." if len(ids) > _SHOWN else "") if len(ids) else "none"


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Agreement of classes with labels."""

    confusion: list[list[int]]
    """``[true class][predicted class]``, number of sectors or patches."""
    right: float
    """Accuracy; NaN without labels."""
    even: float
    """Balanced accuracy over the classes that occur; NaN without labels."""
    recall: list[float]
    """Share of each class that is found, 0..1; NaN for a class that does not occur."""

    @property
    def count(self) -> int:
        """Number of sectors or patches."""
        return sum(map(sum, self.confusion))


def accuracy_of(truth: NDArray[np.integer], answer: NDArray[np.integer], classes: int) -> Accuracy:
    """Compare answers (n,) with the truth (n,) where it is known: 0 or above.

    By numpy: `bumpymap evaluate` runs with the default install, where scikit-learn is not, and is no shorter with its
    ``confusion_matrix`` and ``recall_score``, as these refuse to count where nothing is labelled.
    """
    known = truth >= 0
    place = truth[known].astype(np.int64) * classes + answer[known]
    counts = np.bincount(place, minlength=classes**2).reshape(classes, classes)
    totals = counts.sum(axis=1)
    there = totals > 0
    recall = np.divide(np.diag(counts), totals, out=np.full(classes, np.nan), where=there)
    right = float(np.trace(counts) / totals.sum()) if there.any() else math.nan
    even = float(recall[there].mean()) if there.any() else math.nan
    return Accuracy(counts.tolist(), right, even, recall.tolist())
