"""Square cells around a sensor: the ground that a scan shows in them, and the memory of a robot."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import CLASSES, FAIL_SHARE, NOT_TRAVERSABLE, ClassedSectors, GridSettings, GroundGrid, loops
from bumpymap.scan.align import judge_by_view
from bumpymap.scan.sectors import ZoneGrid, class_field

_OCCUPANCY = np.array([0, 33, 66, 100, -1], np.int8)
"""Occupancy of ground of class 0 (smooth), 1 (fair) and 2 (rough), of what is not traversable, and of the unknown."""
_MOST_COST = 98
"""Occupancy of ground from the upper limit of C_r on: Nav2 takes 99 for the edge of an obstacle."""
_BENEATH_M = 2.0
"""Depth behind the side of an object in which ground seen beneath it is not known to be free, m: half a car."""


class SeenCells(NamedTuple):
    """The square cells around a sensor as a frame shows them; arrays (side, side), as in `GroundGrid`."""

    kind: NDArray[np.uint8]
    """Row of ``_OCCUPANCY``."""
    class_id: NDArray[np.uint8]
    layers: NDArray[np.float32]
    """(6, side, side) elevation, step, top of an obstacle, clearance, z of that top, c_r; NaN where unknown."""
    probe_m: float
    """Middle between belly and height of the vehicle, above the ground, m."""
    limits: NDArray[np.float32]
    """(3,) of C_r between the classes of the vehicle, rad/m; (0,) without one."""

    def finish(self, cell_m: float, corner_m: tuple[float, float] | None = None) -> GroundGrid:
        """Return the cells as users know them."""
        elevation, step, top, clearance, _, c_r = self.layers
        occupancy, has_ride = _OCCUPANCY.take(self.kind), len(self.limits) > 0
        if has_ride:
            ride = np.where(np.isnan(c_r), self.limits[np.minimum(self.kind, CLASSES - 1)], c_r)
            cost = np.rint(_MOST_COST * np.minimum(ride / self.limits[-1], 1.0)).astype(np.int8)
            occupancy = np.where(self.kind < CLASSES, cost, occupancy)
        own = c_r if has_ride else None
        return GroundGrid(cell_m, occupancy, self.class_id, elevation, step, top, clearance, own, corner_m)


def see_cells(
    points: NDArray[np.float32],
    classed: ClassedSectors,
    settings: GridSettings,
    pose: NDArray[np.float64] | None = None,
) -> SeenCells:
    """Lay cells around the sensor over the points (n, 3) of a classified scan, m.

    ``pose`` (4, 4): from the sensor to the frame whose axes and multiples of whole cells count, m; heights are over the
    sensor.
    """
    stack, normal, cell_m = classed.sectors, classed.sectors.normal, settings.resolution_m
    back, shift = np.eye(2), np.zeros(2)
    if pose is not None:
        turn, back = pose[:3, :3].astype(np.float32), pose[:2, :2].T.copy()
        shift = pose[:2, 3] - cell_m * _cell_of(pose, cell_m)
        x, y, z = np.ascontiguousarray(points.T)
        points = np.empty_like(points)  # without a product of matrices, whose library would start threads
        for axis, offset in enumerate((*shift.astype(np.float32), np.float32(0.0))):
            points[:, axis] = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z + offset
        normal = normal @ turn.T
    half = math.ceil(settings.reach_m / cell_m - 1e-9)
    side, cells = 2 * half, 4 * half * half
    kinds = np.append(np.minimum(classed.class_id, CLASSES), np.uint8(CLASSES + 1))
    c_r, limits = np.full(len(kinds), np.nan, np.float32), np.empty(0, np.float32)
    if classed.ride is not None:
        c_r[:-1], limits = classed.ride.c_r, classed.ride.limits
        kinds[:-1][classed.ride.p_fail >= FAIL_SHARE] = CLASSES
    slope = np.zeros((len(kinds), 2))
    level = np.flatnonzero(stack.traversable)
    slope[level] = -normal[level, :2] / normal[level, 2:]
    if len(level):
        slope[-1] = np.median(slope[level], axis=0)
    layers = np.full((6, cells), np.nan, np.float32)
    kind, class_id, sector = *np.empty((2, cells), np.uint8), np.full(cells, -1, np.int32)
    names = ("elevation", "step", "top", "clearance", "tip")
    out = {"kind": kind, "class_id": class_id, "sector": sector, **dict(zip(names, layers, strict=False))}
    scan = {
        "points": np.ascontiguousarray(points, np.float32),
        "ground": stack.point_ground,
        "airborne": stack.point_airborne,
        "height": stack.point_height,
        "sector": stack.point_sector,
        "kind": kinds,
        "class_id": np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE)),
        "drops": np.append(stack.drop, np.False_),
        "slope": slope,
    }
    rule = {
        "resolution": cell_m,
        "half": half,
        "belly": stack.settings.belly_m,
        "height": stack.settings.height_m,
        "beneath": round(_BENEATH_M / cell_m),
        "to_sensor": np.column_stack([cell_m * back, back @ (-half * cell_m - shift)]),
    }
    loops.lay_cells(scan, ZoneGrid.of(stack.settings), class_field(classed.field), rule, out)
    if classed.ride is not None:
        layers[-1] = c_r[sector]
    return SeenCells(
        kind.reshape(side, side),
        class_id.reshape(side, side),
        layers.reshape(6, side, side),
        0.5 * (stack.settings.belly_m + stack.settings.height_m),
        limits,
    )


def _cell_of(pose: NDArray[np.float64], cell_m: float) -> NDArray[np.int64]:
    """Return the corner of cells, in whole cells along x and y, that is nearest to the place of a pose (4, 4)."""
    return np.round(pose[:2, 3] / cell_m).astype(np.int64)


def _overlap(move: NDArray[np.int64], side: int) -> tuple[Any, Any]:
    """Return where cells of a square are in that square, and in one moved by whole cells along x and y."""
    x, y = np.clip(move, -side, side).tolist()
    here = np.s_[..., max(y, 0) : side + min(y, 0), max(x, 0) : side + min(x, 0)]
    return here, np.s_[..., max(-y, 0) : side - max(y, 0), max(-x, 0) : side - max(x, 0)]


_NEW, _MOST = 2, 6
"""Evidence for an object in a cell: added by a frame in which it stands there, and the most that is kept; a frame that
sees through it or its bare ground takes one away. So what goes is forgotten after six frames."""
_KEPT, _LEAD = 0.9, 1.25
"""Share of the votes for the ground of a cell that stays when it is seen again: those of ten frames count; and ratio of
its votes to those of the last class that another class needs (chosen)."""
_FORGOTTEN = 100
"""Number of frames without sight after which a cell is unknown again: 10 s at 10 Hz (chosen)."""
_ELEVATION, _TOP, _TIP = 0, 2, 4
"""Rows of ``SeenCells.layers``."""
_RANK = np.array([1, 2, 3, 4, 0], np.uint8)
"""The kind of a cell with the highest counts where sensors differ."""


class FrameView(NamedTuple):
    """The view of a sensor from its place, for the memory."""

    pose: NDArray[np.float64]
    """(4, 4) from the sensor to the frame of the memory, m."""
    cells: SeenCells
    """As `see_cells` lays them at that pose."""
    ranges: NDArray[np.uint16]
    """See `nearest_ranges`."""


class GroundMemory:
    """The surroundings of a robot as it has seen them, in square cells of its odometry frame that roll with it.

    Frame after frame votes for what the ground of a cell is; each vote fades with later ones. What stood in a cell goes
    when frames see through its place, or bare ground in its cell, and not because it is out of view. Ground that
    something hides is unknown again at once, so that nothing that came meanwhile is overlooked; so is all that was not
    seen for 100 frames.
    """

    def __init__(self, settings: GridSettings) -> None:
        self._cell = settings.resolution_m
        side = 2 * math.ceil(settings.reach_m / settings.resolution_m - 1e-9)
        self._corner = np.zeros(2, np.int64)
        self._votes = np.zeros((CLASSES + 1, side, side), np.float32)
        """For the classes of ground, and for ground that bars the way; all zeros where nothing is known."""
        self._class = np.zeros((1, side, side), np.uint8)
        """The class with the most of them."""
        self._stands = np.zeros((1, side, side), np.int8)
        """Evidence that something stands there."""
        self._unseen = np.zeros((1, side, side), np.int16)
        """Frames since it was seen."""
        self._layers = np.full((6, side, side), np.nan, np.float32)
        """As last seen: elevation, step, top of an obstacle, clearance, z of that top, c_r."""

    def add(self, views: Sequence[FrameView], pose: NDArray[np.float64]) -> GroundGrid:
        """Add what one or several sensors see at a time; return what is known of the ground around ``pose`` (4, 4), m.

        Of cells that several see, an obstacle counts first, then what is the rougher ground.
        """
        half = len(self._stands[0]) // 2
        self._roll(_cell_of(pose, self._cell) - half)
        seen = [self._place(view) for view in views]
        kind, layers = seen[0]
        for other, more in seen[1:]:
            rank, own = _RANK[kind], _RANK[other]
            layers = np.where(np.isnan(layers) | (own > rank) & ~np.isnan(more), more, layers)
            kind = np.where(own > rank, other, kind)
        self._clear(views, kind, layers)
        there, new = kind <= CLASSES, np.isfinite(layers[_TIP])
        stands, unseen = self._stands[0], self._unseen[0]
        np.minimum(stands + np.int8(_NEW), np.int8(_MOST), out=stands, where=new)
        voters = there & ~new
        self._votes *= np.where(voters, np.float32(_KEPT), np.float32(1.0))
        self._votes += voters & (kind == np.arange(CLASSES + 1, dtype=np.uint8)[:, None, None])
        unseen += 1
        unseen[there] = 0
        old = unseen > _FORGOTTEN
        stands[old] = 0
        self._votes[:, old] = 0.0
        np.copyto(self._layers, layers, where=np.isfinite(layers))
        return self._grid(views[0].cells)

    def _place(self, view: FrameView) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Return kinds and layers of a view in the cells that are remembered, heights in their frame."""
        kind = np.full(self._stands[0].shape, CLASSES + 1, np.uint8)
        layers = np.full(self._layers.shape, np.nan, np.float32)
        side = len(kind)
        there, here = _overlap(_cell_of(view.pose, self._cell) - side // 2 - self._corner, side)
        kind[there], layers[there] = view.cells.kind[here], view.cells.layers[here]
        layers[[_ELEVATION, _TIP]] += np.float32(view.pose[2, 3])
        return kind, layers

    def _roll(self, corner: NDArray[np.int64]) -> None:
        """Move the cells so that they begin at a corner, in cells; what comes in is unknown."""
        here, there = _overlap(corner - self._corner, len(self._stands[0]))
        if (corner == self._corner).all():
            return
        self._corner = corner
        for values, empty in (
            (self._votes, 0.0), (self._class, 0), (self._stands, 0), (self._unseen, 0), (self._layers, np.nan)
        ):  # fmt: skip
            kept = values[here].copy()
            values[:] = empty
            values[there] = kept

    def _clear(self, views: Sequence[FrameView], kind: NDArray[np.uint8], layers: NDArray[np.float32]) -> None:
        """Take evidence from what is seen through, and forget ground that no view can see for what hides it."""
        stands = self._stands[0] > 0
        hidden = self._votes.any(axis=0) & (kind > CLASSES)
        asked = np.flatnonzero(stands | hidden)
        row, column = np.divmod(asked, len(stands))
        over = self._layers[_ELEVATION] + np.float32(views[0].cells.probe_m)
        high = np.where(stands, self._layers[_TIP], over).ravel()[asked]
        through, covered = np.zeros((2, *stands.shape), np.bool_)
        for view in views:
            up = np.nan_to_num(high - view.pose[2, 3])
            here = view.pose.copy()
            here[:3, 3] = *(view.pose[:2, 3] - self._cell * self._corner), 0.0
            places = np.column_stack([(column + 0.5) * self._cell, (row + 0.5) * self._cell, up])
            found = judge_by_view(np.round(1000.0 * places).astype(np.int32), here, view.ranges) > 0
            through.ravel()[asked] |= found[0]
            covered.ravel()[asked] |= found[1]
        covered = covered & ~through | np.isnan(over)  # between returns: how high it is was never seen
        bare = np.isfinite(layers[_ELEVATION]) & (kind < CLASSES)
        self._stands[0] -= stands & (through | bare)
        self._layers[_TOP][self._stands[0] == 0] = np.nan
        self._votes[:, hidden & ~stands & covered] = 0.0

    def _grid(self, like: SeenCells) -> GroundGrid:
        """Return what is known; ``like``: cells of the vehicle."""
        ground, stands, best = self._votes[:CLASSES], self._stands[0] > 0, self._class[0]
        most = np.take_along_axis(ground, best[None], axis=0)[0]
        for number, votes in enumerate(ground):
            more = votes > _LEAD * most
            best[more], most = number, np.where(more, votes, most)
        total = self._votes.sum(axis=0)
        kind = np.where(2.0 * self._votes[CLASSES] >= total, np.uint8(CLASSES), best)
        kind[total == 0.0] = CLASSES + 1
        kind[stands] = CLASSES
        class_id = np.where(most > 0.0, best, np.uint8(NOT_TRAVERSABLE))
        layers = np.where(kind <= CLASSES, self._layers, np.float32(np.nan))
        corner = self._cell * self._corner
        known = SeenCells(kind, class_id, layers, like.probe_m, like.limits)
        return known.finish(self._cell, (float(corner[0]), float(corner[1])))
