"""The tiles of a map as a page shows them: small grids in which the worst tile decides, as base 64."""

import base64
import math
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pyproj import Transformer

from bumpymap.core import (
    CLASS_NAMES,
    FREE,
    NO_CLASS,
    OBSTACLE,
    BadInputError,
    Barred,
    CostRule,
    Reason,
    stated_crs,
)
from bumpymap.layers import UNKNOWN_OBJECT, MapFile, first_island, read_tiles

NOT_KNOWN = 255
"""Byte where a value is not known."""
STEPS = 254
"""Largest byte of a known value."""
_LEAST = 1e-4
"""Smallest value of a logarithmic scale: chosen, below what any vehicle feels."""
Scale: TypeAlias = Literal["linear", "log", "root"]
"""``root``: steps of the square root, for differences of which most are small."""


@dataclass(frozen=True, slots=True)
class ByteGrid:
    """A grid whose byte b stands for ``low + b step``, for its exponential, or for its square with the sign kept."""

    key: str
    label: str
    unit: str
    decimals: int
    scale: Scale
    low: float
    step: float
    codes: NDArray[np.uint8]
    """(rows, cols), north row first; ``NOT_KNOWN`` where there is no value."""
    text: str
    """The same, packed."""

    @classmethod
    def of(
        cls,
        about: tuple[str, str, str, int],
        values: NDArray[np.float32],
        scale: Scale = "linear",
        limits: tuple[float, float] | None = None,
    ) -> Self:
        """Round values, (rows, cols), NaN where unknown, to 255 steps between ``limits``, or between their extremes.

        ``about`` is key, label, unit, and the number of decimals to show. Values beyond the limits take those.
        """
        with np.errstate(divide="ignore"):
            plain = values.astype(np.float64)
            if scale == "log":
                plain = np.log(np.maximum(values, _LEAST))
            elif scale == "root":
                plain = np.sign(plain) * np.sqrt(np.abs(plain))
        known = np.isfinite(plain)
        if scale == "root" and known.any():  # as far down as up, so that 0 is in the middle, and exact
            most = float(np.abs(plain[known]).max())
            limits = (-most, most)
        low, high = limits or ((float(plain[known].min()), float(plain[known].max())) if known.any() else (0.0, 1.0))
        step = (high - low) / STEPS or 1.0
        codes = np.full(values.shape, NOT_KNOWN, np.uint8)
        codes[known] = np.clip(np.rint((plain[known] - low) / step), 0, STEPS).astype(np.uint8)
        return cls(*about, scale, low, step, codes, packed(codes))

    @property
    def is_known(self) -> bool:
        """True if it has a value anywhere."""
        return bool((self.codes != NOT_KNOWN).any())

    def words(self, most: float = math.inf) -> list[str]:
        """Return the least value of the scale, that in its middle, and the largest, ``most`` at most, with their unit.

        ``most`` is for linear scales.
        """
        high = self.low + self.step * STEPS
        ends = [self.low, (self.low + min(high, most)) / 2, min(high, most)]
        plain: dict[str, Callable[[float], float]] = {"log": math.exp, "root": lambda root: root * abs(root)}
        values = [plain.get(self.scale, float)(round(end, 12)) + 0.0 for end in ends]
        unit = self.unit if self.unit == "°" else self.unit and f" {self.unit}"
        words = [f"{value:.{self.decimals}f}{unit}" if value else "0" for value in values]
        return words if most >= high else [*words[:2], f"{words[2]} and more"]

    def record(self) -> dict[str, Any]:
        """Return the grid as plain JSON."""
        keys = ("key", "label", "unit", "decimals", "scale", "low", "step")
        return {key: getattr(self, key) for key in keys} | {"codes": self.text}


def packed(codes: NDArray[np.uint8]) -> str:
    """Return bytes compressed (zlib) in base 64."""
    return base64.b64encode(zlib.compress(np.ascontiguousarray(codes).tobytes(), 6)).decode()


UNKNOWN_FROM = 16
"""``ground`` of an unknown tile is this plus its `Reason`."""
NO_POINTS = 255
"""``ground`` and ``barred`` where no tile holds a point."""
_NUMBERS = ("c_r", "p_fail", "slope", "obstacle")
_AGAIN = "Map the survey again"


@dataclass(frozen=True, slots=True)
class Spot:
    """Where a map lies, and the grid on which a page shows it."""

    west: float
    """m, in the survey's CRS: its units times metres per unit."""
    north: float
    tile_size: float
    """m."""
    pixels: int
    """Pixels of heightmap.tif along a side of a tile."""
    cols: int
    """Tiles."""
    rows: int
    step: int
    """Tiles along a side of a pixel of the page."""
    unit: float
    """Metres per unit of the CRS."""

    @classmethod
    def of(cls, file: Any, record: Mapping[str, Any], side: int) -> Self:
        """Take the place of a raster of tiles, which is open; the grid has at most ``side`` pixels a side."""
        unit, grid = float(record["metres_per_unit"]["horizontal"]), record["grid"]
        west, north, tile = file.transform.c * unit, file.transform.f * unit, float(grid["tile_size_m"])
        step = math.ceil(max(file.width, file.height, 1) / side)
        return cls(west, north, tile, int(grid["pixels"]), file.width, file.height, step, unit)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the page's grid."""
        return -(-self.rows // self.step), -(-self.cols // self.step)

    @property
    def metres(self) -> float:
        """Side of a pixel of the page's grid, m."""
        return self.tile_size * self.step

    def record(self) -> dict[str, Any]:
        """Return what the script of the page needs, as plain JSON."""
        rows, cols = self.shape
        return {
            "west": self.west,
            "north": self.north,
            "unit": self.unit,
            "metres": self.metres,
            "rows": rows,
            "cols": cols,
            "width": self.cols * self.tile_size,
            "height": self.rows * self.tile_size,
        }

    def shown(self, side: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return row and column of the page's grid of each pixel of a picture, to index with; ``side`` is its longer.

        Where the grid is smaller, its pixels are whole numbers of those of the picture.
        """
        longer = max(self.shape)
        scale = max(1, side // longer) if longer <= side else side / longer
        down, right = (
            ((np.arange(max(1, int(size * scale))) + 0.5) * size / max(1, int(size * scale))).astype(np.int64)
            for size in self.shape
        )
        return down[:, None], right[None, :]


def block_means(values: NDArray[np.float32], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return the means of what is known in each of ``shape`` blocks of an array; NaN where nothing is."""
    rows, cols = shape
    blocks = values.reshape(rows, values.shape[0] // rows, cols, values.shape[1] // cols)
    known = np.isfinite(blocks)
    count = known.sum(axis=(1, 3))
    total = np.where(known, blocks, np.float32(0)).sum(axis=(1, 3), dtype=np.float64)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan).astype(np.float32)


def map_metres(record: Mapping[str, Any]) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """Return how positions of GeoJSON, (n, 2), become metres of the grid of a map or a comparison.

    It raises ValueError for a position without coordinates in the CRS.
    """
    crs, unit = record.get("crs"), float(record["metres_per_unit"]["horizontal"])
    forward = None
    if crs is not None:
        forward = Transformer.from_crs("OGC:CRS84", stated_crs(crs["wkt"]).to_2d(), always_xy=True)

    def metres(part: NDArray[np.float64]) -> NDArray[np.float64]:
        if forward is not None:
            part = np.column_stack(forward.transform(part[:, 0], part[:, 1]))
        if not np.isfinite(part).all():
            raise ValueError("a position has no coordinates in the CRS of the map")
        return part * unit

    return metres


def crs_name(record: Mapping[str, Any]) -> str:
    """Return the name of the CRS of a record."""
    crs = record["crs"]
    return "local coordinates, no CRS" if crs is None else str(crs["name"])


@dataclass(frozen=True, slots=True)
class PageTiles:
    """The tiles on the grid of a page, (rows, cols), north row first, and counts over all of them."""

    spot: Spot
    ground: NDArray[np.uint8]
    """Class 0 to 3, ``UNKNOWN_FROM`` plus a `Reason`, or ``NO_POINTS``. A pixel of several tiles is unknown if one of
    them is unknown or, at the survey's edge or in a hole, holds no point; else it has the roughest class."""
    barred: NDArray[np.uint8]
    """A `Barred`, or ``NO_POINTS``; not passable if one tile is not."""
    objects: NDArray[np.uint8]
    """OBSTACLE where a tile holds one, FREE where none does, UNKNOWN_OBJECT where that is not known, else 255."""
    c_r: NDArray[np.float32]
    """rad/m, the largest; NaN where the pixel is unknown (so are the next two)."""
    p_fail: NDArray[np.float32]
    slope: NDArray[np.float32]
    cost: NDArray[np.float32]
    """Factor on distance, the largest; NaN where a tile is not passable."""
    free: NDArray[np.int64]
    """(4,) passable tiles of each class."""
    islands: NDArray[np.bool_]
    """True where ground that can be crossed is an island."""

    @classmethod
    def read(cls, folder: Path, record: Mapping[str, Any], spot: Spot) -> Self:
        """Read tiles.parquet, some thousand tiles at a time.

        Raises BadInputError: the file is missing, damaged, or was written by an earlier version.
        """
        shape = spot.shape
        # One more than the code, so that 0 stands for no points and the largest is the worst.
        ground, barred = np.zeros(shape, np.uint8), np.zeros(shape, np.uint8)
        known = np.zeros(shape, np.uint16 if spot.step < 256 else np.uint32)
        zone = np.zeros(shape, np.int32)
        numbers = {name: np.full(shape, -1.0, np.float32) for name in (*_NUMBERS, "cost")}
        free = np.zeros(len(CLASS_NAMES), np.int64)
        names = ("ride_weight_m_per_rad", "fail_weight_m", "drive_m", "slope_limit_deg")
        ride, fail, drive, slope = (float(record["cost"][name]) for name in names)
        rule = CostRule(ride, fail, drive, slope)
        for found in read_tiles(folder / MapFile.TILES, record["counts"]["tiles"]):
            place = _place(found, spot)
            unknown = UNKNOWN_FROM + found["reason"].astype(np.uint8)
            kind = np.where(found["class"] == NO_CLASS, unknown, found["class"]).astype(np.uint8)
            np.maximum.at(ground, place, kind + 1)
            np.maximum.at(barred, place, found["barred"] + 1)
            np.add.at(known, place, 1)
            passable = found["class"][found["barred"] == Barred.NO]
            free += np.bincount(passable, minlength=len(free))[: len(free)]
            np.maximum.at(zone, place, found["zone"])
            found["cost"] = rule.cost(found["c_r"].astype(np.float64), rule.hazard(found["p_fail"])).astype(np.float32)
            for name, canvas in numbers.items():
                np.fmax.at(canvas, place, found[name])
        empty = known == 0
        down, right = (  # tiles along the pixels of the page: fewer at the south and east edges
            np.minimum(spot.step, tiles - spot.step * np.arange(pixels))
            for tiles, pixels in zip((spot.rows, spot.cols), shape, strict=True)
        )
        part = ~empty & (known < np.multiply.outer(down, right))  # next to tiles without points
        ground[part] = np.maximum(ground[part], UNKNOWN_FROM + Reason.NO_POINTS + 1)
        barred[part] = np.maximum(barred[part], Barred.UNKNOWN + 1)
        ground, barred = (ground - 1).astype(np.uint8), (barred - 1).astype(np.uint8)  # 0 becomes 255
        for name, canvas in numbers.items():
            canvas[(canvas < 0) | ((ground >= UNKNOWN_FROM) & (name != "obstacle"))] = np.nan
        numbers["cost"][barred != Barred.NO] = np.nan
        first = first_island(record)
        islands = (zone >= (np.inf if first is None else first)) & (barred == Barred.NO)
        share = numbers.pop("obstacle")
        objects = np.select(
            [ground == NO_POINTS, share > 0, share == 0], [NO_CLASS, OBSTACLE, FREE], UNKNOWN_OBJECT
        ).astype(np.uint8)
        return cls(spot, ground, barred, objects, **numbers, free=free, islands=islands)


def _place(found: Mapping[str, NDArray[Any]], spot: Spot) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    col = found["col"].astype(np.intp) - round(spot.west / spot.tile_size)
    line = round(spot.north / spot.tile_size) - 1 - found["row"].astype(np.intp)
    inside = len(col) == 0 or (col.min() >= 0 and line.min() >= 0 and col.max() < spot.cols and line.max() < spot.rows)
    if not inside:
        raise BadInputError(f"tiles.parquet holds tiles outside of class.tif: they are not of one run. {_AGAIN}")
    return line // spot.step, col // spot.step
