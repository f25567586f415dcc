"""Merge the frames of a drive into one survey: points that were seen through go, the others are thinned evenly.

Frames come one after another. Their points are written to a file in the folder of the run, sorted by block of the
world, with an image of the nearest ranges by direction. When all are there, the standing objects of the frames give
corrections of the poses in plan, with which the points are placed again, and their ground those of height and tilt.
Then block after block is read back: a voxel through which two other frames or more saw, and more than saw something in
it, held something that moved. Memory is bounded by the surfaces in one block and by a number of squares of ground.

Each frame is held against the one before it, one some metres away, and one of an earlier passage: by how much the
height of the same ground differs, where the objects on it in one frame are found in the other, and how many of them
are seen through. What does not fit is reported with the frame; far beyond any error of good poses the run is refused.
"""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, loops
from bumpymap.layers import AccumulatedSurvey
from bumpymap.scan.align import (
    VIEW_REACH_M,
    VIEW_SHAPE,
    Alignment,
    DriveHeights,
    GroundHeights,
    ObjectFit,
    ObjectMatcher,
    PlanPair,
    align_frames,
    correct_in_plan,
    frame_pairs,
    ground_heights,
    height_between,
    judge_by_view,
    misfit_in_plan,
    moved_heights,
    nearest_ranges,
    standing_objects,
    turned_in_plan,
)

_log = logging.getLogger(__name__)

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
"""A point in the file: place, mm; distance from its sensor; 1 if it is ground."""
_FAR_MM = 2_000_000_000
"""Largest coordinate in the file, mm: that of 32 bits."""
_THICK_M = 0.5
"""Difference of ground between frames above which poses are refused, m (chosen)."""
_WRONG, _GONE, _LEAST_AWAY_M, _LEAST_COMPARED = 0.5, 0.8, 5.0, 60
"""Share of objects seen through, of those and of those found again, above which poses are refused by all frames at that
distance, m, or farther, and above which a frame does not fit; fewest objects compared. With traffic the share is up to
0.26, with inverted, reversed or swapped poses 0.8 to 1."""
_LEANS, _SCALED, _LEFT = 0.026, 0.04, 0.3
"""Least slope (1.5 degrees), and least share of a way, that explain misfits, and share of their squares that may be
left (chosen)."""
_PLACED_M, _PLACED_RAD = 0.03, math.radians(0.1)
"""Largest corrections of place and direction, of all frames, that are errors of their own: none is made (chosen)."""
_MOVED_M = 0.1
"""Distance from the pose of the one before at which a frame with the same points is a repeated one, m (chosen)."""
_NAMED = 5
"""Number of frames that a message names."""


class MisfitLimits(NamedTuple):
    """Limits of the misfit of a frame against an earlier one (chosen together)."""

    beside_m: float
    """Distance of its objects from their places, m."""
    turned_deg: float
    """Turn of its objects, degrees."""
    higher_m: float
    """Difference of the height of the same ground, m; of what is refused, that after corrections."""
    found: float
    """Objects are beside their places if a smaller share of what is found there is found at the poses."""


_REPORTED, _REFUSED = MisfitLimits(0.3, 1.5, 0.25, 0.8), MisfitLimits(1.0, 2.5, 0.5, 0.5)
"""Misfits that are reported, and those for which the poses are refused."""


class WrongPosesError(BadInputError):
    """Poses with which the frames contradict each other: the same run would end in the same way again."""


@dataclass(frozen=True, slots=True)
class PlacedPoints:
    """The points of a frame in the world."""

    name: str
    pose: NDArray[np.float64]
    rows: NDArray[Any]
    """(n,) points as in the file, sorted by block."""
    blocks: NDArray[np.int64]
    """(k,) blocks that hold points, in order."""
    counts: NDArray[np.int64]
    """(k,) points in each."""
    image: NDArray[np.uint16]
    """See `nearest_ranges`."""
    heights: GroundHeights
    objects: NDArray[np.float32]
    """Objects around the sensor, see `standing_objects`."""


@dataclass(frozen=True, slots=True)
class FramePair:
    """A frame held against an earlier one, by their numbers."""

    later: int
    earlier: int
    way: NDArray[np.float64]
    """(3,) to the later one, m."""
    fit: ObjectFit
    higher_m: float
    """By how much the later one has the same ground higher; NaN if unknown."""
    left_m: float
    """The same after corrections."""
    through: int
    """Objects of each that the other sees through."""
    found: float
    """Objects of each that the other has too."""
    repeated: bool
    """True if both hold the same points, though at different poses."""

    def evidence(self) -> list[str]:
        """Return what does not fit, in words."""
        said = ["it holds the same points"] if self.repeated else []
        beside = float(np.hypot(*self.fit.move))
        is_turned = abs(self.fit.turn) > _REPORTED.turned_deg
        if self.fit.is_displaced(_REPORTED.found) and (beside > _REPORTED.beside_m or is_turned):
            turned = f"turned by {abs(self.fit.turn):.0f} degrees"
            moved = f"{beside:.1f} m beside their places" + (f", {turned}" if is_turned else "")
            said.append(f"objects stand {moved if beside > _REPORTED.beside_m else turned}")
        if abs(self.higher_m) > _REPORTED.higher_m:
            way = "higher" if self.higher_m > 0.0 else "lower"
            said.append(f"the same ground is {abs(self.higher_m):.2f} m {way}")
        if self.through > _GONE * (self.through + self.found) and self.through + self.found > _LEAST_COMPARED:
            said.append(f"{self.through / (self.through + self.found):.0%} of the objects there are seen through")
        return said

    def size(self) -> float:
        """Return how far it is from fitting, m; the same points at another place are no frame of their own."""
        if self.repeated:
            return np.inf
        return float(
            self.fit.is_displaced(_REPORTED.found) * np.hypot(*self.fit.move) + abs(np.nan_to_num(self.higher_m))
        )

    @property
    def is_wrong(self) -> bool:
        """True if it fits worse than with any good poses."""
        far = np.hypot(*self.fit.move) >= _REFUSED.beside_m or abs(self.fit.turn) > _REFUSED.turned_deg
        return bool(abs(self.left_m) > _REFUSED.higher_m or (far and self.fit.is_displaced(_REFUSED.found)))

    def record(self, names: list[str]) -> dict[str, Any]:
        """Return the entry in scan.json."""
        seen = self.through + self.found
        return {
            "frame": names[self.later],
            "against": names[self.earlier],
            "beside_m": round(float(np.hypot(*self.fit.move)), 2) if self.fit.is_displaced(_REPORTED.found) else None,
            "turned_deg": round(self.fit.turn, 2) if self.fit.is_displaced(_REPORTED.found) else None,
            "higher_m": None if np.isnan(self.higher_m) else round(self.higher_m, 3),
            "seen_through": round(self.through / seen, 3) if seen else None,
        }


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
    """Points of that frame so far."""
    held: NDArray[np.int32]
    """Points kept of it."""
    turn: NDArray[np.uint32]
    """(rows, kept) increasing: points the frame had there before, times 65,536, plus distance from the sensor, cm."""
    place: NDArray[np.int32]
    """(rows, kept, 3) where they are, mm."""
    size: NDArray[np.int32]
    """(1,)."""


@dataclass
class DriveMerge:
    """The frames of a drive while they come, then their merged points.

    ``points``, ``images``: take the points, and the range images, of all frames; ``offset`` (3,): what is taken off
    coordinates before they become whole millimetres, m; whole metres.
    """

    points: BinaryIO
    images: BinaryIO
    offset: NDArray[np.float64]
    trusted: bool = False
    """True if poses that contradict the frames are used all the same."""
    frames: list[tuple[NDArray[np.float64], int, int]] = field(default_factory=list)
    """Pose of each, and where its points lie in the file: from, to."""
    names: list[str] = field(default_factory=list)
    objects: list[NDArray[np.float32]] = field(default_factory=list)
    """Objects around each."""
    misfits: list[FramePair] = field(default_factory=list)
    """The worst of each frame that does not fit."""
    blocks: dict[int, list[tuple[int, int, int]]] = field(default_factory=dict)
    """Of each block of the world: the frames with points there, and where they lie in the file: from, to."""
    heights: DriveHeights = field(default_factory=DriveHeights)
    """Of their ground."""
    seen: int = 0
    """Points that came."""
    written: int = 0
    ground: int = 0
    """Ground points among the written ones."""
    moving: int = 0
    """Points in voxels that were seen through."""
    alignment: Alignment | None = None
    """None until all frames have come."""
    shift: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
    """Its corrections."""
    plan: dict[str, float | None] = field(default_factory=dict)
    """Corrections in plan, as in scan.json."""

    def record(self) -> dict[str, Any]:
        """Return the entry in scan.json."""
        poses: dict[str, Any] | None = None
        if self.alignment is not None:
            misfits = [pair.record(self.names) for pair in self.misfits]
            poses = self.alignment.record() | self.plan | {"misfits": misfits}
        counts = {"seen": self.seen, "points": self.written, "ground": self.ground, "moving": self.moving}
        return {**counts, "poses": poses}

    def place_points(
        self, name: str, points: NDArray[np.float32], pose: NDArray[np.float64], is_ground: NDArray[np.bool_]
    ) -> PlacedPoints:
        """Prepare the points of a frame for `add_points`; several threads may do so at a time.

        ``name``: of the frame; ``points`` (n, 3): in the frame of the sensor, m; ``pose`` (4, 4): transform from the
        sensor's frame to the world, m. Raises BadInputError: the frame lies too far from the first one.
        """
        # Not a matrix product: its library would start threads of its own in each of ours, for half of the time.
        world = np.einsum("nj,ij->ni", points.astype(np.float64), pose[:3, :3]) + (pose[:3, 3] - self.offset)
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
        image = nearest_ranges(points)
        heights = ground_heights(points, is_ground, pose)
        objects = standing_objects(points, is_ground, pose)
        return PlacedPoints(name, pose, *self._by_block(rows), image, heights, objects)

    def _by_block(self, rows: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64]]:
        """Return points sorted by block, the blocks that hold any, in order, and the points in each."""
        column, row = np.floor((rows["place"][:, :2] + self._whole_offset()) / _BLOCK_MM).T  # whole numbers: exact
        blocks, number = np.unique((column + _SIDE * row).astype(np.int64), return_inverse=True)
        order = np.argsort(number.astype(np.min_scalar_type(len(blocks))), kind="stable")
        return rows[order], blocks, np.bincount(number, minlength=len(blocks))

    def add_points(self, placed: PlacedPoints) -> None:
        """Take the points of the next frame."""
        self._list_blocks(len(self.frames), self.seen, placed.blocks, placed.counts)
        placed.rows.tofile(self.points)
        placed.image.tofile(self.images)
        count = len(placed.rows)
        self.frames.append((placed.pose, self.seen, self.seen + count))
        self.names.append(placed.name)
        self.heights.add(placed.heights)
        self.objects.append(placed.objects)
        self.seen += count

    def _list_blocks(self, frame: int, start: int, blocks: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Note where the points of a frame, from ``start`` on in the file, lie in blocks (k,), ``counts`` (k,) each."""
        ends = start + np.cumsum(counts)
        for block, begin, end in zip(blocks.tolist(), (ends - counts).tolist(), ends.tolist(), strict=True):
            self.blocks.setdefault(block, []).append((frame, begin, end))

    def write(self, survey: AccumulatedSurvey) -> None:
        """Align the frames, and write what is left of their points, block by block."""
        self.points.flush()
        self.images.flush()
        self.alignment = align_frames(self.heights.frames)
        pairs = self._pairs(self.alignment.shift) if len(self.poses) > 1 else []
        fits = [(pair.later, pair.earlier, pair.way[:2], pair.fit) for pair in pairs]
        contradiction = self._check_poses(pairs, self.alignment) if pairs else ""
        outcome = self._correct_plan(fits)
        if contradiction:
            _log.warning("%s %s", contradiction, outcome)
        self.shift = self.alignment.shift
        for block in sorted(self.blocks):
            xyz, is_ground = self._thin(block, self._gather(block))
            survey.add_points(self.offset + 0.001 * xyz, is_ground)
            self.written += len(xyz)
            self.ground += int(is_ground.sum())

    @cached_property
    def poses(self) -> NDArray[np.float64]:
        """(frames, 4, 4) when all have come: as they were given, then corrected in plan."""
        return np.array([pose for pose, *_ in self.frames]).reshape(-1, 4, 4)

    def _image(self, number: int) -> NDArray[np.uint16]:
        """Read the range image of a frame, see `nearest_ranges`."""
        pixels = VIEW_SHAPE[0] * VIEW_SHAPE[1]
        return np.fromfile(self.images.name, np.uint16, pixels, offset=2 * pixels * number).reshape(VIEW_SHAPE)

    def _correct_plan(self, fits: list[PlanPair]) -> str:
        """Move and turn the frames in plan to where their objects lie on each other; return what that means, in words.

        Poses that are trusted stay.
        """
        found, none = correct_in_plan(fits, len(self.frames)), np.zeros((len(self.frames), 3))
        before, after = misfit_in_plan(fits, none), misfit_in_plan(fits, found)
        moved = float(np.linalg.norm(found[:, :2], axis=1).max(initial=0.0))
        turned = float(np.abs(found[:, 2]).max(initial=0.0))
        if self.trusted or not after < before or (moved < _PLACED_M and turned < _PLACED_RAD):
            found, after, moved, turned = none, before, 0.0, 0.0
        self.plan = {
            "beside_before_m": None if math.isnan(before) else round(before, 3),
            "beside_after_m": None if math.isnan(after) else round(after, 3),
            "largest_move_m": round(moved, 3),
            "largest_turn_deg": round(math.degrees(turned), 3),
        }
        if not found.any():
            return "The map may show objects twice, or not where they stand"
        self.blocks.clear()
        with open(self.points.name, "r+b") as file:  # noqa: PTH123 (a name of a file that is open)
            for number, ((given, begin, end), by) in enumerate(zip(self.frames, found, strict=True)):
                pose, place = given.copy(), given[:2, 3]
                self.frames[number] = (pose, begin, end)
                pose[:2, :3] = turned_in_plan(pose[:2, :3].T, by[2]).T
                pose[:2, 3] += by[:2]
                self.heights.frames[number] = moved_heights(self.heights.frames[number], place, by)
                file.seek(begin * _POINT.itemsize)
                rows = np.fromfile(file, _POINT, end - begin)
                middle = 1000.0 * (place - self.offset[:2])
                turned_places = turned_in_plan(rows["place"][:, :2] - middle, by[2]) + middle + 1000.0 * by[:2]
                rows["place"][:, :2] = np.round(turned_places)
                rows, blocks, counts = self._by_block(rows)
                self._list_blocks(number, begin, blocks, counts)
                file.seek(begin * _POINT.itemsize)
                rows.tofile(file)
        del self.poses  # as they are now
        self.alignment = align_frames(self.heights.frames)
        return (
            f"The frames were moved by up to {moved:.2f} m and turned by up to {math.degrees(turned):.1f} degrees: "
            f"their objects lie {after:.2f} m apart in the median, {before:.2f} m before"
        )

    def _check_poses(self, pairs: list[FramePair], given: Alignment) -> str:
        """Return what does not fit, in words. Raises WrongPosesError: poses that cannot be right."""
        misfits = sorted((pair for pair in pairs if pair.evidence()), key=FramePair.size)
        worst = {pair.later: pair for pair in misfits}
        self.misfits = [worst[frame] for frame in sorted(worst)]
        whole = _contradiction(pairs, given)
        reasons = [whole] if whole else []
        is_wrong = bool(reasons) or any(pair.is_wrong for pair in pairs)
        if self.misfits:
            first = "; ".join(
                f"{self.names[pair.later]} against {self.names[pair.earlier]}: {' and '.join(pair.evidence())}"
                for pair in self.misfits[:_NAMED]
            )
            verb = "do" if len(self.misfits) > 1 else "does"
            count = f"{len(self.misfits)} of {len(self.poses)} frames {verb} not fit others"
            reasons.append(f"{count}{_likely(pairs, self.poses)} ({first})")
        if not reasons:
            return ""
        few = not whole and 3 * len(self.misfits) < len(self.poses)
        advice = (
            "Are `poses` those of the LiDAR (not of a camera or of the robot's base), one per frame in order of time, "
            "in metres, and from the sensor to the world (not inverted)?"
        )
        message = f"according to the poses, {', and '.join(reasons)}. {'Look at their poses.' if few else advice}"
        if is_wrong and not self.trusted:
            raise WrongPosesError(f"{message} `trust_poses=True` makes a map all the same")
        return message

    def _pairs(self, shift: NDArray[np.float64]) -> list[FramePair]:
        """Hold frames against earlier ones; ``shift``: corrections of all."""
        pairs, matcher, poses, heights = [], ObjectMatcher(), self.poses, self.heights.frames
        for later, earlier in frame_pairs(poses):
            way = poses[later, :3, 3] - poses[earlier, :3, 3]
            fit = matcher.fit(self.objects[later], way[:2], self.objects[earlier])
            images, through = [self._image(each) for each in (later, earlier)], 0
            for own, other, by, image in ((later, earlier, way, images[1]), (earlier, later, -way, images[0])):
                turned = np.eye(4)
                turned[:3, :3] = poses[other, :3, :3]
                places = np.clip(np.round(1000.0 * (self.objects[own] + by)), -_FAR_MM, _FAR_MM).astype(np.int32)
                through += int(judge_by_view(places, turned, image)[0].sum())
            higher = height_between(heights[later], heights[earlier])
            left = height_between(heights[later], heights[earlier], shift[[later, earlier]])
            repeated = later == earlier + 1 and np.linalg.norm(way) > _MOVED_M and np.array_equal(images[0], images[1])
            both = 2.0 * fit.found * fit.objects
            pairs.append(FramePair(later, earlier, way, fit, higher, left, through, both, bool(repeated)))
        return pairs

    def _whole_offset(self) -> NDArray[np.int64]:
        return (1000 * self.offset[:2]).astype(np.int64)

    def _corner(self, block: int) -> NDArray[np.int64]:
        """Return the corner of a block in the coordinates of the file, mm."""
        row = (block + _SIDE // 2) // _SIDE
        return np.array([block - row * _SIDE, row]) * _BLOCK_MM - self._whole_offset()

    def _gather(self, block: int) -> VoxelTable:
        """Read the points of a block, frame after frame, into voxels."""
        table, corner = _empty_table(1 << 16), self._corner(block)
        for number, begin, end in self.blocks[block]:
            rows = np.fromfile(self.points.name, _POINT, end - begin, offset=begin * _POINT.itemsize)
            xyz = rows["place"].astype(np.int64)
            shift, away = self.shift[number], 0.001 * xyz[:, :2] - (self.poses[number, :2, 3] - self.offset[:2])
            xyz[:, 2] += np.round(1000.0 * (shift[0] + away @ shift[1:])).astype(np.int64)
            xyz[:, :2] -= corner
            table = _with_room(table, len(rows))
            loops.gather_points(
                xyz.astype(np.int32), rows["range_cm"].copy(), rows["kind"].copy(), number, VOXEL_MM, table
            )
        return table

    def _judge(self, block: int, where: NDArray[np.int32]) -> NDArray[np.int32]:
        """Count for places (n, 3) in a block the frames that `judge_by_view` tells apart, (4, n)."""
        corner = 0.001 * self._corner(block) + self.offset[:2]
        middle = self.poses[:, :2, 3]
        away = np.linalg.norm(middle - np.clip(middle, corner, corner + 0.001 * _BLOCK_MM), axis=1)
        found = np.zeros((4, len(where)), np.int32)
        for number in np.flatnonzero(away < VIEW_REACH_M).tolist():
            pose = self.poses[number].copy()
            pose[:3, 3] -= [*corner, self.offset[2]]
            pose[2, 3] += self.shift[number, 0]
            judge_by_view(where, pose, self._image(number), found)
        return found

    def _thin(self, block: int, table: VoxelTable) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the points of a block that stay, mm, and whether they are ground.

        Those in voxels that were seen through go. So does ground above which something hides the space that a vehicle
        needs from every frame: it was seen between the wheels of a car.
        """
        used = int(table.size[0])
        is_ground = table.key[:used] & 1 == 1
        nearest = table.place[:used, 0]
        through = self._judge(block, nearest.copy())[0]
        moved = (through >= 2) & (through > table.hits[:used])
        above = self._judge(block, nearest[is_ground] + np.array([0, 0, _PROBE_MM], np.int32))
        hidden = np.zeros(used, np.bool_)
        hidden[is_ground] = (above[0] + above[2] == 0) & (above[1] > 0)
        kept = np.arange(MOST_GROUND) < table.held[:used, None]
        self.moving += int(kept[moved].sum())
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


def _contradiction(pairs: list[FramePair], given: Alignment) -> str:
    """Return how all frames together contradict the poses, in words; empty if they do not."""
    far = [pair for pair in pairs if np.linalg.norm(pair.way[:2]) >= _LEAST_AWAY_M] or pairs
    through, found = sum(pair.through for pair in far), sum(pair.found for pair in far)
    if given.before_m > _THICK_M:
        return f"the height of the same ground differs by {given.before_m:.1f} m between frames"
    if through > _WRONG * (through + found) and through + found > _LEAST_COMPARED:
        return f"frames see through {through / (through + found):.0%} of the objects in others"
    if not given.squares and min(np.linalg.norm(pair.way) for pair in pairs) > 2.0 * VIEW_REACH_M:
        return "the frames are so far apart that they share no ground"
    return ""


def _likely(pairs: list[FramePair], poses: NDArray[np.float64]) -> str:
    """Return what would explain most of the misfits of all frames, in words; empty if nothing does."""
    way = np.array([poses[pair.earlier, :3, :3].T @ pair.way for pair in pairs])[:, :2]
    higher = np.array([pair.higher_m for pair in pairs])
    known = np.isfinite(higher)
    lean = np.linalg.lstsq(way[known], higher[known], rcond=None)[0]
    rest = np.sum((higher - way @ lean)[known] ** 2) / max(np.sum(higher[known] ** 2), 1e-9)
    if np.abs(higher[known]).max(initial=0.0) > _REPORTED.higher_m and np.hypot(*lean) > _LEANS and rest < _LEFT:
        return f", as if the LiDAR leaned by {np.degrees(np.arctan(np.hypot(*lean))):.0f} degrees against its poses"
    plan = np.array([pair.way[:2] for pair in pairs if pair.fit.is_displaced(1.0)])
    move = np.array([pair.fit.move for pair in pairs if pair.fit.is_displaced(1.0)])
    longer = np.sum(plan * move) / max(np.sum(plan**2), 1e-9)
    if _SCALED < abs(longer) < 0.5 and np.sum((move - longer * plan) ** 2) < _LEFT * np.sum(move**2):
        return f", as if all ways were {1.0 / (1.0 + longer):.2f} times as long as in truth"
    return ""


def _empty_table(rows: int) -> VoxelTable:
    """Make a table with room for that many voxels, a power of two."""

    def zeros(*shape: int, kind: type = np.int32) -> NDArray[Any]:
        return np.zeros((rows, *shape), kind)

    return VoxelTable(
        np.full(2 * rows, -1, np.int32),
        zeros(kind=np.int64),
        zeros(),
        zeros(),
        zeros(),
        zeros(),
        zeros(MOST_GROUND, kind=np.uint32),
        zeros(MOST_GROUND, 3),
        np.zeros(1, np.int32),
    )


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


@contextmanager
def open_merge(folder: Path, first: NDArray[np.float64], *, trusted: bool = False) -> Iterator[DriveMerge]:
    """Open the files of a merge in the folder of a run, and remove them at the end.

    ``first`` (4, 4): pose of the first frame, m; coordinates in the files count from there; ``trusted``: poses that
    contradict the frames are used all the same.
    """
    paths = [folder / name for name in ("merge.points", "merge.images")]
    try:
        with paths[0].open("wb") as points, paths[1].open("wb") as images:
            yield DriveMerge(points, images, np.round(first[:3, 3]), trusted)
    finally:
        for path in paths:
            path.unlink(missing_ok=True)
