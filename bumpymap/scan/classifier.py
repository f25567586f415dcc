"""Classify the ground of scans: methods, the ride of a vehicle; for one scan in memory, and for the loop of a robot.

*Ride.* The ground points of a scan are cut into tiles around the sensor, and rated by the same steps as those of a
survey. A tile is unknown if its heightmap cannot be rated by the rules of a survey. Thinner tiles of a survey are rated
from their points alone, but those lie at random; in a scan they lie along a few lines, and what is rough between the
lines is not seen: there, the ride would be rated smoother than it is, by a factor of up to 50. Also in the tiles that
are rated the lines miss some relief, so that the interval is wider than in a survey. The ride on a sector is the mean
over its area, as far as that is rated.
"""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeAlias, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bumpymap.core import (
    CLASS_NAMES,
    CLASSES,
    FAIL_SHARE,
    NO_CLASS,
    NOT_TRAVERSABLE,
    VEHICLE_OR_CALIBRATION,
    ClassedSectors,
    FeatureSettings,
    GridSettings,
    GroundGrid,
    PatchStack,
    PolarCells,
    PolarSettings,
    Reason,
    Robot,
    Scan,
    ScanMethod,
    SectorBounds,
    SectorRide,
    SectorStack,
    UsageError,
    cell_numbers,
    path_of_call,
    refuse_clashes,
    sector_bounds,
    settings_of_call,
)
from bumpymap.patches import choose_tiles, measure, measure_thin
from bumpymap.rating import (
    BlockRating,
    Calibration,
    RideModel,
    apply_steps,
    dense_share,
    find_calibration,
    find_steps,
    rate_thin,
    thin_columns,
)
from bumpymap.readers import read_scan, scene_points
from bumpymap.scan.align import nearest_ranges
from bumpymap.scan.cells import FrameView, GroundMemory, see_cells
from bumpymap.scan.config import ScanConfig
from bumpymap.scan.learned import ScanModel, classify_learned
from bumpymap.scan.sectors import polar_sectors
from bumpymap.scan.stripes import classify_filter, load_stripes
from bumpytiles import Grid, TilePoints, group_points, join_tiles, sort_block

_REACH_M = 60.0
"""Distance from the sensor beyond which points are too few for any tile, m (chosen)."""
_LEAST_SHARE = 0.5
"""Least share of the area of a sector that is rated (chosen)."""
_CELLS = 6
"""Cells along the side of a tile whose centres stand for the area of sectors: 0.5 m of 3 m (chosen)."""
_BELOW, _ABOVE = 0.35, (0.45, 0.15)
"""Widening of the 80 % interval of ln C_r by scan lines: below; above in tiles of a coverage of 0.75 and less, and of
0.9 and more. Measured in made-up scans of ground whose dense survey was mapped."""
_LEAST_STEP_PIXELS = 10
"""Fewest pixels along the side of a tile in which steps are looked for (chosen)."""


class SectorRater:
    """Rates the ground of sectors for one vehicle.

    ``calibration``: of the vehicle. Raises BadInputError: its ride model is damaged.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._calibration = calibration
        self._ride = RideModel(calibration)
        self._grid = Grid(calibration.tile_size, calibration.pixels)
        self._side = math.ceil(_REACH_M / calibration.tile_size)  # tiles from the sensor to each side
        centre = (np.arange(2 * self._side * _CELLS) + 0.5) * calibration.tile_size / _CELLS
        centre -= self._side * calibration.tile_size
        y, x = np.meshgrid(centre[::-1], centre, indexing="ij")  # the lowest y is last, as in the tiles
        self._cells = np.hypot(x, y), np.arctan2(y, x) / (2.0 * math.pi)
        self._places: PolarCells | None = None

    def __call__(self, scan: Scan, stack: SectorStack) -> SectorRide:
        """Rate the ground of the sectors of a scan.

        ``stack``: its sectors; ``point_ground`` says which points are rated. The ride is unknown where a sector is not
        traversable, and where less than half of its area can be rated.
        """
        return self._by_sector(self._rate(_cut(scan.points[stack.point_ground], self._grid, self._side)), stack)

    def _rate(self, points: TilePoints) -> BlockRating:
        """Rate tiles; return all those of the square around the sensor, north row first."""
        settings, calibration = FeatureSettings(), self._calibration
        patches = measure(points, settings, ground_only=False)
        rated = self._ride.rate(patches)
        found = {f.name: getattr(rated, f.name) for f in fields(BlockRating) if f.name != "reason"}
        laid = {name: self._lay(values, patches, NO_CLASS) for name, values in found.items()}
        first = BlockRating(**laid, reason=self._lay(patches.reason, patches, Reason.NO_POINTS))
        coverage, slope = (self._lay(values, patches) for values in (patches.coverage, patches.slope))
        pairs, maps = measure_thin(points, patches, settings, ground_only=False)
        columns = thin_columns(pairs, maps, patches.count, self._ride.operator)
        columns[patches.reason != Reason.OK] = np.nan
        own = rate_thin(self._lay(columns, patches), first, coverage, slope, calibration)
        # A sector has no bar of its own for slopes: ground that is too steep fails there.
        too_steep = slope[1:-1, 1:-1] > float(calibration.vehicle["slope_limit_deg"])
        own = replace(own, p_fail=np.where(too_steep, np.float32(1.0), own.p_fail))
        if calibration.pixels >= _LEAST_STEP_PIXELS:
            own = self._with_steps(own, patches, dense_share(coverage)[1:-1, 1:-1], coverage[1:-1, 1:-1])
        # What scan lines miss widens the intervals.
        above = np.interp(np.nan_to_num(coverage[1:-1, 1:-1]), (0.75, 0.9), _ABOVE)
        low, high = (np.log(end / own.c_r) for end in (own.c_r_low, own.c_r_high))
        lowest, highest = own.c_r * np.exp(-np.hypot(low, _BELOW)), own.c_r * np.exp(np.hypot(high, above))
        return replace(own, c_r_low=lowest, c_r_high=highest)

    def _lay(self, values: NDArray[Any], patches: PatchStack, gap: int = 0) -> NDArray[Any]:
        """Lay values of tiles out in the square and a ring around it, north row first; NaN or ``gap`` elsewhere."""
        side = 2 * self._side + 2
        fill = np.nan if values.dtype.kind == "f" else gap
        square = np.full((side, side, *values.shape[1:]), fill, values.dtype)
        square[self._side - patches.row, self._side + 1 + patches.col] = values
        return square

    def _with_steps(
        self, own: BlockRating, patches: PatchStack, share: NDArray[Any], coverage: NDArray[Any]
    ) -> BlockRating:
        """Rate dense tiles with steps at their borders as tiles with the same step in their middle."""
        rows, cols = np.nonzero(share > 0.0)
        if not len(rows):
            return own
        inner = np.s_[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
        ring = np.s_[rows.min() : rows.max() + 3, cols.min() : cols.max() + 3]
        heights = self._lay(patches.heights, patches)[ring]
        pixels = self._calibration.pixels
        joined = heights.swapaxes(1, 2).reshape(len(heights) * pixels, -1)
        step = find_steps(joined, pixels, self._calibration.wheel_pixels).unseen * share[inner]
        columns = asdict(own)
        near = {name: values[inner] for name, values in columns.items()} | {"coverage": coverage[inner]}
        for name, values in apply_steps(near, step, self._calibration).items():
            columns[name][inner] = values
        return BlockRating(**columns)

    def _by_sector(self, tiles: BlockRating, stack: SectorStack) -> SectorRide:
        """Take the mean of tiles over the area of each sector."""
        places = self._places
        if places is None or places.settings != stack.settings:
            places = self._places = PolarCells.of(stack.settings, *self._cells)
        table = np.full(int(np.dot(stack.settings.sectors, stack.settings.rings)) + 1, -1)
        count = len(stack.zone)
        table[cell_numbers(stack)] = np.arange(count)
        sector = table[places.cells(stack.azimuth_start_rad)].ravel()
        inside = np.flatnonzero(sector >= 0)
        sector = sector[inside]
        line, column = np.divmod(inside, len(self._cells[0]))
        tile = line // _CELLS * (2 * self._side) + column // _CELLS
        known = (tiles.class_id.ravel() != NO_CLASS)[tile]
        sectors, tile = sector[known], tile[known]
        area = np.bincount(sectors, minlength=count)
        rated = stack.traversable & (area >= _LEAST_SHARE * np.bincount(sector, minlength=count)) & (area > 0)

        def mean(values: NDArray[np.float32]) -> NDArray[np.float32]:
            total = np.bincount(sectors, values.ravel()[tile], count)
            return np.where(rated, total / np.maximum(area, 1), np.nan).astype(np.float32)

        c_r, fails = mean(tiles.c_r), mean(tiles.p_fail)
        limits = np.array(self._calibration.map_limits)
        class_id = np.where(fails >= FAIL_SHARE, len(limits), np.searchsorted(limits, c_r, side="right"))
        class_id = np.where(rated, class_id, NO_CLASS).astype(np.uint8)
        low, high = mean(tiles.c_r_low), mean(tiles.c_r_high)
        return SectorRide(c_r, low, high, class_id, fails, limits.astype(np.float32))


def _cut(points: NDArray[np.float32], grid: Grid, side: int) -> TilePoints:
    """Cut points into the tiles of the square around the sensor; those with too few for a rating are left out."""
    x, y, z = points[np.abs(points[:, :2]).max(axis=1, initial=0.0) < side * grid.tile_size].T.astype(np.float64)
    blocks = group_points(grid, x, y, z, np.ones(len(x), np.bool_))
    parts = [sort_block(grid, key, [blocks.block(place, blocks.points)]) for place, key in enumerate(blocks.keys)]
    tiles = join_tiles(parts or [sort_block(grid, (0, 0), [])])
    return choose_tiles(tiles, np.diff(tiles.starts) >= FeatureSettings().min_coverage * grid.pixels**2)


@dataclass(frozen=True, slots=True)
class Method:
    """The method that classifies the sectors of a run."""

    name: ScanMethod
    basis: str
    """Description of the network or the stripe classes."""
    classify: Callable[[Scan], ClassedSectors]
    """Cuts a scan into sectors and classifies them; keeps buffers for the next scan, each thread its own."""
    calibration: Calibration | None = None
    """Of the vehicle whose ride on the sectors is computed; None: of none."""


def choose_method(config: ScanConfig) -> Method:
    """Choose the method according to the settings and load what it needs.

    The default is the learned method: a network trained on labels recognises mud or bushes that are as flat as grass,
    while stripes show only relief. For a grid that the included network was not trained on, the default is the filter.

    Raises UsageError: the network or the stripe classes are for another grid. There is no such vehicle, or the settings
    name another belly or height. Raises BadInputError: the network, the stripe classes or
    the calibration of the vehicle cannot be read.
    """
    polar, calibration, rater = config.polar, None, None
    if config.vehicle is not None or config.calibration is not None:
        calibration = find_calibration(config.vehicle or "", config.calibration)
        rater = SectorRater(calibration)
        own: dict[str, Any] = {"belly_m": calibration.body.lowest_obstacle_m, "height_m": calibration.body.height_m}
        for name, value in own.items():
            if getattr(polar, name) not in {value, getattr(PolarSettings(), name)}:
                raise UsageError(
                    f"{name} is {getattr(polar, name)} among the settings of the polar grid, and {value} for the "
                    f"vehicle: leave out {name}, or the vehicle"
                )
        polar = replace(polar, **own)
    network = ScanModel.load(config.model) if config.model is not None else None
    if network is None and config.method != "filter":
        network = ScanModel.shipped()
        if config.method is None and network.pixels != polar.pixels:
            network = None
    classify: Callable[[SectorStack], ClassedSectors]
    if network is not None:
        network.require_pixels(polar)
        basis, classify = f"scan network {network.id}", partial(classify_learned, model=network)
    else:
        stripes = load_stripes()
        stripes.require_pixels(polar)
        basis = f"stripe classes of bumpymap: {', '.join(f'{centre:.2f}' for centre in stripes.centres)}"
        classify = partial(classify_filter, model=stripes)

    def classed(scan: Scan) -> ClassedSectors:
        found = classify(polar_sectors(scan, polar))
        return found if rater is None else replace(found, ride=rater(scan, found.sectors))

    return Method("filter" if network is None else "learned", basis, classed, calibration)


_NAMES = {**dict(enumerate(CLASS_NAMES[:CLASSES])), NOT_TRAVERSABLE: "not traversable"}
_TURN_ERROR = 1e-3
"""A rotation differs by less from one, in each element of its product with its transpose."""


@dataclass(frozen=True, repr=False)
class ScanResult:
    """The classified ground of one scan: arrays with one row per point, and arrays with one row per sector."""

    points: NDArray[np.float32]
    """(n, 3) m. The given points (not copied if they are float32); of a file, those without returns on the robot."""
    point_class: NDArray[np.uint8]
    """(n,) of the ground about each point: 0 smooth, 1 fair, 2 rough; 255 where there is none."""
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
        if isinstance(self._grid, GroundGrid):
            return self._grid
        return see_cells(self._scene, self.sectors, self._grid).finish(self._grid.resolution_m)

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
        return self._classify(points, None) if pose is None else self.together([points], [np.eye(4)], pose)[0]

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
        classes, sector = classed.point_class, classed.sectors.point_sector
        if rows is not None:
            found, classes = classes, np.full(len(array), NOT_TRAVERSABLE, np.uint8)
            classes[rows] = found
            held, sector = sector, np.full(len(array), -1, np.int32)
            sector[rows] = held
        return ScanResult(array, classes, sector, classed, scan.points, self._grid)

    def _view(self, result: ScanResult, pose: NDArray[np.float64]) -> FrameView:
        scene = result._scene  # noqa: SLF001 (of this module)
        return FrameView(pose, see_cells(scene, result.sectors, self._grid, pose), nearest_ranges(scene))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the settings; the network and the buffers are made anew."""
        return partial(type(self), **self._given), ()

    def _scene(self, points: NDArray[np.float32]) -> NDArray[np.intp] | None:
        """Return the rows of points of the scene; None if all may be classified."""
        if not self._blind:
            return np.flatnonzero(scene_points(points, self._robot))
        # Points nearer than the inner border of the grid are in no sector: only those that are not finite are left out.
        finite = np.isfinite(points)
        return None if finite.all() else np.flatnonzero(finite.all(axis=1))


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
