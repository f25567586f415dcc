"""The layers of two surveys where both have tiles, and what has changed between them: change.tif, change.geojson."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import BadInputError, Band
from bumpymap.layers._cog import TILE_WINDOW, write_cog
from bumpymap.layers.map_reader import MapReader, common_window, open_map, require_written
from bumpymap.layers.placement import Placement, RasterSpec, RasterWindow
from bumpymap.layers.products import MapFile
from bumpymap.layers.vector import GeoJsonCoordinates, feature, trace_labels, write_features
from bumpytiles import TileWindow

_COMPARED_BANDS = ("c_r", "c_r_low", "c_r_high", "density", "coverage")
_MOST_TILES = 100_000_000
"""Most tiles that are compared: the values of all of them are in memory, 44 bytes a tile and what follows from them."""


@dataclass(frozen=True, slots=True)
class SurveyTiles:
    """Values of one survey in the tiles of a window. Arrays are (rows, cols), north row first."""

    barred: NDArray[np.uint8]
    """A `Barred`, 0 where passable; ``NO_TILE`` where there is no tile."""
    class_id: NDArray[np.uint8]
    """Class; ``NO_CLASS`` where unknown."""
    c_r: NDArray[np.float32]
    """Ride cost, rad/m; NaN where unknown (so are the next two)."""
    c_r_low: NDArray[np.float32]
    c_r_high: NDArray[np.float32]
    density: NDArray[np.float32]
    """Points per m2; NaN where there is no tile."""
    coverage: NDArray[np.float32]
    """Share of the pixels that hold a point; NaN where there is no tile."""


@dataclass(frozen=True, slots=True)
class SurveyPair:
    """Two surveys that can be compared; from `open_pair`."""

    before: MapReader
    after: MapReader
    window: TileWindow
    """The tiles that lie in the extent of both."""

    def tiles(self, window: TileWindow) -> tuple[SurveyTiles, SurveyTiles]:
        """Read the tiles of a window, before and after. Raises BadInputError if a file is missing or damaged."""
        first, second = (
            SurveyTiles(**site.values(window, _COMPARED_BANDS, classes=True)) for site in (self.before, self.after)
        )
        return first, second

    def heights(self, window: TileWindow) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Read the heights of a window, which may extend beyond both surveys, before and after.

        Returns (rows * p, cols * p) each, m; NaN where there is no height.
        """
        return self.before.heights(window), self.after.heights(window)

    def cell_m(self, pixels: int) -> float:
        """Return the length of a number of pixels, m."""
        return pixels * self.before.grid.tile_size / self.before.grid.pixels


def open_pair(before: Path, after: Path) -> SurveyPair:
    """Open the layers of two surveys of one site.

    Raises BadInputError: a folder holds no complete run; the surveys differ in CRS, grid, vehicle, calibration, rating
    or in which points are ground; or they have no place in common, or one of too many tiles.
    """
    first, second = open_map(before), open_map(after)
    if found := _differences(first, second):  # they would not be differences between the surveys
        raise BadInputError(f"{before} and {after} cannot be compared: {found}. Map both with the same settings")
    for site in (first, second):
        require_written(site.folder, site.manifest, (MapFile.CLASS,))  # `open_map` does not look at it
    window = common_window(first.window, second.window)
    if window is None:
        raise BadInputError(
            f"{before} and {after} have no place in common: they are surveys of two sites. Give two surveys of one site"
        )
    if window.cols * window.rows > _MOST_TILES:
        raise BadInputError(
            f"{before} and {after} have {window.cols * window.rows:,} tiles in common, with those between them; "
            f"{_MOST_TILES:,} can be compared. Map the same part of both surveys, and compare these"
        )
    return SurveyPair(first, second, window)


def _differences(first: MapReader, second: MapReader) -> str:
    """Return how the settings and places of two maps differ, or nothing."""
    own, other = _identity(first), _identity(second)
    found = [f"{name} is {own[name]} and {other[name]}" for name in own if own[name] != other[name]]
    if not found and first.georeference.crs != second.georeference.crs:
        found = ["the definition of the CRS differs"]
    return "; ".join(found)


def _identity(site: MapReader) -> dict[str, Any]:
    """Return settings and place that maps must have in common to be compared, by the words that a message uses."""
    settings, crs = site.manifest["settings"], site.manifest["crs"]
    return {
        "tile size [m]": site.grid.tile_size,
        "pixels along a tile": site.grid.pixels,
        "CRS": None if crs is None else crs["name"],
        "metres per unit of the CRS": site.georeference.metres_per_unit,
        "vehicle": site.vehicle.name,
        "calibration": site.calibration_id,
        "rating": settings.get("rating"),
        "compat": settings.get("compat"),
        "ride weight [m/rad]": site.rule.ride_weight,
        "fail weight [m]": site.rule.fail_weight,
        "length of a calibration drive [m]": site.rule.drive_m,
        "slope limit [deg]": site.rule.slope_limit_deg,
        "width of the vehicle [m]": site.vehicle.width_m,
        "speed of the vehicle [m/s]": site.vehicle.speed_mps,
        "ground points only": site.manifest.get("ground_only"),
    }


_CHANGED = "0 not changed, 1 ride as before, 2 rougher, 3 smoother, 4 ride unknown in one survey, 5 ride not decided"
_BANDS = (
    Band("d_c_r", "rad/m", "ride cost after minus before"),
    Band("z_c_r", "", "difference of ln c_r over its combined spread"),
    Band("d_height", "m", "mean height after minus before, the offset taken off"),
    Band("d_largest", "m", "height difference farthest from 0 that two neighbouring pixels both reach"),
    Band("z_height", "", "evidence for another height, over its spread"),
    Band("z_shape", "", "evidence for another shape, over its spread"),
    Band("sd_height", "m", "standard deviation of d_height"),
    Band("least_volume", "m3", "smallest heap or pit on the tile found in 95 of 100 cases; infinite: none"),
    Band("changed", "", _CHANGED),
)
CHANGED_BAND = len(_BANDS)
"""Band of change.tif with the codes, from 1."""


@dataclass(frozen=True, slots=True)
class ChangeField:
    """Changes in the tiles of a window. Arrays are (rows, cols), north row first; NaN where not compared."""

    placement: Placement
    """The raster that the window spans."""
    d_c_r: NDArray[np.float32]
    """Ride cost after minus before, rad/m."""
    z_c_r: NDArray[np.float32]
    d_height: NDArray[np.float32]
    """Mean height after minus before, m."""
    d_largest: NDArray[np.float32]
    """Difference farthest from 0 that two neighbouring pixels both reach, m."""
    z_height: NDArray[np.float32]
    z_shape: NDArray[np.float32]
    sd_height: NDArray[np.float32]
    """Standard deviation of ``d_height``, m."""
    least_volume: NDArray[np.float32]
    """Smallest heap or pit on the tile that would have been found in 95 of 100 cases, m3."""
    changed: NDArray[np.float32]
    """0 not changed; 1 ground changed, ride as before; 2 rougher; 3 smoother; 4 ground changed, one ride unknown;
    5 ground changed, ride not decided."""
    area: NDArray[np.int32]
    """Number of the connected change that a tile belongs to, 1..m; 0: none."""
    regions: tuple[Mapping[str, Any], ...]
    """(m,) properties of each."""


def write_change_raster(field: ChangeField, path: Path) -> None:
    """Write change.tif. Raises OutputError if it cannot be written."""
    layers = np.stack([getattr(field, band.name) for band in _BANDS]).astype(np.float32, copy=False)
    spec = RasterSpec(
        bands=_BANDS,
        crs=field.placement.horizontal_crs,
        overviews="NEAREST",
        tags={"title": "change between two surveys", "changed": _CHANGED},
    )

    def paint(window: RasterWindow) -> NDArray[np.float32]:
        rows = slice(window.line, window.line + window.tiles.rows)
        return layers[:, rows, window.column : window.column + window.tiles.cols]

    write_cog(path, field.placement, spec, paint, TILE_WINDOW)


def write_change_regions(field: ChangeField, path: Path) -> None:
    """Write change.geojson: RFC 7946 in WGS 84, or the survey's own coordinates without a CRS; one change a feature."""
    place = GeoJsonCoordinates.of(field.placement, local=True)
    window, numbers = field.placement.window, range(1, len(field.regions) + 1)
    traced = trace_labels(field.area, window, slice(0, window.rows), numbers) if numbers else np.empty(0, object)
    features = [feature(*each) for each in zip(field.regions, place.polygons(traced), numbers, strict=True)]
    write_features(path, "change", place, features)
