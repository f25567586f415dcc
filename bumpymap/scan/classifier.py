"""Classify the ground of scans in memory: a function for one scan, an object for the loop of a robot."""

import math
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
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
_TURN_ERROR = 1e-3
"""A rotation differs by less from one, in each element of its product with its transpose."""
_BENEATH_M = 2.0
"""Ground that is seen beneath a thing, at most so far behind its side, is not known to be free: it may be a car."""


def lay_grid(points: NDArray[np.float32], classed: ClassedSectors, settings: GridSettings) -> GroundGrid:
    """Lay a grid of square cells over the points (n, 3) of a classified scan, m; see `GroundGrid`."""
    return _lay_grid(points, classed, classed.sectors.normal, settings)[0]


def _lay_grid(
    points: NDArray[np.float32], classed: ClassedSectors, normal: NDArray[np.floating], settings: GridSettings
) -> tuple[GroundGrid, NDArray[np.float32]]:
    """Lay a grid whose axes are those of the points (n, 3) and of the ``normal`` of the sectors, around the sensor.

    Returns it, and z of the tops of obstacles, (side, side), m.
    """
    stack = classed.sectors
    half = math.ceil(settings.reach_m / settings.resolution_m - 1e-9)
    side, cells = 2 * half, 4 * half * half
    kinds = np.append(np.minimum(classed.class_id, CLASSES), np.uint8(CLASSES + 1))
    slope = np.zeros((len(kinds), 2))
    level = np.flatnonzero(stack.traversable)
    slope[level] = -normal[level, :2] / normal[level, 2:]
    unknown = np.full((5, cells), np.nan, np.float32)
    out = SquareCells(np.empty(cells, np.int8), np.full(cells, -1, np.int32), *unknown)
    lay_cells(
        ClassedPoints(
            np.ascontiguousarray(points, np.float32),
            stack.point_ground,
            stack.point_airborne,
            stack.point_height,
            stack.point_sector,
            _OCCUPANCY[kinds],
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

    def by_cell(values: NDArray[Any]) -> NDArray[Any]:
        return values[out.sector].reshape(side, side)

    c_r = None if classed.ride is None else by_cell(np.append(classed.ride.c_r, np.float32(np.nan)))
    class_id = by_cell(np.append(classed.class_id, np.uint8(NOT_TRAVERSABLE)))
    elevation, step, top, tip, clearance = unknown.reshape(5, side, side)
    occupancy = out.occupancy.reshape(side, side)
    return GroundGrid(settings.resolution_m, occupancy, class_id, elevation, step, top, clearance, c_r), tip


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


_NEW, _GONE, _MOST = 2, 1, 6
"""Evidence for a thing in a cell: added by a frame in which it stands there, taken away by one that sees through it or
its bare ground, and the most that is kept. So what goes is forgotten after six frames."""
_KEPT, _LEAD = 0.9, 1.25
"""Share of the votes for the ground of a cell that stays when it is seen again: those of ten frames count. Another
class than the last one needs so many times its votes."""
_FORGOTTEN = 100
"""A cell that was not seen in so many frames is unknown again."""
_ELEVATION, _TOP, _TIP = 0, 2, 4


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

    def add(self, points: NDArray[np.float32], classed: ClassedSectors, pose: NDArray[np.float64]) -> GroundGrid:
        """Add a classified frame; return what is known of the ground around it.

        ``points`` (n, 3): in the sensor's frame, m; ``pose`` (4, 4): from there to the odometry frame, m.
        """
        turn, place = pose[:3, :3].astype(np.float32), pose[:3, 3]
        middle = np.round(place[:2] / self._cell).astype(np.int64)
        self._roll(middle - len(self._stands[0]) // 2)
        shift = (*(place[:2] - self._cell * middle).astype(np.float32), np.float32(0.0))
        x, y, z = np.ascontiguousarray(points.T)
        local = np.empty_like(points)  # without a product of matrices, whose library would start threads
        for axis in range(3):
            local[:, axis] = turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z + shift[axis]
        seen, tip = _lay_grid(local, classed, classed.sectors.normal @ turn.T, self._settings)
        self._clear(points, seen, pose, classed.sectors.settings)
        there, new = seen.occupancy >= 0, np.isfinite(tip)
        stands, unseen, up = self._stands[0], self._unseen[0], np.float32(place[2])
        np.minimum(stands + np.int8(_NEW), np.int8(_MOST), out=stands, where=new)
        voters = there & ~new
        self._votes *= np.where(voters, np.float32(_KEPT), np.float32(1.0))
        for number, value in enumerate(_OCCUPANCY[: CLASSES + 1]):
            self._votes[number] += voters & (seen.occupancy == value)
        unseen += 1
        unseen[there] = 0
        old = unseen > _FORGOTTEN
        stands[old] = 0
        self._votes[:, old] = 0.0
        layers = [seen.elevation + up, seen.step, seen.obstacle_height, seen.clearance, tip + up]
        for kept, layer in zip(self._layers, layers if seen.c_r is None else [*layers, seen.c_r], strict=False):
            np.copyto(kept, layer, where=np.isfinite(layer))
        return self._grid(has_ride=seen.c_r is not None)

    def _roll(self, corner: NDArray[np.int64]) -> None:
        """Move the cells so that they begin at a corner, in cells; what comes in is unknown."""
        (columns, rows), side = (corner - self._corner).tolist(), len(self._stands[0])
        self._corner = corner
        if not (columns or rows):
            return
        rows, columns = max(min(rows, side), -side), max(min(columns, side), -side)
        here = np.s_[:, max(rows, 0) : side + min(rows, 0), max(columns, 0) : side + min(columns, 0)]
        there = np.s_[:, max(-rows, 0) : side - max(rows, 0), max(-columns, 0) : side - max(columns, 0)]
        for values, empty in (
            (self._votes, 0.0), (self._class, 0), (self._stands, 0), (self._unseen, 0), (self._layers, np.nan)
        ):  # fmt: skip
            kept = values[here].copy()
            values[:] = empty
            values[there] = kept

    def _clear(
        self, points: NDArray[np.float32], seen: GroundGrid, pose: NDArray[np.float64], body: PolarSettings
    ) -> None:
        """Take evidence from what a frame sees through, and forget ground that it cannot see for what hides it."""
        stands = self._stands[0] > 0
        hidden = self._votes.any(axis=0) & (seen.occupancy < 0)
        asked = np.flatnonzero(stands | hidden)
        row, column = np.divmod(asked, len(stands))
        over = self._layers[_ELEVATION] + np.float32(0.5 * (body.belly_m + body.height_m))
        high = np.where(stands, self._layers[_TIP], over).ravel()[asked]
        high = np.nan_to_num(high - pose[2, 3])
        here = pose.copy()
        here[:3, 3] = *(pose[:2, 3] - self._cell * self._corner), 0.0
        places = np.column_stack([(column + 0.5) * self._cell, (row + 0.5) * self._cell, high])
        found = judge_by_view(np.round(1000.0 * places).astype(np.int32), here, nearest_ranges(points)) > 0
        through, covered = np.zeros((2, *stands.shape), np.bool_)
        through.ravel()[asked], covered.ravel()[asked] = found[:2]
        covered |= np.isnan(over)  # between returns: how high it is was never seen
        bare = np.isfinite(seen.elevation) & (seen.occupancy >= 0) & (seen.occupancy < _OCCUPANCY[CLASSES])
        self._stands[0] -= stands & (through | bare)
        self._layers[_TOP][self._stands[0] == 0] = np.nan
        self._votes[:, hidden & ~stands & covered] = 0.0

    def _grid(self, *, has_ride: bool) -> GroundGrid:
        """Return what is known."""
        ground, stands, best = self._votes[:CLASSES], self._stands[0] > 0, self._class[0]
        most = np.take_along_axis(ground, best[None], axis=0)[0]
        for class_id, votes in enumerate(ground):
            more = votes > _LEAD * most
            best[more], most = class_id, np.where(more, votes, most)
        total = self._votes.sum(axis=0)
        kind = np.where(2.0 * self._votes[CLASSES] >= total, np.uint8(CLASSES), best)
        kind[total == 0.0] = CLASSES + 1
        kind[stands] = CLASSES
        elevation, step, top, clearance, _, c_r = np.where(kind <= CLASSES, self._layers, np.float32(np.nan))
        return GroundGrid(
            self._cell,
            _OCCUPANCY[kind],
            np.where(most > 0.0, best, np.uint8(NOT_TRAVERSABLE)),
            elevation,
            step,
            top,
            clearance,
            c_r if has_ride else None,
            (float(self._cell * self._corner[0]), float(self._cell * self._corner[1])),
        )


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
        placed = None if pose is None else _rigid(pose)
        rows = None
        if isinstance(points, str | os.PathLike):
            scan = read_scan(Path(path_of_call("points", points)), self._robot)
            array = scan.points
        else:
            array = _columns(points)
            rows = self._scene(array)
            scan = Scan(array if rows is None else array.take(rows, axis=0))
        if placed is not None:
            scan = replace(scan, heading_rad=math.atan2(placed[1, 0], placed[0, 0]))
        classed = self._method.classify(scan)
        classes, sector = point_classes(scan, classed), classed.sectors.point_sector
        grid: GridSettings | GroundGrid = self._grid
        if placed is not None:
            self._memory = self._memory or GroundMemory(self._grid)
            grid = self._memory.add(scan.points, classed, placed)
        if rows is not None:
            found, classes = classes, np.full(len(array), NOT_TRAVERSABLE, np.uint8)
            classes[rows] = found
            held, sector = sector, np.full(len(array), -1, np.int32)
            sector[rows] = held
        return ScanResult(array, classes, sector, classed, scan.points, grid)

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


def _rigid(pose: ArrayLike) -> NDArray[np.float64]:
    """Return a pose as an array (4, 4). Raises UsageError if it is not made of a rotation and a shift."""
    with suppress(TypeError, ValueError):
        matrix = np.asarray(pose, np.float64)
        if matrix.shape == (4, 4) and np.isfinite(matrix).all() and (matrix[3] == (0.0, 0.0, 0.0, 1.0)).all():
            turn = matrix[:3, :3]
            if np.abs(turn @ turn.T - np.eye(3)).max() < _TURN_ERROR and np.linalg.det(turn) > 0.0:
                return matrix
    raise UsageError(
        "pose must be an array (4, 4): a rotation and a shift in metres, from the sensor's frame to that of the "
        "odometry, last row 0 0 0 1"
    )


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
