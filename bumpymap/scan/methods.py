"""Methods that classify sectors, and the ride of a vehicle on them.

*Ride.* The ground points of a scan are cut into tiles around the sensor, and rated by the same steps as those of a
survey. A tile is unknown if its heightmap cannot be rated by the rules of a survey. Thinner tiles of a survey are rated
from their points alone, but those lie at random; in a scan they lie along a few lines, and what is rough between the
lines is not seen: there, the ride would be rated smoother than it is, by a factor of up to 50. Also in the tiles that
are rated the lines miss some relief, so that the interval is wider than in a survey. The ride on a sector is the mean
over its area, as far as that is rated.
"""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import (
    FAIL_SHARE,
    NO_CLASS,
    ClassedSectors,
    FeatureSettings,
    PatchStack,
    PolarCells,
    PolarSettings,
    Reason,
    Scan,
    ScanMethod,
    SectorRide,
    SectorStack,
    UsageError,
    cell_numbers,
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
        return _widened(own, coverage[1:-1, 1:-1])

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


def _widened(tiles: BlockRating, coverage: NDArray[np.floating]) -> BlockRating:
    """Widen the intervals of tiles by what scan lines miss."""
    above = np.interp(np.nan_to_num(coverage), (0.75, 0.9), _ABOVE)
    low, high = (np.log(end / tiles.c_r) for end in (tiles.c_r_low, tiles.c_r_high))
    return replace(
        tiles, c_r_low=tiles.c_r * np.exp(-np.hypot(low, _BELOW)), c_r_high=tiles.c_r * np.exp(np.hypot(high, above))
    )


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
