"""The records that all packages share: frozen dataclasses of arrays, with their georeference.

All lengths and coordinates are in metres; ``Georeference`` converts back to the units of the survey. One row of a
record is one tile; all arrays of a record have the same length.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from bumpytiles import Column, Grid, TileTable

if TYPE_CHECKING:
    from pyproj import CRS

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]
Value = TypeVar("Value", bound=np.generic)

THIN_POINTS = 4
"""A thin tile with fewer points is unknown: three lie on a plane, whatever the ground."""

SPANNED_POINTS = 11
"""At least this number of points must span a thin tile: with fewer, a quarter of it without points is chance."""

SEEN_PER_M2 = 4 / 3
"""Pixels per m2 that hold a point, without which no way leads through a thin tile: objects there may be unseen."""

THIN_PARTS = 3
"""Parts along a side of a tile, of which each block of 2 x 2 must hold a point."""

THIN_SEEN = 5 / THIN_PARTS**2
"""Least share of these parts that hold a point."""

DENSE_COVERAGE = 0.75
"""Tiles with at least this share of pixels with points are rated from their heightmap alone (35 points per m2, if they
are spread at random)."""

HOLE_POINTS = 64
"""From this number of points on a tile has holes for a reason, if it has too many."""

HOLE_SHARE = 0.7
"""Its holes are chance where it has at least this share of the coverage that its points would have at random."""

Texture = Literal["flat", "low_noise", "noise_sin", "high_noise"]

TEXTURES: tuple[Texture, ...] = ("flat", "low_noise", "noise_sin", "high_noise")
"""The four terrain forms of the paper, in the order of the texture axis of every array."""

CLASS_NAMES = ("smooth", "fair", "rough", "very rough")
"""Names of classes 0 to 3."""

NORMAL_80 = 1.2815515655446004
"""Half width of the 80 % interval of a normal variable, in standard deviations."""

NO_CLASS = 255
"""Value of ``CostMap.class_id`` for unknown tiles."""
NO_TILE = 255
"""Value of ``TileField.barred`` where the map has no tile."""


class Reason(IntEnum):
    """Why a tile has no class."""

    OK = 0
    NO_POINTS = 1
    TOO_FEW_POINTS = 2
    TOO_MANY_HOLES = 3
    NO_GROUND = 4
    OUTLIER_RELIEF = 5


REASON_TEXT: dict[Reason, str] = {
    Reason.OK: "ok",
    Reason.NO_POINTS: "no points",
    Reason.TOO_FEW_POINTS: "too few points",
    Reason.TOO_MANY_HOLES: "too many holes",
    Reason.NO_GROUND: "no ground points",
    Reason.OUTLIER_RELIEF: "outlier-only relief",
}

FREE, OBSTACLE, CANOPY, UNDECIDED, UNSEEN = 0, 1, 2, 3, 255
"""States of a pixel in ``ObjectStack.objects``."""


class Barred(IntEnum):
    """Why a tile is not passable."""

    NO = 0
    UNKNOWN = 1
    OBSTACLE = 2
    SLOPE = 3
    FAILS = 4
    STEP = 5
    SPLIT = 6
    LITTLE_SEEN = 7


CROSSING_UNKNOWN = (Barred.UNKNOWN, Barred.LITTLE_SEEN)
"""Tiles of which it is not known whether the vehicle can cross them: without a class, or with too little seen."""
CLOSED_WHOLLY = (*CROSSING_UNKNOWN, Barred.SLOPE, Barred.FAILS)
"""Tiles that are barred as a whole, by their ground or because too little of it is known."""
CLOSED_IN_PART = (Barred.OBSTACLE, Barred.SPLIT, Barred.STEP)
"""Tiles that are decided on pixels: an obstacle, or a step, closes a part of them or all."""
OPEN_THROUGH = (Barred.NO, *CLOSED_IN_PART, *CROSSING_UNKNOWN)
"""Tiles of which a part may be open; those without a class have no cost."""

BARRED_TEXT: dict[Barred, str] = {
    Barred.NO: "passable",
    Barred.UNKNOWN: "unknown ground",
    Barred.OBSTACLE: "obstacle",
    Barred.SLOPE: "too steep",
    Barred.FAILS: "drives fail",
    Barred.STEP: "step",
    Barred.SPLIT: "split by an obstacle",
    Barred.LITTLE_SEEN: "too little seen",
}

CHANGE_KINDS = (
    "not changed",
    "ground changed, ride as before",
    "rougher",
    "smoother",
    "ground changed, ride unknown",
    "ground changed, ride not decided",
)
"""Changes of a tile between two surveys, by code in change.tif."""

SIDES = ("north", "east", "south", "west")
"""Sides of a tile, in the order of every array of sides."""


@dataclass(frozen=True, slots=True)
class Georeference:
    """The survey's CRS and its units in metres."""

    crs: "CRS | None"
    """The survey's CRS, a compound CRS if the survey states a vertical one; None if unknown (local coordinates)."""
    metres_per_unit: float = 1.0
    """Horizontal: metres = file units x this."""
    metres_per_unit_z: float = 1.0
    """Vertical: metres = file units x this."""
    assumed: bool = False
    """True if nothing states the horizontal unit, so that metres are assumed."""


POINT_OTHER, POINT_GROUND, POINT_BUILDING, POINT_PLANT, POINT_DECK, POINT_CLASSED = range(6)
"""Kinds of points, by their LAS class: what a reader hands over as the flag of each point."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """A chunk of points in metres, after withheld and noise points have been removed."""

    easting: NDArray[np.float64]
    """(n,) m."""
    northing: NDArray[np.float64]
    """(n,) m."""
    upward: NDArray[np.float64]
    """(n,) m."""
    kind: NDArray[np.uint8]
    """(n,) ``POINT_GROUND`` (classes 2 and 11), ``POINT_DECK`` (17), ``POINT_BUILDING`` (6), ``POINT_PLANT`` (3 to 5),
    ``POINT_OTHER`` (0 and 1, and all if the file has no classes), else ``POINT_CLASSED``.
    `MapConfig.ground_classes` may name other ground."""
    colour: NDArray[np.uint32] | None = None
    """(n,) red, green and blue as in `bumpytiles.ScaledPoints`; None: no point has one."""

    @property
    def is_ground(self) -> NDArray[np.bool_]:
        """(n,) which points are ground."""
        return np.asarray((self.kind == POINT_GROUND) | (self.kind == POINT_DECK))


@dataclass(frozen=True, slots=True)
class PatchStack:
    """Measured tiles, one row each; only tiles that hold points."""

    grid: Grid
    col: NDArray[np.int64]
    """(n,) tile column, floor(easting / tile_size)."""
    row: NDArray[np.int64]
    """(n,) tile row, floor(northing / tile_size); grows to the north."""
    count: NDArray[np.int64]
    """(n,) points that were measured."""
    z_min: NDArray[np.float64]
    """(n,) lowest point, m."""
    z_max: NDArray[np.float64]
    """(n,) highest point, m."""
    z_variance: NDArray[np.float64]
    """(n,) population variance of z over the tile's points, m^2."""
    ransac_residual: NDArray[np.float64]
    """(n,) mean perpendicular distance of all points to the RANSAC plane, m; NaN if they span no plane."""
    slope: NDArray[np.float64]
    """(n,) angle between the robust plane of the points and the horizontal, degrees; NaN if they span no plane."""
    z_range: NDArray[np.float64]
    """(n,) max - min of ``heights``, m."""
    density: NDArray[np.float64]
    """(n,) points per square metre."""
    coverage: NDArray[np.float64]
    """(n,) share of the pixels that hold a point, 0..1."""
    heights: NDArray[np.float32]
    """(n, pixels, pixels) mean z of each pixel, m, north row first, west column first; NaN in pixels without points."""
    spread_count: NDArray[np.int32]
    """(n, pixels, pixels) number of points in each pixel."""
    spread_variance: NDArray[np.float32]
    """(n, pixels, pixels) population variance, inside each pixel, of the height above the tile's robust plane (of z if
    there is no plane), m^2; NaN in pixels without points."""
    relief_map: NDArray[np.float32]
    """(n, pixels, pixels) heights minus their least-squares plane, with holes filled from neighbours, m; NaN if the
    tile cannot be rated."""
    relief: NDArray[np.float64]
    """(n,) max - min of ``relief_map``, m."""
    reason: NDArray[np.uint8]
    """(n,) a ``Reason``; 0 if the tile can be rated."""


STEP_EDGE = 8
"""State of a pixel of ground that the vehicle cannot cross: the line of a step, drop or ditch; settled states only."""
LONE, SOLID, EMPTY, STEEP, LOW_SOLID, MAYBE_SOLID, SEEN = 4, 5, 6, 7, 9, 10, 16
"""Further states before the neighbours of a tile are known, see `bumpymap.patches.settle_solids`: a single point of an
obstacle; canopy that lets no pulse through; no point; points far above one another, where all count as ground; as
``SOLID``, and nothing high above the vehicle; low canopy that has too few points to tell; and, added to a state, ground
in the same pixel."""
OVERHEAD = (CANOPY, SOLID, LOW_SOLID, MAYBE_SOLID)
"""Those of them that lie over the vehicle."""

OBJECT_NAMES = ("free", "obstacle", "canopy", "unknown", "step")
"""Names of these states in obstacle.tif, where ``UNSEEN`` is 3 and ``STEP_EDGE`` 4."""


@dataclass(frozen=True, slots=True)
class ObjectStack:
    """Objects that stand on the ground of tiles or hang over it, one row a tile."""

    objects: NDArray[np.uint8]
    """(n, pixels, pixels) state of each pixel, north row first: ``FREE``; ``OBSTACLE`` between the vehicle's belly and
    its height; ``CANOPY``: only higher than the vehicle; ``UNSEEN``: neither ground nor anything else is known;
    ``STEP_EDGE``: a step that the vehicle cannot cross.
    ``UNDECIDED``, at a tile's border only: points of an obstacle, too few without those of the neighbouring tile."""
    obstacle: NDArray[np.float32]
    """(n,) share of the pixels with an obstacle, 0..1; NaN in unknown tiles without one (so is ``canopy``)."""
    obstacle_height: NDArray[np.float32]
    """(n,) highest point of the obstacles, up to the vehicle's height, above the ground beneath, m; 0 without an
    obstacle; NaN in unknown tiles, and where an obstacle stands over unknown ground."""
    clearance: NDArray[np.float32]
    """(n,) height of the lowest object overhead above the ground beneath, m; NaN where there is none."""
    canopy: NDArray[np.float32]
    """(n,) share of the pixels under something higher than the vehicle, obstacle or not, 0..1."""

    @classmethod
    def empty(cls, tiles: int, pixels: int) -> "ObjectStack":
        """Return n tiles where objects are part of the relief: no pixel is known to hold one."""
        unknown = np.full(tiles, np.nan, np.float32)
        return cls(np.full((tiles, pixels, pixels), FREE, np.uint8), *[unknown] * 4)

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name, as a run stores them."""
        return {name: getattr(self, name) for name in self.__slots__}


FAIL_SHARE = 0.5
"""If at least this share of the simulated drives fails, the ground is not passable and gets the roughest class."""


def interval_log_sd(
    c_r: NDArray[np.floating], low: NDArray[np.floating], high: NDArray[np.floating], drive_log_sd: float = 0.0
) -> NDArray[np.float64]:
    """Return the standard deviations of ln C_r below and above it, (2, ...), by its 80 % interval (...), rad/m.

    ``drive_log_sd``: of `CostRule`, is taken off: what remains is of the mean of many drives. NaN where one is unknown.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        low, middle, high = (np.log(np.asarray(values, np.float64)) for values in (low, c_r, high))
        sides = np.stack((middle - low, high - middle)) / NORMAL_80
        sides = np.where(np.isfinite(sides), sides, np.nan)
    return np.asarray(np.sqrt(np.maximum(np.maximum(sides, 0.0) ** 2 - drive_log_sd**2, 0.0)))


@dataclass(frozen=True, slots=True)
class CostRule:
    """How ride cost and failure risk become a planner's cost: passable tiles, and the factor on distance.

    ``cost = 1 + ride_weight * c_r + fail_weight * hazard``. Its integral along a path is the path's length, plus the
    detours that the shaking and the risk are worth. ``exp(-integral of the hazard)`` is the probability of arriving.
    """

    ride_weight: float
    """m/rad: the detour that one radian of pitch motion is worth."""
    fail_weight: float
    """m: the detour that one certain failure is worth."""
    drive_m: float
    """Path length of a calibration drive, m: ``p_fail`` is the share of such drives that fail."""
    slope_limit_deg: float
    """Steeper ground is not passable for this vehicle."""
    speeds: tuple[tuple[float, float], ...] = ()
    """Speed made good: C_r of the map [rad/m], rising, and the highest speed [m/s] within the comfort limits there. The
    first is the top speed, and that of smoother ground too; none: not known."""
    drive_log_sd: float = 0.0
    """Standard deviation of ln C_r of one drive of ``drive_m`` about the mean of many, which the map's intervals hold.
    0: they are of that mean, as those of ``rating="table"`` and of maps of earlier versions."""

    @property
    def top_mps(self) -> float:
        """The top speed, m/s; NaN if it is not known."""
        return self.speeds[0][1] if self.speeds else math.nan

    def slowness(self, c_r: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the time of a metre of ground with a C_r [rad/m] at the speed made good, s/m; NaN if unknown.

        It is linear in C_r between ``speeds``, and in proportion to it beyond the last.
        """
        if not self.speeds:
            return np.full(np.shape(c_r), math.nan)
        known, speed = np.array(self.speeds).T
        return np.asarray(np.interp(c_r, known, 1.0 / speed) * np.maximum(c_r / known[-1], 1.0))

    def hazard(self, p_fail: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return failures per metre, ``-ln(1 - p_fail) / drive_m``, 1/m: infinite if all fail, NaN if unknown."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-p_fail.astype(np.float64)) / self.drive_m)

    def barred(self, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.uint8]:
        """Return why tiles are not passable as far as each tile alone tells: unknown, too steep, or drives fail.

        At least ``FAIL_SHARE`` of the drives must fail. If the rating has no ``p_fail`` (NaN: with ``compat``), the
        roughest class is not passable. ``columns``: ``class_id``, ``c_r``, ``p_fail`` and ``slope``, arrays of one
        shape, as in `tile_columns`. Returns a `Barred`.
        """
        class_id, c_r, p_fail, slope = (columns[name] for name in ("class_id", "c_r", "p_fail", "slope"))
        fails = np.where(np.isnan(p_fail), class_id == len(CLASS_NAMES) - 1, p_fail >= FAIL_SHARE)
        unknown = (class_id == NO_CLASS) | ~np.isfinite(c_r)
        barred = [unknown, ~(slope <= self.slope_limit_deg), fails]
        return np.select(barred, [Barred.UNKNOWN, Barred.SLOPE, Barred.FAILS], Barred.NO).astype(np.uint8)

    def cost(self, c_r: NDArray[np.floating], hazard: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the factor on distance; an unknown hazard (NaN) counts as 0."""
        known = np.where(np.isnan(hazard) | (self.fail_weight == 0.0), 0.0, hazard)
        return np.asarray(1.0 + self.ride_weight * c_r + self.fail_weight * known)

    def time_cost(self, c_r: NDArray[np.floating], hazard: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return the same by time: a metre counts as many as are driven at the top speed meanwhile."""
        slower = np.maximum(self.top_mps * self.slowness(c_r), 1.0)
        return slower - 1.0 + replace(self, ride_weight=0.0).cost(np.zeros(()), hazard)


@dataclass(frozen=True, slots=True)
class VehicleBody:
    """Outline of a vehicle: what it passes over, between and under, m."""

    clearance_m: float
    """Of the belly, above level ground."""
    height_m: float
    """Of the whole vehicle above ground; what is higher is overhead."""
    width_m: float
    """Full width."""
    brush_stem_m: float
    """Plants up to this height above ground are brushed aside."""

    @property
    def lowest_obstacle_m(self) -> float:
        """Height above ground from which an object is an obstacle, m: it reaches the belly and is not brushed aside."""
        return max(self.clearance_m, self.brush_stem_m)


_OBSTACLE_MARGIN_M = 0.1
"""Room between vehicle and obstacle, m: half a pixel of 0.2 m, for an obstacle fills its pixel only in part."""


def obstacle_reach(width_m: float) -> float:
    """Return the distance that the middle of a vehicle keeps from obstacles, m: half its width and a margin."""
    return 0.5 * width_m + _OBSTACLE_MARGIN_M


def within(marks: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Mark all pixels nearer than a radius [px] to marked ones, (rows, cols)."""
    reach = math.ceil(radius)
    rows, cols = marks.shape
    counts = np.cumsum(np.pad(marks, ((reach, reach), (reach + 1, reach))), axis=1, dtype=np.int32)
    near = np.zeros_like(marks)
    for down in range(-reach, reach + 1):
        half = sum(down * down + right * right < radius * radius for right in range(reach + 1)) - 1
        if half >= 0:
            line = counts[reach + down :][:rows]
            near |= line[:, reach + half + 1 :][:, :cols] > line[:, reach - half :][:, :cols]
    return near


def tiles_of(mosaic: NDArray[Value], pixels: int) -> NDArray[Value]:
    """Cut a mosaic of tiles, (n * pixels, m * pixels), into these: (n, m, pixels, pixels)."""
    rows, cols = (side // pixels for side in mosaic.shape)
    return mosaic.reshape(rows, pixels, cols, pixels).swapaxes(1, 2)


def corners_join(width_m: float, reach_m: float, pixel_m: float) -> bool:
    """Say whether a vehicle can go from one free pixel to another that it touches at a corner alone.

    The middle of a free pixel is at least ``reach_m`` from those of all closed ones, so over the corner the middle of
    the vehicle is at least sqrt(reach^2 - pixel^2 / 2) from them. That must be half its ``width_m``, and so much that
    the pixels beside the corner are not what closes the ground: they may be a diagonal line of it.
    """
    over = reach_m**2 - 0.5 * pixel_m**2
    return over >= (0.5 * width_m) ** 2 and reach_m**2 >= 2.0 * pixel_m**2


THIN_MEASURES = 44
"""Length of a row of ``CostMap.thin``."""


@dataclass(frozen=True, slots=True)
class CostMap:
    """Rated tiles: everything that is written to the layers."""

    patches: PatchStack
    class_id: NDArray[np.uint8]
    """(n,) class 0 (flattest) to 3 (roughest); ``NO_CLASS`` if unknown."""
    c_r: NDArray[np.float32]
    """(n,) ride cost, rad of pitch per metre; NaN if unknown (so are the next four)."""
    c_r_low: NDArray[np.float32]
    """(n,) lower end of the 80 % interval of c_r, rad/m."""
    c_r_high: NDArray[np.float32]
    """(n,) upper end, rad/m."""
    p_fail: NDArray[np.float32]
    """(n,) share of simulated drives over such ground that roll over or get stuck, 0..1."""
    confidence: NDArray[np.float32]
    """(n,) probability that the class is right, 0..1."""
    probability: NDArray[np.float32] | None = None
    """(n, 4) probability of each texture in the order of ``TEXTURES``, rows sum to 1; NaN for unknown tiles. None
    without a texture network."""
    objects: ObjectStack | None = None
    """Objects on the ground; None where that is part of the relief, because all points are measured as ground."""
    all_density: NDArray[np.float32] | None = None
    """(n,) points of any class per square metre; None if no objects are looked for, as the next."""
    smallest_object: NDArray[np.float32] | None = None
    """(n,) side of the narrowest standing object that would have shown with 95 %, m."""
    thin: NDArray[np.float32] | None = None
    """(n, 44) what the rating of thin tiles needs, see `bumpymap.rating.thin_columns`; None if they are not rated."""

    def band(self, name: str) -> NDArray[np.floating]:
        """Return the values of one of ``BANDS``, (n,)."""
        return np.asarray(getattr(self if hasattr(self, name) else self.patches, name))

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of `rated_columns`, one row for each tile."""
        objects = self.objects or ObjectStack.empty(len(self.class_id), self.patches.grid.pixels)
        own: dict[str, NDArray[Any]] = {"class_id": self.class_id, **objects.columns()}
        shapes = {"probability": (len(TEXTURES),), "thin": (THIN_MEASURES,), "all_density": (), "smallest_object": ()}
        for name, shape in shapes.items():
            values = getattr(self, name)
            own[name] = np.full((len(self.class_id), *shape), np.nan, np.float32) if values is None else values
        names = [column.name for column in rated_columns(self.patches.grid.pixels) if column.name not in own]
        return {name: self.band(name) for name in names} | own


@dataclass(frozen=True, slots=True)
class Orthophoto:
    """A photo from above, in a file."""

    path: Path
    shift: int
    """Bits that its numbers are shifted by to have 8."""


@dataclass(frozen=True, slots=True)
class CostTable:
    """All rated tiles of a run, read by window, from which the layers are written."""

    georeference: Georeference
    rule: CostRule
    """Rule by which tiles are passable, and their cost."""
    tiles: TileTable
    """Columns of `tile_columns`."""
    has_photo: bool = False
    """True if the tiles have the column of `photo_column`, and enough points have a colour."""
    orthophoto: Orthophoto | None = None
    """The photo instead of the colours of points."""


def photo_column(pixels: int) -> Column:
    """Return the column of the photo: red, green and blue of the highest coloured point in each pixel; 0: none."""
    return Column("photo", "|u1", (pixels, pixels, 3))


_RIDE = ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence")


def rated_columns(pixels: int) -> tuple[Column, ...]:
    """Return the columns of a tile rated by itself, named as in `PatchStack`, `CostMap` and `ObjectStack`."""
    floats = ("z_min", "z_max", "z_variance", "ransac_residual", "slope", "z_range", "density", "coverage", "relief")
    return (
        *(Column(name, "<i8") for name in ("col", "row", "count")),
        *(Column(name, "<f8") for name in floats),
        *(Column(name, "|u1") for name in ("reason", "class_id")),
        *(Column(name, "<f4") for name in _RIDE),
        Column("probability", "<f4", (len(TEXTURES),)),
        Column("heights", "<f4", (pixels, pixels)),
        *(Column(name, "<f4") for name in ("obstacle", "obstacle_height", "clearance", "canopy")),
        *(Column(name, "<f4") for name in ("all_density", "smallest_object")),
        Column("objects", "|u1", (pixels, pixels)),
        Column("thin", "<f4", (THIN_MEASURES,)),
    )


SEEN_COLUMNS = ("all_density", "smallest_object", "smallest_step")
"""Columns of what the survey of a tile would have shown, as `SeenSizes` has them."""


def neighbour_columns(pixels: int) -> tuple[Column, ...]:
    """Return the columns that depend on the neighbours of a tile; rating and objects are among them: they may change.

    ``edge_step`` [m] is the highest of the steps at the four sides, ``step_north`` to ``step_west`` [m]; NaN where
    nothing is known beyond the side. ``inner_step`` [m] is the highest at the pixels of the tile. ``c_r_open`` and
    ``p_fail_open`` are those of the ground beside the steps that close a part of it; else NaN. ``all_density``,
    ``smallest_object`` and ``smallest_step`` [m] say what would have shown; NaN in unknown tiles. ``barred`` is a
    `Barred`; ``passable`` is 1 or 0. ``passage`` numbers the areas of a tile in which the middle of the vehicle can
    move, from 1, the largest; 0 where it cannot be.
    """
    objects, steps = ("obstacle", "obstacle_height", "clearance"), tuple(f"step_{side}" for side in SIDES)
    singles = (*_RIDE, *objects, "edge_step", "inner_step", "c_r_open", "p_fail_open", *SEEN_COLUMNS, *steps)
    return (
        *(Column(name, "|u1") for name in ("reason", "class_id", "barred", "passable")),
        *(Column(name, "<f4") for name in singles),
        Column("objects", "|u1", (pixels, pixels)),
        Column("passage", "|u1", (pixels, pixels)),
    )


def tile_columns(pixels: int) -> tuple[Column, ...]:
    """Return all columns of a finished tile."""
    own = rated_columns(pixels)
    known = {column.name for column in own}
    return (*own, *(column for column in neighbour_columns(pixels) if column.name not in known), ZONE)


ZONE = Column("zone", "<i4")
"""Number of the piece of ground that a tile belongs to and that the vehicle cannot leave, from 1; 0: none."""
GROUND_SOURCE = Column("ground_source", "|u1")
"""Of the tiles of a survey of which a part is not classified: 1 if measured from all points, 0 from ground points."""


@dataclass(frozen=True, slots=True)
class Band:
    """A band of a raster; those of roughness.tif are columns of tiles.parquet too."""

    name: str
    unit: str = ""
    """As GDAL writes units; empty if there is none."""
    description: str = ""
    """Written as ``long_name``."""
    categories: tuple[str, ...] = ()
    """Names of the values 0, 1, 2, ...; only for the band of a uint8 raster that has one."""


BANDS: tuple[Band, ...] = (
    Band("c_r", "rad/m", "ride cost: pitch motion per metre driven"),
    Band("c_r_low", "rad/m", "lower end of the 80 % interval of c_r"),
    Band("c_r_high", "rad/m", "upper end of the 80 % interval of c_r"),
    Band("p_fail", "", "share of simulated drives that rolled over or got stuck"),
    Band("z_variance", "m2", "population variance of z over the tile's points"),
    Band("ransac_residual", "m", "mean perpendicular distance of all points to the RANSAC plane"),
    Band("z_range", "m", "max - min of the heightmap"),
    Band("slope", "deg", "angle between the robust plane of the points and the horizontal"),
    Band("density", "m-2", "points per square metre"),
    Band("coverage", "", "share of the pixels that hold a point"),
    Band("confidence", "", "probability that the class is right"),
    Band("passable", "", "1 if the vehicle can cross the tile, else 0"),
    Band("obstacle", "", "share of the pixels with an obstacle between the vehicle's belly and its height"),
    Band("obstacle_height", "m", "highest point of the obstacles above the ground, up to the vehicle's height"),
    Band("clearance", "m", "lowest object above the vehicle's height, above the ground"),
    Band("canopy", "", "share of the pixels under something higher than the vehicle"),
    Band("edge_step", "m", "highest step between the tile's ground and its neighbours'"),
    Band("inner_step", "m", "highest step inside the tile"),
    Band("c_r_open", "rad/m", "ride cost beside the steps that close a part of the tile"),
    Band("p_fail_open", "", "share of simulated drives that fail beside these steps"),
    Band("all_density", "m-2", "points of any class per square metre"),
    Band("smallest_object", "m", "side of the narrowest standing object that the survey would have shown with 95 %"),
    Band("smallest_step", "m", "lowest step of the ground that would have been found with 95 %; 10: none"),
    Band("zone", "", "number of the piece of ground that hangs together, 1 the largest; NaN: part of none"),
)
"""The bands of roughness.tif, in order."""
