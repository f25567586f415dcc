"""Test whether tiles keep their class if their points are rotated, mirrored, tilted or lifted."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import PatchStack, Reason
from bumpymap.lab.evaluate.keyed_random import uniform_by_key
from bumpymap.lab.evaluate.library import rebuild_buckets
from bumpymap.lab.evaluate.subject import MAPPED, Subject, Verdict
from bumpytiles import TilePoints

__all__ = ["MOVES", "MoveRow", "invariance"]

Floats = NDArray[np.float64]
_MOST_TILT_DEG = 10.0
_LIFT_M = 1000.0
_EDGE_M = 1e-6
"""Minimum distance of moved points from the edges of their tile, so that they stay in it."""

MOVES = ("turned by 90 degrees", "mirrored", "tilted by up to 10 degrees", "lifted by 1000 m")


@dataclass(frozen=True, slots=True)
class MoveRow:
    """Comparison of one rating before and after a move."""

    rating: str
    move: str
    tiles: int
    """Tiles that are classified and within the vehicle's slope limit, before and after."""
    same_class: float
    """Share of them that keep their class, 0..1; NaN without tiles."""
    c_r_change: float
    """Median of abs(C_r after / C_r before - 1)."""


def invariance(
    blocks: Iterable[TilePoints], measured: Callable[[TilePoints], PatchStack], subject: Subject, seed: int
) -> list[MoveRow]:
    """Move the points of each tile inside it and rate it again.

    Parameters
    ----------
    blocks : iterable of TilePoints
    measured : callable
        Function that measures a block.
    subject : Subject
    seed : int
        Seed of the tilts.
    """
    names = [name for name in MAPPED if name in subject.ratings]
    limit = subject.profile.slope_limit_deg
    found: dict[tuple[str, str], list[tuple[Verdict, Verdict]]] = {(name, move): [] for name in names for move in MOVES}
    for points in blocks:
        patches = measured(points)
        before = subject.judge(patches, names)
        for move in MOVES:
            again = measured(moved_points(points, move, seed))
            after = subject.judge(again, names)
            good = _within(patches, limit) & _within(again, limit)
            for name in names:
                found[name, move].append((before[name].take(good), after[name].take(good)))
    return [_row(name, move, pairs) for (name, move), pairs in found.items()]


def _within(patches: PatchStack, limit: float) -> NDArray[np.bool_]:
    good: NDArray[np.bool_] = (patches.reason == Reason.OK) & (patches.slope <= limit)
    return good


def _row(name: str, move: str, pairs: list[tuple[Verdict, Verdict]]) -> MoveRow:
    before, after = (Verdict.join(side) for side in zip(*pairs, strict=True))
    if not len(before.class_id):
        return MoveRow(name, move, 0, float("nan"), float("nan"))
    change = float(np.median(np.abs(after.c_r / before.c_r - 1)))
    return MoveRow(name, move, len(before.class_id), float(np.mean(before.class_id == after.class_id)), change)


def moved_points(points: TilePoints, move: str, seed: int) -> TilePoints:
    """Move the points of each tile; they stay in it."""
    size = points.grid.tile_size
    count = np.diff(points.starts)
    col, row = np.repeat(points.col, count), np.repeat(points.row, count)
    middle_east, middle_north = (col + 0.5) * size, (row + 0.5) * size
    east, north = points.easting - middle_east, points.northing - middle_north
    upward = points.upward
    if move == "turned by 90 degrees":
        east, north = -north, east
    elif move == "mirrored":
        east = -east
    elif move == "tilted by up to 10 degrees":
        tangent = np.tan(np.radians(_MOST_TILT_DEG * uniform_by_key(seed, col, row)))
        bearing = 2 * np.pi * uniform_by_key(seed + 1, col, row)
        upward = upward + tangent * (east * np.cos(bearing) + north * np.sin(bearing))
    else:
        upward = upward + _LIFT_M
    half = size / 2 - _EDGE_M
    moved = replace(
        points,
        easting=middle_east + np.clip(east, -half, half),
        northing=middle_north + np.clip(north, -half, half),
        upward=upward,
    )
    return next(rebuild_buckets(moved).blocks())
