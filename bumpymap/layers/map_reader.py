"""The layers of one run, or of several that are sheets of one map, read by window."""

import os
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from bumpymap.core import (
    NO_CLASS,
    NO_TILE,
    BadInputError,
    Barred,
    CostRule,
    Georeference,
    RouteVehicle,
    TileField,
    UsageError,
    describe_crs,
)
from bumpymap.layers.sheet_paths import sheet_folders
from bumpymap.layers.sheet_reader import (
    SheetReader,
    common_window,
    kept_rasters,
    sheet_choice,
    window_slices,
    worse_objects,
)
from bumpytiles import Grid, TileWindow

__all__ = ["MapReader", "map_differences", "open_map"]


Coordinate = TypeVar("Coordinate", float, NDArray[np.float64])
_Merge: TypeAlias = Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]]

_BANDS = ("c_r", "c_r_low", "c_r_high", "p_fail", "obstacle")


@dataclass(frozen=True)
class MapReader:
    """The layers of one map, in one folder or several; from `open_map`.

    Where sheets overlap, what is known counts before what is unknown, a barred tile before a passable one, and of two
    tiles alike the larger value of each band. So the order of the folders does not matter.
    """

    sheets: tuple[SheetReader, ...]
    window: TileWindow
    """The smallest window around the tiles of all sheets."""

    @property
    def grid(self) -> Grid:
        """The grid of tiles."""
        return self.sheets[0].grid

    @property
    def georeference(self) -> Georeference:
        """CRS and units of the survey."""
        return self.sheets[0].georeference

    @property
    def rule(self) -> CostRule:
        """How ride and risk became the cost of the layers."""
        return self.sheets[0].rule

    @property
    def vehicle(self) -> RouteVehicle:
        """The vehicle that the map was made for."""
        return self.sheets[0].vehicle

    @property
    def manifests(self) -> tuple[dict[str, Any], ...]:
        """The content of each run.json."""
        return tuple(sheet.manifest for sheet in self.sheets)

    @property
    def folders(self) -> tuple[Path, ...]:
        """The folder of each sheet."""
        return tuple(sheet.folder for sheet in self.sheets)

    @property
    def calibration_id(self) -> str:
        """Id of the calibration."""
        return self.sheets[0].calibration_id

    def kept_open(self) -> AbstractContextManager[None]:
        """Keep its files open from read to read in the body of a ``with``, and close them at its end."""
        return self.sheets[0].rasters.keep()

    def read(self, window: TileWindow, bands: Sequence[str] = _BANDS) -> TileField:
        """Read the tiles of a window, which may extend beyond the map.

        Parameters
        ----------
        window : TileWindow
        bands : sequence of str
            Of ``c_r``, ``c_r_low``, ``c_r_high``, ``p_fail`` and ``obstacle``. Arrays of the others are NaN, read-only
            and take no memory.

        Raises
        ------
        BadInputError
            A file is missing or damaged.
        """
        found = self.values(window, bands)
        nothing = np.broadcast_to(np.float32(np.nan), (window.rows, window.cols))
        columns = {band: found.get(band, nothing) for band in _BANDS}
        return TileField(
            self.grid, self.georeference, window, found["barred"], **columns, rule=self.rule, vehicle=self.vehicle
        )

    def values(self, window: TileWindow, bands: Sequence[str], *, classes: bool = False) -> dict[str, NDArray[Any]]:
        """Read what bars the tiles of a window, bands of roughness.tif by name, and if asked for the classes.

        Returns
        -------
        dict
            ``barred``, uint8: a `Barred`, or ``NO_TILE``; ``class_id``, uint8: ``NO_CLASS`` where unknown; bands,
            float32, NaN where unknown. Each (rows, cols), north row first.

        Raises
        ------
        BadInputError
            A file is missing or damaged.
        """
        shape = (window.rows, window.cols)
        out: dict[str, NDArray[Any]] = {"barred": np.full(shape, NO_TILE, np.uint8)}
        out |= {"class_id": np.full(shape, NO_CLASS, np.uint8)} if classes else {}
        out |= {band: np.full(shape, np.nan, np.float32) for band in bands}
        rasters = {
            "barred.tif": (),
            **({"class.tif": ()} if classes else {}),
            **({"roughness.tif": bands} if bands else {}),
        }
        overlapping = any(common_window(window, shared) is not None for shared in self._shared)
        for sheet in self.sheets:
            part = common_window(window, sheet.window)
            if part is None:
                continue
            place, choice = window_slices(window, part), None
            arrays = iter(out.values())
            for raster, names in rasters.items():
                own = [next(arrays)[place] for _ in names or (0,)]
                if not overlapping:
                    sheet.read_into(own, raster, part, names)
                    continue
                found = [np.empty_like(array) for array in own]
                sheet.read_into(found, raster, part, names)
                choice = choice or sheet_choice(own[0], found[0])  # what bars tiles is read first
                for old, new in zip(own, found, strict=True):
                    old[...] = choice(old, new)
        barred = out["barred"]
        if ((barred > max(Barred)) & (barred != NO_TILE)).any():
            raise BadInputError(f"barred.tif of {self.folders[0]} holds unknown codes. Map the survey again")
        for band in set(bands) & {"c_r", "c_r_high", "p_fail"}:
            if (out[band] < 0.0).any() or (band == "p_fail" and (out[band] > 1.0).any()):
                raise BadInputError(f"roughness.tif of {self.folders[0]} is damaged: {band}. Map the survey again")
        return out

    def heights(self, window: TileWindow) -> NDArray[np.float32]:
        """Read heights of the ground, m, float32 (rows * pixels, cols * pixels); NaN where there is none.

        Of two sheets the higher value counts.
        """
        return self.relief(window, self._shape(window))

    def relief(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Read mean heights of the ground from the overviews of heightmap.tif.

        Parameters
        ----------
        window : TileWindow
            May extend beyond the map.
        shape : tuple
            Rows and columns of the result, which spans the window.

        Returns
        -------
        float32 of that shape
            m, north row first; NaN where there is none. A sheet is placed to the nearest pixel; of two sheets the
            higher value counts.

        Raises
        ------
        BadInputError
            A file is missing or damaged.
        """
        return self._pixels("heightmap.tif", window, np.full(shape, np.nan, np.float32), np.fmax)

    def objects(self, window: TileWindow) -> NDArray[np.uint8]:
        """Read what stands on the ground, uint8 (rows * pixels, cols * pixels).

        0 free, 1 obstacle, 2 canopy, 3 unknown; 255 outside the tiles with points. Of two sheets, an obstacle counts
        first, then canopy, free, unknown.
        """
        return self._pixels("obstacle.tif", window, np.full(self._shape(window), NO_TILE, np.uint8), worse_objects)

    def passage(self, window: TileWindow) -> NDArray[np.bool_]:
        """Read where the middle of the vehicle can be, (rows * pixels, cols * pixels); nowhere outside the map.

        Where sheets overlap, what is closed in one of those that know the pixel is closed.
        """
        return self.passage_shown(window, self._shape(window))

    def passage_shown(self, window: TileWindow, shape: tuple[int, int]) -> NDArray[np.bool_]:
        """Read `passage` in ``shape`` pixels that span a window; one of an overview is closed where one of four is."""
        # NO_TILE is the largest code, so the smaller of two is the known one, or the closed one of two that are known.
        out = self._pixels("passage.tif", window, np.full(shape, NO_TILE, np.uint8), np.minimum)
        return np.asarray((out > 0) & (out != NO_TILE))

    def _shape(self, window: TileWindow) -> tuple[int, int]:
        return window.rows * self.grid.pixels, window.cols * self.grid.pixels

    def _pixels(self, raster: str, window: TileWindow, out: NDArray[Any], merge: _Merge) -> NDArray[Any]:
        """Fill pixels that span a window; ``merge`` says which of two sheets counts."""
        rows, cols = out.shape[0] / window.rows, out.shape[1] / window.cols
        for sheet in self.sheets:
            part = common_window(window, sheet.window)
            if part is None:
                continue
            place = tuple(
                slice(*np.rint(np.array([tiles.start, tiles.stop]) * scale).astype(int).tolist())
                for tiles, scale in zip(window_slices(window, part), (rows, cols), strict=True)
            )
            shape = place[0].stop - place[0].start, place[1].stop - place[1].start
            if min(shape) > 0:
                out[place] = merge(out[place], sheet.read_pixels(raster, part, shape))
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
        """Convert easting and northing on the grid, m, to WGS 84 longitude and latitude, degrees.

        They are infinite where the CRS cannot be used.

        Raises
        ------
        BadInputError
            The map has no CRS.
        """
        longitude, latitude = self._to_wgs84.transform(*self.to_crs(easting, northing))
        return longitude, latitude

    def from_lonlat(self, longitude: Coordinate, latitude: Coordinate) -> tuple[Coordinate, Coordinate]:
        """Convert WGS 84 longitude and latitude, degrees, to easting and northing on the grid, m.

        They are infinite where the CRS cannot be used.

        Raises
        ------
        BadInputError
            The map has no CRS.
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

    @cached_property
    def _shared(self) -> list[TileWindow]:
        """The windows that two sheets have in common; none in a map that was written in sheets."""
        sides = np.array([(w.col, w.row, w.col + w.cols, w.row + w.rows) for w in (s.window for s in self.sheets)])
        shared: list[TileWindow | None] = []
        for number, (west, south, east, north) in enumerate(sides[:-1].tolist()):
            later = sides[number + 1 :]
            meets = (later[:, 0] < east) & (later[:, 2] > west) & (later[:, 1] < north) & (later[:, 3] > south)
            others = [self.sheets[other].window for other in (np.flatnonzero(meets) + number + 1).tolist()]
            shared += [common_window(self.sheets[number].window, other) for other in others]
        return [window for window in shared if window is not None]


def open_map(folders: Sequence[str | os.PathLike[str]]) -> MapReader:
    """Open the layers of one map: the folder of a run, in sheets or not, or several that are sheets of one map.

    Parameters
    ----------
    folders : sequence of path
        Each holds a complete run.

    Raises
    ------
    BadInputError
        A folder holds no complete run, or one that cannot be read; or the folders differ in grid, CRS, vehicle,
        calibration or weights.
    UsageError
        There is no folder.
    """
    if not folders:
        raise UsageError("no folder of layers is given. Give the output folder of a run of bumpymap map")
    paths = [sheet for folder in folders for sheet in sheet_folders(folder)]
    rasters = kept_rasters()
    opened = {path.resolve(): SheetReader.open(path, rasters) for path in paths}
    first, *others = sheets = tuple(opened.values())
    for other in others:
        if found := map_differences(first, other):
            raise BadInputError(
                f"{first.folder} and {other.folder} are not sheets of one map: {found}. "
                "Give folders that were mapped with the same vehicle and settings, or one folder only"
            )
    windows = [sheet.window for sheet in sheets]
    west, south = min(window.col for window in windows), min(window.row for window in windows)
    east = max(window.col + window.cols for window in windows)
    north = max(window.row + window.rows for window in windows)
    return MapReader(sheets, TileWindow(west, south, east - west, north - south))


def map_differences(first: SheetReader, second: SheetReader, *, ground: bool = False) -> str:
    """Return how the settings and places of two runs differ, and with ``ground`` which points they took; or nothing."""
    own, other = (
        sheet.identity | ({"ground points only": sheet.manifest.get("ground_only")} if ground else {})
        for sheet in (first, second)
    )
    found = [f"{name} is {own[name]} and {other[name]}" for name in own if own[name] != other[name]]
    if not found and first.georeference.crs != second.georeference.crs:
        found = ["the definition of the CRS differs"]
    return "; ".join(found)
