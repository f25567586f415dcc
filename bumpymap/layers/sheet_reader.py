"""One folder of layers as a route reads it: checked when it is opened, then read window by window."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from itertools import pairwise, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pyproj.exceptions import CRSError

from bumpymap.core import (
    CANOPY,
    FREE,
    NO_TILE,
    OBSTACLE,
    BadInputError,
    Barred,
    CostRule,
    Georeference,
    Number,
    RouteVehicle,
    shape_fault,
    stated_crs,
)
from bumpymap.layers.manifest import read_manifest
from bumpymap.layers.map_files import KeptRasters, read_averaged, require_written
from bumpytiles import Grid, TileWindow

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

__all__ = ["SheetReader", "common_window", "kept_rasters", "sheet_choice", "window_slices", "worse_objects"]

_DTYPES = {
    "barred.tif": "uint8",
    "roughness.tif": "float32",
    "cost.tif": "float32",
    "heightmap.tif": "float32",
    "obstacle.tif": "uint8",
    "passage.tif": "uint8",
    "class.tif": "uint8",
}
_RASTERS = tuple(name for name in _DTYPES if name != "class.tif")
"""Rasters of a route; a comparison of surveys reads the classes too."""
_VEHICLE = {"name": str, "width_m": Number(), "speed_mps": Number()}
_PER_PIXEL = ("heightmap.tif", "obstacle.tif", "passage.tif")
CHECKED_BYTES = 64 << 20
"""The checksum of a larger raster, which takes a second for 1.4 GB, is compared when it is first read."""
_OFF = 1e-3
"""Greatest distance of a raster's corner from a corner of the grid of tiles, in tiles."""
_PIECE = 512
"""Side of the pieces that are read at once, raster pixels: roughness.tif keeps 17 bands together, which GDAL decodes
for one; a piece of all of them fits into its cache."""
_CACHE = 32 << 20
"""Decoded blocks that GDAL keeps of all rasters together, bytes."""
_AGAIN = "Map the survey again"


def kept_rasters() -> KeptRasters:
    """Return what opens the rasters of one map."""
    return KeptRasters(GDAL_CACHEMAX=_CACHE)


@dataclass(frozen=True, slots=True)
class SheetReader:
    """One folder of layers."""

    folder: Path
    manifest: dict[str, Any]
    grid: Grid
    window: TileWindow
    """The tiles that its rasters span."""
    georeference: Georeference
    rule: CostRule
    vehicle: RouteVehicle
    rasters: KeptRasters = field(default_factory=kept_rasters, repr=False, compare=False)
    """Its rasters as they are opened; sheets of one map have them together."""

    @classmethod
    def open(cls, folder: Path, rasters: KeptRasters | None = None) -> "SheetReader":
        """Open the folder of a complete run.

        Raises
        ------
        BadInputError
            It holds no complete run, one of an earlier version, or a raster is missing, cut off, or does not fit to
            the others.
        """
        rasters = rasters or kept_rasters()
        manifest = read_manifest(folder)
        try:
            require_written(folder, manifest, _RASTERS, most=CHECKED_BYTES)
            crs, unit = manifest["crs"], manifest["metres_per_unit"]
            known = None if crs is None else stated_crs(crs["wkt"])
            cost = manifest["cost"]
            names = ("ride_weight_m_per_rad", "fail_weight_m", "drive_m", "slope_limit_deg")
            parts = (
                Grid(float(manifest["grid"]["tile_size_m"]), int(manifest["grid"]["pixels"])),
                Georeference(known, float(unit["horizontal"]), float(unit["vertical"])),
                CostRule(*(float(cost[name]) for name in names)),
                _vehicle(folder, manifest),
            )
        except (LookupError, TypeError, ValueError, AttributeError, CRSError) as error:
            raise BadInputError(f"{folder / 'run.json'} is damaged: {error!r}. {_AGAIN}") from error
        grid, georeference, rule, vehicle = parts
        window = _common_raster(folder, grid, georeference, rasters)
        return cls(folder, manifest, grid, window, georeference, rule, vehicle, rasters)

    @property
    def identity(self) -> dict[str, Any]:
        """Settings and place that sheets of one map have in common, by the words that a message uses."""
        settings, crs = self.manifest.get("settings", {}), self.manifest.get("crs")
        return {
            "tile size [m]": self.grid.tile_size,
            "pixels along a tile": self.grid.pixels,
            "CRS": None if crs is None else crs["name"],
            "metres per unit of the CRS": self.georeference.metres_per_unit,
            "vehicle": self.vehicle.name,
            "calibration": self.calibration_id,
            "rating": settings.get("rating"),
            "compat": settings.get("compat"),
            "ride weight [m/rad]": self.rule.ride_weight,
            "fail weight [m]": self.rule.fail_weight,
            "length of a calibration drive [m]": self.rule.drive_m,
            "slope limit [deg]": self.rule.slope_limit_deg,
            "width of the vehicle [m]": self.vehicle.width_m,
            "speed of the vehicle [m/s]": self.vehicle.speed_mps,
        }

    @property
    def calibration_id(self) -> str:
        """Id of the calibration; empty if the manifest has none."""
        return str(self.manifest.get("calibration", {}).get("id", ""))

    def read_into(self, out: Sequence[NDArray[Any]], name: str, window: TileWindow, bands: Sequence[str] = ()) -> None:
        """Read a window that lies inside the sheet into arrays, which may be parts of larger ones.

        Parameters
        ----------
        out : sequence of arrays
            One for each band, (rows * p, cols * p), north row first; p is the number of pixels along a tile in rasters
            of pixels, else 1.
        name : str
            Name of the raster.
        window : TileWindow
        bands : sequence of str
            Names of the bands; none: the first.

        Raises
        ------
        BadInputError
            The file is missing or damaged.
        """
        top, left, rows, cols = self._place(name, window)
        self._require_whole(name)
        with self.rasters.opened(self.folder / name) as file:
            numbers = _numbers(self.folder / name, file, bands)
            # Cut at multiples of a piece, so that no block of the file is decoded twice.
            for lines, columns in product(_cut(top, top + rows), _cut(left, left + cols)):
                part = ((lines.start, lines.stop), (columns.start, columns.stop))
                for array, values in zip(out, file.read(numbers, window=part), strict=True):
                    array[_moved(lines, top), _moved(columns, left)] = values

    def read_pixels(self, name: str, window: TileWindow, shape: tuple[int, int]) -> NDArray[Any]:
        """Read a window that lies inside the sheet of a raster with several pixels a tile, in ``shape`` pixels.

        With fewer pixels than the file has they come from the overviews: numbers as means. For errors see `read_into`.
        """
        top, left, rows, cols = self._place(name, window)
        if shape == (rows, cols):
            whole = np.empty(shape, _DTYPES[name])
            self.read_into([whole], name, window)
            return whole
        part = ((top, top + rows), (left, left + cols))
        self._require_whole(name)
        with self.rasters.opened(self.folder / name) as file:
            if _DTYPES[name] == "float32":
                return read_averaged(file, shape, part)
            found: NDArray[Any] = file.read(1, window=part, out_shape=shape)
            return found

    def _place(self, name: str, window: TileWindow) -> tuple[int, int, int, int]:
        """Return top, left, rows and columns of a window in a raster, pixels."""
        own, scale = self.window, self.grid.pixels if name in _PER_PIXEL else 1
        top = own.row + own.rows - window.row - window.rows
        return top * scale, (window.col - own.col) * scale, window.rows * scale, window.cols * scale

    def _require_whole(self, name: str) -> None:
        """Raise BadInputError if a raster whose checksum was not compared when the sheet was opened is damaged."""
        written = {str(file["path"]): file for file in self.manifest["files"]}
        if name in _RASTERS and int(written[name]["bytes"]) > CHECKED_BYTES:
            _compare(self.folder, name, int(written[name]["bytes"]), str(written[name]["sha256"]))


@lru_cache(maxsize=1024)
def _compare(folder: Path, name: str, size: int, sha256: str) -> None:
    """Compare the checksum of a raster once."""
    require_written(folder, {"files": [{"path": name, "bytes": size, "sha256": sha256}]}, [name])


def common_window(first: TileWindow, second: TileWindow) -> TileWindow | None:
    """Return the tiles that two windows share; None if there are none."""
    west, south = max(first.col, second.col), max(first.row, second.row)
    cols = min(first.col + first.cols, second.col + second.cols) - west
    rows = min(first.row + first.rows, second.row + second.rows) - south
    return TileWindow(west, south, cols, rows) if cols > 0 and rows > 0 else None


def _numbers(path: Path, file: "DatasetReader", bands: Sequence[str]) -> list[int]:
    if not bands:
        return [1]
    names = file.descriptions
    missing = [band for band in bands if band not in names]
    if missing:
        raise BadInputError(f"{path} has no band {missing[0]}: it was made by an earlier version. {_AGAIN}")
    return [names.index(band) + 1 for band in bands]


def _cut(start: int, stop: int) -> list[slice]:
    edges = [start, *range((start // _PIECE + 1) * _PIECE, stop, _PIECE), stop]
    return [slice(low, high) for low, high in pairwise(edges)]


def _moved(part: slice, by: int) -> slice:
    return slice(part.start - by, part.stop - by)


def _common_raster(folder: Path, grid: Grid, georeference: Georeference, rasters: KeptRasters) -> TileWindow:
    """Return the tiles that all rasters of a folder span. Raises BadInputError if they do not agree."""
    windows = {name: _window_of(folder / name, grid, georeference, rasters) for name in _RASTERS}
    for name, window in windows.items():
        if window != windows[_RASTERS[0]]:
            raise BadInputError(f"{folder / name} spans other tiles than {folder / _RASTERS[0]}. {_AGAIN}")
    return windows[_RASTERS[0]]


def _window_of(path: Path, grid: Grid, georeference: Georeference, rasters: KeptRasters) -> TileWindow:
    pixels = grid.pixels if path.name in _PER_PIXEL else 1
    tile = grid.tile_size / georeference.metres_per_unit
    with rasters.opened(path) as file:
        place, width, height = file.transform, file.width, file.height
    sides = (place.c / tile, place.f / tile - height / pixels, width / pixels, height / pixels)
    if not all(map(math.isfinite, sides)):
        raise BadInputError(f"{path} has no place. {_AGAIN}")
    whole = [round(side) for side in sides]
    steps = (place.a * pixels / tile, place.b, place.d, -place.e * pixels / tile)
    fits = all(math.isclose(side, near, abs_tol=_OFF) for side, near in zip(sides, whole, strict=True))
    if not fits or not np.allclose(steps, (1.0, 0.0, 0.0, 1.0), rtol=0.0, atol=1e-9):
        raise BadInputError(
            f"{path} does not lie on the grid of tiles of {grid.tile_size:g} m that run.json states. {_AGAIN}"
        )
    return TileWindow(*whole)


def _vehicle(folder: Path, manifest: Mapping[str, Any]) -> RouteVehicle:
    vehicle = manifest.get("vehicle")
    if vehicle is None:
        raise BadInputError(
            f"{folder} was made by an earlier version, which did not store the width and speed of the vehicle. Map the "
            "survey again, with `overwrite=True` to replace these layers"
        )
    if fault := shape_fault(vehicle, _VEHICLE, "vehicle"):
        raise BadInputError(f"{folder / 'run.json'} is damaged: {fault}. {_AGAIN}")
    return RouteVehicle(vehicle["name"], float(vehicle["width_m"]), float(vehicle["speed_mps"]))


_UNKNOWN_OBJECT = 3
_WORST = np.array([NO_TILE, _UNKNOWN_OBJECT, FREE, CANOPY, OBSTACLE], np.uint8)
"""States of a pixel of obstacle.tif; of two sheets, the later one counts."""
_OBJECT_RANK = np.zeros(256, np.uint8)
_OBJECT_RANK[_WORST] = np.arange(len(_WORST))
_TILE_RANK = np.full(256, 3, np.uint8)
_TILE_RANK[[NO_TILE, Barred.UNKNOWN, Barred.NO]] = 0, 1, 2
"""How much a tile counts, by what bars it: no tile, unknown, passable, barred."""


def sheet_choice(
    old: NDArray[np.uint8], new: NDArray[np.uint8]
) -> Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]:
    """Compare what bars the tiles that two sheets share.

    Returns
    -------
    callable
        Returns, of the old and the new values of the tiles, those that count: the larger where both sheets count, NaN
        only if both are.
    """
    before, now = _TILE_RANK[old], _TILE_RANK[new]
    return lambda one, other: np.where(now > before, other, np.where(now == before, np.fmax(one, other), one))


def window_slices(window: TileWindow, part: TileWindow, pixels: int = 1) -> tuple[slice, slice]:
    """Return where a part of a window lies in its arrays."""
    top = (window.row + window.rows - part.row - part.rows) * pixels
    left = (part.col - window.col) * pixels
    return slice(top, top + part.rows * pixels), slice(left, left + part.cols * pixels)


def worse_objects(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return, of the states of pixels in two sheets, the one that counts."""
    return _WORST[np.maximum(_OBJECT_RANK[first], _OBJECT_RANK[second])]
