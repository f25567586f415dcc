"""Merge the frames of a drive into one survey: points that were seen through go, the others are thinned evenly.

Frames come one after another. Their points are written to a file in the folder of the run, sorted by block of the
world, with a `View` of each. When all are there, their poses are held against the frames, and corrected if the settings
say so; then the points are placed again. Block after block is read back: a voxel through which two other frames or more
saw, and more than saw something in it, held something that moved, and so did objects where the robot drove. Memory
is bounded by the surfaces in one block.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Floats, Robot, loops
from bumpymap.scan.align import VIEW, VIEW_REACH_M, judge_by_view, view_of
from bumpymap.scan.pose_checks import PoseCheck, way_along
from bumpymap.scan.registration import correct_poses

MOST_GROUND, MOST_OTHERS = 8, 3
"""Ground points per pixel of the map, and other points per voxel, that are kept (chosen)."""
VOXEL_MM = 200
"""Edge of a voxel, mm: that of a pixel of the map."""
_BLOCK_MM, _SIDE = 30_000, 1 << 20
"""Edge of a block, mm, and blocks in a row of the world (chosen)."""
_PROBE_MM = 800
"""Height above ground, between belly and top of a vehicle, at which it shows whether the ground can be driven on,
mm."""
_POINT = np.dtype([("place", "<i4", 3), ("range_cm", "<u2"), ("kind", "u1")])
"""A point in the file: place, mm; distance from its sensor; 1 if it is ground, and 2 more if it stands still."""
_FAR_MM = 2_000_000_000
"""Largest coordinate in the file, mm: that of 32 bits."""
_STILL_MM, _STRETCH_M, _STRETCHES = 500, 2.0, 5
"""Edge of a voxel, mm, of which the points stand still if it is seen from that many stretches of that length, m, or
more (chosen)."""
_VIEWS = 32
"""Views of frames that are held at a time, 0.3 MB each (chosen)."""
_LEAST_THROUGH = 2
"""Fewest frames that see through what has moved (chosen)."""
_BELLY_M, _TOP_M, _AROUND = 0.25, 0.1, 20
"""Height above ground that a robot clears, and height above its sensor that it takes, m; voxels around that to which
what moved may reach (chosen)."""
_NEAR_CM = 4_000
"""Distance from the sensor of the points that are registered, cm (chosen)."""


def place_points(
    name: str, points: NDArray[np.float32], is_ground: NDArray[np.bool_], pose: Floats, offset: Floats
) -> dict[str, NDArray[Any]]:
    """Prepare the points of a frame for `DriveMerge.add_points`.

    Returns ``points`` (n,) as in the file, sorted by block; ``blocks`` (k,) that hold any, in order; ``counts`` (k,) of
    points in each; ``view`` (1,), see `view_of`.

    ``name``: of the frame; ``points`` (n, 3): in the frame of the sensor, m; ``pose`` (4, 4): transform from the
    sensor's frame to the world, m; ``offset``: see `DriveMerge`. Raises BadInputError: the frame lies too far from it.
    """
    # Not a matrix product: its library would start threads of its own in each of ours, for half of the time.
    world = np.einsum("nj,ij->ni", points.astype(np.float64), pose[:3, :3]) + (pose[:3, 3] - offset)
    whole = np.round(1000.0 * world)
    if np.abs(whole).max(initial=0.0) > _FAR_MM:
        raise BadInputError(
            f"according to its pose, the frame {name} lies more than 2,000 km from the first one. Are they from "
            "one drive?"
        )
    rows = np.empty(len(points), _POINT)
    rows["place"] = whole
    rows["range_cm"] = np.minimum(100.0 * np.linalg.norm(points, axis=1), 65_535.0)
    rows["kind"] = is_ground
    rows, blocks, counts = _by_block(rows, offset)
    return {"points": rows, "blocks": blocks, "counts": counts, "view": view_of(points, is_ground, pose)}


def _by_block(rows: NDArray[Any], offset: Floats) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64]]:
    """Return points sorted by block, the blocks that hold any, in order, and the points in each."""
    column, row = np.floor((rows["place"][:, :2] + _whole(offset)) / _BLOCK_MM).T  # whole numbers: exact
    blocks, number = np.unique((column + _SIDE * row).astype(np.int64), return_inverse=True)
    order = np.argsort(number.astype(np.min_scalar_type(len(blocks))), kind="stable")
    return rows[order], blocks, np.bincount(number, minlength=len(blocks))


def _whole(offset: Floats) -> NDArray[np.int64]:
    return (1000 * offset[:2]).astype(np.int64)


class VoxelTable(NamedTuple):
    """Voxels by a hash of their key; ``size`` is the number of rows in use."""

    slot: NDArray[np.int32]
    """(a power of two,) row of the voxel that has the slot; -1 if free."""
    key: NDArray[np.int64]
    """(rows,) which voxel, as the next ones."""
    hits: NDArray[np.int32]
    """Frames with a point in it."""
    last: NDArray[np.int32]
    """The last of them."""
    mine: NDArray[np.int32]
    """Points of that frame so far, if they are not ground."""
    held: NDArray[np.int32]
    """Points kept of it."""
    turn: NDArray[np.uint32]
    """(rows, kept) increasing: of ground a hash of the place in the voxel; of others the points that the frame had
    there before, times 65,536, plus distance from the sensor, cm."""
    place: NDArray[np.int32]
    """(rows, kept, 3) where they are, mm."""
    size: NDArray[np.int32]
    """(1,)."""


class DriveMerge:
    """The frames of a drive while they come, then their merged points.

    ``folder``: for the points and `VIEW` of all frames; ``offset`` (3,): what is taken off coordinates before they
    become whole millimetres, m; whole metres; ``robot``: where it drove, nothing stands; ``trusted``: poses that
    contradict the frames are used all the same; ``corrected``: poses are corrected.
    """

    def __init__(
        self, folder: Path, offset: Floats, robot: Robot, *, trusted: bool = False, corrected: bool = False
    ) -> None:
        self._points, self._views, self._offset, self._robot = folder / "points", folder / "views", offset, robot
        self._names: list[str] = []
        self._ends = [0]
        """Where the points of frames begin and end in the file."""
        self._blocks: dict[int, list[tuple[int, int, int]]] = {}
        """Of each block of the world: the frames with points there, and where they lie in the file: from, to."""
        self._counts = {"points": 0, "ground": 0, "moving": 0}
        self._correction: dict[str, Any] | None = None
        self._given: list[Floats] = []
        self.poses = np.empty((0, 4, 4))
        """(frames, 4, 4) when all have come: as they were given, then corrected."""
        self._view = lru_cache(_VIEWS)(self._read_view)
        self._check = PoseCheck(self.poses, self._names, self._view, trusted, corrected)

    def record(self) -> dict[str, Any]:
        """Return the entry in scan.json."""
        poses = {**self._check.record(), "correction": self._correction}
        return {"seen": self._ends[-1], **self._counts, "poses": poses}

    def add_points(self, name: str, pose: Floats, placed: Mapping[str, NDArray[Any]]) -> None:
        """Take the points of the next frame, see `place_points`."""
        self._list_blocks(len(self._names), placed["blocks"], placed["counts"])
        for path, values in ((self._points, placed["points"]), (self._views, placed["view"])):
            with path.open("ab") as file:
                values.tofile(file)
        self._names.append(name)
        self._ends.append(self._ends[-1] + len(placed["points"]))
        self._given.append(pose)

    def _list_blocks(self, frame: int, blocks: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Note where the points of a frame lie in blocks (k,), ``counts`` (k,) each."""
        ends = self._ends[frame] + np.cumsum(counts)
        for block, begin, end in zip(blocks.tolist(), (ends - counts).tolist(), ends.tolist(), strict=True):
            self._blocks.setdefault(block, []).append((frame, begin, end))

    def write(self, add_points: Callable[[Floats, NDArray[np.bool_]], None]) -> None:
        """Hold the poses against the frames, and write what is left of their points, block by block.

        Raises WrongPosesError: poses that cannot be right, and are not trusted.
        """
        self.poses = self._check.poses = np.array(self._given).reshape(-1, 4, 4)
        if len(self._names) > 1:
            self._check.run()
            if self._check.corrected:
                self._correct()
        for block, parts in sorted(self._blocks.items()):
            self._blocks[block] = [each for each in parts if each[0] not in self._check.left_out]
            if self._blocks[block]:
                xyz, is_ground = self._thin(block, self._gather(block))
                add_points(self._offset + 0.001 * xyz, is_ground)
                self._counts["points"] += len(xyz)
                self._counts["ground"] += int(is_ground.sum())

    def _read_view(self, number: int) -> Any:
        return np.fromfile(self._views, VIEW, 1, offset=VIEW.itemsize * number)[0]

    def _rows(self, begin: int, end: int) -> NDArray[Any]:
        return np.fromfile(self._points, _POINT, end - begin, offset=begin * _POINT.itemsize)

    def _replace(self, begin: int, rows: NDArray[Any]) -> None:
        with self._points.open("r+b") as file:
            file.seek(begin * _POINT.itemsize)
            rows.tofile(file)

    def _in_sensor(self, number: int) -> tuple[NDArray[Any], Floats]:
        """Return the rows of a frame in the file, and its points (n, 3) in the frame of its sensor, m."""
        rows, pose = self._rows(*self._ends[number : number + 2]), self.poses[number]
        away = 0.001 * rows["place"] + (self._offset - pose[:3, 3])
        return rows, np.einsum("nj,ji->ni", away, pose[:3, :3])

    def _correct(self) -> None:
        """Correct the poses, and place the points of all frames again."""

        def cloud(number: int) -> Floats:
            rows, points = self._in_sensor(number)
            return points[(rows["kind"] > 1) & (rows["range_cm"] < _NEAR_CM)]

        self._mark_still()
        pairs = sorted(pair for pair in self._check.pairs if not {*pair}.intersection(self._check.left_out))
        poses, self._correction = correct_poses(self.poses, pairs, cloud)
        self._correction["poses"] = dict(zip(self._names, poses.tolist(), strict=True))
        self._blocks.clear()
        for number in self._check.kept:
            rows, points = self._in_sensor(number)
            world = np.einsum("nj,ij->ni", points, poses[number, :3, :3]) + (poses[number, :3, 3] - self._offset)
            rows["place"], rows["kind"] = np.round(1000.0 * world), rows["kind"] & 1
            rows, blocks, counts = _by_block(rows, self._offset)
            self._list_blocks(number, blocks, counts)
            self._replace(self._ends[number], rows)
        self.poses = poses

    def _mark_still(self) -> None:
        """Mark the points in voxels that enough stretches of the way have seen, and beside these, for poses err."""
        steps = np.linalg.norm(np.diff(self.poses[:, :3, 3], axis=0), axis=1)
        stretch = (np.r_[0.0, np.cumsum(steps)] // _STRETCH_M).astype(int).tolist()
        beside = (np.indices((3, 3, 3)).reshape(3, 27).T - 1)[:, None]
        for block, parts in self._blocks.items():
            table, corner = self._gather(block, _STILL_MM, stretch), np.append(self._corner(block), 0)
            seen = table.hits[: int(table.size[0])] >= _STRETCHES
            cell = table.place[: len(seen), 0][seen].astype(np.int64) // _STILL_MM
            still = np.unique(_key_of((cell + beside).reshape(-1, 3)))
            for _, begin, end in parts:
                rows = self._rows(begin, end)
                is_still = np.isin(_key_of((rows["place"] - corner) // _STILL_MM), still)
                rows["kind"] += 2 * is_still.astype(np.uint8)
                self._replace(begin, rows)

    def _corner(self, block: int) -> NDArray[np.int64]:
        """Return the corner of a block in the coordinates of the file, mm."""
        row = (block + _SIDE // 2) // _SIDE
        return np.array([block - row * _SIDE, row]) * _BLOCK_MM - _whole(self._offset)

    def _origin(self, block: int) -> Floats:
        """Return the corner of a block in the world, m; heights count from that of the offset."""
        return np.append(0.001 * self._corner(block), 0.0) + self._offset

    def _gather(self, block: int, voxel_mm: int = VOXEL_MM, numbers: list[int] | None = None) -> VoxelTable:
        """Read the points of a block, frame after frame, into voxels.

        ``numbers``: of frames that count as one; else each counts.
        """
        table, corner = _empty_table(1 << 16), self._corner(block)
        for number, begin, end in self._blocks[block]:
            rows = self._rows(begin, end)
            xyz = rows["place"].astype(np.int64)
            xyz[:, :2] -= corner
            table = _with_room(table, len(rows))
            one = number if numbers is None else numbers[number]
            loops.gather_points(
                xyz.astype(np.int32), rows["range_cm"].copy(), rows["kind"].copy(), one, voxel_mm, table
            )
        return table

    def _judge(self, block: int, where: NDArray[np.int32]) -> NDArray[np.int32]:
        """Count for places (n, 3) in a block the frames that `judge_by_view` tells apart, (4, n)."""
        origin, middle = self._origin(block), self.poses[:, :2, 3]
        corner = origin[:2]
        away = np.linalg.norm(middle - np.clip(middle, corner, corner + 0.001 * _BLOCK_MM), axis=1)
        found = np.zeros((4, len(where)), np.int32)
        away[self._check.left_out] = np.inf
        for number in np.flatnonzero(away < VIEW_REACH_M).tolist():
            pose = self.poses[number].copy()
            pose[:3, 3] -= origin
            judge_by_view(where, pose, self._view(number)["ranges"], found)
        return found

    def _has_moved(
        self, block: int, table: VoxelTable, points: NDArray[np.int32], through: NDArray[np.int32]
    ) -> NDArray[np.bool_]:
        """Return which voxels of a block (n,) hold what moved; ``through``: frames that saw through each.

        More frames saw through it, or through one above, than saw something in it.
        """
        hits, cell = table.hits[: len(points)], points.astype(np.int64) // VOXEL_MM
        moved = (through >= _LEAST_THROUGH) & (through > hits)
        other = table.key[: len(points)] & 1 == 0
        known, seen = _key_of(cell[moved & other]), through[moved & other]
        if len(known):
            order = np.argsort(known)
            for east, north in np.ndindex(3, 3):  # what is low is not seen through: the ground is close behind it
                key = _key_of(cell + np.array([east - 1, north - 1, 1]))
                at = order[np.minimum(np.searchsorted(known, key, sorter=order), len(known) - 1)]
                moved |= other & (known[at] == key) & (seen[at] > hits)
        return moved | self._was_driven_over(block, points, cell, other, through >= _LEAST_THROUGH)

    def _was_driven_over(
        self,
        block: int,
        points: NDArray[np.int32],
        cell: NDArray[np.int64],
        other: NDArray[np.bool_],
        is_through: NDArray[np.bool_],
    ) -> NDArray[np.bool_]:
        """Return which voxels of a block (n,) hold what stood where the robot drove, between its belly and the sensor.

        With them go those that hang together with them and were seen through at all.
        """
        from scipy.ndimage import binary_propagation
        from scipy.spatial import KDTree

        driven = np.zeros(len(points), np.bool_)
        wide = np.abs([self._robot.radius_m, *(self._robot.box_m or ())[2:]]).max()
        if self._check.height_m is None or not wide:
            return driven
        way = way_along(self.poses[self._check.kept]) - self._origin(block)
        near = KDTree(way[:, :2]).query(0.001 * points[:, :2], distance_upper_bound=wide)[1]
        above = 0.001 * points[:, 2] - np.append(way[:, 2], np.nan)[near]
        driven = other & (above > _BELLY_M - self._check.height_m) & (above < _TOP_M)
        if driven.any():
            low, high = cell[driven].min(axis=0) - _AROUND, cell[driven].max(axis=0) + _AROUND
            chosen = np.flatnonzero(other & (driven | is_through) & ((cell >= low) & (cell <= high)).all(axis=1))
            at, mask = tuple((cell[chosen] - low).T), np.zeros((2, *(high - low + 1)), np.bool_)
            mask[0][at], mask[1][at] = driven[chosen], True
            driven[chosen] = binary_propagation(mask[0], np.ones((3, 3, 3)), mask[1])[at]
        return np.asarray(driven, np.bool_)

    def _thin(self, block: int, table: VoxelTable) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the points of a block that stay, mm, and whether they are ground.

        Those in voxels that were seen through go. So does ground above which something hides the space that a vehicle
        needs from every frame: it was seen between the wheels of a car.
        """
        used = int(table.size[0])
        is_ground = table.key[:used] & 1 == 1
        points = table.place[:used, 0]
        through = self._judge(block, points.copy())[0]
        moved = self._has_moved(block, table, points, through)
        above = self._judge(block, points[is_ground] + np.array([0, 0, _PROBE_MM], np.int32))
        hidden = np.zeros(used, np.bool_)
        hidden[is_ground] = (above[0] + above[2] == 0) & (above[1] > 0)
        kept = np.arange(MOST_GROUND) < table.held[:used, None]
        self._counts["moving"] += int(kept[moved].sum())
        _, voxel = np.unique(table.key[:used] >> 1, return_inverse=True)
        votes = np.where(is_ground, 1, -1) * table.hits[:used]
        outvoted = is_ground & (np.bincount(voxel, votes)[voxel] < 0)  # more frames did not take it for ground
        kept &= ~(moved | hidden | outvoted)[:, None]
        kept[~is_ground, MOST_OTHERS:] = False
        row, rank = np.nonzero(kept)
        xyz, ground = table.place[row, rank].astype(np.int64), is_ground[row]
        pixel = xyz[:, 1] // VOXEL_MM * 4096 + xyz[:, 0] // VOXEL_MM
        # More than one voxel of ground may lie in a pixel.
        order = np.lexsort((table.turn[row, rank], pixel, ground))
        first = np.r_[True, (np.diff(pixel[order]) != 0) | np.diff(ground[order])][: len(order)]
        since = np.arange(len(order)) - np.maximum.accumulate(np.where(first, np.arange(len(order)), 0))
        chosen = np.zeros(len(order), np.bool_)
        chosen[order] = ~ground[order] | (since < MOST_GROUND)
        xyz[:, :2] += self._corner(block)
        return xyz[chosen], ground[chosen]


def _key_of(cell: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return a number for each cell (n, 3) of a block."""
    x, y, z = cell.T
    return np.asarray((z * 4096 + y) * 4096 + x)


def _empty_table(rows: int) -> VoxelTable:
    """Make a table with room for that many voxels, a power of two."""
    slot, key = np.full(2 * rows, -1, np.int32), np.zeros(rows, np.int64)
    hits, last, mine, held = np.zeros((4, rows), np.int32)
    turn, place = np.zeros((rows, MOST_GROUND), np.uint32), np.zeros((rows, MOST_GROUND, 3), np.int32)
    return VoxelTable(slot, key, hits, last, mine, held, turn, place, np.zeros(1, np.int32))


def _with_room(table: VoxelTable, more: int) -> VoxelTable:
    """Return the table, or a copy with room for ``more`` voxels."""
    used = int(table.size[0])
    if used + more <= len(table.key):
        return table
    larger = _empty_table(1 << int(used + more).bit_length())
    for name in ("key", "hits", "last", "mine", "held", "turn", "place"):
        getattr(larger, name)[:used] = getattr(table, name)[:used]
    loops.move_voxels(table, larger)
    return larger
