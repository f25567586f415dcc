"""Correction of the poses of a drive by registering its frames (extra ``poses``).

Frames are registered to earlier ones with small_gicp (Segal, Haehnel and Thrun, "Generalized-ICP", RSS 2009; Koide,
"small_gicp", JOSS 2024), by the surfaces that several stretches of the way saw in the same place: no moving ones. A
registration is believed where it brings the surfaces of both frames clearly closer; else the given poses are kept
between the two. All together are a pose graph, in which the given poses hold loosely.
"""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import Floats, UsageError, install_command

_THINNED_M, _NEIGHBOURS = 0.25, 30
"""Edge of the voxels of which one point is used, m, and number of points near one that show its surface (chosen): more
than lie on one ring of returns, which would be laid on the ring of another frame."""
_REACHES_M = (1.0, 0.3)
"""Farthest point that one is laid on, in each registration, m (chosen)."""
_STEPS, _STEP_RAD, _STEP_M = 30, 1e-5, 1e-4
"""Most steps of a registration, and change of angle, rad, and place, m, at which it ends (chosen)."""
_HELD = 64
"""Number of frames before one whose points are held for it, some MB each (chosen)."""
_LEAST_POINTS, _CLOSER, _PER_MOVE = 200, 0.05, 0.15
"""Fewest points of a frame and fewest pairs of points; share by which the distance between the surfaces of both frames
falls at least, and share of the move, of a registration that is believed (chosen)."""
MOST_M, MOST_DEG = 0.8, 5.0
"""Errors between two frames beyond which no registration is believed: m, and degrees (chosen)."""
_BARE = 0.004
"""Share of the strongest hold of surfaces on a place, across them, below which they do not hold it: on a plane it is
0.002 along (chosen)."""
_UPRIGHT = 0.7
"""Largest vertical part of the normal of a standing surface (chosen)."""
_ALIKE = 20.0
"""Number of points that count as one: those of a surface err alike (chosen)."""
_LEAST_ERROR = 0.02
"""Weighted square of the distance of a pair of points, at least, as of surfaces that lie 6 mm apart (chosen)."""
_LOOSE = np.array([*3 * [math.radians(1.0)], *3 * [0.3]])
"""Usual errors of given poses, rad and m (chosen)."""
_ROUNDS, _KNEE = 6, 9.0
"""Steps of Gauss and Newton; square of the misfit of an edge, in its standard deviations, that counts half (chosen)."""


@dataclass(frozen=True, slots=True)
class Edge:
    """How a frame lies in an earlier one."""

    later: int
    earlier: int
    pose: Floats
    """(4, 4) from the later to the earlier."""
    weight: Floats
    """(6, 6) inverse of its covariance: turns, rad, then moves, m, in the frame of the later."""
    before_m: float
    """Median distance of the surfaces of both at the given poses; NaN if none are near."""
    after_m: float
    """And at this one."""
    is_significant: bool
    """True if it was registered, and not kept as given."""
    is_limited: bool = False
    """True if the registration was not believed for its size."""


def require_registration() -> Any:
    """Return the module small_gicp. Raises UsageError: it is not installed."""
    try:
        import small_gicp
    except ImportError as error:
        raise UsageError(
            f"poses are corrected with small_gicp, which cannot be imported ({error}): {install_command('poses')}"
        ) from error
    return small_gicp


def correct_poses(
    poses: Floats, pairs: Iterable[tuple[int, int]], cloud: Callable[[int], Floats]
) -> tuple[Floats, dict[str, Any]]:
    """Register frames; return the poses (frames, 4, 4) with which all registrations agree best, and their record.

    Parameters
    ----------
    poses : array (frames, 4, 4)
        From the sensor to the world, m.
    pairs
        Frames that are registered, a later to an earlier one each, in order of the later.
    cloud : callable
        Returns the points (n, 3) of a frame that stand still, in the frame of its sensor, m.

    Raises
    ------
    UsageError
        The extra ``poses`` is not installed.
    """
    gicp = require_registration()
    order = list(pairs)
    last = {number: place for place, pair in enumerate(order) for number in pair}
    clouds: dict[int, Any] = {}
    edges = []
    for place, (later, earlier) in enumerate(order):
        for number in (later, earlier):
            if number not in clouds:
                points = cloud(number)
                enough = len(points) > _LEAST_POINTS
                clouds[number] = gicp.preprocess_points(points, _THINNED_M, _NEIGHBOURS, 1) if enough else None
        given = np.linalg.solve(poses[earlier], poses[later])
        edges.append(_register(later, earlier, given, clouds[later], clouds[earlier]))
        clouds = {key: each for key, each in clouds.items() if last[key] > place and key > later - _HELD}
    found = _solve(poses, edges)
    moved = np.linalg.norm(found[:, :3, 3] - poses[:, :3, 3], axis=1)
    turned = np.linalg.norm(_turn_of(np.einsum("nji,njk->nik", poses[:, :3, :3], found[:, :3, :3])), axis=1)
    sizes = [(each.before_m, each.after_m) for each in edges if not math.isnan(each.before_m)]
    before, after = np.median(sizes, axis=0).round(4).tolist() if sizes else (None, None)
    return found, {
        "edges": len(edges),
        "significant": sum(each.is_significant for each in edges),
        "limited": sum(each.is_limited for each in edges),
        "surfaces_before_m": before,
        "surfaces_after_m": after,
        "largest_move_m": round(float(moved.max(initial=0.0)), 4),
        "largest_turn_deg": round(math.degrees(turned.max(initial=0.0)), 3),
    }


def _register(later: int, earlier: int, given: Floats, source: Any, target: Any) -> Edge:
    """Register one frame to another; ``source``, ``target``: points and tree of each, None if they are too few."""
    gicp = require_registration()
    nothing = Edge(later, earlier, given, np.diag(1.0 / np.square(_LOOSE)), math.nan, math.nan, is_significant=False)
    if source is None or target is None:
        return nothing
    pose = given
    for reach in _REACHES_M:
        clouds = target[0], source[0], target[1]
        result = gicp.align(*clouds, pose, "GICP", reach, 1, _STEPS, _STEP_RAD, _STEP_M)
        pose = result.T_target_source
    if result.num_inliers < _LEAST_POINTS:
        return nothing
    change = np.linalg.solve(given, pose)
    strength, axes = np.linalg.eigh(result.H[3:, 3:])
    known = axes[:, strength > _BARE * strength[-1]]  # along a bare wall, the given place is as good as any
    change[:3, 3] = known @ (known.T @ change[:3, 3])
    pose = given @ change
    before, after = (_distances(source[0], target, each) for each in (given, pose))
    moved, turned = float(np.linalg.norm(change[:3, 3])), math.degrees(float(np.linalg.norm(_turn_of(change[None]))))
    closer = [
        float(np.median(here)) - float(np.median(there)) > max(_CLOSER * float(np.median(here)), _PER_MOVE * moved)
        for here, there in zip(before, after, strict=True)
        if min(len(here), len(there)) > _LEAST_POINTS
    ]
    is_limited = bool(moved > MOST_M or turned > MOST_DEG)
    is_significant = any(closer) and not is_limited
    error = max(_LEAST_ERROR, 2.0 * result.error / result.num_inliers)
    medians = [float(np.median(np.concatenate(each))) for each in (before, after)]
    chosen = pose if is_significant else given
    weight = result.H / (error * _ALIKE)
    return Edge(later, earlier, chosen, weight, medians[0], medians[is_significant], is_significant, is_limited)


def _distances(source: Any, target: Any, pose: Floats) -> tuple[Floats, Floats]:
    """Return the distances of points from the surfaces (n,) of another frame that are level, and that stand, m."""
    points = source.points()[:, :3] @ pose[:3, :3].T + pose[:3, 3]
    near, square = target[1].batch_nearest_neighbor_search(points)
    there = np.asarray(square) < _REACHES_M[0] ** 2
    near = np.asarray(near)[there]
    normal = target[0].normals()[near, :3]
    away = np.abs(((points[there] - target[0].points()[near, :3]) * normal).sum(axis=1))
    stands = np.abs(normal[:, 2]) < _UPRIGHT
    return away[~stands], away[stands]


def _turn_of(poses: NDArray[np.floating[Any]]) -> Floats:
    """Return rotation vectors (n, 3) of poses (n, 4, 4), or of their rotations, rad."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(poses[:, :3, :3]).as_rotvec())


def _solve(given: Floats, edges: list[Edge]) -> Floats:
    """Return the poses (frames, 4, 4) that fit edges, and the given ones loosely, by steps of Gauss and Newton."""
    from scipy.sparse import csc_matrix
    from scipy.sparse.linalg import splu
    from scipy.spatial.transform import Rotation

    poses, count, inside = given.copy(), len(given), np.arange(6)
    prior = np.diag(1.0 / np.square(_LOOSE))
    for _ in range(_ROUNDS):
        off = _left(given, poses)
        right = -off @ prior
        blocks = [(each, each, prior) for each in range(count)]
        for edge in edges:
            now = np.linalg.solve(poses[edge.earlier], poses[edge.later])
            left = _left(edge.pose[None], now[None])[0]
            weight = edge.weight / (1.0 + float(left @ edge.weight @ left) / _KNEE)
            turn, way = now[:3, :3].T, now[:3, 3]
            of_earlier = np.block([[-turn, np.zeros((3, 3))], [turn @ np.cross(way, np.eye(3)).T, -turn]])
            right[edge.later] -= weight @ left
            right[edge.earlier] -= of_earlier.T @ weight @ left
            across = weight @ of_earlier
            blocks += [(edge.later, edge.later, weight), (edge.later, edge.earlier, across)]
            blocks += [(edge.earlier, edge.later, across.T), (edge.earlier, edge.earlier, of_earlier.T @ across)]
        rows, columns = (6 * np.array([each[axis] for each in blocks])[:, None, None] for axis in (0, 1))
        at = np.broadcast_arrays(rows + inside[:, None], columns + inside)
        values = np.array([each[2] for each in blocks])
        normal = csc_matrix((values.ravel(), tuple(each.ravel() for each in at)), shape=(6 * count, 6 * count))
        step = splu(normal).solve(right.ravel()).reshape(count, 6)
        poses[:, :3, 3] += np.einsum("nij,nj->ni", poses[:, :3, :3], step[:, 3:])
        poses[:, :3, :3] = np.einsum("nij,njk->nik", poses[:, :3, :3], Rotation.from_rotvec(step[:, :3]).as_matrix())
    return poses


def _left(wanted: Floats, poses: Floats) -> Floats:
    """Return turns and moves (n, 6) from wanted poses to others (n, 4, 4), rad and m, in the frames of the wanted."""
    turn = np.einsum("nji,njk->nik", wanted[:, :3, :3], poses[:, :3, :3])
    way = np.einsum("nji,nj->ni", wanted[:, :3, :3], poses[:, :3, 3] - wanted[:, :3, 3])
    return np.concatenate([_turn_of(turn), way], axis=1)
