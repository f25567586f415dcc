"""The vocabulary that the rooms share: frozen records that carry their place on Earth.

Everything inside is metres. ``Georeference`` knows how to go back to the survey's own units. One row of a record is
one tile; arrays of one record have the same length.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from bumpytiles import Column, Grid, TileTable

if TYPE_CHECKING:  # half of this module's time to import
    from pyproj import CRS

__all__ = [
    "BANDS",
    "CLASS_NAMES",
    "FAIL_SHARE",
    "NO_CLASS",
    "PASSABLE_COLUMNS",
    "REASON_TEXT",
    "TEXTURES",
    "Band",
    "CostMap",
    "CostRule",
    "CostTable",
    "Georeference",
    "PatchStack",
    "PointCloud",
    "Reason",
    "Texture",
    "TextureMap",
    "tile_columns",
]

Texture = Literal["flat", "low_noise", "noise_sin", "high_noise"]
TEXTURES: tuple[Texture, ...] = ("flat", "low_noise", "noise_sin", "high_noise")
"""The four terrain forms of the paper, in the order of every array that has a texture axis."""

CLASS_NAMES = ("smooth", "fair", "rough", "very rough")
"""Class 0 to 3 in words."""
NO_CLASS = 255
"""Value of ``CostMap.klass`` where a tile is unknown."""


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


@dataclass(frozen=True, slots=True)
class Georeference:
    """The survey's CRS and what one of its units is in metres."""

    crs: "CRS | None"
    """The survey's CRS, with the vertical one where it states that (a compound CRS); None where nothing is known (local
    coordinates)."""
    metres_per_unit: float = 1.0
    """Horizontal: metres = file units x this."""
    metres_per_unit_z: float = 1.0
    """Vertical: metres = file units x this."""


@dataclass(frozen=True, slots=True)
class PointCloud:
    """A chunk of points that count, in metres."""

    easting: NDArray[np.float64]
    """(n,) m."""
    northing: NDArray[np.float64]
    """(n,) m."""
    upward: NDArray[np.float64]
    """(n,) m."""
    is_ground: NDArray[np.bool_]
    """(n,) True where the file says class 2 (ground). All False where the file has no classes."""


@dataclass(frozen=True, slots=True)
class PatchStack:
    """Measured tiles: one row each, only tiles that hold points."""

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
    """(n,) mean perpendicular distance of all points to the plane that RANSAC found, m; NaN where there is none."""
    slope: NDArray[np.float64]
    """(n,) angle of that plane with the horizontal, degrees; NaN where there is none."""
    z_range: NDArray[np.float64]
    """(n,) max - min of ``heights``, m."""
    density: NDArray[np.float64]
    """(n,) points per square metre."""
    coverage: NDArray[np.float64]
    """(n,) share of the pixels that hold a point, 0..1."""
    heights: NDArray[np.float32]
    """(n, pixels, pixels) mean z of a pixel, m, north row first, west column first; NaN where no point fell."""
    spread_count: NDArray[np.int32]
    """(n, pixels, pixels) points behind each height."""
    spread_variance: NDArray[np.float32]
    """(n, pixels, pixels) population variance inside the pixel of the height above the tile's plane, m^2: of
    z where RANSAC found none; NaN where no point fell."""
    relief_map: NDArray[np.float32]
    """(n, pixels, pixels) heights with their least-squares plane taken off and holes filled from their neighbours, m;
    NaN where the tile cannot be judged."""
    relief: NDArray[np.float64]
    """(n,) max - min of ``relief_map``, m."""
    reason: NDArray[np.uint8]
    """(n,) a ``Reason``: 0 where the tile can be judged."""


@dataclass(frozen=True, slots=True)
class TextureMap:
    """What the texture network sees in each tile."""

    probability: NDArray[np.float32]
    """(n, 4) over ``TEXTURES``, rows sum to 1; NaN where the tile is unknown."""


FAIL_SHARE = 0.5
"""Ground on which at least this share of the drives fails is not passable, and of the last class."""


PASSABLE_COLUMNS = ("class_id", "c_r", "p_fail", "slope")
"""What decides whether a tile is passable."""


@dataclass(frozen=True, slots=True)
class CostRule:
    """How a vehicle's ride becomes the cost of a planner: what is passable, and the factor on distance where it is.

    ``cost = 1 + ride_weight * c_r + fail_weight * hazard``. Integrated along a path it is the path's length, plus a
    detour for the shaking, plus one for the risk: ``exp(-integral of the hazard)`` is the probability of arriving.
    """

    ride_weight: float
    """m/rad: the detour that one radian of pitch motion is worth."""
    fail_weight: float
    """m: the detour that one certain failure is worth."""
    drive_m: float
    """Length of a drive of the calibration, m: ``p_fail`` is a share of such drives."""
    slope_limit_deg: float
    """Steeper ground is not for this vehicle."""

    def hazard(self, p_fail: NDArray[np.floating]) -> NDArray[np.float64]:
        """Failures per metre, 1/m: ``-ln(1 - p_fail) / drive_m``; infinite where all drives fail, NaN where unknown."""
        with np.errstate(divide="ignore"):
            return np.asarray(-np.log1p(-p_fail.astype(np.float64)) / self.drive_m)

    def passable(self, columns: Mapping[str, NDArray[Any]]) -> NDArray[np.bool_]:
        """Whether tiles may be driven on: known, not too steep, and fewer than ``FAIL_SHARE`` of the drives fail.

        Where the rating knows no ``p_fail`` (NaN: ``--compat paper``) the last class is not passable.

        Parameters
        ----------
        columns : mapping
            Those named in ``PASSABLE_COLUMNS``, (n,) each, as in `tile_columns`.
        """
        class_id, c_r, p_fail, slope = (columns[name] for name in PASSABLE_COLUMNS)
        fails = np.where(np.isnan(p_fail), class_id == len(CLASS_NAMES) - 1, p_fail >= FAIL_SHARE)
        return np.asarray((class_id != NO_CLASS) & np.isfinite(c_r) & (slope <= self.slope_limit_deg) & ~fails)

    def cost(self, c_r: NDArray[np.floating], hazard: NDArray[np.floating]) -> NDArray[np.float64]:
        """Factor on distance; a hazard that is not known (NaN) counts nothing."""
        return np.asarray(1.0 + self.ride_weight * c_r + self.fail_weight * np.where(np.isnan(hazard), 0.0, hazard))


@dataclass(frozen=True, slots=True)
class CostMap:
    """Rated tiles: everything that the products are made of."""

    georeference: Georeference
    patches: PatchStack
    textures: TextureMap
    class_id: NDArray[np.uint8]
    """(n,) class 0 (flattest) to 3 (roughest); ``NO_CLASS`` where unknown."""
    c_r: NDArray[np.float32]
    """(n,) ride cost, rad of pitch per metre; NaN where unknown (so are the next four)."""
    c_r_low: NDArray[np.float32]
    """(n,) lower end of the 80 % interval of c_r, rad/m."""
    c_r_high: NDArray[np.float32]
    """(n,) upper end, rad/m."""
    p_fail: NDArray[np.float32]
    """(n,) share of simulated drives over such ground that rolled over or got stuck, 0..1."""
    confidence: NDArray[np.float32]
    """(n,) probability that the class is right, 0..1."""
    rule: CostRule
    """What of it is passable, and at what cost."""

    def band(self, name: str) -> NDArray[np.floating]:
        """Values of one of ``BANDS``, (n,)."""
        owner = self if name in self.__slots__ else self.patches
        values: NDArray[np.floating] = getattr(owner, name)
        return values

    def columns(self) -> dict[str, NDArray[Any]]:
        """Columns of `tile_columns`, one row a tile: what a run keeps of its tiles."""
        own: dict[str, NDArray[Any]] = {"class_id": self.class_id, "probability": self.textures.probability}
        names = [column.name for column in tile_columns(self.patches.grid.pixels) if column.name not in own]
        return {name: self.band(name) for name in names} | own


@dataclass(frozen=True, slots=True)
class CostTable:
    """All rated tiles of a run, read by window: what the products are made of."""

    georeference: Georeference
    rule: CostRule
    """What of it is passable, and at what cost."""
    tiles: TileTable
    """Columns of `tile_columns`."""

    @classmethod
    def of(cls, cost_map: CostMap) -> "CostTable":
        """Make a mosaic of a map in memory (at least one tile)."""
        return cls(cost_map.georeference, cost_map.rule, TileTable.of(cost_map.patches.grid, cost_map.columns()))


def tile_columns(pixels: int) -> tuple[Column, ...]:
    """Columns of a rated tile, named and measured as in `PatchStack` and `CostMap`."""
    floats = ("z_min", "z_max", "z_variance", "ransac_residual", "slope", "z_range", "density", "coverage", "relief")
    singles = ("c_r", "c_r_low", "c_r_high", "p_fail", "confidence")
    return (
        *(Column(name, "<i8") for name in ("col", "row", "count")),
        *(Column(name, "<f8") for name in floats),
        *(Column(name, "|u1") for name in ("reason", "class_id")),
        *(Column(name, "<f4") for name in singles),
        Column("probability", "<f4", (len(TEXTURES),)),
        Column("heights", "<f4", (pixels, pixels)),
    )


@dataclass(frozen=True, slots=True)
class Band:
    """A layer of roughness.tif and a column of tiles.parquet."""

    name: str
    unit: str
    """As GDAL writes units; empty where the number has none."""
    description: str


BANDS: tuple[Band, ...] = (
    Band("c_r", "rad/m", "ride cost: pitch motion per metre of way"),
    Band("c_r_low", "rad/m", "lower end of the 80 % interval of c_r"),
    Band("c_r_high", "rad/m", "upper end of the 80 % interval of c_r"),
    Band("p_fail", "", "share of simulated drives that rolled over or got stuck"),
    Band("z_variance", "m2", "population variance of z over the tile's points"),
    Band("ransac_residual", "m", "mean perpendicular distance of all points to the RANSAC plane"),
    Band("z_range", "m", "max - min of the heightmap"),
    Band("slope", "deg", "angle between the RANSAC plane and the horizontal"),
    Band("density", "m-2", "points per square metre"),
    Band("coverage", "", "share of the pixels that hold a point"),
    Band("confidence", "", "probability that the class is right"),
)
"""The bands of roughness.tif, in order."""
