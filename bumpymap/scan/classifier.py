"""Classify the ground of scans in memory: a function for one scan, an object for the loop of a robot."""

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
    FAIL_SHARE,
    NOT_TRAVERSABLE,
    VEHICLE_OR_CALIBRATION,
    ClassedSectors,
    GridSettings,
    GroundGrid,
    PolarSettings,
    Robot,
    Scan,
    ScanMethod,
    SectorBounds,
    SectorRide,
    UsageError,
    path_of_call,
    point_classes,
    refuse_clashes,
    sector_bounds,
    settings_of_call,
)
from bumpymap.readers import read_scan, scene_points
from bumpymap.scan._place_kernels import RAYS, CellRule, CellScratch, ClassedPoints, SquareCells, lay_cells
from bumpymap.scan.align import judge_by_view, nearest_ranges
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.methods import choose_method

_NAMES = {**dict(enumerate(CLASS_NAMES[:CLASSES])), NOT_TRAVERSABLE: "not traversable"}
_OCCUPANCY = np.array([0, 33, 66, 100, -1], np.int8)
"""Occupancy of ground of class 0 (smooth), 1 (fair) and 2 (rough), of what is not traversable, and of the unknown."""
_MOST_COST = 98
"""Occupancy of ground from the upper limit of C_r on: Nav2 takes 99 for the edge of an obstacle."""
_TURN_ERROR = 1e-3
"""A rotation differs by less from one, in each element of its product with its transpose."""
_BENEATH_M = 2.0
"""Ground that is seen beneath a thing, at most so far behind its side, is not known to be free: it may be a car."""


class SeenCells(NamedTuple):
    """What a frame shows of the square cells around its sensor; arrays (side, side), as in `GroundGrid`."""

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
        occupancy = _OCCUPANCY[self.kind]
        if len(self.limits):
            ride = np.where(np.isnan(c_r), self.limits[np.minimum(self.kind, CLASSES - 1)], c_r)
            cost = np.rint(_MOST_COST * np.minimum(ride / self.limits[-1], 1.0)).astype(np.int8)
            occupancy = np.where(self.kind < CLASSES, cost, occupancy)
        ride_of_cells = c_r if len(self.limits) else None
        return GroundGrid(cell_m, occupancy, self.class_id, elevation, step, top, clearance, ride_of_cells, corner_m)


def lay_grid(points: NDArray[np.float32], classed: ClassedSectors, settings: GridSettings) -> GroundGrid:
    """Lay a grid of square cells over the points (n, 3) of a classified scan, m; see `GroundGrid`."""
    return see_cells(points, classed, settings).finish(settings.resolution_m)


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
    stack, normal = classed.sectors, classed.sectors.normal
    if pose is not None:
        turn, shift = pose[:3, :3].astype(np.float32), pose[:2, 3] - settings.resolution_m * _cell_of(pose, settings)
        x, y, z = np.ascontiguousarray(points.T)
        points = np.empty_like(points)  # without a product of matrices, whose library would start threads
        for axis, offset in enumerate((*shift.astype(np.float32), np.float32(0.0))):
            points[:, axis] = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z + offset
        normal = normal @ turn.T
    half = math.ceil(settings.reach_m / settings.resolution_m - 1e-9)
    side, cells = 2 * half, 4 * half * half
    kinds = np.append(np.minimum(classed.class_id, CLASSES), np.uint8(CLASSES + 1))
    c_r, limits = np.full(len(kinds), np.nan, np.float32), np.empty(0, np.float32)
    if classed.ride is not None:
        c_r[:-1], limits = classed.ride.c_r, classed.ride.limits
        kinds[:-1][classed.ride.p_fail >= FAIL_SHARE] = CLASSES
    slope = np.zeros((len(kinds), 2))
    level = np.flatnonzero(stack.traversable)
    slope[level] = -normal[level, :2] / normal[level, 2:]
    layers = np.full((6, cells), np.nan, np.float32)
    out = SquareCells(np.empty(cells, np.uint8), np.full(cells, -1, np.int32), *layers[:-1])
    lay_cells(
        ClassedPoints(
            np.ascontiguousarray(points, np.float32),
            stack.point_ground,
            stack.point_airborne,
            stack.point_height,
            stack.point_sector,
            kinds,
            np.append(stack.drop, np.False_),
            slope,
        ),
        CellRule(
            settings.resolution_m,
            half,
            stack.settings.belly_m,
            stack.settings.height_m,
            round(_BENEATH_M / settings.resolution_m),
        ),
        out,
        CellScratch(
            _rays_of(half),
            np.empty(len(points), np.int32),
            np.zeros((cells, 2)),
            np.zeros(cells, np.int32),
            np.empty(cells),
            np.full((4 * RAYS, half, 3), np.inf, np.float32),
            np.full((4 * RAYS, half), -1, np.int32),
            np.full((4 * RAYS, half), -1, np.int32),
            np.zeros(len(kinds), np.bool_),
        ),
    )
    layers[-1] = c_r[out.sector]
    class_id = np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE))[out.sector]
    return SeenCells(
        out.kind.reshape(side, side),
        class_id.reshape(side, side),
        layers.reshape(6, side, side),
        0.5 * (stack.settings.belly_m + stack.settings.height_m),
        limits,
    )


def _cell_of(pose: NDArray[np.float64], settings: GridSettings) -> NDArray[np.int64]:
    """Return the corner of cells, in whole cells along x and y, that is nearest to the place of a pose (4, 4)."""
    return np.round(pose[:2, 3] / settings.resolution_m).astype(np.int64)


@lru_cache(maxsize=1)
def _rays_of(half: int) -> NDArray[np.int32]:
    """Return the first and the last ray through every cell, and its ring, (cells, 3), see `CellScratch`."""
    centre = np.arange(2 * half) + 0.5 - half
    x, y = np.tile(centre, 2 * half), np.repeat(centre, 2 * half)
    ahead = np.abs(x) >= np.abs(y)
    far = np.where(ahead, np.abs(x), np.abs(y))
    across = np.where(ahead, np.where(x > 0.0, y, -y), np.where(y > 0.0, -x, x))
    first, end = (
        np.clip(((across + edge) / far + 1.0) * (0.5 * RAYS), 0, RAYS).astype(np.int32) for edge in (-0.5, 0.5)
    )
    begin = np.where(ahead, np.where(x > 0.0, 0, 2), np.where(y > 0.0, 1, 3)) * RAYS
    return np.column_stack([begin + first, begin + np.maximum(end - 1, first), far]).astype(np.int32)


def _overlap(move: NDArray[np.int64], side: int) -> tuple[Any, Any]:
    """Return where cells of a square are in that square, and in one moved by whole cells along x and y."""
    x, y = np.clip(move, -side, side).tolist()
    here = np.s_[..., max(y, 0) : side + min(y, 0), max(x, 0) : side + min(x, 0)]
    return here, np.s_[..., max(-y, 0) : side - max(y, 0), max(-x, 0) : side - max(x, 0)]


_NEW, _MOST = 2, 6
"""Evidence for a thing in a cell: added by a frame in which it stands there, and the most that is kept; a frame that
sees through it or its bare ground takes one away. So what goes is forgotten after six frames."""
_KEPT, _LEAD = 0.9, 1.25
"""Share of the votes for the ground of a cell that stays when it is seen again: those of ten frames count. Another
class than the last one needs so many times its votes."""
_FORGOTTEN = 100
"""A cell that was not seen in so many frames is unknown again."""
_ELEVATION, _TOP, _TIP = 0, 2, 4
_RANK = np.array([1, 2, 3, 4, 0], np.uint8)
"""Which of two kinds of a cell counts where sensors differ."""


class FrameView(NamedTuple):
    """What a sensor sees from its place, for the memory."""

    pose: NDArray[np.float64]
    """(4, 4) from the sensor to the frame of the memory, m."""
    cells: SeenCells
    """As `see_cells` lays them at that pose."""
    ranges: NDArray[np.uint16]
    """See `nearest_ranges`."""

    @classmethod
    def of(
        cls, points: NDArray[np.float32], classed: ClassedSectors, settings: GridSettings, pose: NDArray[np.float64]
    ) -> "FrameView":
        """Return the view of a classified scan, as `see_cells` takes it."""
        return cls(pose, see_cells(points, classed, settings, pose), nearest_ranges(points))


class GroundMemory:
    """The surroundings of a robot as it has seen them, in square cells of its odometry frame that roll with it.

    Frame after frame votes for what the ground of a cell is; each vote fades with later ones. What stood in a cell goes
    when frames see through its place, or bare ground in its cell, and not because it is out of view. Ground that
    something hides is unknown again at once, so that nothing that came meanwhile is overlooked; so is all that was not
    seen for 100 frames.
    """

    def __init__(self, settings: GridSettings) -> None:
        self._cell = settings.resolution_m
        self._settings = settings
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
        self._roll(_cell_of(pose, self._settings) - half)
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
        there, here = _overlap(_cell_of(view.pose, self._settings) - side // 2 - self._corner, side)
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


@dataclass(frozen=True, repr=False)
class ScanResult:
    """The classified ground of one scan: arrays with one row per point, and arrays with one row per sector."""

    points: NDArray[np.float32]
    """(n, 3) m. The given points (not copied if they are float32); of a file, those without returns on the robot."""
    point_class: NDArray[np.uint8]
    """(n,) 0 smooth, 1 fair, 2 rough; 255 not traversable, or in no measured sector."""
    point_sector: NDArray[np.int32]
    """(n,) row of the point's sector in the arrays of sectors; -1 if it is in no measured sector."""
    sectors: ClassedSectors
    """All measures of the sectors; the most important ones are also properties of this object. Where returns were left
    out (not finite, on the robot), its arrays with a row per point have no rows for them."""
    _scene: NDArray[np.float32]
    """(m, 3) the points without those, m."""
    _grid: GridSettings | GroundGrid

    @cached_property
    def grid(self) -> GroundGrid:
        """The ground in square cells around the sensor; computed when it is first asked for.

        With a pose: what is remembered, in cells of the odometry frame.
        """
        return self._grid if isinstance(self._grid, GroundGrid) else lay_grid(self._scene, self.sectors, self._grid)

    @property
    def class_names(self) -> dict[int, str]:
        """Name of each class: 0 to 2, and 255."""
        return dict(_NAMES)

    @property
    def method(self) -> ScanMethod:
        """How the classes were found: ``learned`` or ``filter``."""
        return self.sectors.method

    @property
    def sector_class(self) -> NDArray[np.uint8]:
        """(m,) class of each sector: 0 to 2, or 255 where it is not traversable."""
        return self.sectors.class_id

    @property
    def sector_confidence(self) -> NDArray[np.float32]:
        """(m,) probability of the class; NaN where the sector is not traversable, everywhere by the filter method."""
        confidence = self.sectors.confidence
        return np.full(len(self.sector_class), np.nan, np.float32) if confidence is None else confidence

    @property
    def sector_c_r(self) -> NDArray[np.float32]:
        """(m,) C_r of the vehicle, rad/m, as in a survey's map; NaN where unknown, everywhere without a vehicle."""
        return self._ride.c_r

    @property
    def sector_c_r_low(self) -> NDArray[np.float32]:
        """(m,) lower end of the 80 % interval of ``sector_c_r``, rad/m."""
        return self._ride.c_r_low

    @property
    def sector_c_r_high(self) -> NDArray[np.float32]:
        """(m,) upper end, rad/m."""
        return self._ride.c_r_high

    @property
    def sector_ride_class(self) -> NDArray[np.uint8]:
        """(m,) class for the vehicle, 0 (flattest) to 3 (roughest), as in a survey's map; 255 where unknown."""
        return self._ride.class_id

    @property
    def _ride(self) -> SectorRide:
        return self.sectors.ride or SectorRide.unknown(len(self.sector_class))

    @property
    def sector_bounds(self) -> SectorBounds:
        """``near`` and ``far`` (distance from the sensor, m), ``right`` and ``left`` (azimuth, rad), (m,) each."""
        return sector_bounds(self.sectors.sectors)

    @property
    def sector_points(self) -> NDArray[np.int32]:
        """(m,) number of points in each sector."""
        return self.sectors.sectors.count

    @property
    def point_confidence(self) -> NDArray[np.float32]:
        """(n,) confidence of each point's sector; NaN if it is in none."""
        padded: NDArray[np.float32] = np.append(self.sector_confidence, np.float32(np.nan))
        return padded[self.point_sector]

    def __repr__(self) -> str:
        counts = {name: int((self.sector_class == value).sum()) for value, name in _NAMES.items()}
        shares = ", ".join(f"{name} {count}" for name, count in counts.items())
        return (
            f"<ScanResult: {len(self.points):,} points, {len(self.sector_class):,} sectors: {shares} ({self.method})>"
        )


ScanSource: TypeAlias = ArrayLike | str | os.PathLike[str]
"""Points (n, 3 or more columns: x, y, z first) in the sensor's frame, m, or the path of a file with them."""


class ClassifierSettings(TypedDict, total=False):
    """Settings of `ScanClassifier`: fields of ``ScanConfig``; paths may be strings, tables dicts."""

    method: ScanMethod | None
    model: str | os.PathLike[str] | None
    polar: PolarSettings | Mapping[str, Any] | None
    robot: Robot | Mapping[str, Any] | None
    vehicle: str | os.PathLike[str] | None
    calibration: str | os.PathLike[str] | None
    grid: GridSettings | Mapping[str, Any] | None


class ScanClassifier:
    """Classifies scan after scan with one network and one set of buffers, for the loop of a robot.

    The first scan takes longer, because the network and the compiled code are loaded. Threads may share one object:
    each has buffers of its own. A pickled object carries its settings, and reads the files that they name again.

    Parameters
    ----------
    method : {"learned", "filter"}, optional
        How sectors are classified; the default is the network if one is included for the grid.
    model : path, optional
        A scan network, instead of the included one.
    polar : dict, optional
        The polar grid, with the names and values of ``[polar]`` in a settings file.
    robot : dict, optional
        Which returns are on the robot itself, with the names and values of ``[robot]`` in a settings file.
    vehicle : str or path, optional
        Vehicle whose ride on the sectors is computed: the name of an included one, or a TOML file with its calibration
        beside it. Its belly and height say what an obstacle is.
    calibration : path, optional
        A calibration file, instead of ``vehicle``.
    grid : dict, optional
        Size of ``ScanResult.grid``, with the names and values of ``[grid]`` in a settings file.

    Raises
    ------
    UsageError
        Settings are invalid, or contradict each other; or there is no such vehicle.
    BadInputError
        The network, the stripe classes or the calibration of the vehicle cannot be read.

    Examples
    --------
    >>> import numpy as np
    >>> from bumpymap import ScanClassifier
    >>> angle, distance = np.meshgrid(np.linspace(0, 2 * np.pi, 800), np.arange(4, 30, 0.3))
    >>> points = np.stack([distance * np.cos(angle), distance * np.sin(angle), 0 * angle - 1.5], axis=-1)
    >>> classifier = ScanClassifier(method="filter")
    >>> result = classifier(points.reshape(-1, 3))
    >>> result.class_names[int(result.sector_class[0])]
    'smooth'
    >>> result.point_class.shape == (len(result.points),)
    True
    """

    def __init__(self, **settings: Unpack[ClassifierSettings]) -> None:
        own = settings_of_call(settings, ScanConfig, "ScanClassifier", ClassifierSettings.__annotations__)
        refuse_clashes(own, [VEHICLE_OR_CALIBRATION])
        config = ScanConfig(frames=(), out=Path(), **own)  # these two are not used
        self._given: dict[str, Any] = {**settings}
        self._robot, self._grid = config.robot, config.grid
        nearest = config.polar.zone_starts_m[0]
        self._blind = config.robot.box_m is None and nearest > 0.0 and config.robot.radius_m <= nearest
        self._method = choose_method(config)
        self._memory: GroundMemory | None = None

    def __call__(self, points: ScanSource, /, pose: ArrayLike | None = None) -> ScanResult:
        """Classify the ground of one scan.

        Parameters
        ----------
        points : array (n, 3 or more) or path
            x forward, y to the left, z up, in the sensor's frame, m; further columns are ignored. Returns at
            (0, 0, 0), those that are not finite and those on the robot get class 255. Or a file: PLY, PCD or
            KITTI-style ``.bin``.
        pose : array (4, 4), optional
            Transform from the sensor's frame to one that does not move with the robot (``odom``), m. Sectors then keep
            their directions, and ``grid`` holds what the frames with poses have seen so far, in that frame. They come
            in order of time, from one thread.

        Returns
        -------
        ScanResult
            Its arrays are not changed by the next scan.

        Raises
        ------
        UsageError
            The array does not have three columns of numbers, or the pose is no rotation and shift.
        BadInputError
            The file cannot be read.
        """
        placed = None if pose is None else _rigid(pose, "pose")
        result = self._classify(points, placed)
        if placed is None:
            return result
        self._memory = self._memory or GroundMemory(self._grid)
        return replace(result, _grid=self._memory.add([self._view(result, placed)], placed))

    def together(
        self, points: Sequence[ScanSource], /, sensors: Sequence[ArrayLike], pose: ArrayLike | None = None
    ) -> list[ScanResult]:
        """Classify what several sensors of a robot see at the same time, each in its own frame, and join their grids.

        Parameters
        ----------
        points : sequence of array (n, 3 or more) or path
            Of each sensor, as of a call.
        sensors : sequence of array (4, 4)
            Transform from the frame of each sensor to that of the robot, m; the robot's z axis points up.
        pose : array (4, 4), optional
            Transform from the robot's frame to one that does not move with it (``odom``), m: ``grid`` then remembers,
            as with a call.

        Returns
        -------
        list of ScanResult
            One for each sensor, in its frame. All have the same ``grid``, in the frame of the robot or that of the
            pose: an obstacle that one sensor sees counts, and ground that one of them sees is known.

        Raises
        ------
        UsageError
            There is not one transform for each sensor, or one is no rotation and shift; see also a call.
        BadInputError
            A file cannot be read.
        """
        if not len(points) or len(points) != len(sensors):
            raise UsageError(
                f"there are {len(points)} scans and {len(sensors)} sensors; give one transform for each scan"
            )
        base = np.eye(4) if pose is None else _rigid(pose, "pose")
        poses = [base @ _rigid(sensor, f"sensors[{number}]") for number, sensor in enumerate(sensors)]
        found = [self._classify(each, placed) for each, placed in zip(points, poses, strict=True)]
        views = [self._view(result, placed) for result, placed in zip(found, poses, strict=True)]
        memory = GroundMemory(self._grid)
        if pose is not None:
            self._memory = memory = self._memory or memory
        grid = memory.add(views, base)
        return [replace(result, _grid=grid) for result in found]

    def _classify(self, points: ScanSource, pose: NDArray[np.float64] | None) -> ScanResult:
        rows = None
        if isinstance(points, str | os.PathLike):
            scan = read_scan(Path(path_of_call("points", points)), self._robot)
            array = scan.points
        else:
            array = _columns(points)
            rows = self._scene(array)
            scan = Scan(array if rows is None else array.take(rows, axis=0))
        if pose is not None:
            scan = replace(scan, heading_rad=math.atan2(pose[1, 0], pose[0, 0]))
        classed = self._method.classify(scan)
        classes, sector = point_classes(scan, classed), classed.sectors.point_sector
        if rows is not None:
            found, classes = classes, np.full(len(array), NOT_TRAVERSABLE, np.uint8)
            classes[rows] = found
            held, sector = sector, np.full(len(array), -1, np.int32)
            sector[rows] = held
        return ScanResult(array, classes, sector, classed, scan.points, self._grid)

    def _view(self, result: ScanResult, pose: NDArray[np.float64]) -> FrameView:
        return FrameView.of(result._scene, result.sectors, self._grid, pose)  # noqa: SLF001 (of this module)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the settings; the network and the buffers are made anew."""
        return partial(type(self), **self._given), ()

    def _scene(self, points: NDArray[np.float32]) -> NDArray[np.intp] | None:
        """Return the rows of points of the scene; None if all may be classified."""
        if not self._blind:
            return np.flatnonzero(scene_points(points, self._robot))
        # Points nearer than the inner border of the grid are in no sector: only those that are not finite are left out.
        with np.errstate(over="ignore", invalid="ignore"):
            finite = np.isfinite(points[:, 0] + points[:, 1] + points[:, 2])
        return None if finite.all() else np.flatnonzero(finite)


def classify_scan(points: ScanSource, /, **settings: Unpack[ClassifierSettings]) -> ScanResult:
    """Classify the ground of one scan.

    Parameters
    ----------
    points : array (n, 3 or more) or path
        As for a call of `ScanClassifier`.
    **settings
        As for `ScanClassifier`, which is faster for several scans: ``method``, ``model``, ``polar``,
        ``robot``, ``vehicle``, ``calibration``, ``grid``.

    Returns
    -------
    ScanResult

    Raises
    ------
    BumpymapError
        Invalid settings or points, or a file that cannot be read.
    """
    return ScanClassifier(**settings)(points)


def _rigid(pose: ArrayLike, name: str) -> NDArray[np.float64]:
    """Return a pose as an array (4, 4). Raises UsageError if it is not made of a rotation and a shift."""
    with suppress(TypeError, ValueError):
        matrix = np.asarray(pose, np.float64)
        if matrix.shape == (4, 4) and np.isfinite(matrix).all() and (matrix[3] == (0.0, 0.0, 0.0, 1.0)).all():
            turn = matrix[:3, :3]
            if np.abs(turn @ turn.T - np.eye(3)).max() < _TURN_ERROR and np.linalg.det(turn) > 0.0:
                return matrix
    raise UsageError(f"{name} must be an array (4, 4): a rotation and a shift in metres, last row 0 0 0 1")


def _columns(points: ArrayLike) -> NDArray[np.float32]:
    """Return x, y and z of an array of points as contiguous float32; not copied if the array is so itself."""
    try:
        array = np.asarray(points)
        if array.ndim == 2 and array.shape[1] >= 3 and array.dtype.kind in "fiu":
            return np.ascontiguousarray(array[:, :3], np.float32)
        what = f"an array of shape {array.shape} and type {array.dtype}"
    except ValueError as error:  # rows of different lengths
        what = f"no array ({error})"
    raise UsageError(f"points are {what}; give an array (n, 3) of x, y and z in metres, or the path of a file")
