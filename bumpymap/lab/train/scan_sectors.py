"""Training and test sectors, from labelled frames."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, PolarSettings, Scan
from bumpymap.lab.label_sets import LABEL_SETS
from bumpymap.readers import find_frames, read_scan
from bumpymap.scan import MEASURES, network_input, polar_sectors

GRIDS = (
    PolarSettings(zone_starts_m=(4.0, 12.0, 28.0, 60.0), end_m=100.0, sectors=(24, 32, 48, 32), rings=(4, 4, 4, 2)),
    PolarSettings(zone_starts_m=(1.0, 5.0, 15.0, 30.0), end_m=60.0, sectors=(12, 24, 36, 48), rings=(2, 4, 4, 4)),
    PolarSettings(zone_starts_m=(2.0, 6.0, 18.0, 45.0), end_m=90.0, sectors=(16, 40, 48, 40), rings=(2, 4, 6, 4)),
)
"""Polar grids that training uses beside the default one, so that a network fits any grid."""
_OTHER_GRID = 0.5
"""Share of the additional cuts that use one of them."""
SWAPPED_MEASURES = ("coverage",)
"""Measures that training swaps between some sectors."""
_SWAPPED_SHARE = 0.15
"""Share of the sectors of an epoch that take them. Chosen."""
_TREE, _BUSH = 4, 19
"""Ids of RELLIS-3D."""
ScanProgress = Callable[[int, int], None]
"""Called with the number of finished scans and the number of all scans."""


@dataclass(frozen=True, slots=True)
class Sectors:
    """Sectors with known classes."""

    patches: NDArray[np.float32]
    """(n, CHANNELS, pixels, pixels)"""
    measures: NDArray[np.float32]
    """(n, len(MEASURES))"""
    class_id: NDArray[np.int64]
    """(n,) 0..2"""
    label: NDArray[np.int16]
    """(n,) the RELLIS-3D id behind the class."""


def join(parts: Sequence[Sectors]) -> Sectors:
    """Concatenate one or more sets of sectors, in order."""
    return Sectors(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Sectors)))


def draw_cuts(rng: np.random.Generator, count: int) -> list[tuple[float, PolarSettings]]:
    """Draw angles [rad] and polar grids of additional cuts of a scan."""
    angles = rng.uniform(0, 2 * np.pi, count)
    other, which = rng.uniform(size=count) < _OTHER_GRID, rng.integers(len(GRIDS), size=count)
    return [
        (float(angle), GRIDS[k] if draws else PolarSettings())
        for angle, draws, k in zip(angles, other, which, strict=True)
    ]


def labelled_sectors(scan: Scan, cuts: Iterable[tuple[float, PolarSettings]] = ()) -> Sectors:
    """Cut a labelled scan into sectors and keep those with a class that have ground: others are never classified.

    The scan is cut once more for each of ``cuts``, after rotating it about z by the angle [rad], on the grid: that puts
    the same ground into other sectors.
    """
    scan = crowns_as_bushes(scan)
    stacks = [polar_sectors(scan)]
    for turn, grid in cuts:
        cos, sin = np.cos(turn), np.sin(turn)
        about_z = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]], np.float32)
        stacks.append(polar_sectors(Scan(scan.points @ about_z.T, None, scan.label), grid))
    parts = []
    for stack in stacks:
        class_id = LABEL_SETS["rellis"].classes_of(stack.label)
        known = (class_id >= 0) & stack.traversable
        patches, measures = network_input(stack)
        chosen = known[stack.traversable]
        parts.append(Sectors(patches[chosen], measures[chosen], class_id[known].astype(np.int64), stack.label[known]))
    return join(parts)


def crowns_as_bushes(scan: Scan) -> Scan:
    """Return a labelled scan whose tree points higher than the vehicle are labelled as bush.

    A crown over a road is no reason to avoid it, a trunk on it is.
    """
    stack = polar_sectors(scan)
    label = np.asarray(scan.label).copy()
    label[(label == _TREE) & (stack.point_height >= stack.settings.height_m)] = _BUSH
    return replace(scan, label=label)


def folder_frames(folder: Path) -> tuple[list[Path], list[Path]]:
    """List frames of a data set in the layout of RELLIS-3D: training frames, and the last fifth of every sequence.

    ``folder`` contains sequences (``00000``, ..), is a sequence, or contains ``Rellis-3D``. Only every tenth frame is
    used, because neighbouring frames show nearly the same ground; this also separates the two parts of a sequence.
    """
    inner = folder / "Rellis-3D"
    root = inner if inner.is_dir() else folder
    inside = root.iterdir() if root.is_dir() else []
    sequences = sorted(path for path in inside if path.is_dir() and path.name.isdigit())
    learn: list[Path] = []
    unseen: list[Path] = []
    for sequence in sequences or [root]:
        frames = find_frames([sequence])
        border = len(frames) - max(1, len(frames) // 5)
        learn += frames[:border]
        unseen += frames[border:]
    if not learn:
        raise BadInputError(f"{folder} contains {len(unseen)} frame(s); training needs 2 or more in a sequence")
    return learn, unseen


def folder_sectors(
    frames: Sequence[Path], turns: int = 0, seed: int = 1, progress: ScanProgress | None = None
) -> Sectors:
    """Return the sectors of labelled frames on disk, in order.

    Raises BadInputError if a frame has no labels, or none of them has a class.
    """
    parts = []
    for done, frame in enumerate(frames, start=1):
        scan = read_scan(frame)
        if scan.label is None:
            raise BadInputError(
                f"{frame} has no label file; training needs os1_cloud_node_semantickitti_label_id/{frame.stem}.label "
                "next to its folder"
            )
        parts.append(labelled_sectors(scan, draw_cuts(np.random.default_rng([seed, done, 3]), turns)))
        if progress:
            progress(done, len(frames))
    joined = join(parts)
    if not len(joined.class_id):
        raise BadInputError(
            f"no sector of {len(frames)} frames has a label with a class; the labels must be ids of RELLIS-3D"
        )
    return joined


def draw_epoch(
    sectors: Sectors, per_class: int, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
    """Draw the same number of sectors of every class that occurs, half of them mirrored in azimuth; shuffled.

    If a class has fewer sectors, each is drawn equally often, up to a difference of one. Some sectors take their
    ``SWAPPED_MEASURES`` from others, so that the network does not rely on these measures alone: the share of filled
    pixels depends more on the sensor than relief does.
    """
    rows = []
    for class_id in np.unique(sectors.class_id):
        there = np.flatnonzero(sectors.class_id == class_id)
        rounds = [rng.permutation(there) for _ in range(-(-per_class // len(there)))]
        rows.append(np.concatenate(rounds)[:per_class])
    order = rng.permutation(np.concatenate(rows))
    patches = sectors.patches[order]
    mirrored = rng.uniform(size=len(order)) < 0.5
    patches[mirrored] = patches[mirrored][..., ::-1]
    measures = sectors.measures[order]
    for name in SWAPPED_MEASURES:
        column = MEASURES.index(name)
        takes = np.flatnonzero(rng.uniform(size=len(order)) < _SWAPPED_SHARE)
        measures[takes, column] = measures[rng.permutation(takes), column]
    return patches, measures, sectors.class_id[order]
