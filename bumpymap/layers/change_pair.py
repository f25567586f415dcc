"""The layers of two surveys of a site, read window by window where both have tiles."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bumpymap.core import NO_CLASS, NO_TILE, BadInputError
from bumpymap.layers.map_files import require_written
from bumpymap.layers.placement import check_extent
from bumpymap.layers.route_map import RouteMap, open_map
from bumpymap.layers.route_overlap import SheetChoice, window_slices
from bumpymap.layers.route_sheet import common_window
from bumpytiles import TileWindow

__all__ = ["SurveyPair", "SurveyTiles", "open_pair"]

_BANDS = ("c_r", "c_r_low", "c_r_high", "density", "coverage")
_MUST_AGREE = "Map both with the same settings"


@dataclass(frozen=True, slots=True)
class SurveyTiles:
    """What one survey says of the tiles of a window. Arrays are (rows, cols), north row first."""

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

    before: RouteMap
    after: RouteMap
    window: TileWindow
    """The tiles that lie in the extent of both."""

    def tiles(self, window: TileWindow) -> tuple[SurveyTiles, SurveyTiles]:
        """Read the tiles of a window, before and after. Raises BadInputError if a file is missing or damaged."""
        return _read(self.before, window), _read(self.after, window)

    def heights(self, window: TileWindow) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Read the heightmaps of a window, before and after: (rows, cols, p, p), m; NaN where there is no height."""
        return _heightmaps(self.before, window), _heightmaps(self.after, window)


def open_pair(before: Path, after: Path) -> SurveyPair:
    """Open the layers of two surveys of one site.

    Raises
    ------
    BadInputError
        A folder holds no complete run; the surveys differ in CRS, grid, vehicle, calibration, rating or in which points
        are ground; or they have no place in common, or more than one map may span.
    """
    first, second = open_map([before]), open_map([after])
    _require_alike(first, second)
    for sheet in (*first.sheets, *second.sheets):
        require_written(sheet.folder, sheet.manifest, ("class.tif",))  # `open_map` does not look at it
    window = common_window(first.window, second.window)
    if window is None:
        raise BadInputError(
            f"{before} and {after} have no place in common: they are surveys of two sites. Give two surveys of one site"
        )
    check_extent(first.grid, window, "Compare one sheet of both at a time, by its folder in OUT/sheets. ")
    return SurveyPair(first, second, window)


def _require_alike(first: RouteMap, second: RouteMap) -> None:
    """Raise BadInputError if differences between the layers would not be differences between the surveys."""
    (one, *_), (other, *_) = first.sheets, second.sheets
    own = one.identity | {"ground points only": one.manifest.get("ground_only")}
    theirs = other.identity | {"ground points only": other.manifest.get("ground_only")}
    found = [f"{name} is {own[name]} and {theirs[name]}" for name in own if own[name] != theirs[name]]
    if not found and first.georeference.crs != second.georeference.crs:
        found = ["the definition of the CRS differs"]
    if found:
        raise BadInputError(f"{one.folder} and {other.folder} cannot be compared: {'; '.join(found)}. {_MUST_AGREE}")


def _read(site: RouteMap, window: TileWindow) -> SurveyTiles:
    barred = np.full((window.rows, window.cols), NO_TILE, np.uint8)
    class_id = np.full(barred.shape, NO_CLASS, np.uint8)
    values = [np.full(barred.shape, np.nan, np.float32) for _ in _BANDS]
    for sheet in site.sheets:
        part = common_window(window, sheet.window)
        if part is None:
            continue
        place = window_slices(window, part)
        found = sheet.read("barred.tif", part)[0]
        choice = SheetChoice.of(barred[place], found)
        barred[place] = choice.codes(barred[place], found)
        class_id[place] = choice.codes(class_id[place], sheet.read("class.tif", part)[0])
        for band, new in zip(values, sheet.read("roughness.tif", part, _BANDS), strict=True):
            band[place] = choice.values(band[place], new)
    return SurveyTiles(barred, class_id, *values)


def _heightmaps(site: RouteMap, window: TileWindow) -> NDArray[np.float32]:
    pixels = site.grid.pixels
    parts = site.heights(window).reshape(window.rows, pixels, window.cols, pixels)
    return np.ascontiguousarray(parts.swapaxes(1, 2))
