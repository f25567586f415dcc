"""Poses of a drive held against its frames: those that cannot be right are named, with what contradicts them.

Each frame is held against the one before it, one some metres away, and one of an earlier passage. Of frames that
disagree, one that fits few others is the culprit, and is left out. If too many disagree, nothing can be left out: far
beyond any error of good poses the drive is refused, and else the frames are named.

A LiDAR whose mounting is missing in its poses leans by the same angle against the ground that the robot drives on, in
its own axes as in the world. Where the way bends, or leads on, the same ground differs between frames by just that.
"""

import logging
import math
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from bumpymap.core import BadInputError, Floats
from bumpymap.scan.align import (
    VIEW_REACH_M,
    HeightDifference,
    ObjectFit,
    compare_heights,
    fit_objects,
    fit_plane,
    judge_by_view,
    keeps_beside,
    places_of_squares,
)

_log = logging.getLogger(__name__)

_APART_M, _BEFORE = (5.0, 15.0), 16
"""A frame is compared with the last one at such a distance, m, or else with the one that many frames before
(chosen)."""
_PATH_M, _FLOOR_M = 40.0, 2.0
"""And with the nearest one that came that much path before, at most that far above or below, m (chosen): beyond, it may
be on another floor."""
_THICK_M, _ROUGH_M = 0.5, 0.05
"""Difference of ground between frames above which poses are refused, and standard deviation of heights above which it
is reported, m (chosen)."""
_WRONG, _GONE, _LEAST_AWAY_M, _LEAST_COMPARED = 0.5, 0.8, 5.0, 60
"""Share of objects seen through, of those and of those found again, above which poses are refused by all frames at that
distance, m, or farther, and above which a frame does not fit; fewest objects compared. With traffic the share is up to
0.26, with inverted, reversed or swapped poses 0.8 to 1."""
_SCALED, _LEFT = 0.04, 0.3
"""Least share of a way that explains misfits, and share of their squares that may be left (chosen)."""
_MOVED_M = 0.1
"""Distance from the pose of the one before at which a frame with the same points is a repeated one, m (chosen)."""
_STRIP_M, _STEP_M, _AHEAD_M, _LEAST_STRIP = 1.25, 0.25, 10.0, 12
"""Distance from the way within which a robot drives on the ground, step along the way, distance from the sensor to
which it is looked at, m, and fewest squares of it (chosen)."""
_LEANS, _LEVER_M = math.tan(math.radians(1.5)), 10.0
"""Slope against the ground that is reported; distance at which one between frames counts like a difference of height, m
(chosen)."""
_FEWEST = 5
"""A fifth of the frames, and one at least, may be left out (chosen)."""
_NAMED = 5
"""Number of frames that a message names."""


class MisfitLimits(NamedTuple):
    """Limits of the misfit of a frame against an earlier one (chosen together)."""

    beside_m: float
    """Distance of its objects from their places, m."""
    turned_deg: float
    """Turn of its objects, degrees."""
    higher_m: float
    """Difference of the height of the same ground, m."""
    leaning_deg: float
    """Angle between the same ground in both, degrees."""
    found: float
    """Objects are beside their places if a smaller share of what is found there is found at the poses."""


_REPORTED, _REFUSED = MisfitLimits(0.3, 1.5, 0.25, 2.0, 0.8), MisfitLimits(1.0, 2.5, 0.75, 4.0, 0.5)
"""Misfits that are reported, and those for which the poses are refused."""


class WrongPosesError(BadInputError):
    """Poses with which the frames contradict each other: the same run would end in the same way again."""


@dataclass(frozen=True, slots=True)
class FramePair:
    """A frame held against an earlier one, by their numbers."""

    numbers: tuple[int, int]
    """The later one, and the earlier one."""
    way: Floats
    """(3,) to the later one, m."""
    fit: ObjectFit
    ground: HeightDifference
    through: int
    """Objects of each that the other sees through, without those that keep beside the sensor."""
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
        higher = self.ground.higher_m
        if abs(higher) > _REPORTED.higher_m:
            said.append(f"the same ground is {abs(higher):.2f} m {'higher' if higher > 0.0 else 'lower'}")
        if self.ground.leaning_deg > _REPORTED.leaning_deg:
            said.append(f"the same ground leans by {self.ground.leaning_deg:.1f} degrees")
        if self.through > _GONE * (self.through + self.found) and self.through + self.found > _LEAST_COMPARED:
            said.append(f"{self.through / (self.through + self.found):.0%} of the objects there are seen through")
        return said

    def size(self) -> float:
        """Return how far it is from fitting, m; the same points at another place are no frame of their own."""
        if self.repeated:
            return np.inf
        leaning = _LEVER_M * math.tan(math.radians(float(np.nan_to_num(self.ground.leaning_deg))))
        moved = self.fit.is_displaced(_REPORTED.found) * np.hypot(*self.fit.move)
        return float(moved + abs(np.nan_to_num(self.ground.higher_m)) + leaning)

    @property
    def is_wrong(self) -> bool:
        """True if it fits worse than with any good poses."""
        far = np.hypot(*self.fit.move) >= _REFUSED.beside_m or abs(self.fit.turn) > _REFUSED.turned_deg
        uneven = abs(self.ground.higher_m) > _REFUSED.higher_m or self.ground.leaning_deg > _REFUSED.leaning_deg
        return bool(self.repeated or uneven or (far and self.fit.is_displaced(_REFUSED.found)))

    def record(self, names: list[str]) -> dict[str, Any]:
        """Return the entry in scan.json."""
        seen, is_displaced = self.through + self.found, self.fit.is_displaced(_REPORTED.found)
        return {
            "frame": names[self.numbers[0]],
            "against": names[self.numbers[1]],
            "beside_m": round(float(np.hypot(*self.fit.move)), 2) if is_displaced else None,
            "turned_deg": round(self.fit.turn, 2) if is_displaced else None,
            "higher_m": _rounded(self.ground.higher_m, 3),
            "leaning_deg": _rounded(self.ground.leaning_deg, 2),
            "seen_through": round(self.through / seen, 3) if seen else None,
        }


def _rounded(value: float, digits: int) -> float | None:
    return None if math.isnan(value) else round(value, digits)


def frame_pairs(poses: Floats) -> list[tuple[int, int]]:
    """Return the frames of ``poses`` (frames, 4, 4) that are compared, a later with an earlier one each, in order."""
    place, pairs = poses[:, :2, 3], []
    path = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(place, axis=0), axis=1))]
    for later in range(1, len(poses)):
        away = np.linalg.norm(place[:later] - place[later], axis=1)
        apart = np.flatnonzero((away >= _APART_M[0]) & (away <= _APART_M[1]))
        floor = np.abs(poses[:later, 2, 3] - poses[later, 2, 3]) < _FLOOR_M
        again = np.flatnonzero((path[later] - path[:later] > _PATH_M) & (away <= _APART_M[1]) & floor)
        again = again[np.argsort(away[again], kind="stable")]
        before = apart[-1:].tolist() or [max(0, later - _BEFORE)]
        pairs += [(later, each) for each in sorted({later - 1, *before, *again[:1].tolist()})]
    return pairs


@dataclass
class PoseCheck:
    """Poses of a drive, held against its frames.

    ``poses`` (frames, 4, 4), m; ``names``: of frames; ``view``: returns the `VIEW` of a frame by its number;
    ``trusted``: nothing is refused or left out; ``corrected``: small errors will be corrected, and are not left out.
    """

    poses: Floats
    names: list[str]
    view: Callable[[int], Any]
    trusted: bool = False
    corrected: bool = False
    pairs: dict[tuple[int, int], FramePair] = field(default_factory=dict)
    """By their numbers, those of frames that were left out too."""
    left_out: list[int] = field(default_factory=list)
    """Frames whose poses are wrong, one by one."""
    lean_deg: tuple[float, float] | None = None
    """Roll and pitch of the LiDAR that the poses lack; None if they lack none."""
    height_m: float | None = None
    """Of the sensor above the ground that the robot drives on; None if unknown."""

    @property
    def kept(self) -> list[int]:
        """The numbers of the frames that are used."""
        return sorted({*range(len(self.poses))}.difference(self.left_out))

    def record(self) -> dict[str, Any]:
        """Return what scan.json says."""
        return {
            "compared": len(self.pairs),
            "ground_spread_m": _rounded(self._spread(), 4),
            "lean_deg": self.lean_deg and [round(angle, 1) for angle in self.lean_deg],
            "left_out": [self.names[number] for number in self.left_out],
            "misfits": [pair.record(self.names) for pair in self._misfits(self.pairs.values())],
        }

    def run(self) -> None:
        """Hold the frames against each other, leave out those that are wrong, and say what does not fit.

        Raises WrongPosesError: poses that cannot be right.
        """
        self._compare()
        if not self.trusted:
            self._leave_out()
        if self.left_out:
            said = "; ".join(self._named(number) for number in self.left_out[:_NAMED])
            _log.warning(
                "%d of %d frames are left out of the map: their poses are wrong (%s)",
                *(len(self.left_out), len(self.poses), said),
            )
        pairs = self._used()
        lean, is_sure = self._find_lean(pairs)
        whole, spread = self._contradiction(pairs), self._spread()
        left = self._misfits(pairs)
        reasons = [whole] if whole else []
        if left:
            verb = "do" if len(left) > 1 else "does"
            said = "; ".join(self._against(pair, pair.numbers[0]) for pair in left[:_NAMED])
            reasons.append(
                f"{len(left)} of {len(self.poses)} frames {verb} not fit others{lean or _scaled(pairs)} ({said})"
            )
        elif lean:
            reasons.append(f"the ground lies{lean[1:]}")
        elif spread > _ROUGH_M and not (whole or self.corrected):
            reasons.append(f"the height of the same ground differs by {spread:.2f} m between frames")
        if reasons:
            is_wrong = bool(whole) or is_sure or any(pair.is_wrong for pair in pairs)
            small = "" if is_wrong or self.corrected else " `correct_poses=True` corrects small errors"
            advice = _LEAN_ADVICE if lean else _ADVICE if whole or 3 * len(left) >= len(self.poses) else small
            message = f"according to the poses, {', and '.join(reasons)}.{advice}"
            if is_wrong and not self.trusted:
                raise WrongPosesError(f"{message} `trust_poses=True` makes a map all the same")
            _log.warning("%s", message)

    def _used(self) -> list[FramePair]:
        """Return the pairs without frames that were left out."""
        left_out = {*self.left_out}
        return [pair for pair in self.pairs.values() if not left_out.intersection(pair.numbers)]

    def _misfits(self, pairs: Iterable[FramePair]) -> list[FramePair]:
        """Return the worst pair that does not fit of each later frame, in order."""
        worst = {pair.numbers[0]: pair for pair in sorted(pairs, key=FramePair.size) if pair.evidence()}
        return [worst[number] for number in sorted(worst)]

    def _against(self, pair: FramePair, number: int) -> str:
        """Return in words what does not fit in a pair about one of its frames."""
        later, earlier = pair.numbers
        other = earlier if number == later else later
        return f"{self.names[number]} against {self.names[other]}: {' and '.join(pair.evidence())}"

    def _named(self, number: int) -> str:
        """Return in words what does not fit in the worst pair of a frame."""
        pairs = [pair for pair in self.pairs.values() if number in pair.numbers and pair.evidence()]
        return self._against(max(pairs, key=FramePair.size), number)

    def _compare(self) -> None:
        """Hold the frames that are used against each other, where they have not been."""
        kept = np.array(self.kept)
        for rows in frame_pairs(self.poses[kept]):
            later, earlier = kept[list(rows)].tolist()
            if (later, earlier) not in self.pairs:
                self.pairs[later, earlier] = self._pair(later, earlier)

    def _pair(self, later: int, earlier: int) -> FramePair:
        poses = self.poses[later], self.poses[earlier]
        views = self.view(later), self.view(earlier)
        way = poses[0][:3, 3] - poses[1][:3, 3]
        objects = [each["objects"][np.isfinite(each["objects"][:, 0])] for each in views]
        beside = keeps_beside(objects[0], objects[1], poses)
        through = 0
        for own, by in ((0, way), (1, -way)):
            turned = np.eye(4)
            turned[:3, :3] = poses[1 - own][:3, :3]
            places = np.round(1000.0 * np.clip(objects[own][~beside[own]] + by, -1e6, 1e6)).astype(np.int32)
            through += int(judge_by_view(places, turned, views[1 - own]["ranges"])[0].sum())
        fit = fit_objects(objects[0][~beside[0]], way[:2], objects[1][~beside[1]])
        ground = compare_heights(views[0]["heights"], views[1]["heights"], poses)
        same = np.array_equal(views[0]["ranges"], views[1]["ranges"])
        repeated = later == earlier + 1 and np.linalg.norm(way) > _MOVED_M and same
        return FramePair((later, earlier), way, fit, ground, through, 2.0 * fit.found * fit.objects, bool(repeated))

    def _is_bad(self, pair: FramePair) -> bool:
        return pair.is_wrong if self.corrected else bool(pair.evidence())

    def _leave_out(self) -> None:
        """Leave out frames that disagree with most others, the worst first, as long as there are few.

        They explain half of all that does not fit at least; else the fault is in all frames.
        """
        most, bad = max(1, len(self.poses) // _FEWEST), list[FramePair]()
        while len(self.left_out) <= most:
            used, found = self._used(), len(self.left_out)
            bad = [pair for pair in used if self._is_bad(pair)]
            while bad and len(self.left_out) <= most:
                own, worst = (Counter(number for pair in pairs for number in pair.numbers) for pairs in (used, bad))
                size = Counter[int]()
                for pair in bad:
                    size.update(dict.fromkeys(pair.numbers, pair.size()))
                culprits = [number for number in worst if 2 * worst[number] > own[number] > 1]
                if not culprits:
                    break
                culprit = max(culprits, key=lambda number: (worst[number], size[number]))
                self.left_out.append(culprit)
                used, bad = ([pair for pair in pairs if culprit not in pair.numbers] for pairs in (used, bad))
            if len(self.left_out) == found:
                break
            self._compare()
        explained = sum(map(self._is_bad, self.pairs.values())) - len(bad)
        if len(self.left_out) > most or len(bad) > explained:
            self.left_out.clear()
        self.left_out.sort()

    def _spread(self) -> float:
        """Return the standard deviation of the height of the same ground between frames, m; NaN if none share any."""
        spread = [pair.ground.spread_m for pair in self._used() if not math.isnan(pair.ground.spread_m)]
        return float(np.median(spread)) if spread else math.nan

    def _contradiction(self, pairs: list[FramePair]) -> str:
        """Return how all frames together contradict the poses, in words; empty if they do not."""
        far = [pair for pair in pairs if np.linalg.norm(pair.way[:2]) >= _LEAST_AWAY_M] or pairs
        through, found, spread = sum(pair.through for pair in far), sum(pair.found for pair in far), self._spread()
        if spread > _THICK_M:
            return f"the height of the same ground differs by {spread:.1f} m between frames"
        if through > _WRONG * (through + found) and through + found > _LEAST_COMPARED:
            return f"frames see through {through / (through + found):.0%} of the objects in others"
        if math.isnan(spread) and min(np.linalg.norm(pair.way) for pair in pairs) > 2.0 * VIEW_REACH_M:
            return "the frames are so far apart that they share no ground"
        return ""

    def _find_lean(self, pairs: list[FramePair]) -> tuple[str, bool]:
        """Find how the sensor leans against the ground that the robot drives on, beyond what its poses say.

        Returns this in words, empty if it does not, and whether the frames show it for sure.
        """
        own, world, high, way = [], [], [], way_along(self.poses[self.kept])
        for number in self.kept:
            pose = self.poses[number]
            at, z = places_of_squares(self.view(number)["heights"], pose)
            near = np.linalg.norm(at, axis=1) < _AHEAD_M
            ahead = way - pose[:3, 3]
            ahead = ahead[(np.linalg.norm(ahead[:, :2], axis=1) < _AHEAD_M) & (np.abs(ahead[:, 2]) < _FLOOR_M)]
            on = (np.linalg.norm(at[near][:, None] - ahead[:, :2], axis=2) < _STRIP_M).any(axis=1)
            if on.sum() < _LEAST_STRIP:
                continue
            plane = fit_plane(at[near][on], z[near][on])
            high.append(-plane[0])
            slope, normal = plane[1:], np.array([-plane[1], -plane[2], 1.0])
            heading = pose[:2, 0] / max(np.linalg.norm(pose[:2, 0]), 1e-9)
            world.append([slope @ heading, slope @ [-heading[1], heading[0]]])
            turned = pose[:3, :3].T @ normal
            own.append(-turned[:2] / max(turned[2], 1e-9))
        if not own:
            return "", False
        self.height_m = float(np.median(high))
        level, lean = np.median(own, axis=0), np.median(world, axis=0)
        seen, rest, count = 0.0, 0.0, 1
        for pair in pairs:
            turned = [self.poses[number, :2, :2] @ lean for number in pair.numbers]
            ground = np.array([pair.ground.at_sensor_m, *(_LEVER_M * np.array(pair.ground.slope))])
            made = np.array([-turned[1] @ pair.way[:2], *(_LEVER_M * (turned[0] - turned[1]))])
            if np.isfinite(ground).all():
                seen, rest, count = seen + ground @ ground, rest + (ground - made) @ (ground - made), count + 1
        is_sure = rest < _LEFT * seen and seen > count * _ROUGH_M**2
        # Poses that hold the mounting make the ground level, and on a hillside the robot leans as the ground does.
        if np.hypot(*lean) < _LEANS or not (
            is_sure or (level @ lean > 0.5 * lean @ lean and rest <= 1.2 * seen + count * _ROUGH_M**2)
        ):
            return "", False
        roll, pitch = -math.degrees(math.atan(lean[1])), math.degrees(math.atan(lean[0]))
        self.lean_deg = roll, pitch
        words = f", as if the LiDAR leaned by {math.degrees(math.atan(np.hypot(*lean))):.0f} degrees against its poses"
        return f"{words}: a roll of {roll:.1f} and a pitch of {pitch:.1f} degrees", is_sure


_ADVICE = (
    " Are `poses` those of the LiDAR (not of a camera or of the robot's base), one per frame in order of time, in "
    "metres, and from the sensor to the world (not inverted)?"
)
_LEAN_ADVICE = " Multiply each pose from the right by the rotation of the LiDAR's mounting."


def way_along(poses: Floats) -> Floats:
    """Return places (n, 3) of the sensor in small steps along poses (frames, 4, 4), none between those far apart."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    path = np.r_[0.0, np.cumsum(np.where(steps < _AHEAD_M, steps, 1e-6))]
    along = np.arange(0.0, path[-1] + _STEP_M, _STEP_M)
    return np.column_stack([np.interp(along, path, poses[:, axis, 3]) for axis in range(3)])


def _scaled(pairs: list[FramePair]) -> str:
    """Return what would explain most of the misfits of all frames, in words; empty if nothing does."""
    moved = [pair for pair in pairs if pair.fit.is_displaced(1.0)]
    plan = np.array([pair.way[:2] for pair in moved]).reshape(-1, 2)
    move = np.array([pair.fit.move for pair in moved]).reshape(-1, 2)
    longer = np.sum(plan * move) / max(np.sum(plan**2), 1e-9)
    if _SCALED < abs(longer) < 0.5 and np.sum((move - longer * plan) ** 2) < _LEFT * np.sum(move**2):
        return f", as if all ways were {1.0 / (1.0 + longer):.2f} times as long as in truth"
    return ""
