"""The layers of one run as they are read back: checked when they are opened, then read window by window.

A folder of layers may come from anybody: each raster is opened as the one format that it must be, as
`bumpymap.core.open_tiff` does, and held against the manifest.
"""

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from bumpymap.core import (
    NO_CLASS,
    NO_TILE,
    OPEN_THROUGH,
    SEEN_COLUMNS,
    BadInputError,
    Barred,
    CostRule,
    Georeference,
    RouteVehicle,
    TileField,
    closed_gdal,
    describe_crs,
    gdal_text,
    open_tiff,
    raster_lock,
    stated_crs,
    tiles_of,
)
from bumpymap.layers.manifest import MANIFEST_NAME, describe_file, read_manifest
from bumpymap.layers.products import MapFile
from bumpytiles import Grid, TileWindow

if TYPE_CHECKING:
    from rasterio.io import DatasetReader


Coordinate = TypeVar("Coordinate", float, NDArray[np.float64])
Number = TypeVar("Number", np.uint8, np.float32)

_BANDS = ("c_r", "c_r_low", "c_r_high", "p_fail", "obstacle", *SEEN_COLUMNS)

_RASTERS = (MapFile.BARRED, MapFile.ROUGHNESS, MapFile.COST, MapFile.HEIGHTMAP, MapFile.OBSTACLE, MapFile.PASSAGE)
"""Rasters of a route; a comparison of surveys reads the classes too, and a route photo.tif where it is there."""
_PER_PIXEL = (MapFile.HEIGHTMAP, MapFile.OBSTACLE, MapFile.PASSAGE, MapFile.PHOTO)
CHECKED_BYTES = 64 << 20
"""The checksum of a larger raster, which takes a second for 1.4 GB, is compared when it is first read."""
_OFF = 1e-3
"""Greatest distance of a raster's corner from a corner of the grid of tiles, in tiles."""
_AGAIN = "Map the survey again"
_PLANE_PIXELS = 1 << 20
"""Heights that planes are put through at once: chosen, 4 MB."""
_LEAST_SPREAD = 0.05
"""Of the pixels that have a height, of that of a whole tile: they give a plane if they are not all on one line."""


def read_averaged(
    file: "DatasetReader", shape: tuple[int, int], window: tuple[tuple[int, int], tuple[int, int]] | None = None
) -> NDArray[Any]:
    """Read the first band of a raster, or of a window of it, in another shape: means, from its overviews if it can.

    ``window`` holds the first row and the one after the last, then the columns likewise.
    """
    from rasterio.enums import Resampling

    found: NDArray[Any] = file.read(1, window=window, out_shape=shape, resampling=Resampling.average)
    return found


def read_colours(
    file: "DatasetReader", shape: tuple[int, int], window: tuple[tuple[int, int], tuple[int, int]] | None = None
) -> NDArray[Any]:
    """Do the same with red, green and blue, (3, rows, cols) float32; NaN where the mask of the raster hides them."""
    from rasterio.enums import Resampling

    found = file.read((1, 2, 3), window=window, out_shape=(3, *shape), resampling=Resampling.average, masked=True)
    colours: NDArray[Any] = found.astype(np.float32).filled(np.nan)
    return colours


@contextmanager
def reading_raster(path: Path, remedy: str = _AGAIN, **options: Any) -> Iterator[None]:
    """Read a raster inside `closed_gdal`; its errors, and names that are no text, become BadInputErrors."""
    from rasterio.errors import RasterioError

    try:
        with closed_gdal(**options):
            yield
    except (OSError, UnicodeDecodeError, RasterioError) as error:
        raise BadInputError(f"cannot read {path}: {gdal_text(error)}. {remedy}") from error


@contextmanager
def open_layer(path: Path, *, remedy: str = _AGAIN, **options: Any) -> "Iterator[DatasetReader]":
    """Open a raster of a map, a GeoTIFF; nothing else is read.

    ``remedy``: sentence that ends the message of an error; ``**options``: of GDAL, while the raster is open. Raises
    BadInputError: it is missing, damaged or of another format; it leads to other files, or the names in it are no text.
    So is each error of GDAL in the body of the ``with``.
    """
    with reading_raster(path, remedy, **options), open_tiff(path, remedy) as file:
        yield file


_KEPT: dict[str, Any] = {"GDAL_CACHEMAX": 32 << 20}
"""Decoded blocks that GDAL keeps of all rasters together, bytes."""


class KeptRasters:
    """Rasters of one map that stay open from read to read inside `keep`, so that each is opened once.

    Outside of `keep`, a raster is opened for each read. A process that unpickles this starts with none open.
    """

    def __init__(self) -> None:
        self._keepers = 0
        self._open: dict[Path, DatasetReader] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return KeptRasters, ()

    @contextmanager
    def keep(self) -> Iterator[None]:
        """Keep rasters open during the body; all are closed when the last of several bodies ends."""
        with raster_lock():
            self._keepers += 1
        try:
            yield
        finally:
            with raster_lock():
                self._keepers -= 1
                self._close_unkept()

    @contextmanager
    def opened(self, path: Path) -> "Iterator[DatasetReader]":
        """Yield an open raster; for errors see `open_layer`."""
        if not self._keepers:
            with open_layer(path, **_KEPT) as file:
                yield file
            return
        with raster_lock(), reading_raster(path, **_KEPT):
            if path not in self._open:
                self._open[path] = open_tiff(path, _AGAIN)
            try:
                yield self._open[path]
            finally:  # the last body of `keep` may have ended in another thread meanwhile
                self._close_unkept()

    def _close_unkept(self) -> None:
        while self._open and not self._keepers:
            self._open.popitem()[1].close()


def require_written(folder: Path, manifest: Mapping[str, Any], names: Iterable[str], most: float = math.inf) -> None:
    """Raise BadInputError if a file is missing, or is not the one that a manifest lists by size and checksum.

    GDAL reads many a damaged block without an error. ``manifest``: with ``files``, from `describe_file`; ``most``:
    bytes of the largest file whose checksum is compared; a larger one is held against its size.
    """
    written = {str(file["path"]): file for file in manifest["files"]}
    for name in names:
        path = folder / name
        if not path.is_file():
            raise BadInputError(f"{path} is missing: it was not written, or was removed since. {_AGAIN}")
        if name not in written:
            raise BadInputError(f"{path} is not listed in {MANIFEST_NAME}: it is of another run. {_AGAIN}")
        size, found = int(written[name]["bytes"]), path.stat().st_size
        if found != size:
            raise BadInputError(
                f"{path} is cut off or was changed: it has {found:,} bytes and was written with {size:,}. Copy it "
                "again, or map the survey again"
            )
        if size <= most and describe_file(path)["sha256"] != written[name]["sha256"]:
            raise BadInputError(f"{path} is damaged: its checksum is not that of {MANIFEST_NAME}. {_AGAIN}")


@dataclass(frozen=True)
class MapReader:
    """The layers of one map in its folder; from `open_map`.

    What reads them raises BadInputError if a file is missing or damaged.
    """

    folder: Path
    manifest: dict[str, Any]
    """The content of run.json."""
    grid: Grid
    """The grid of tiles."""
    window: TileWindow
    """The tiles that its rasters span."""
    georeference: Georeference
    """CRS and units of the survey."""
    rule: CostRule
    """How ride and risk became the cost of the layers."""
    vehicle: RouteVehicle
    """The vehicle that the map was made for."""
    rasters: KeptRasters = field(default_factory=KeptRasters, repr=False, compare=False)
    """Its rasters as they are opened."""

    @property
    def calibration_id(self) -> str:
        """Id of the calibration."""
        return str(self.manifest["calibration"]["id"])

    def kept_open(self) -> AbstractContextManager[None]:
        """Keep its files open from read to read in the body of a ``with``, and close them at its end."""
        return self.rasters.keep()

    def read(self, window: TileWindow, bands: Sequence[str] = _BANDS) -> TileField:
        """Read the tiles of a window, which may extend beyond the map.

        ``bands``: names of arrays of `TileField`. Those of the others are NaN, read-only and take no memory. Of tiles
        that a step closes in part the ride and p_fail are those of the ground beside the step.
        """
        found = self.values(window, bands)
        stepped = found["barred"] == Barred.STEP
        if stepped.any() and found.keys() & {"c_r_low", "c_r_high", "c_r", "p_fail"}:
            beside = self.values(window, ("c_r", "c_r_open", "p_fail_open"))
            stepped &= np.isfinite(beside["c_r_open"])
            for name in found.keys() & {"c_r_low", "c_r_high", "c_r"}:
                found[name][stepped] *= (beside["c_r_open"] / beside["c_r"])[stepped]
            if "p_fail" in found:
                found["p_fail"][stepped] = beside["p_fail_open"][stepped]
        nothing = np.broadcast_to(np.float32(np.nan), (window.rows, window.cols))
        columns = {band: found.get(band, nothing) for band in _BANDS}
        return TileField(
            self.grid, self.georeference, window, found["barred"], **columns, rule=self.rule, vehicle=self.vehicle
        )

    def values(self, window: TileWindow, bands: Sequence[str], *, classes: bool = False) -> dict[str, NDArray[Any]]:
        """Read what bars the tiles of a window, bands of roughness.tif by name, and if asked for the classes.

        Returns ``barred``, uint8: a `Barred`, or ``NO_TILE``; ``class_id``, uint8: ``NO_CLASS`` where unknown; bands,
        float32, NaN where unknown. Each (rows, cols), north row first.
        """
        shape = (window.rows, window.cols)
        barred = self._fill(MapFile.BARRED, window, np.full(shape, NO_TILE, np.uint8))
        out: dict[str, NDArray[Any]] = {"barred": barred}
        if classes:
            out["class_id"] = self._fill(MapFile.CLASS, window, np.full(shape, NO_CLASS, np.uint8))
        if bands:
            numbers = np.full((len(bands), *shape), np.nan, np.float32)
            out |= zip(bands, self._fill(MapFile.ROUGHNESS, window, numbers, bands), strict=True)
        if ((barred > max(Barred)) & (barred != NO_TILE)).any():
            raise BadInputError(f"{self.folder / MapFile.BARRED} holds unknown codes. Map the survey again")
        for band in set(bands) & {"c_r", "c_r_high", "p_fail"}:
            if (out[band] < 0.0).any() or (band == "p_fail" and (out[band] > 1.0).any()):
                raise BadInputError(f"{self.folder / MapFile.ROUGHNESS} is damaged: {band}. Map the survey again")
        return out

    def heights(self, window: TileWindow) -> NDArray[np.float32]:
        """Read heights of the ground, m, float32 (rows * pixels, cols * pixels); NaN where there is none."""
        return self.relief(window, self._shape(window))

    def gradient(self, window: TileWindow) -> NDArray[np.float32]:
        """Return the gradient of the ground of each tile: that of its corners, at the mean of the planes around them.

        The plane of a tile goes through the heights of its pixels. Planes of tiles that are closed by their ground do
        not count at the corners of others. So what one tile rises, the next goes on with, and the rise along a way is
        that of the ground whichever tiles it crosses. Returns float32 (rows, cols, 2): rise per metre southwards and
        eastwards; 0 where too few heights are known for a plane.
        """
        pixels = self.grid.pixels
        out = np.empty((window.rows, window.cols, 2), np.float32)
        at_once = max(1, _PLANE_PIXELS // (window.cols * pixels**2))
        for top, part in window.cut(at_once):
            around = part.grown(1)
            z = tiles_of(self.heights(around), pixels).reshape(around.rows, around.cols, -1)
            is_open = np.isin(self.read(around, ()).barred, OPEN_THROUGH)
            out[top : top + part.rows] = _corner_gradient(_planes(z), is_open)[1:-1, 1:-1] / self.grid.tile_size
        return out

    def relief(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Read mean heights of the ground from the overviews of heightmap.tif.

        ``window``: may extend beyond the map; ``shape``: rows and columns of the result, which spans the window.
        Returns heights in m, north row first; NaN where there is none. The map is placed to the nearest pixel.
        """
        return self._fill(MapFile.HEIGHTMAP, window, np.full(shape, np.nan, np.float32))

    def photo(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32] | None:
        """Read the colours of the points from the overviews of photo.tif; None if the map has no photo.

        ``window``, ``shape``: as for `relief`. Returns float32 (rows, cols, 3): red, green and blue, 0 to 255; NaN
        where there is none.
        """
        if MapFile.PHOTO not in _rasters(self.manifest):
            return None
        out = np.full((*shape, 3), np.nan, np.float32)
        self._fill(MapFile.PHOTO, window, np.moveaxis(out, -1, 0))
        return out

    def objects(self, window: TileWindow, shape: tuple[int, int] | None = None) -> NDArray[np.uint8]:
        """Read the objects on the ground, uint8 (rows * pixels, cols * pixels), or in another ``shape``.

        0 free, 1 obstacle, 2 canopy, 3 unknown, 4 a step that it cannot cross; 255 outside the tiles with points.
        """
        return self._fill(MapFile.OBSTACLE, window, np.full(shape or self._shape(window), NO_TILE, np.uint8))

    def passage(self, window: TileWindow, shape: tuple[int, int] | None = None) -> NDArray[np.bool_]:
        """Read where the middle of the vehicle can be, (rows * pixels, cols * pixels); nowhere outside the map.

        In another ``shape`` a pixel, of an overview, is closed where one of four is.
        """
        out = self._fill(MapFile.PASSAGE, window, np.full(shape or self._shape(window), NO_TILE, np.uint8))
        return np.asarray((out > 0) & (out != NO_TILE))

    def zone_at(self, point: NDArray[np.float64]) -> int:
        """Return the zone that a point, (2,) easting and northing [m], lies in; 0: in none.

        The zone of a tile is that of its largest area: in the others it is not known.
        """
        (col,), (row,) = tile = self.grid.index(point[:, None])
        window, pixels = TileWindow(int(col), int(row), 1, 1), self.grid.pixels
        right, up = self.grid.pixel(point[:, None], tile)[:, 0]
        area = self._fill(MapFile.PASSAGE, window, np.zeros((pixels, pixels), np.uint8))[pixels - 1 - up, right]
        return int(np.nan_to_num(self.values(window, ("zone",))["zone"][0, 0])) if area == 1 else 0

    def _shape(self, window: TileWindow) -> tuple[int, int]:
        return window.rows * self.grid.pixels, window.cols * self.grid.pixels

    def _fill(
        self, name: MapFile, window: TileWindow, out: NDArray[Number], bands: Sequence[str] = ()
    ) -> NDArray[Number]:
        """Read those of the pixels that span a window which lie on the map into an array, and return it.

        ``out``: ([bands,] rows, cols), north row first. With fewer pixels than the raster has they come from its
        overviews: numbers as means. ``bands``: names of the bands; none: the first.
        """
        from rasterio.enums import Resampling

        part, whole = common_window(window, self.window), out if out.ndim == 3 else out[None]
        if part is None:
            return out
        scales = whole.shape[1] / window.rows, whole.shape[2] / window.cols
        first = window.row + window.rows - part.row - part.rows, part.col - window.col
        sides = zip(first, (part.rows, part.cols), scales, strict=True)
        rows, cols = (slice(round(at * scale), round((at + size) * scale)) for at, size, scale in sides)
        inside = whole[:, rows, cols]
        if not inside.size:
            return out
        own, scale = self.window, self.grid.pixels if name in _PER_PIXEL else 1
        top, left = (own.row + own.rows - part.row - part.rows) * scale, (part.col - own.col) * scale
        place = ((top, top + part.rows * scale), (left, left + part.cols * scale))
        for each in self.manifest["files"]:
            if each["path"] == name and name in _rasters(self.manifest) and int(each["bytes"]) > CHECKED_BYTES:
                _compare(self.folder, name, int(each["bytes"]), str(each["sha256"]))
        with self.rasters.opened(self.folder / name) as file:
            if name == MapFile.PHOTO:
                inside[:] = read_colours(file, inside.shape[1:], place)
                return out
            if missing := [band for band in bands if band not in file.descriptions]:
                raise BadInputError(f"{self.folder / name} has no band {missing[0]}. {_AGAIN}")
            numbers = [file.descriptions.index(band) + 1 for band in bands] or [1]
            how = Resampling.average if out.dtype == np.float32 else Resampling.nearest
            file.read(numbers, window=place, out=inside, resampling=how)
        return out

    def to_grid(self, x: Coordinate, y: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Convert coordinates of the CRS to easting and northing on the grid, m."""
        unit = self.georeference.metres_per_unit
        return x * unit, y * unit

    def to_crs(self, easting: Coordinate, northing: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Convert easting and northing on the grid, m, to coordinates of the CRS."""
        unit = self.georeference.metres_per_unit
        return easting / unit, northing / unit

    def to_lonlat(self, easting: Coordinate, northing: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Convert easting and northing, m, to WGS 84 degrees: the inverse of `from_lonlat`."""
        longitude, latitude = self._to_wgs84.transform(*self.to_crs(easting, northing))
        return longitude, latitude

    def from_lonlat(self, longitude: Coordinate, latitude: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Convert WGS 84 longitude and latitude, degrees, to easting and northing on the grid, m.

        They are infinite where the CRS cannot be used. Raises BadInputError: the map has no CRS.
        """
        return self.to_grid(*self._to_wgs84.transform(longitude, latitude, direction="INVERSE"))

    @property
    def has_crs(self) -> bool:
        """True if longitude and latitude are known."""
        return self.georeference.crs is not None

    @cached_property
    def _to_wgs84(self) -> Transformer:
        crs = self.georeference.crs
        if crs is None:
            raise BadInputError(
                "the map has no CRS, so longitude and latitude are not known. Give points in the survey's own "
                "coordinates (crs:X,Y), or map the survey with `crs='EPSG:CODE'`"
            )
        try:
            return Transformer.from_crs(crs.to_2d(), CRS.from_epsg(4326), always_xy=True)
        except ProjError as error:
            raise BadInputError(
                f"the CRS of the map, {describe_crs(crs)}, has no known relation to longitude and latitude. Give "
                "points in the survey's own coordinates (crs:X,Y)"
            ) from error


def open_map(folder: str | os.PathLike[str]) -> MapReader:
    """Open the layers of a complete run.

    Raises BadInputError: the folder holds no complete run, or one of another version; or a raster is missing, cut off,
    or does not fit to the others.
    """
    folder, rasters = Path(folder), KeptRasters()
    manifest = read_manifest(folder)
    require_written(folder, manifest, _rasters(manifest), most=CHECKED_BYTES)
    crs, unit, cost, own = (manifest[name] for name in ("crs", "metres_per_unit", "cost", "vehicle"))
    try:
        known = None if crs is None else stated_crs(crs["wkt"])
    except CRSError as error:
        raise BadInputError(f"{folder / 'run.json'} is damaged: {error!r}. {_AGAIN}") from error
    grid = Grid(manifest["grid"]["tile_size_m"], manifest["grid"]["pixels"])
    georeference = Georeference(known, unit["horizontal"], unit["vertical"])
    weights = {"ride_weight": cost["ride_weight_m_per_rad"], "fail_weight": cost["fail_weight_m"]}
    limits = {"drive_m": cost["drive_m"], "slope_limit_deg": cost["slope_limit_deg"]}
    limits["drive_log_sd"] = cost.get("drive_log_sd", 0.0)
    rule = CostRule(**weights, **limits, speeds=tuple((c_r, mps) for mps, c_r in cost["speeds_mps_at_c_r_radpm"]))
    vehicle = RouteVehicle(own["name"], own["width_m"], own["speed_mps"])
    windows = {name: _window_of(folder, name, grid, georeference, rasters) for name in _rasters(manifest)}
    (first, window), *others = windows.items()
    for name, own in others:
        if own != window:
            raise BadInputError(f"{folder / name} spans other tiles than {folder / first}. {_AGAIN}")
    return MapReader(folder, manifest, grid, window, georeference, rule, vehicle, rasters)


def _rasters(manifest: Mapping[str, Any]) -> tuple[MapFile, ...]:
    """Return the rasters of a route that a map has."""
    written = {file["path"] for file in manifest["files"]}
    return (*_RASTERS, MapFile.PHOTO) if MapFile.PHOTO in written else _RASTERS


@lru_cache(maxsize=1024)
def _compare(folder: Path, name: str, size: int, sha256: str) -> None:
    """Compare the checksum of a raster once."""
    require_written(folder, {"files": [{"path": name, "bytes": size, "sha256": sha256}]}, [name])


def common_window(first: TileWindow, second: TileWindow) -> TileWindow | None:
    """Return the tiles that two windows share; None if there are none."""
    found = first.overlap(second)
    return found if found.cols > 0 and found.rows > 0 else None


def _window_of(folder: Path, name: MapFile, grid: Grid, georeference: Georeference, rasters: KeptRasters) -> TileWindow:
    path, pixels = folder / name, grid.pixels if name in _PER_PIXEL else 1
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


def _planes(z: NDArray[np.float32]) -> NDArray[np.float64]:
    """Put planes through the heights of tiles, (rows, cols, pixels * pixels), by least squares; NaN where unknown.

    Returns (3, rows, cols): height in the middle, rise over the tile southwards and eastwards; NaN without a plane.
    """
    side = math.isqrt(z.shape[2])
    at = (np.arange(side) + 0.5) / side - 0.5
    south, east = (x.ravel() for x in np.meshgrid(at, at, indexing="ij"))
    whole, known = np.square(south).sum(), np.isfinite(z)
    low = z[..., :1].astype(np.float64)
    up = z - low
    out = np.stack([up.mean(axis=2), (up * south).sum(axis=2) / whole, (up * east).sum(axis=2) / whole])
    row, col = np.nonzero(~known.all(axis=2))
    known, up = known[row, col], z[row, col].astype(np.float64)
    count = np.maximum(known.sum(axis=1), 1)
    mean = [np.where(known, x, 0.0).sum(axis=1) / count for x in np.broadcast_arrays(south, east, up)]
    down, right, rise = (np.where(known, x - m[:, None], 0.0) for x, m in zip((south, east, up), mean, strict=True))
    pairs = ((down, down), (down, right), (right, right), (down, rise), (right, rise))
    a, b, c, d, e = ((x * y).sum(axis=1) for x, y in pairs)
    det = a * c - b * b
    det[det < _LEAST_SPREAD * whole * whole] = np.nan
    slope = (c * d - b * e) / det, (a * e - b * d) / det
    out[:, row, col] = mean[2] - mean[0] * slope[0] - mean[1] * slope[1], *slope
    low[row, col] = 0.0
    out[0] += low[..., 0]
    return out


def _corner_gradient(planes: NDArray[np.float64], counts: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the rise of tiles southwards and eastwards, (rows, cols, 2), by the mean heights of their corners.

    ``planes`` as of `_planes`; those that do not count, (rows, cols), keep their own rise; 0 without a plane.
    """
    middle, south, east = planes
    rows, cols = middle.shape
    counts = counts & np.isfinite(middle)
    total, number = np.zeros((rows + 1, cols + 1)), np.zeros((rows + 1, cols + 1))
    ends = ((0, 0), (0, 1), (1, 0), (1, 1))
    for down, right in ends:
        height = middle + (down - 0.5) * south + (right - 0.5) * east
        total[down : rows + down, right : cols + right] += np.where(counts, height, 0.0)
        number[down : rows + down, right : cols + right] += counts
    mean = total / np.maximum(number, 1.0)
    nw, ne, sw, se = (mean[down : rows + down, right : cols + right] for down, right in ends)
    own = np.nan_to_num(planes[1:])
    return np.where(counts, 0.5 * np.stack([sw + se - nw - ne, ne + se - nw - sw]), own).transpose(1, 2, 0)
