"""Points of tiles in, rated tiles out; and when all tiles are finished, each looked at together with its neighbours.

A step at the border of two tiles belongs to both, a vehicle is wider than a pixel, and few points say more beside those
of the neighbours: none of that is known while the points of one block are measured. So blocks are read once more, a
strip of them with the tiles around it, and again to sweep the vehicle between what is then known to stand in these
blocks and in those around them. What is added to a tile depends on the finished tiles alone, not on how they were
divided among files, strips, tasks or machines.
"""

import logging
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, TypeAlias, TypeVar

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bumpymap.core import (
    CANOPY,
    EMPTY,
    FREE,
    NO_CLASS,
    OBSTACLE,
    OVERHEAD,
    POINT_GROUND,
    POINT_OTHER,
    SEEN,
    SEEN_COLUMNS,
    SEEN_PER_M2,
    SIDES,
    STEP_EDGE,
    UNSEEN,
    ZONE,
    Barred,
    MapConfig,
    PatchStack,
    Progress,
    Reason,
    SilentProgress,
    VehicleBody,
    neighbour_columns,
    smallest_object,
    smallest_step,
    tiles_of,
)
from bumpymap.patches import (
    decks_as_ground,
    find_in_relief,
    find_objects,
    leave_out_standing,
    mark_ground,
    measure,
    measure_thin,
    settle_solids,
    take_off_standing,
)
from bumpymap.rating import (
    THIN_RING,
    BlockRating,
    Calibration,
    RideModel,
    TextureModel,
    TileSteps,
    ZoneFinder,
    apply_steps,
    at_speed,
    classify,
    close_split_tiles,
    closing_height,
    dense_share,
    edge_usable,
    find_calibration,
    find_passable,
    find_steps,
    free_areas,
    is_rateable,
    map_rule,
    rate,
    rate_as_paper,
    rate_beside_steps,
    rate_thin,
    settle_objects,
    shipped_calibrations,
    thin_columns,
)
from bumpymap.survey.engine import TileSink
from bumpytiles import BLOCK_TILES, BlockKey, Column, Pack, TilePoints, TileTable, TileWindow, run_blocks

_log = logging.getLogger(__name__)


# What is part of the package is read once by a process that maps many surveys.
_included, _shipped = lru_cache(4)(find_calibration), lru_cache(1)(TextureModel.shipped)


@dataclass(frozen=True, slots=True)
class RatingModels:
    """The texture network and the vehicle's calibration."""

    texture: TextureModel | None
    """None: the columns of the texture stay empty."""
    calibration: Calibration

    @classmethod
    def load(cls, config: MapConfig) -> "RatingModels":
        """Load both, and check that they were made for the tiles of the run.

        The ride model does not need the texture, so tiles for which there is no network are rated without. Raises
        BumpymapError: a file cannot be read, or is for tiles of another size.
        """
        is_included = config.calibration is None and str(config.vehicle) in shipped_calibrations()
        find = _included if is_included else find_calibration
        calibration = find(config.vehicle, config.calibration, config.tile_size)
        calibration.require_grid(config.tile_size, config.pixels)
        calibration = at_speed(calibration, config.speed)
        own = float(calibration.vehicle["speed_mps"])
        fastest = max(calibration.map_speed, map_rule(calibration).top_mps)
        if fastest > own * (1.0 + 1e-5):
            _log.warning("p_fail is that of drives at %g m/s: at %g m/s more of them may fail", own, fastest)
        texture = TextureModel.load(config.model) if config.model else _shipped()
        fits = (texture.tile_size, texture.pixels) == (config.tile_size, config.pixels)
        if not fits and config.model is None and config.by_ride:
            return cls(None, calibration)
        texture.require_grid(config.tile_size, config.pixels)
        return cls(texture, calibration)

    @property
    def texture_id(self) -> str | None:
        """The ``id`` of the texture network; None without one."""
        return None if self.texture is None else self.texture.id


@dataclass(frozen=True, slots=True)
class TileRating:
    """Rates the points of tiles; picklable, because other threads and machines run it."""

    config: MapConfig
    models: RatingModels
    ride: RideModel | None
    """None: rate by texture and relief."""
    most_seen: float = math.inf
    """Points per m2 of which more show nothing more."""

    @classmethod
    def of(cls, config: MapConfig, models: RatingModels, most_seen: float = math.inf) -> "TileRating":
        """Choose the steps that the settings ask for."""
        ride = RideModel(models.calibration) if config.by_ride else None
        return cls(config, models, ride, most_seen)

    def measure_all(self, points: TilePoints) -> PatchStack:
        """Measure tiles from all of their points."""
        return measure(points, self.config.features, ground_only=False)

    def __call__(
        self,
        points: TilePoints,
        ground_only: bool,
        patches: PatchStack | None = None,
        around: Mapping[str, NDArray[Any]] | None = None,
    ) -> dict[str, NDArray[Any]]:
        """Find the ground and standing objects, measure, classify and rate; return the columns of `tile_columns`.

        ``patches`` are the tiles measured, and ``around`` the heights of these and of those beside them, if all points
        count as ground, see `bumpymap.patches.find_in_relief`.
        """
        points, config = decks_as_ground(points), self.config
        if config.ground == "csf":
            ground = mark_ground(points, config.csf)
            of_file = np.where(points.flag == POINT_GROUND, POINT_OTHER, points.flag)
            points = replace(points, flag=np.where(ground, POINT_GROUND, of_file).astype(np.uint8))
        if patches is None:
            patches = measure(points, config.features, ground_only=ground_only)
        body, objects, bare, on_ground = self.models.calibration.body, None, patches, ground_only
        if ground_only:
            # The cloth takes low objects for ground.
            apart = take_off_standing(points, patches, body) if config.ground == "csf" else (points, patches)
            objects = find_objects(*apart, body)
        elif config.compat == "none":  # the paper knows none
            found = find_in_relief(points, patches, body, around)
            points, bare = leave_out_standing(points, patches, found, config.features)
            objects = found[0]
            on_ground = True
        probability = None if self.models.texture is None else classify(bare, self.models.texture)
        thin = None
        if self.ride is not None:
            rated = self.ride.rate(bare, probability)
            # How thin a tile is, and whether it has holes, depends on its survey, and not on standing objects.
            pairs, maps = measure_thin(points, patches, config.features, ground_only=on_ground)
            thin = thin_columns(pairs, maps, bare.count, self.ride.operator)
        else:
            rating = rate_as_paper if config.compat == "paper" else rate
            rated = rating(bare, np.asarray(probability), self.models.calibration)
        measured = replace(patches, relief=bare.relief, slope=bare.slope, reason=bare.reason)
        if objects is not None:
            states, size = objects.objects, points.grid.tile_size
            count = np.minimum(np.diff(points.starts), self.most_seen * size**2)
            held = (states != UNSEEN) & (states % SEEN != EMPTY)
            smallest = smallest_object(held, count, size, in_relief=not ground_only)
            rated = replace(rated, all_density=(count / size**2).astype(np.float32), smallest_object=smallest)
        return replace(rated, patches=measured, objects=objects, thin=thin).columns()


STRIP_BLOCKS = 4
"""Most blocks of a strip that is rated at once: chosen, the tiles around it are a fifth of those in it."""
STRIP_PIXELS = 1 << 21
"""Most pixels whose zones are looked for at once, unless a block has more: chosen, 8 MB of labels."""
_FILL: dict[str, Any] = {"f": np.nan, "u": 255, "i": 0}
"""Value of a missing tile, by the kind of a column."""


@dataclass(frozen=True, slots=True)
class NeighbourWindow:
    """The tiles of a strip of blocks and of the rings around it, as arrays over a window of n x m tiles."""

    table: TileTable
    area: TileWindow
    """The smallest window around the tiles of the strip."""
    rings: int
    """How many tiles lie around it on each side."""
    columns: Mapping[str, NDArray[Any]]
    """(n, m, ...) each, north row first; missing tiles are NaN, 255 in columns of bytes, 0 in other integers."""
    present: NDArray[np.bool_]
    """(n, m) whether there is a tile."""

    @classmethod
    def read(cls, table: TileTable, area: TileWindow, names: Sequence[str], rings: int) -> "NeighbourWindow":
        """Read some columns of the tiles of a window and of the rings around it."""
        window = area.grown(rings)
        part = table.read(names, window)
        cells = window.cells(part["col"], part["row"])
        columns: dict[str, NDArray[Any]] = {}
        for name in names:
            values = part.pop(name)
            shape = (window.rows, window.cols, *values.shape[1:])
            columns[name] = np.full(shape, _FILL[values.dtype.kind], values.dtype)
            columns[name][cells] = values
        present = np.zeros((window.rows, window.cols), np.bool_)
        present[cells] = True
        return cls(table, area, rings, columns, present)

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def mosaic(self, name: str) -> NDArray[Any]:
        """Return a column of (pixels, pixels) maps as one image, north up."""
        values = self.columns[name]
        rows, cols, lines, samples = values.shape
        return np.ascontiguousarray(values.swapaxes(1, 2)).reshape(rows * lines, cols * samples)

    def inner(self, name: str) -> NDArray[Any]:
        """Return a column of the tiles of the strip alone."""
        return self.columns[name][self.rings : -self.rings, self.rings : -self.rings]


Columns = dict[str, NDArray[Any]]
_Value = TypeVar("_Value", np.uint8, np.bool_)
_Rating: TypeAlias = "NeighbourRating | VehicleSweep"
"""Rates the tiles of a strip with their neighbours."""


def add_neighbours(
    table: TileTable, rating: "_Rating", folder: Path, threads: int, progress: Progress, kind: str = "neighbours"
) -> TileTable:  # fmt: skip
    """Rate all tiles with their neighbours; return the table with the new columns, whose packs are in ``folder``.

    The packs are named after ``kind``, which differs where one table is rated again. Raises OSError: the packs cannot
    be written.
    """
    progress.start("comparing neighbours", len(table.keys))
    sink = TileSink(folder, kind, rating.columns)
    strips = strips_of(table.keys, STRIP_BLOCKS)

    def rate(blocks: list[BlockKey]) -> tuple[list[BlockKey], Columns]:
        tiles = table.read_blocks(blocks, ("col", "row"))
        area = TileWindow.around(tiles["col"], tiles["row"])
        rated, cells = rating(NeighbourWindow.read(table, area, rating.needs, rating.rings)), area.cells(**tiles)
        return blocks, {column.name: rated[column.name][cells] for column in rating.columns} | tiles

    for blocks, columns in run_blocks(rate, strips, threads):
        add_blocks(sink, table, blocks, columns)
        progress.advance(len(blocks))
    sink.flush()
    return table.with_columns([Pack(path) for path in sink.new_packs()])


def strips_of(keys: Sequence[BlockKey], most: int) -> Iterator[list[BlockKey]]:
    """Yield runs of up to ``most`` blocks that adjoin in a row, from north to south, then from west to east."""
    strip: list[BlockKey] = []
    for row, col in sorted(keys, key=lambda key: (-key[0], key[1])):
        if strip and ((row, col - 1) != strip[-1] or len(strip) == most):
            yield strip
            strip = []
        strip.append((row, col))
    yield strip


def add_blocks(sink: TileSink, table: TileTable, blocks: Sequence[BlockKey], columns: Columns) -> None:
    """Add the columns of some blocks to packs; their tiles lie in the order of ``blocks``."""
    ends = np.cumsum([0, *map(table.count, blocks)]).tolist()
    for key, (start, stop) in zip(blocks, pairwise(ends), strict=True):
        sink.add(key, {name: array[start:stop] for name, array in columns.items()})


_RATED = ("class_id", "c_r", "c_r_low", "c_r_high", "p_fail", "confidence", "reason")
_OBJECTS = ("obstacle", "obstacle_height", "clearance")
_STEPS = ("edge_step", "inner_step", *(f"step_{side}" for side in SIDES))
_BESIDE_STEPS = ("c_r_open", "p_fail_open")
_BESIDE = ((-1, 0), (0, 1), (1, 0), (0, -1))
"""Rows and columns to the tile beyond each side; rows go south."""
_SIDES = Column("sides", "|u1")
"""Bits: the vehicle can cross the side in the north, east, south, west."""
_LEAST_COVERAGE = 0.25
"""With fewer points a step closes its tiles as a whole: where it ends is not known. 7 points/m2 of 0.2 m pixels."""
_MOST_PER_PIXEL = 2.0
"""Points on a pixel, on average, below which steps are looked for in all points of both sides: at random, 13 % of the
pixels have none then. A dense survey with holes has as many of them, and runs of pixels tell its steps."""
_LEAST_PIXELS = 10
"""With fewer pixels along the side of a tile, steps are not measured."""


@dataclass(frozen=True, slots=True)
class NeighbourRating:
    """Rates the tiles of a strip with their neighbours: thin tiles, steps and standing objects.

    What it returns in ``barred`` is what the ground of a tile bars; `VehicleSweep` adds obstacles.
    """

    config: MapConfig
    calibration: Calibration
    rings: ClassVar = 2
    """Tiles around a strip that it reads: steps at the border of a neighbour are those of that."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Columns of the finished tiles that it reads."""
        seen = ("density", "all_density", "smallest_object")
        return (*_RATED, "slope", "coverage", "heights", "objects", *_OBJECTS, *seen, "thin")

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns that it returns."""
        config = self.config
        columns = neighbour_columns(config.pixels)
        return (*(column for column in columns if column.name not in ("passable", "passage")), _SIDES)

    def _of_unknown(self, own: Mapping[str, NDArray[Any]]) -> Columns:
        """Return the columns of unknown tiles beside unknown ones."""
        tiles = own["class_id"].shape
        nothing = np.full(tiles, np.nan, np.float32)
        # What is not in the way there is unseen.
        states = own["objects"] % SEEN
        overhead = np.where(np.isin(states, OVERHEAD), np.uint8(CANOPY), np.uint8(UNSEEN))
        objects = np.where(states == OBSTACLE, np.uint8(OBSTACLE), overhead)
        return (
            {name: own[name] for name in (*_RATED, *_OBJECTS)}
            | dict.fromkeys((*_STEPS, *SEEN_COLUMNS, *_BESIDE_STEPS), nothing)
            | {"barred": np.full(tiles, Barred.UNKNOWN, np.uint8), _SIDES.name: np.zeros(tiles, np.uint8)}
            | {"objects": objects}
        )

    def __call__(self, window: NeighbourWindow) -> Columns:
        """Return `neighbour_columns` of the inner tiles."""
        known = self._known(window)
        alone = ~sliding_window_view(known[1:-1, 1:-1], (3, 3)).any(axis=(2, 3))
        if alone.all():
            return self._of_unknown({name: window.inner(name) for name in self.needs})
        own, grid = {name: window.inner(name) for name in (*_RATED, "slope", "coverage", *_OBJECTS)}, self.config.grid
        known &= self._seen(window)
        if self.config.by_ride:
            names = (*_RATED, "thin", "coverage", "slope")
            wide = NeighbourWindow.read(window.table, window.area, names, THIN_RING)
            measured = wide["thin"], _first(wide), wide["coverage"], wide["slope"]
            own |= asdict(rate_thin(*measured, self.calibration, THIN_RING))
        solids = settle_solids(window.mosaic("objects"), grid, self.config.features.max_hole)
        objects = settle_objects(solids, grid.pixels)
        objects[(objects == FREE) & ~self._pixels(known)] = UNSEEN
        few = window["density"] * self.config.grid.pixel_size**2 < _MOST_PER_PIXEL
        steps = self._steps(window, known & few)
        if self.config.compat == "none":
            # Few points make steps of rough ground: in thin tiles they bar the way, but do not change the ride.
            share = dense_share(own["coverage"]) if self.config.by_ride else 1.0
            own |= apply_steps(own, steps.unseen * share, self.calibration)
        states = self._inner(objects)
        share = np.mean(states == OBSTACLE, axis=(2, 3), dtype=np.float32)
        barred, nothing = self.calibration.cost_rule.barred(own), np.float32(np.nan)
        beside = {name: np.full(barred.shape, nothing) for name in _BESIDE_STEPS}
        if self.config.compat == "none" and (steps.closed.any() or steps.low.any()):
            barred, states, beside = self._decide_steps(window, steps, own | {"barred": barred}, states)
        obstacle = np.where(np.isnan(own["obstacle"]), np.float32(np.nan), share)
        height = own["obstacle_height"]
        found = (
            {name: own[name] for name in _RATED}
            | {f"step_{side}": steps.border[..., number] for number, side in enumerate(SIDES)}
            | {"edge_step": steps.edge_step, "inner_step": steps.inner}
            | self._seen_sizes(window, own["class_id"], steps)
            | {"barred": barred, _SIDES.name: sides_crossed(edge_usable(steps.border, self.calibration), steps, known)}
            | {"objects": states, "obstacle": obstacle}
            | beside
            # A roof is an obstacle of unknown height, and nothing that hangs over the way.
            | {"obstacle_height": np.where((height == 0.0) & (obstacle > 0.0), nothing, height)}
            | {"clearance": np.where((states == CANOPY).any(axis=(2, 3)), own["clearance"], nothing)}
        )
        if alone.any():
            tiles = {name: window.inner(name)[alone] for name in self.needs}
            for name, values in self._of_unknown(tiles).items():
                found[name][alone] = values
        return found

    def _seen_sizes(self, window: NeighbourWindow, class_id: NDArray[np.uint8], steps: TileSteps) -> Columns:
        """Return what the survey of the inner tiles would have shown."""
        step = smallest_step(steps.limit, window.inner("density"), closing_height(self.calibration))
        found = window.inner("all_density"), window.inner("smallest_object"), step
        columns, known = zip(SEEN_COLUMNS, found, strict=True), class_id != NO_CLASS
        return {name: np.where(known, values, np.float32(np.nan)) for name, values in columns}

    def _known(self, window: NeighbourWindow) -> NDArray[np.bool_]:
        """Return which tiles have a class, or will have one."""
        known: NDArray[np.bool_] = window["class_id"] != NO_CLASS
        return known | is_rateable(window["thin"], window["reason"]) if self.config.by_ride else known

    def _seen(self, window: NeighbourWindow) -> NDArray[np.bool_]:
        """Return which tiles show enough for a way: of few points the ride may be known, but not the obstacles."""
        states = window["objects"]
        held = np.sum((states != UNSEEN) & (states % SEEN != EMPTY), axis=(2, 3))
        return np.asarray((window["class_id"] != NO_CLASS) | (held >= SEEN_PER_M2 * self.config.tile_size**2))

    def _steps(self, window: NeighbourWindow, searched: NDArray[np.bool_]) -> TileSteps:
        if self.config.pixels >= _LEAST_PIXELS:
            # Where all points count as ground, obstacles are part of the relief.
            in_relief = window.present & np.isnan(window["obstacle"])
            standing = self._pixels(in_relief) & (window.mosaic("objects") == OBSTACLE)
            calibration = self.calibration
            wheel, closing = calibration.wheel_pixels, closing_height(calibration)
            found = find_steps(window.mosaic("heights"), self.config.pixels, wheel, closing, standing, searched)
            return found.inner_tiles(self.config.pixels)
        rows, cols = window.inner("class_id").shape
        border, one = (np.full(shape, np.nan, np.float32) for shape in ((rows, cols, len(SIDES)), (rows, cols)))
        closed = np.zeros(self._inner(window.mosaic("objects")).shape, np.bool_)
        return TileSteps(border, one, one, closed, closed, limit=one)

    def _decide_steps(
        self, window: NeighbourWindow, steps: TileSteps, own: Columns, states: NDArray[np.uint8]
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8], Columns]:
        """Bar the inner tiles that a step closes in part or wholly, at their sides too, and mark its pixels.

        What reads tiles alone would cross a wall on a border if it barred one of its tiles only. Beside the step, the
        ground is rated for itself; what is not fit to drive on is marked as well.
        """
        closed, low = steps.closed, steps.low
        touched = closed.any(axis=(2, 3))
        touched |= steps.edge_step >= closing_height(self.calibration)
        failing = np.isin(own["barred"], (Barred.FAILS, Barred.SLOPE)) & (own["coverage"] >= _LEAST_COVERAGE)
        touched |= failing & low.any(axis=(2, 3))
        touched &= own["barred"] != Barred.UNKNOWN
        edges = closed | touched[..., None, None]
        beside = {name: np.full(touched.shape, np.float32(np.nan)) for name in _BESIDE_STEPS}
        tiles = np.nonzero(touched & (own["coverage"] >= _LEAST_COVERAGE) & self.config.by_ride)
        if len(tiles[0]):
            line, standing = (closed | low)[tiles], np.isin(states[tiles], (OBSTACLE, UNSEEN))
            whole = own["c_r"][tiles], own["p_fail"][tiles]
            heights, thin = (window.inner(name)[tiles] for name in ("heights", "thin"))
            closed, c_r, p_fail = rate_beside_steps(heights, line, standing, whole, thin, self.calibration)
            beside["c_r_open"][tiles], beside["p_fail_open"][tiles] = c_r, p_fail
            edges[tiles] = line | closed
        barred = np.where(touched, np.uint8(Barred.STEP), own["barred"])
        return barred, np.where(edges & (states != OBSTACLE), np.uint8(STEP_EDGE), states), beside

    def _pixels(self, of_tiles: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Give every pixel of a mosaic the value of its tile."""
        return np.repeat(np.repeat(of_tiles, self.config.pixels, axis=0), self.config.pixels, axis=1)

    def _inner(self, mosaic: NDArray[_Value]) -> NDArray[_Value]:
        """Cut the inner tiles out of a mosaic, (n, m, pixels, pixels)."""
        return tiles_of(mosaic, self.config.pixels)[self.rings : -self.rings, self.rings : -self.rings]


@dataclass(frozen=True, slots=True)
class VehicleSweep:
    """Finds where the vehicle fits in the tiles of a strip, and which of them it can pass.

    Obstacles are those that `NeighbourRating` found for each tile beside the neighbours of its own strip: what a strip
    knows of those in the ring around it, from fewer neighbours, may differ. The ways through the tiles of the inner
    ring are needed to tell where an obstacle splits tiles, and depend on the obstacles in the outer one.
    """

    config: MapConfig
    calibration: Calibration
    rings: ClassVar = 2
    """Tiles around a strip that it reads."""
    needs: ClassVar = ("barred", "objects", _SIDES.name)
    """Columns that it reads."""

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns that it returns."""
        names = ("barred", "passable", "passage")
        return tuple(column for column in neighbour_columns(self.config.pixels) if column.name in names)

    def __call__(self, window: NeighbourWindow) -> Columns:
        """Return the columns of the inner tiles."""
        body, size = self.calibration.body, self.config.tile_size
        objects = window.mosaic("objects")
        alone = np.where(window.present, window["barred"], np.uint8(Barred.UNKNOWN))
        barred = alone[1:-1, 1:-1]
        if self.config.compat == "none":
            sides = np.where(window.present, window[_SIDES.name], 0)[1:-1, 1:-1, None]
            crossed = np.unpackbits(sides, axis=-1, count=len(SIDES), bitorder="little").astype(np.bool_)
            barred = find_passable(objects, barred, crossed, body, size)
        areas = free_areas(objects, alone, barred, body, size)
        closed = close_split_tiles(areas, barred, body, size) if self.config.compat == "none" else barred[1:-1, 1:-1]
        passable = (closed == Barred.NO).astype(np.uint8)
        return {"barred": closed, "passable": passable, "passage": areas[1:-1, 1:-1]}


def finish_tiles(
    table: TileTable, rating: NeighbourRating, folder: Path, threads: int, progress: Progress
) -> TileTable:  # fmt: skip
    """Rate all tiles with their neighbours, sweep the vehicle over them, number the zones; packs are in ``folder``.

    Raises OSError: the packs cannot be written.
    """
    rated = add_neighbours(table, rating, folder, threads, progress)
    sweep = VehicleSweep(rating.config, rating.calibration)
    swept = add_neighbours(rated, sweep, folder, threads, SilentProgress(), "swept")
    return add_zones(swept, rating.calibration.body, folder)


def add_zones(table: TileTable, body: VehicleBody, folder: Path) -> TileTable:
    """Return the table with the column `ZONE`, whose packs are in ``folder``.

    Raises OSError: the packs cannot be written.
    """
    most = max(1, STRIP_PIXELS // (BLOCK_TILES * table.grid.pixels) ** 2)
    finder, labels = ZoneFinder(table.grid, body), list[NDArray[np.int32]]()
    strips = list(strips_of(table.keys, most))
    for blocks in strips:
        found = table.read_blocks(blocks, ("col", "row", "passage", "barred"))
        labels.append(finder.add(blocks[0], found["col"], found["row"], found["passage"], found["barred"] == Barred.NO))
    sink, numbers = TileSink(folder, ZONE.name, (ZONE,)), finder.numbers()
    for blocks, own in zip(strips, labels, strict=True):
        add_blocks(sink, table, blocks, {"col": own, ZONE.name: numbers[own]})
    sink.flush()
    return table.with_columns([Pack(path) for path in sink.new_packs()])


def _first(window: NeighbourWindow) -> BlockRating:
    """Return what the first pass found."""
    columns = {name: window[name] for name in _RATED}
    missing = np.where(window.present, columns.pop("reason"), np.uint8(Reason.NO_POINTS))
    return BlockRating(**columns, reason=missing)


def sides_crossed(usable: NDArray[np.bool_], steps: TileSteps, known: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return which sides of the inner tiles the vehicle can cross, (n, m), as bits of `SIDES`.

    Where nobody saw a step, such as in a thin survey, none is assumed between known tiles: the rating of both tiles
    holds what their points tell. A side without a known tile beyond it leads nowhere, but does not bar a tile of which
    no neighbour is known. ``usable`` (n, m, 4) are the sides whose step is none for the vehicle, ``known`` (n + 4,
    m + 4).
    """
    known = known[1:-1, 1:-1]
    rows, cols = (side - 2 for side in known.shape)
    beside = [known[1 + down : 1 + down + rows, 1 + right : 1 + right + cols] for down, right in _BESIDE]
    beyond = np.stack(beside, axis=-1)
    alone = ~beyond.any(axis=-1, keepdims=True)
    crossed = (beyond & (usable | np.isnan(steps.border))) | alone
    return np.packbits(crossed, axis=-1, bitorder="little")[..., 0]
